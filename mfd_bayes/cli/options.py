"""Arguments and options that several commands have, and the settings made of them."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer
from typer import Argument, Option

from mfd_bayes.cli.errors import this_command

if TYPE_CHECKING:
    from mfd_bayes.pipeline.plan import Options

Settings = TypeVar("Settings")


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
    Literal["device", "new_test", "observation", "this_test"],
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
Quiet = Annotated[bool, Option("-q", "--quiet", help="Print only warnings and the verdict.")]


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
