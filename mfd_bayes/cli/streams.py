"""How a command ends: with one sentence on a mistake, and where its output takes nothing."""

from __future__ import annotations

import os
import re
import sys
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

import typer

from mfd_bayes.console import clean, say
from mfd_bayes.errors import MfdError
from mfd_bayes.jobs.signals import hinting

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@contextmanager
def mistakes(resume: Callable[[], str]) -> Iterator[None]:
    """Turn errors that a user can cause into one sentence and exit code 2."""

    def hint() -> str:
        command = resume()
        return f"; what is finished is kept, go on with: {clean(command)}" if command else ""

    try:
        with hinting(hint):
            yield
    except MfdError as error:
        refuse(str(error))
    except MemoryError as error:
        refuse(f"memory is too short{f': {error}' if str(error) else ''}{hint()}")
    except OSError as error:
        refuse(f"cannot write {error.filename or 'the output'}: {error.strerror or error}")


def refuse(sentence: str) -> NoReturn:
    """End with a sentence, in which words that no one reads to their end are cut."""
    sentence = re.sub(r"\S{500,}", lambda word: f"{word[0][:60]}…", sentence)
    say(f"mfd-bayes: {sentence}", err=True)
    raise typer.Exit(2)


class _Output:
    """The standard output, of which a reader that has seen enough, such as `head`, is no error."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except BrokenPipeError:
            forget_output()
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except BrokenPipeError:
            forget_output()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def checked_output() -> Iterator[None]:
    """End with exit code 2 and a sentence where what is printed cannot be written."""
    for number in (0, 1, 2):  # else the next file that is opened would get what is printed
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115, PTH123
    sys.stdout = _Output(sys.stdout)
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except OSError as error:
        forget_output()
        with suppress(OSError):
            say(f"mfd-bayes: cannot write the output: {error.strerror or error}", err=True)
        sys.exit(2)


def forget_output() -> None:
    """Let the standard output forget what it holds and gets; Python writes it at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
