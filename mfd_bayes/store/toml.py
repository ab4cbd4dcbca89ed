"""A TOML file as a dict, within limits on its size; texts as TOML strings and comments."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from mfd_bayes.records.inputs import why_invalid, why_no_file

LARGEST = 2**20  # largest file, bytes: ten times a campaign of 500 tests
DOTS = 200  # most dots of a line: parsing takes the square of the number of a key's parts


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


def quoted(text: str) -> str:
    """TOML basic string of a text."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def commented(text: str) -> str:
    """TOML comment of a text: on one line, with escapes for all that cannot be printed."""
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return f"# {shown}"
