"""The options of the command `respond`; the docstring is its help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from typer import Option

from mfd_bayes.options import Folder, Jobs, Quiet, Replace, RunFolder, Seed, TrustModel, Units, path


@dataclass(frozen=True)
class RespondOptions:
    """Compute a building's response to earthquakes, with this device as its dampers.

    Every draw of the dampers goes through a nonlinear time-history analysis. Writes
    FOLDER/report.html with the drift profile and its bands, histories, loops and
    limits, and the tables peaks.csv, limits.csv, draws.csv, peaks.tex and
    response.json. A step file without its step is given as FILE:0.01s. Files that
    are numbers alone are taken to be in g; FILE:0.01s:cm/s^2 says otherwise. A scaled
    peak above 5 g or below 0.0001 g is refused, as is one above 2 g without a unit.

    Example:
      mfd-bayes respond out --building b.toml --ground quake.AT2 -o response

    With --sweep actuation="500 psi to 1500 psi" it compares actuations.
    """

    out: RunFolder
    building: Annotated[Path, Option(parser=path, help="The building file; see init --building.")]
    grounds: Annotated[
        tuple[str, ...],
        Option("--ground", help="Ground motion, .AT2 or CSV; several by several --ground."),
    ]
    folder: Folder
    sweep: Annotated[
        str, Option(metavar="RANGE", help='actuation="500 psi to 1500 psi in 8 steps".')
    ] = ""
    quantity: Annotated[
        Literal["drift", "acceleration"], Option("--minimise", help="What the sweep makes small.")
    ] = "drift"
    statistic: Annotated[
        Literal["mean", "q90", "passing"],
        Option(help="By its mean, its 90 % quantile, or the probability to exceed its limit."),
    ] = "mean"
    kind: Annotated[
        Literal["new_test", "mean"],
        Option(help="With each damper's scatter from test to test, or without."),
    ] = "new_test"
    draws: Annotated[int, Option(min=10, max=5000)] = 300
    scale: Annotated[
        float | None, Option(help="Factor of every ground motion.", show_default="1")
    ] = None
    unit: Annotated[str, Option(metavar='"cm/s^2"', help="Unit of files that do not say it.")] = ""
    peak: Annotated[
        str, Option(metavar='"0.3 g"', help="Scale every ground motion to this peak.")
    ] = ""
    tolerance: Annotated[
        float, Option(help="Largest error of a draw's peak drift, as a share.")
    ] = 0.01
    jobs: Jobs = 0
    seed: Seed = 1
    units: Units = ""
    force: Replace = False
    quiet: Quiet = False
    trust_model: TrustModel = False
