"""Changes that damage a file: bytes of any file, and words, trees and parts of some formats."""

from __future__ import annotations

import copy
import io
import json
import re
import struct
import zipfile
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

Rng = np.random.Generator
Mutate = Callable[[bytes, Rng], bytes]

MAGIC = (
    *(0, 1, 2, 4, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1),
    2**64 - 1,
)
FLOATS = (float("nan"), float("inf"), float("-inf"), 1e308, 1e-308, 5e-324, -0.0)
WORDS = (
    *("", "0", "-1", "nan", "NaN", "inf", "-Infinity", "1e999", "-1e308", "1e-400", "1_000"),
    *("0x10", "1,5", "1.234.567", "9" * 400, "9" * 5000, "1e" + "9" * 30, "true", "null"),
    *("'", '"', '"""', "=cmd|' /C calc'!A0", "@SUM(1)", "\x1b[31mred", "\x1b]0;title\x07"),
    *("\u202eevil", "\u2028", "../../etc/passwd", "/etc/passwd", "CON", "\x00", "\ufeff", "\\"),
    *("{{7*7}}", "<script>", "$x^2", "kN", "[psi]", "time_s", "degC", "dB", "1/0", "a" * 3000),
    *("٣", "½", "−1", "\r", "\t", ";", ",", "500 psi", "1e300 psi", "0 s to 1e999 s"),
    *("500 psi/0", "1979-05-27T07:32:00", "#", "[[test]]"),
)
_TOKEN = re.compile(r"[+-]?\d[\d.eE+-]*|\w+|\s+|.", re.DOTALL)


def mutate_bytes(data: bytes, rng: Rng) -> bytes:
    """One to four things done to bytes wherever they stand; every other time none is moved."""
    if rng.random() < 0.5:
        return _flip(data, rng) if rng.random() < 0.5 else _put_number(data, rng)[: len(data)]
    for _ in range(rng.integers(1, 5)):
        data = _BYTE_CHANGES[rng.integers(len(_BYTE_CHANGES))](data, rng)
    return data


def mutate_text(data: bytes, rng: Rng) -> bytes:
    """Tokens and lines changed; now and then bytes."""
    if rng.random() < 0.2:
        return mutate_bytes(data, rng)
    text = data.decode("utf-8", "surrogateescape")
    for _ in range(rng.integers(1, 5)):
        text = _TEXT_CHANGES[rng.integers(len(_TEXT_CHANGES))](text, rng)
    return text.encode("utf-8", "surrogateescape")


def mutate_json(data: bytes, rng: Rng) -> bytes:
    """Values, keys and nesting of a tree changed; now and then tokens."""
    if rng.random() < 0.3:
        return mutate_text(data, rng)
    text = data.decode()
    for _ in range(rng.integers(1, 5)):
        tree = [json.loads(text)]  # anew, so that no part is there twice
        try:
            _change_tree(tree, rng)
            changed = json.dumps(tree[0])
        except (RecursionError, ValueError):  # nested too deeply, or a number too long
            return b"[" * 100_000
        text = changed if len(changed) < 10**6 else text
    return text.encode()


def mutate_tree(data: bytes, rng: Rng) -> bytes:
    """Leaves of a JSON tree replaced by others of their kind; every other time anything."""
    if rng.random() < 0.4:
        return mutate_json(data, rng)
    tree = json.loads(data)
    for _ in range(rng.integers(1, 4)):
        places = list(_leaves(tree))
        if places:
            node, key = places[rng.integers(len(places))]
            node[key] = _other(node[key], rng)
    return json.dumps(tree).encode()


def _leaves(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Every place of a tree that holds no tree."""
    for key in tree if isinstance(tree, dict) else range(len(tree)):
        if isinstance(tree[key], dict | list):
            yield from _leaves(tree[key])
        else:
            yield tree, key


def _other(value: Any, rng: Rng) -> Any:
    if rng.random() < 0.1:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        return _word(rng)
    if isinstance(value, int):
        return (-1, *MAGIC, 10**400)[rng.integers(len(MAGIC) + 2)]
    return (0.0, -1.0, 1, *FLOATS, float(10.0 ** rng.uniform(-9, 9)))[rng.integers(len(FLOATS) + 4)]


def mutate_zip(data: bytes, rng: Rng) -> bytes:
    """A part of a zip file changed and packed again; now and then the archive itself."""
    if rng.random() < 0.3:
        return mutate_bytes(data, rng)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    name = sorted(parts)[rng.integers(len(parts))]
    if rng.random() < 0.1:
        del parts[name]
    else:
        parts[name] = mutate_text(parts[name], rng)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for part, content in parts.items():
            archive.writestr(part, content)
    return packed.getvalue()


def _place(size: int, rng: Rng) -> int:
    """Somewhere in a file; often near its beginning, where headers are."""
    share = rng.random() ** (3 if rng.random() < 0.5 else 1)
    return int(share * max(size - 1, 0))


def _flip(data: bytes, rng: Rng) -> bytes:
    found = bytearray(data)
    for _ in range(int(rng.integers(1, 9)) if found else 0):
        found[_place(len(found), rng)] ^= 1 << int(rng.integers(8))
    return bytes(found)


def _truncate(data: bytes, rng: Rng) -> bytes:
    return data[: _place(len(data), rng)]


def _splice(data: bytes, rng: Rng) -> bytes:
    begin, at = _place(len(data), rng), _place(len(data), rng)
    piece = data[begin : begin + int(rng.integers(1, 200))]
    return data[:at] + piece + data[at + (len(piece) if rng.random() < 0.5 else 0) :]


def _repeat(data: bytes, rng: Rng) -> bytes:
    at, size = _place(len(data), rng), int(rng.integers(1, 100))
    return data[:at] + data[at : at + size] * int(rng.integers(2, 60)) + data[at + size :]


def _delete(data: bytes, rng: Rng) -> bytes:
    at = _place(len(data), rng)
    return data[:at] + data[at + int(rng.integers(1, 64)) :]


def _put_number(data: bytes, rng: Rng) -> bytes:
    order = "<>"[rng.integers(2)]
    if rng.random() < 0.2:
        packed = struct.pack(f"{order}d", FLOATS[rng.integers(len(FLOATS))])
    else:
        size, code = ((1, "B"), (2, "H"), (4, "I"), (8, "Q"))[rng.integers(4)]
        packed = struct.pack(order + code, MAGIC[rng.integers(len(MAGIC))] % 256**size)
    at = _place(len(data), rng)
    at -= at % len(packed) if rng.random() < 0.7 else 0
    return data[:at] + packed + data[at + (len(packed) if rng.random() < 0.8 else 0) :]


_BYTE_CHANGES = (_flip, _flip, _truncate, _splice, _repeat, _delete, _put_number, _put_number)


def _replace_token(text: str, rng: Rng) -> str:
    tokens = _TOKEN.findall(text[:20_000])
    if not tokens:
        return _word(rng)
    at = _place(len(tokens), rng)
    tokens[at] = _word(rng)
    return "".join(tokens) + text[20_000:]


def _swap_tokens(text: str, rng: Rng) -> str:
    tokens = _TOKEN.findall(text[:20_000]) or [""]
    one, other = _place(len(tokens), rng), _place(len(tokens), rng)
    tokens[one], tokens[other] = tokens[other], tokens[one]
    return "".join(tokens) + text[20_000:]


def _insert_word(text: str, rng: Rng) -> str:
    at = _place(len(text), rng)
    return text[:at] + _word(rng) + text[at:]


def _change_line(text: str, rng: Rng) -> str:
    lines = text.split("\n")
    at, other = _place(len(lines), rng), _place(len(lines), rng)
    match int(rng.integers(5)):
        case 0:
            del lines[at]
        case 1:
            lines.insert(at, lines[other])
        case 2:
            lines[at] = lines[at] * int(rng.integers(2, 30))
        case 3:
            lines[at], lines[other] = lines[other], lines[at]
        case _:
            lines[at:at] = [lines[at]] * int(rng.integers(2, 200))
    return "\n".join(lines)


def _change_sign(text: str, rng: Rng) -> str:
    signs = (",", ";", "\t", " ", ".", "\n", "\r\n", "=", "[", "]", "{", "}", '"')
    one, other = (signs[rng.integers(len(signs))] for _ in range(2))
    return text.replace(one, other, int(rng.integers(1, 20)) if rng.random() < 0.5 else -1)


def _nest(text: str, rng: Rng) -> str:
    at, depth = _place(len(text), rng), int(10 ** rng.uniform(0, 4.5))
    sign = ("[", "{", "(", "a.", '"', "{a=", "[[")[rng.integers(7)]
    return text[:at] + sign * depth + text[at:]


_TEXT_CHANGES = (
    *(_replace_token, _replace_token, _replace_token, _swap_tokens),
    *(_insert_word, _change_line, _change_sign, _nest),
)


def _word(rng: Rng) -> str:
    return WORDS[rng.integers(len(WORDS))]


def _change_tree(tree: list[Any], rng: Rng) -> None:
    """Change one place of a tree, found by a random walk from its root."""
    node: Any = tree
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        if not keys:
            return
        key = keys[rng.integers(len(keys))]
        if not isinstance(node[key], dict | list) or rng.random() < 0.2:
            break
        node = node[key]
    match int(rng.integers(7)):
        case 0:
            del node[key]
            if node is tree:
                tree.append(None)
        case 1 if isinstance(node, dict):
            node[_word(rng)] = node.pop(key)
        case 2:
            for _ in range(int(10 ** rng.uniform(0, 2.7))):
                node[key] = [node[key]] if rng.random() < 0.5 else {"a": node[key]}
        case 3:
            node[key] = _word(rng)
        case 4:
            node[key] = copy.deepcopy(tree[0])
        case 5 if isinstance(node[key], list):
            node[key] = node[key] * int(rng.integers(0, 4))
        case _:
            node[key] = _VALUES[rng.integers(len(_VALUES))]


_VALUES = (
    *(None, True, False, 0, -1, 1e308, -1e-308, float("nan"), float("inf"), 2**63, 10**400),
    *("", "x", [], {}, [[]], [None], {"": None}, [1, "2", None], {"0": 1, "1": 2}),
    *("calibrate", "done", 3.5),
)
