"""What is read as a file must be one: a pipe may never end, and a device has no content."""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from os import PathLike
from pathlib import Path
from typing import Any

from mfd_bayes.errors import MfdError

_KINDS = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def why_no_file(path: Path) -> str:
    """Why a path cannot be read as a file: "is a pipe, not a file"; "" where it may be one."""
    if "\0" in str(path):
        return "is no file: no name of one can hold the character NUL"
    mode = path.stat().st_mode
    return next((f"is {words}, not a file" for test, words in _KINDS if test(mode)), "")


def path_of(name: str, value: Any, error: type[MfdError]) -> Path:
    """Path that a caller gives as text or as a path."""
    if not isinstance(value, str | PathLike) or not isinstance(text := os.fspath(value), str):
        raise error(f"{name} must be a path, as text or pathlib.Path, got {value!r}")
    if "\0" in text:
        raise error(f"{name} must be a path without the character NUL, got {text!r}")
    return Path(text)


def file_inside(folder: Path, name: str) -> Path | None:
    """Path of a file that a text in a folder names, links followed; None where it lies outside."""
    path = (folder / name).resolve()
    inside = not Path(name).is_absolute() and path.is_relative_to(folder.resolve())
    return path if inside else None


def hash_file(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal; raises OSError where it cannot be read."""
    if reason := why_no_file(path):
        raise OSError(errno.EINVAL, reason, str(path))
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
