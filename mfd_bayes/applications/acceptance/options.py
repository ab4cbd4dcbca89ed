"""The options of the command `accept`; the docstring is its help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from mfd_bayes.options import (
    Cycles,
    Date,
    Folder,
    Quiet,
    Replace,
    RunFolder,
    Seed,
    Temperature,
    TrustModel,
    Units,
    path,
)


@dataclass(frozen=True)
class AcceptOptions:
    """Say whether a device is like the others: accepted, rejected, or that a record cannot tell.

    Compares slip force, peak force, energy, effective stiffness and damping, gap,
    and the whole loop of a record with what the run's tests scatter. A device is
    accepted where its own level is shown to lie within the limits (two one-sided
    tests, 5 % each); it is rejected where it lies beyond one and the scatter of
    tests does not explain it (5 % false alarms, over all quantities and the whole
    batch). Writes FOLDER/acceptance.csv, a page of A4 for each device, and with
    several devices a picture. Ends with exit code 1 where a device is rejected.

    Example:
      mfd-bayes accept out no17.csv --actuation "1000 psi" --device "no. 17" -o qc
      mfd-bayes accept out new/*.csv --actuation 1ksi --limit "slip=10 %" -o qc
    """

    out: RunFolder
    records: Annotated[tuple[Path, ...], Argument(parser=path, help="Records of the devices.")]
    folder: Folder
    actuation: Annotated[str, Option(help='Of the records, such as "1000 psi".')] = ""
    device: Annotated[
        tuple[str, ...],
        Option(metavar='"no. 17"', help="The device of all records; or repeat it for each."),
    ] = ()
    limit: Annotated[
        tuple[str, ...],
        Option(
            metavar='slip="15 %"',
            help="Largest deviation of slip, gap, energy, …, or all; may be repeated.",
            show_default="the campaign's, else its lambda_spec, its standard's, or all=15 %",
        ),
    ] = ()
    uncertainty: Annotated[
        str,
        Option(
            metavar='"0.5 %"',
            help="Of the records' load cell, where it is not the one of the tests.",
        ),
    ] = ""
    session: Annotated[str, Option(help="The session in which the records were made.")] = ""
    date: Date = ""
    cycles: Cycles = None
    temperature: Temperature = ""
    draws: Annotated[int, Option(min=200, max=10000)] = 1000
    seed: Seed = 0
    force: Replace = False
    units: Units = ""
    quiet: Quiet = False
    trust_model: TrustModel = False
