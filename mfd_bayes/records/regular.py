"""What is read as a file must be one: a pipe may never end, and a device has no content."""

from __future__ import annotations

import errno
import hashlib
import stat
from pathlib import Path

_KINDS = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def why_no_file(path: Path) -> str:
    """Why a path cannot be read as a file: "is a pipe, not a file"; "" where it may be one.

    Raises
    ------
    OSError
        When there is nothing at the path.
    """
    mode = path.stat().st_mode
    return next((f"is {words}, not a file" for test, words in _KINDS if test(mode)), "")


def hash_file(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal.

    Raises
    ------
    OSError
        When it cannot be read, or is a pipe or a device.
    """
    if reason := why_no_file(path):
        raise OSError(errno.EINVAL, reason, str(path))
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
