"""The options of the command `reweigh`; the docstring is its help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option

from mfd_bayes.options import Jobs, Quiet, RunFolder, Seed, TrustModel, Units, path


@dataclass(frozen=True)
class ReweighOptions:
    """Show a finished run under another prior file, mostly without sampling.

    Weights the draws of every test, and those of the population, by the ratio of
    both priors. Where the weights cannot be trusted (Pareto k above 0.7), leave too
    few effective draws, or the other prior allows what the first excludes, it
    samples that test or the population again. Writes reweighed.html
    and reweighed.csv: data sheet, laws, bands and verdicts of both priors side by
    side. With -o the run under the other prior becomes a run folder of its own.

    Example:
      mfd-bayes reweigh out --priors wider.toml
      mfd-bayes reweigh out --priors wider.toml -o out_wider
    """

    out: RunFolder
    priors: Annotated[str, Option(help="The other prior file: a name such as mfd, or a path.")]
    folder: Annotated[
        Path | None, Option("-o", "--out", parser=path, help="Run folder to write, a new one.")
    ] = None
    jobs: Jobs = 0
    seed: Seed = 1
    units: Units = ""
    quiet: Quiet = False
    trust_model: TrustModel = False
