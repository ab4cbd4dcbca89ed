"""Arguments and options that several commands have."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mfd_bayes.cli.exits import this_command

if TYPE_CHECKING:
    from mfd_bayes.pipeline.commands import Options


def path(text: str) -> Path:
    """Path of a text; an empty one, as of a variable that is not set, is not this folder."""
    if not str(text).strip():
        raise typer.BadParameter("expected a path, got an empty text")
    return Path(text)


Run = Annotated[Path, typer.Argument(parser=path, help="The run folder.")]
Campaign = Annotated[Path, typer.Argument(parser=path, help="The campaign file, campaign.toml.")]
NewRun = Annotated[Path, typer.Option("-o", "--out", parser=path, help="The run folder to write.")]
NewRunOrNone = Annotated[
    Path | None, typer.Option("-o", "--out", parser=path, help="The run folder to write.")
]
Pictures = Annotated[Path, typer.Option("-o", "--out", parser=path, help="Folder of the PNGs.")]
Replace = Annotated[bool, typer.Option("--force", help="Replace a file that exists.")]
Jobs = Annotated[int, typer.Option(min=0, help="Number of processes; 0 for one per processor.")]
Scheduler = Annotated[
    str,
    typer.Option(
        metavar="TCP://HOST:PORT", help="Calibrate on a dask cluster instead of this machine."
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="The same seed gives the same draws.")]
Resume = Annotated[bool, typer.Option("--resume", help="Finish a run that was interrupted.")]
Force = Annotated[bool, typer.Option("--force", help="Replace a run that exists.")]
Effort = Annotated[
    Literal["quick", "standard", "thorough"] | None,
    typer.Option(
        help="How many draws to aim at; with --resume leave it out: a run keeps its own.",
        show_default="standard",
    ),
]
Kind = Annotated[
    Literal["device", "new_test", "observation", "this_test"],
    typer.Option(
        help="What the band is about: the mean property, this device tested again, a measurement "
        "of it, or one calibrated test."
    ),
]
Units = Annotated[
    Literal["us", "si"] | None,
    typer.Option(help="Units of what is written.", show_default="the campaign's own"),
]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="Print only warnings and the verdict.")]


def completed(options: Options, out: Path | None, effort: str | None) -> Options:
    """Options with this command, and the effort given or else that of the run that is resumed."""
    from mfd_bayes.pipeline.commands import effort_of

    chosen = effort or "standard"
    if out is not None:
        chosen = effort_of(out, effort, resume=options.resume)
    return replace(options, effort=chosen, command=this_command())
