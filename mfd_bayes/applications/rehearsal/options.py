"""The options of the command `rehearse`; the docstring is its help."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass
from typing import Annotated, Literal

from typer import Option

from mfd_bayes.jobs.job import Workplace
from mfd_bayes.options import (
    Jobs,
    Quiet,
    RunFolder,
    Scheduler,
    TrustModel,
    Units,
)


@dataclass(frozen=True, kw_only=True)
class RehearseOptions(Workplace):
    """Rehearse a run: how often would its bounds hold a truth that is known.

    Each rehearsal takes a draw of the run's posterior for the truth, makes the
    records of all tests from it, calibrates them anew, and asks whether the data
    sheet's bounds hold that truth. Writes OUT/rehearsal.html, rehearsal.csv and
    rehearsal.png, and each rehearsal in OUT/rehearsal as it ends. After Ctrl-C the
    same command goes on. It does not test the model itself: see crossvalidate.

    Example:
      mfd-bayes rehearse out --runs 50 --effort quick
    """

    out: RunFolder
    runs: Annotated[int, Option(min=2, help="Number of rehearsals.")] = 50
    effort: Annotated[
        Literal["", "quick", "standard", "thorough"],
        Option(help="Of each calibration.", show_default="the run's own"),
    ] = ""
    jobs: Jobs = 0
    scheduler: Scheduler = ""
    force: Annotated[
        bool, Option("--force", help="Replace rehearsals that were made with other settings.")
    ] = False
    units: Units = ""
    quiet: Quiet = False
    trust_model: TrustModel = False

    def resumption(self) -> str:
        """The command that goes on where this one was interrupted: the same without `--force`."""
        return shlex.join(["mfd-bayes", *(word for word in sys.argv[1:] if word != "--force")])
