"""Options that several commands have: their types with the help that the command line shows.

A command is a frozen dataclass whose fields have such types; `cli.commands` makes it from that.
An empty default, "" or (), stands for an option that was not typed.
"""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option


def path(text: str) -> Path:
    """Path of a text; an empty one, as of a variable that is not set, is not this folder."""
    if not str(text).strip():
        raise typer.BadParameter("expected a path, got an empty text")
    return Path(text)


def this_command() -> str:
    """The command as it was typed."""
    return shlex.join(["mfd-bayes", *sys.argv[1:]])


def resumption() -> str:
    """The command that resumes this one."""
    words = [word for word in sys.argv[1:] if word not in ("--force", "--resume")]
    return shlex.join(["mfd-bayes", *words, "--resume"])


RunFolder = Annotated[Path, Argument(parser=path, help="The run folder.")]
Folder = Annotated[Path, Option("-o", "--out", parser=path, help="Folder to write.")]
Replace = Annotated[bool, Option("--force", help="Replace a file that exists.")]
ReplaceRun = Annotated[bool, Option("--force", help="Replace a run that exists.")]
Jobs = Annotated[int, Option(min=0, help="Number of processes; 0 for one per processor.")]
Scheduler = Annotated[
    str,
    Option(metavar="TCP://HOST:PORT", help="Calibrate on a dask cluster instead of this machine."),
]
Seed = Annotated[int, Option(min=0, help="The same seed gives the same draws.")]
Units = Annotated[
    Literal["", "us", "si"],
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
