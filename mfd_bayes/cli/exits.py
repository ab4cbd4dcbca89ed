"""How a command ends on an error: with one sentence, an exit code, and how to resume."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

import typer

from mfd_bayes.cli.console import clean, say
from mfd_bayes.cli.streams import CannotPrintError, drop
from mfd_bayes.errors import MfdError
from mfd_bayes.jobs.signals import hinting


@contextmanager
def mistakes(resume: str | Callable[[], str] = "") -> Iterator[None]:
    """Turn errors that a user can cause into one sentence and exit code 2.

    Parameters
    ----------
    resume : str or callable
        Command that resumes this one where it is interrupted, or what says it then.
    """

    def hint() -> str:
        command = resume() if callable(resume) else resume
        return f"; what is finished is kept, go on with: {clean(command)}" if command else ""

    try:
        with hinting(hint):
            yield
    except MfdError as error:
        _fail(str(error))
    except MemoryError as error:
        _fail(f"memory is too short{f': {error}' if str(error) else ''}{hint()}")
    except CannotPrintError:
        raise
    except OSError as error:
        _fail(f"cannot write {error.filename or 'the output'}: {error.strerror or error}")


_LONG = re.compile(r"\S{500,}")
"""A word that no one reads to its end, such as a number of thousands of digits."""


def _fail(sentence: str) -> NoReturn:
    sentence = _LONG.sub(lambda word: f"{word[0][:60]}…", sentence)
    try:
        say(f"mfd-bayes: {sentence}", err=True)
        sys.stderr.flush()
    except CannotPrintError as error:  # there may still be the output
        drop(error.number)
        say(f"mfd-bayes: {sentence}")
    raise typer.Exit(2)


def this_command() -> str:
    """The command as it was given."""
    return shlex.join(["mfd-bayes", *sys.argv[1:]])


def resumption() -> str:
    """The command that resumes this one."""
    given = [word for word in sys.argv[1:] if word not in ("--force", "--resume")]
    return shlex.join(["mfd-bayes", *given, "--resume"])
