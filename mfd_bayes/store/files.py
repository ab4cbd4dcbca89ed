"""Files of text, JSON and TOML: written completely or not at all, checked when they are read."""

from __future__ import annotations

import difflib
import json
import math
import os
import reprlib
import secrets
import stat
import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from mfd_bayes.errors import StoreError, why_invalid, why_no_file

PART = ".part"


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file under a temporary name in its folder, which is made, then rename it."""
    check_place(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}{PART}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("xb") as file:  # with the modes that the umask leaves
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise StoreError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):  # the folder became read-only; the next run removes it
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    write_bytes(path, text.encode())


def write_json(path: Path, content: object) -> None:
    """Write valid JSON atomically; numbers that are not finite become null."""
    write_text(path, json_text(content, indent=2) + "\n")


def json_text(content: object, indent: int | None = None) -> str:
    """Valid JSON; numbers that are not finite become null."""
    return json.dumps(_to_json(content), indent=indent, allow_nan=False)


def _to_json(content: object) -> object:
    if isinstance(content, Mapping):
        return {str(key): _to_json(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_to_json(value) for value in content]
    if isinstance(content, np.ndarray | np.generic):
        return _to_json(content.tolist())
    if isinstance(content, float):
        return content if np.isfinite(content) else None
    return str(content) if isinstance(content, Path) else content


def read_json(path: Path) -> dict[str, Any]:
    """Object of a JSON file."""
    try:
        if reason := why_no_file(path):
            raise StoreError(f"{path} {reason}")
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise StoreError(f"{path} is not valid JSON: {why_invalid(error)}") from error
    if not isinstance(content, dict):
        raise StoreError(f"{path} must hold a JSON object")
    return content


def check_place(path: Path) -> None:
    """Refuse a place in which a file would replace something that is no file of its folder."""
    try:
        if path.is_symlink() and not path.resolve().is_relative_to(path.parent.resolve()):
            raise StoreError(f"cannot write {path}: it is a link out of its folder")
        mode = path.stat().st_mode if path.exists() else stat.S_IFREG
    except (OSError, RuntimeError, ValueError) as error:  # links in a circle, too long a name
        reason = getattr(error, "strerror", None) or str(error)
        raise StoreError(f"cannot write {path}: {reason}") from error
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):  # a folder is refused by the system
        raise StoreError(f"cannot write {path}: it is a device or a pipe, and would be replaced")


def is_part(path: Path, name: str) -> bool:
    """Whether a file is a temporary one of `name` that a killed process left."""
    return path.name.startswith(f".{name}.") and path.suffix == PART


def remove_file(path: Path) -> None:
    """Remove a file if it is there."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise cannot_remove(path, error) from error


def cannot_remove(path: Path, error: OSError) -> StoreError:
    """Error that says what cannot be removed, and why."""
    return StoreError(f"cannot remove {error.filename or path}: {error.strerror or error}")


LARGEST_FIGURE = 1e100  # largest size of a figure: its square does not overflow


class Part(BaseModel):
    """An object of JSON; keys other than its fields are ignored."""

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)


Kind = TypeVar("Kind", bound=Part)


def _bounded(value: float) -> float:
    if abs(value) > LARGEST_FIGURE:  # false for NaN
        raise ValueError(f"must not be larger than {LARGEST_FIGURE:g} in size")
    return value


Figure = Annotated[
    float,
    Field(allow_inf_nan=True),
    BeforeValidator(lambda value: math.nan if value is None else value),
    AfterValidator(_bounded),
]
"""A computed number; null in JSON is NaN."""

Positive = Annotated[float, Field(gt=0.0, le=LARGEST_FIGURE)]
Index = Annotated[int, Field(ge=0)]

Item = TypeVar("Item")
AtLeastOne = Annotated[tuple[Item, ...], Field(min_length=1)]
Three = Annotated[tuple[Figure, ...], Field(min_length=3, max_length=3)]


def check(kind: type[Kind], content: Any, source: object) -> Kind:
    """Content of a JSON file as a `Part`.

    `source` is the file, for the message.
    """
    try:
        return kind.model_validate_json(json.dumps(content))  # strict, but lists become tuples
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        key = ".".join(str(segment)[:60] for segment in fault["loc"])
        raise StoreError(
            f"{source} is damaged or of another version of this program: "
            f"{f'{key}: ' if key else ''}{fault['msg'].removeprefix('Value error, ')}, "
            f"got {reprlib.repr(fault['input'])}"
        ) from None


LARGEST_TOML = 2**20  # largest file, bytes: ten times a campaign of 500 tests
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
        content = file.read(LARGEST_TOML + 1)
    if len(content) > LARGEST_TOML:
        raise TomlError(
            f"is larger than {LARGEST_TOML >> 20} MB, the most that is read of a TOML file"
        )
    for number, line in enumerate(content.split(b"\n"), start=1):
        if line.count(b".") > DOTS:
            raise TomlError(f"has more than {DOTS} dots in line {number}, the most that is read")
    try:
        return tomllib.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:  # also thousands of digits
        raise TomlError(f"is not valid TOML: {why_invalid(error)}") from error


RENAMED = {"fit": "window", "start": "initial", "spread": "sigma"}
"""Keys of files that have another name now."""

REPLACED = {"noise_check": "use mfd-bayes compare CAMPAIGN.toml -o OUT --noises ou,iid,staged"}
"""Keys of files that are no more, with what does their work."""


def nearest(name: str, names: Collection[str]) -> str:
    """Hint for a name that is not among those known."""
    if name in REPLACED:
        return REPLACED[name]
    if RENAMED.get(name) in names:
        return f"it is {RENAMED[name]!r} now"
    matches = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    return (
        f"did you mean {matches[0]!r}?" if matches else f"expected {', '.join(islice(names, 20))}"
    )


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
    sentences: list[str] = []
    for fault in error.errors(include_url=False):
        loc = [segment for segment in fault["loc"] if not str(segment).startswith((":", "[key]"))]
        key, value = _place(content, loc, name)
        location = f"{key} in {path}" if key else str(path)
        came, message = reprlib.repr(value), fault["msg"].removeprefix("Value error, ")
        if (
            fault["type"] == "too_short"
            and isinstance(value, list)
            and fault["ctx"]["min_length"] <= len(value)
        ):
            continue  # its entries have faults of their own, which are reported
        if fault["type"] == "extra_forbidden" or "[key]" in fault["loc"]:
            tables = [segment for segment in loc[:-1] if isinstance(segment, str)]
            section = f" in [{_place(content, loc[:-1], name)[0]}]" if tables else ""
            hint = nearest(str(loc[-1]), keys(tables))
            sentences.append(f"unknown key {str(loc[-1])!r}{section} of {path}; {hint}")
        elif fault["type"] == "missing":
            sentences.append(f"{key} is missing in {path}")
        elif fault["type"] == "tuple_type" and len(loc) == 1 and isinstance(value, dict):
            sentences.append(
                f"a {key} in {path} begins with [[{key}]], in two brackets, not [{key}]"
            )
        elif fault["type"] == "tuple_type":
            is_text = isinstance(value, str) and value.isprintable()
            example = f' such as ["{value}"]' if is_text else ""
            sentences.append(f"{location} should be a list{example}, got {came}")
        elif fault["type"] == "model_type":
            sentences.append(f"{location} should be a table, got {came}")
        elif message.startswith("Input should be"):
            sentences.append(f"{location} {message.removeprefix('Input ')}, got {came}")
        else:
            sentences.append(
                f"{location}: {message}" + ("" if came in message or not loc else f", got {came}")
            )
    sentences = list(dict.fromkeys(sentences))
    suffix = "; and more" if len(sentences) > MOST_FAULTS else ""
    return "; ".join(f"{sentence:.400}" for sentence in sentences[:MOST_FAULTS]) + suffix


def _place(content: Any, loc: Loc, name: Callable[[str], str]) -> tuple[str, Any]:
    """Key with its tables, joined by dots, and its value as the file has it.

    An entry of a list is called by its id, or by its number from 1.
    """
    text, value = "", content
    for segment in loc:
        try:
            value = value[segment]
        except (KeyError, IndexError, TypeError):
            value = None
        if isinstance(segment, int):
            entry_id = value.get("id") if isinstance(value, dict) else None
            text += f" {entry_id!r}" if isinstance(entry_id, str) else f" {segment + 1}"
        else:
            text += f".{name(segment)}" if text else name(segment)
    return text, value


def quoted(text: str) -> str:
    """TOML basic string of a text."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def commented(text: str) -> str:
    """TOML comment of a text: on one line, with escapes for all that cannot be printed."""
    escaped = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return f"# {escaped}"
