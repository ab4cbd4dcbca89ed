"""Standard streams that may be full, closed or broken: a command then ends with one sentence."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

_NAMES = {1: "the output", 2: "the messages"}


class CannotPrintError(OSError):
    """A standard stream takes nothing more."""

    def __init__(self, number: int, error: Exception) -> None:
        reason = getattr(error, "strerror", None) or str(error)
        super().__init__(f"cannot write {_NAMES[number]}: {reason}")
        self.number = number


class _Stream:
    """A standard stream, whose errors say that they are its own."""

    def __init__(self, stream: TextIO | None, number: int) -> None:
        self._closed = stream is None
        nowhere = Path(os.devnull)
        self._stream = stream or nowhere.open("w", encoding="utf-8")
        self._number = number

    def write(self, text: str) -> int:
        return int(self._done(self._stream.write, text))

    def flush(self) -> None:
        if not self._closed:
            self._done(self._stream.flush)

    def _done(self, act: Any, *given: str) -> Any:
        try:
            if self._closed:
                raise OSError(errno.EBADF, "it is closed")
            return act(*given)
        except (OSError, ValueError) as error:  # ValueError: closed in between
            if isinstance(error, BrokenPipeError) and self._number == 1:
                drop(1)  # its reader has seen enough
                return len("".join(given))
            raise CannotPrintError(self._number, error) from error

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def checked_streams() -> Iterator[None]:
    """End with exit code 2 and a sentence where what is printed cannot be written.

    The sentence goes to the other stream, where that takes it. A reader that has seen enough, such
    as `head`, is no error.
    """
    for number in (0, 1, 2):  # else the next file that is opened would get what is printed
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    sys.stdout, sys.stderr = _Stream(sys.stdout, 1), _Stream(sys.stderr, 2)
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
    except CannotPrintError as error:
        with suppress(OSError):
            os.write(3 - error.number, f"mfd-bayes: {error}\n".encode())
        drop(error.number)
        sys.exit(2)


def drop(number: int) -> None:
    """Let a standard stream that takes nothing more forget what it holds."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), number)  # Python writes the rest at its end
