"""The content of a campaign file, checked key by key; each error in one sentence."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from mfd_bayes.campaign.schema import Content, known_keys
from mfd_bayes.errors import CampaignError
from mfd_bayes.store.toml import TomlError, read_toml

_MOST_SENTENCES = 10
_LONGEST_SENTENCE = 400


def read_content(path: Path) -> Content:
    """Content of a campaign file.

    Raises
    ------
    CampaignError
        When the file cannot be read or is not TOML, or a key is unknown, missing or has a value
        that it may not have.
    """
    raw = _read(path)
    try:
        return Content.model_validate(raw)
    except ValidationError as error:
        sentences = [
            _cut(text) for text in islice(_sentences(path, raw, error), _MOST_SENTENCES + 1)
        ]
        more = "; and more" if len(sentences) > _MOST_SENTENCES else ""
        raise CampaignError("; ".join(sentences[:_MOST_SENTENCES]) + more) from None


def _read(path: Path) -> dict[str, Any]:
    if path.is_dir():
        example = path / "campaign.toml"
        raise CampaignError(f"{path} is a folder: give the campaign file in it, {example}")
    try:
        return read_toml(path)
    except FileNotFoundError as error:
        if not path.parent.is_dir():
            raise CampaignError(f"cannot read {path}: there is no folder {path.parent}") from error
        beside = [file.name for file in path.parent.glob("*.toml")]
        near = difflib.get_close_matches(path.name, beside, n=1)
        hint = f"; did you mean {path.parent / near[0]}?" if near else ""
        raise CampaignError(f"cannot read {path}: {error.strerror}{hint}") from error
    except OSError as error:
        raise CampaignError(f"cannot read {path}: {error.strerror or error}") from error
    except TomlError as error:
        raise CampaignError(f"{path} {error}") from error


def _sentences(path: Path, raw: dict[str, Any], error: ValidationError) -> Iterator[str]:
    """One sentence for each error: which key, what was expected, what came."""
    for fault in error.errors(include_url=False):
        loc = [part for part in fault["loc"] if not str(part).startswith((":", "[key]"))]
        key, came = _dotted(raw, loc), reprlib.repr(fault["input"])
        if loc == ["test"] and isinstance(raw.get("test"), dict):
            yield f"a test in {path} begins with [[test]], in two brackets, not [test]"
            continue
        if fault["type"] == "too_short" and raw.get("test"):
            continue  # there are tests, but each has an error of its own, which is reported
        if fault["type"] == "extra_forbidden":
            yield _unknown_key(path, raw, loc)
        elif fault["type"] == "missing":
            yield f"{key} is missing in {path}"
        elif fault["type"] == "tuple_type":
            yield f"{key} in {path} should be a list{_as_list(fault['input'])}, got {came}"
        elif fault["msg"].startswith("Input should be"):
            expected = fault["msg"].removeprefix("Input ")
            yield f"{key} in {path} {expected}, got {came}"
        else:
            reason = fault["msg"].removeprefix("Value error, ")
            yield f"{key} in {path}: {reason}" + ("" if came in reason else f", got {came}")


def _as_list(value: object) -> str:
    """How a text is written as a list."""
    return f' such as ["{value}"]' if isinstance(value, str) and value.isprintable() else ""


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST_SENTENCE else f"{text[:_LONGEST_SENTENCE]}…"


def _unknown_key(path: Path, raw: dict[str, Any], loc: list[int | str]) -> str:
    names = [part for part in loc[:-1] if isinstance(part, str)]
    known = known_keys(names[-1] if names else "")
    near = difflib.get_close_matches(str(loc[-1]), known, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}?" if near else f"expected {', '.join(known)}"
    section = f" in [{_dotted(raw, loc[:-1])}]" if names else ""
    return f"unknown key {str(loc[-1])!r}{section} of {path}; {hint}"


def _dotted(raw: dict[str, Any], loc: list[int | str]) -> str:
    """Key with its tables, joined by dots; a test by its id, or by its number from 1."""
    text = ""
    for part in loc:
        if isinstance(part, int):
            entry = raw["test"][part] if text == "test" else None
            name = entry.get("id") if isinstance(entry, dict) else None
            text += f" {name!r}" if isinstance(name, str) else f" {part + 1}"
        else:
            text += f".{part}" if text else part
    return text
