"""The options of the commands that look at data and calibrate; each docstring is a help."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option

from mfd_bayes.jobs.job import Workplace
from mfd_bayes.options import (
    Jobs,
    Quiet,
    Replace,
    ReplaceRun,
    RunFolder,
    Scheduler,
    Seed,
    TrustModel,
    Units,
    path,
    resumption,
)
from mfd_bayes.reporting.options import ReportOptions as ReportOptions

Campaign = Annotated[Path, Argument(parser=path, help="The campaign file, campaign.toml.")]
NewRun = Annotated[Path, Option("-o", "--out", parser=path, help="The run folder to write.")]
NewRunOrNone = Annotated[
    Path | None, Option("-o", "--out", parser=path, help="The run folder to write.")
]
Pictures = Annotated[Path, Option("-o", "--out", parser=path, help="Folder of the PNGs.")]
Resume = Annotated[bool, Option("--resume", help="Finish a run that was interrupted.")]
Effort = Annotated[
    Literal["", "quick", "standard", "thorough"],
    Option(
        help="How many draws to aim at; with --resume leave it out: a run keeps its own.",
        show_default="standard",
    ),
]


@dataclass(frozen=True)
class InitOptions:
    """Write a first campaign.toml for a folder of test files, or a first building.toml.

    Guesses columns, units, actuations and ids from the names and numbers of the
    files; what is not certain is marked "unsure" in the file, with the
    alternatives, and what is missing "FIXME". Writes FOLDER/campaign.toml, and
    FOLDER/priors.toml for a device that no shipped prior file knows: wide priors
    whose scales are read off the records. Of a campaign.toml only the latter is
    written, beside it.

    Example:
      mfd-bayes init tests
      mfd-bayes init tests/campaign.toml --force
      mfd-bayes init --building
      mfd-bayes init coupons --model steel.py:Steel
    """

    folder: Annotated[
        Path,
        Argument(
            parser=path, help="The folder of your test files, or a campaign.toml for its priors."
        ),
    ] = Path()
    force: Annotated[
        bool, Option("--force", help="Replace a campaign.toml or priors.toml that exists.")
    ] = False
    building: Annotated[
        bool, Option("--building", help="Write building.toml and ground.AT2 instead.")
    ] = False
    model: Annotated[
        str, Option("--model", help="Your own model, FILE.py:CLASS, in that folder; it is run.")
    ] = ""


@dataclass(frozen=True)
class InspectOptions:
    """Show what was read, warn of what would spoil a fit, and draw it.

    Columns, units, rate, peaks, cycles, energy and drifts; then warnings: swapped
    signs, lags, clipping, spikes, lost samples and the like. Warnings are not
    errors: the exit code stays 0.

    Writes a PNG of every test: NAME_inspect.png, here or in the folder of -o.

    Example:
      mfd-bayes inspect test.csv
      mfd-bayes inspect campaign.toml -o looks
    """

    file: Annotated[Path, Argument(parser=path, help="A test file or a campaign.toml.")]
    folder: Pictures = Path()
    force: Replace = False
    units: Units = ""


@dataclass(frozen=True)
class PriorCheckOptions:
    """Draw the prior predictive band of the force beside the data of every test.

    Where most of a test's force lies outside the band, the exit code is 1: it
    names the test, the prior that is most wrong and what would mend it. A test
    without actuation is only noted where others have one. Writes a PNG of every
    test: CAMPAIGN_ID_prior.png, here or in the folder of -o.

    Example:
      mfd-bayes prior-check campaign.toml
      mfd-bayes prior-check campaign.toml -o looks
    """

    campaign: Campaign
    folder: Pictures = Path()
    force: Replace = False
    units: Units = ""


@dataclass(frozen=True, kw_only=True)
class RunOptions(Workplace):
    """How a campaign is calibrated, and where; `command` is what was typed, and no option."""

    resume: Resume = False
    force: ReplaceRun = False
    jobs: Jobs = 0
    scheduler: Scheduler = ""
    seed: Seed = 1
    effort: Effort = ""
    quiet: Quiet = False
    command: str = ""

    def resumption(self) -> str:
        """The command that goes on where this one was interrupted."""
        return resumption()


@dataclass(frozen=True, kw_only=True)
class CalibrateOptions(RunOptions):
    """Calibrate every test of a campaign, infer the laws, and write the report.

    Writes the run folder OUT: report.html, tables of parameters and laws (CSV,
    JSON, LaTeX), checks.csv, pictures, and a posterior.nc of every test, which
    ArviZ opens. After Ctrl-C, what is finished is kept: --resume goes on.

    Example:
      mfd-bayes calibrate campaign.toml --dry-run
      mfd-bayes calibrate campaign.toml -o out
      mfd-bayes calibrate campaign.toml -o out --resume
    """

    campaign: Campaign
    out: NewRunOrNone = None
    dry_run: Annotated[bool, Option("--dry-run", help="Read and check only.")] = False
    strict: Annotated[bool, Option("--strict", help="Exit 1 if the run is not usable.")] = False

    def resumption(self) -> str:
        """The command that goes on where this one was interrupted; none of a dry run."""
        return "" if self.dry_run else resumption()


@dataclass(frozen=True)
class CheckOptions:
    """Show checks, warnings and the verdict on every test; exit 1 where the run is not usable.

    Shows how many checks of each kind passed, and every check that failed or needs
    care; --all shows every check. The verdict is "usable", "usable with care" or
    "not usable". Writes nothing; OUT/checks.csv holds every check.

    Example:
      mfd-bayes check out
      mfd-bayes check out --all
      mfd-bayes check out --quiet && echo fit to use
    """

    out: RunFolder
    every: Annotated[bool, Option("--all", help="Show every check.")] = False
    quiet: Quiet = False
    units: Units = ""
    trust_model: TrustModel = False


@dataclass(frozen=True, kw_only=True)
class CrossvalidateOptions(RunOptions):
    """Predict every part of a campaign from all the others, and score the predictions.

    Calibrates the campaign first; with --resume it takes the posteriors that
    OUT has. Then it leaves out one test, level of actuation, session or kind
    of motion after another and infers the population of the others. Writes
    OUT/crossvalidation.csv and the report.

    Example:
      mfd-bayes crossvalidate campaign.toml -o out --by level --resume
    """

    campaign: Campaign
    out: NewRun
    by: Annotated[
        str, Option(metavar="test|level|session|motion", help="What to leave out in turn.")
    ] = "test"


COMPARED = "three_stage,lugre,bouc_wen,backlash"


@dataclass(frozen=True, kw_only=True)
class CompareOptions(RunOptions):
    """Calibrate a campaign under several models or noises; say which one its records favour.

    Writes a run folder OUT/MODEL of each, and OUT/comparison.csv: how well each
    model predicts every cycle of a record from all others (PSIS-LOO), and its log
    evidence. OUT/datasheet_models.csv has the data sheet under each model and under
    their mixture, weighted by how each predicts motions left out with --by motion.
    The campaign's own model does not count. With --noises alone the campaign's model
    is calibrated with each noise, into OUT/NOISE; with both options each model
    with each noise, into OUT/MODEL_NOISE.

    Example:
      mfd-bayes compare campaign.toml -o out
      mfd-bayes compare campaign.toml -o out --models three_stage,lugre
      mfd-bayes compare campaign.toml -o out --noises ou,iid,staged
    """

    campaign: Campaign
    out: Annotated[
        Path, Option("-o", "--out", parser=path, help="Folder of one run for each model.")
    ]
    models: Annotated[
        str, Option(help="Two or more, with commas between them.", show_default=COMPARED)
    ] = ""
    noises: Annotated[str, Option(help="Compare noises too, or alone: such as ou,iid,staged.")] = ""
    by: Annotated[
        str, Option(help="Leave out each test, level, session or motion of each model's run too.")
    ] = ""


@dataclass(frozen=True)
class DemoOptions:
    """Calibrate a synthetic campaign after the MFD paper's test matrix.

    Writes its CSV files and campaign.toml under OUT/campaign, an example for
    your own, calibrates them, writes OUT/report.html and compares the posterior
    with the true values.

    Example:
      mfd-bayes demo out --quick
    """

    out: RunFolder
    quick: Annotated[bool, Option("--quick", help="Fewer draws, in a little less time.")] = False
    jobs: Jobs = 0
    scheduler: Scheduler = ""
    seed: Seed = 1
    force: ReplaceRun = False
    quiet: Quiet = False

    @property
    def effort(self) -> Literal["quick", "standard"]:
        """Effort of the calibration."""
        return "quick" if self.quick else "standard"

    def resumption(self) -> str:
        """The command that goes on where this one was interrupted."""
        campaign, words = self.out / "campaign" / "campaign.toml", ["--seed", str(self.seed)]
        words += ["--scheduler", self.scheduler] if self.scheduler else []
        if not campaign.is_file():  # it is written last
            quicker = ["--quick"] if self.quick else []
            return shlex.join(["mfd-bayes", "demo", str(self.out), *quicker, *words, "--force"])
        run = [str(campaign), "-o", str(self.out), "--effort", self.effort]
        return shlex.join(["mfd-bayes", "calibrate", *run, *words, "--resume"])
