"""What the commands share: their arguments and options, and how each of them ends."""

from __future__ import annotations

import os
import re
import shlex
import sys
from contextlib import contextmanager, suppress
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn, TextIO, TypeVar

import typer
from typer import Argument, Option
from typer.core import TyperCommand, TyperGroup

from mfd_bayes.cli.console import clean, say
from mfd_bayes.errors import MfdError
from mfd_bayes.jobs.signals import hinting

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mfd_bayes.pipeline.plan import Options


class Command(TyperCommand):
    """A command that refuses an empty text, as of a variable that is not set, for an option."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command, when no option was given an empty text."""
        for param in self.params:
            value = ctx.params.get(param.name)
            source = ctx.get_parameter_source(param.name)
            if isinstance(value, str) and not value.strip() and source.name == "COMMANDLINE":
                name = next(reversed(param.opts), param.name)
                raise typer.BadParameter(
                    "got an empty text: give a value, or leave it out", param_hint=name
                )
        return super().invoke(ctx)


class Commands(TyperGroup):
    """The commands; a word typed wrongly is answered in click's own lines, without a box."""

    def main(self, args: Any = None, *, standalone_mode: bool = True, **extra: Any) -> Any:  # type: ignore[override]
        """Run a command; where it stands alone, exit as it asks for."""
        try:
            code = super().main(args, standalone_mode=False, **extra)
        except Exception as error:
            usage: Any = error
            if not standalone_mode or not hasattr(error, "show"):
                raise
            usage.message = str(usage.message).removeprefix("Value error, ")
            if usage.format_message():  # else the help was shown
                usage.show()
            sys.exit(2)
        if not standalone_mode:
            return code
        sys.exit(code if isinstance(code, int) else 0)


@contextmanager
def mistakes(resume: str | Callable[[], str] = "") -> Iterator[None]:
    """Turn errors that a user can cause into one sentence and exit code 2."""

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
    except OSError as error:
        _fail(f"cannot write {error.filename or 'the output'}: {error.strerror or error}")


def _fail(sentence: str) -> NoReturn:
    """End with a sentence, in which words that no one reads to their end are cut."""
    sentence = re.sub(r"\S{500,}", lambda word: f"{word[0][:60]}…", sentence)
    say(f"mfd-bayes: {sentence}", err=True)
    raise typer.Exit(2)


def this_command() -> str:
    """The command as it was given."""
    return shlex.join(["mfd-bayes", *sys.argv[1:]])


def resumption() -> str:
    """The command that resumes this one."""
    words = [word for word in sys.argv[1:] if word not in ("--force", "--resume")]
    return shlex.join(["mfd-bayes", *words, "--resume"])


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


def path(text: str) -> Path:
    """Path of a text; an empty one, as of a variable that is not set, is not this folder."""
    if not str(text).strip():
        raise typer.BadParameter("expected a path, got an empty text")
    return Path(text)


Run = Annotated[Path, Argument(parser=path, help="The run folder.")]
Campaign = Annotated[Path, Argument(parser=path, help="The campaign file, campaign.toml.")]
NewRun = Annotated[Path, Option("-o", "--out", parser=path, help="The run folder to write.")]
NewRunOrNone = Annotated[
    Path | None, Option("-o", "--out", parser=path, help="The run folder to write.")
]
Folder = Annotated[Path, Option("-o", "--out", parser=path, help="Folder to write.")]
Pictures = Annotated[Path, Option("-o", "--out", parser=path, help="Folder of the PNGs.")]
Replace = Annotated[bool, Option("--force", help="Replace a file that exists.")]
Jobs = Annotated[int, Option(min=0, help="Number of processes; 0 for one per processor.")]
Scheduler = Annotated[
    str,
    Option(metavar="TCP://HOST:PORT", help="Calibrate on a dask cluster instead of this machine."),
]
Seed = Annotated[int, Option(min=0, help="The same seed gives the same draws.")]
Resume = Annotated[bool, Option("--resume", help="Finish a run that was interrupted.")]
Force = Annotated[bool, Option("--force", help="Replace a run that exists.")]
Effort = Annotated[
    Literal["quick", "standard", "thorough"] | None,
    Option(
        help="How many draws to aim at; with --resume leave it out: a run keeps its own.",
        show_default="standard",
    ),
]
Kind = Annotated[
    Literal["mean", "new_test", "observation", "this_test"],
    Option(
        help="What the band is about: the mean property, this device tested again, a measurement "
        "of it, or one calibrated test."
    ),
]
Units = Annotated[
    Literal["us", "si"] | None,
    Option(help="Units of what is written.", show_default="the campaign's own"),
]
Date = Annotated[str, Option(help="The day of the test, as 2024-03-05.")]
Cycles = Annotated[float | None, Option(min=0, help="Cycles that the device had made before.")]
Temperature = Annotated[str, Option(help='Of the device, such as "20 °C".')]
TrustModel = Annotated[
    bool,
    Option("--trust-model", help="Run the model.py of a run that is not yours; read it first."),
]
Quiet = Annotated[bool, Option("-q", "--quiet", help="Print only warnings and the verdict.")]


Settings = TypeVar("Settings")


def settings(kind: type[Settings], context: typer.Context, **changed: Any) -> Settings:
    """Settings of a command of the pipeline: its fields are the options of the same names.

    What is not typed, and has no default, is left to the settings' own default.
    """
    names = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    typed = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in context.params.items()
        if name in names and value is not None
    }
    return kind(**typed | changed)


def run_options(context: typer.Context, out: Path | None, **changed: Any) -> Options:
    """Options of a calibration, with this command and the effort of the run that is resumed."""
    from mfd_bayes.pipeline.plan import Options, effort_of

    typed = context.params
    effort = changed.pop("effort", typed.get("effort"))
    if out is not None:
        effort = effort_of(out, effort, resume=typed.get("resume", False))
    effort = effort or "standard"
    return settings(Options, context, effort=effort, command=this_command(), **changed)
