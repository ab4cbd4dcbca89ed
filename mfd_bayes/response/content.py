"""The content of a building file, checked key by key; each error in one sentence."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from mfd_bayes.errors import BuildingError
from mfd_bayes.response.schema import Content, known_keys
from mfd_bayes.store.toml import TomlError, read_toml

_MOST = 8  # sentences


def read_content(path: Path) -> Content:
    """Content of a building file.

    Raises
    ------
    BuildingError
        When the file cannot be read or is not TOML, or a key is unknown, missing or has a value
        that it may not have.
    """
    try:
        raw = read_toml(path)
    except OSError as error:
        raise BuildingError(f"cannot read {path}: {error.strerror or error}") from error
    except TomlError as error:
        raise BuildingError(f"{path} {error}") from error
    return content_of(raw, str(path))


def content_of(raw: dict[str, Any], path: str) -> Content:
    """Content of a parsed building file; `path` is its name in messages."""
    try:
        return Content.model_validate(raw)
    except ValidationError as error:
        found = list(islice(dict.fromkeys(_sentences(path, raw, error)), _MOST))
        raise BuildingError("; ".join(found)) from None


def _sentences(path: str, raw: dict[str, Any], error: ValidationError) -> Iterator[str]:
    for fault in error.errors(include_url=False):
        loc = [part for part in fault["loc"] if not _is_kind(part)]
        key, came = _dotted(loc), reprlib.repr(fault["input"])
        reason = fault["msg"].removeprefix("Value error, ")
        if fault["type"] == "extra_forbidden":
            yield _unknown_key(path, loc)
        elif fault["type"] == "missing":
            yield f"{key} is missing in {path}"
        elif loc and isinstance(raw.get(str(loc[0])), dict) and loc[0] in ("storey", "damper"):
            yield f"a {loc[0]} in {path} begins with [[{loc[0]}]], in two brackets"
        elif fault["type"] == "value_error":
            at = f"{key} in {path}" if key else path
            yield f"{at}: {reason}" + ("" if came in reason or not loc else f", got {came}")
        else:
            value = _value(raw, loc)
            yield f"{key} in {path}: {_expected(reason)}, got {value!r}"


def _expected(reason: str) -> str:
    return reason.replace("Input should be", "it must be")


def _value(raw: Any, loc: list[Any]) -> Any:
    """What the file has at a place."""
    for part in loc:
        try:
            raw = raw[part]
        except (KeyError, IndexError, TypeError):
            break
    return raw


def _is_kind(part: object) -> bool:
    """Whether a part of a place names a kind among several, not a key."""
    text = str(part)
    return text.startswith(("function-", "tuple[", "constrained", "nullable")) or text in (
        *("str", "float", "History", "none"),
    )


def _unknown_key(path: str, loc: list[Any]) -> str:
    names = [part for part in loc[:-1] if isinstance(part, str)]
    known = known_keys(names[-1] if names else "")
    near = difflib.get_close_matches(str(loc[-1]), known, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}?" if near else f"expected {', '.join(known)}"
    section = f" in [{_dotted(loc[:-1])}]" if names else ""
    return f"unknown key {str(loc[-1])!r}{section} of {path}; {hint}"


def _dotted(loc: list[Any]) -> str:
    """Key with its tables, joined by dots; those of lists with their number from 1."""
    text = ""
    for part in loc:
        text += f" {part + 1}" if isinstance(part, int) else (f".{part}" if text else part)
    return text
