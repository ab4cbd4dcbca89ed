"""A TOML file as a dict, and what is wrong with it in sentences; texts as TOML strings."""

from __future__ import annotations

import difflib
import json
import reprlib
import tomllib
from collections.abc import Callable, Collection, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from mfd_bayes.records.inputs import why_invalid, why_no_file

LARGEST = 2**20  # largest file, bytes: ten times a campaign of 500 tests
DOTS = 200  # most dots of a line: parsing takes the square of the number of a key's parts
MOST_FAULTS = 10  # that a message lists

Loc = Sequence[int | str]  # keys and numbers of entries, from the file's top to a value


class TomlError(Exception):
    """Why a file is not read; the message follows the file's name."""


def read_toml(path: Path) -> dict[str, Any]:
    """Content of a TOML file."""
    if reason := why_no_file(path):
        raise TomlError(reason)
    with path.open("rb") as file:
        content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise TomlError(f"is larger than {LARGEST >> 20} MB, the most that is read of a TOML file")
    for number, line in enumerate(content.split(b"\n"), start=1):
        if line.count(b".") > DOTS:
            raise TomlError(f"has more than {DOTS} dots in line {number}, the most that is read")
    try:
        return tomllib.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:  # also thousands of digits
        raise TomlError(f"is not valid TOML: {why_invalid(error)}") from error


def nearest(name: str, known: Collection[str]) -> str:
    """Hint for a name that is not among those known."""
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"did you mean {near[0]!r}?" if near else f"expected {', '.join(islice(known, 20))}"


def faults_text(
    path: Path,
    content: dict[str, Any],
    error: ValidationError,
    keys: Callable[[list[str]], Collection[str]],
    name: Callable[[str], str] = str,
) -> str:
    """What pydantic found in a file: of each fault the key, what was expected and what came.

    `keys` tells the keys that a table may have, by its name and those of the tables around it.
    `name` is what the file calls a key of the schema. Tags of unions begin with a colon.
    """
    found: list[str] = []
    for fault in error.errors(include_url=False):
        loc = [part for part in fault["loc"] if not str(part).startswith((":", "[key]"))]
        key, value = _place(content, loc, name)
        at = f"{key} in {path}" if key else str(path)
        came, message = reprlib.repr(value), fault["msg"].removeprefix("Value error, ")
        if (
            fault["type"] == "too_short"
            and isinstance(value, list)
            and fault["ctx"]["min_length"] <= len(value)
        ):
            continue  # its entries have faults of their own, which are reported
        if fault["type"] == "extra_forbidden" or "[key]" in fault["loc"]:
            tables = [part for part in loc[:-1] if isinstance(part, str)]
            section = f" in [{_place(content, loc[:-1], name)[0]}]" if tables else ""
            hint = nearest(str(loc[-1]), keys(tables))
            found.append(f"unknown key {str(loc[-1])!r}{section} of {path}; {hint}")
        elif fault["type"] == "missing":
            found.append(f"{key} is missing in {path}")
        elif fault["type"] == "tuple_type" and len(loc) == 1 and isinstance(value, dict):
            found.append(f"a {key} in {path} begins with [[{key}]], in two brackets, not [{key}]")
        elif fault["type"] == "tuple_type":
            is_text = isinstance(value, str) and value.isprintable()
            example = f' such as ["{value}"]' if is_text else ""
            found.append(f"{at} should be a list{example}, got {came}")
        elif fault["type"] == "model_type":
            found.append(f"{at} should be a table, got {came}")
        elif message.startswith("Input should be"):
            found.append(f"{at} {message.removeprefix('Input ')}, got {came}")
        else:
            found.append(
                f"{at}: {message}" + ("" if came in message or not loc else f", got {came}")
            )
    found = list(dict.fromkeys(found))
    more = "; and more" if len(found) > MOST_FAULTS else ""
    return "; ".join(f"{sentence:.400}" for sentence in found[:MOST_FAULTS]) + more


def _place(content: Any, loc: Loc, name: Callable[[str], str]) -> tuple[str, Any]:
    """Key with its tables, joined by dots, and its value as the file has it.

    An entry of a list is called by its id, or by its number from 1.
    """
    text, value = "", content
    for part in loc:
        try:
            value = value[part]
        except (KeyError, IndexError, TypeError):
            value = None
        if isinstance(part, int):
            own = value.get("id") if isinstance(value, dict) else None
            text += f" {own!r}" if isinstance(own, str) else f" {part + 1}"
        else:
            text += f".{name(part)}" if text else name(part)
    return text, value


def quoted(text: str) -> str:
    """TOML basic string of a text."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def commented(text: str) -> str:
    """TOML comment of a text: on one line, with escapes for all that cannot be printed."""
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return f"# {shown}"
