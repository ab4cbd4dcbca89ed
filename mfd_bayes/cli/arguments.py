"""Arguments and options that commands share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class EffortName(StrEnum):
    """How far a sampling goes."""

    quick = "quick"
    standard = "standard"
    thorough = "thorough"


class Kind(StrEnum):
    """What a band holds."""

    device = "device"
    new_test = "new_test"
    observation = "observation"


Out = Annotated[Path, typer.Argument(help="The run folder.")]
Campaign = Annotated[Path, typer.Argument(help="The campaign file, campaign.toml.")]
Jobs = Annotated[int, typer.Option(min=0, help="Processes; 0 for one a processor.")]
Scheduler = Annotated[
    str,
    typer.Option(metavar="TCP://HOST:PORT", help="Do the tests on a dask cluster, and not here."),
]
Seed = Annotated[int, typer.Option(min=0, help="The same seed gives the same draws.")]
Force = Annotated[bool, typer.Option("--force", help="Replace a run that is there.")]
Effort = Annotated[
    EffortName | None,
    typer.Option(
        help="How far to sample; that of the run where one is resumed.", show_default="standard"
    ),
]
Quiet = Annotated[
    bool, typer.Option("-q", "--quiet", help="Say nothing but warnings and the verdict.")
]
