"""The options of the command `next`; the docstring is its help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option

from mfd_bayes.options import Quiet, Replace, RunFolder, Seed, TrustModel, Units, path


@dataclass(frozen=True)
class NextTestOptions:
    """Say which test to make next: by how much each narrows a band or an interval.

    Simulates every candidate from the posterior and finds how much narrower the
    goal's band would be once it is calibrated. Writes OUT/next.csv, next.json
    and next.png. Goals: band (the default, over the campaign's range), energy,
    peak, peak_fwd, peak_bwd, slip, each "at" some tests; gap; "slope of Fc_fwd";
    "exponent of Fc_fwd". A test in words has an actuation, a frequency, an
    amplitude (half the stroke), and may have cycles, a waveform (sine, triangle)
    and its cost as a time; semicolons are between tests, and bars between
    values. Goal, candidates and limits can also stand in the table "goal" of the
    campaign file.

    Example:
      mfd-bayes next out
      mfd-bayes next out --goal "band at 1000 psi, 0.5 Hz, 1 in"
      mfd-bayes next out --protocol asce7-22
    """

    out: RunFolder
    goal: Annotated[
        str, Option(help='What to know better: "energy at 1000 psi, 0.5 Hz, 1 in".')
    ] = ""
    candidates: Annotated[
        str, Option(help='Tests to choose from: "500|1350 psi, 0.5 Hz, 1 in", or a file.')
    ] = ""
    limits: Annotated[str, Option(help='Of the actuator: "10 in/s, 6 in, 20 kip".')] = ""
    table: Annotated[
        Path | None,
        Option(
            "-o",
            "--out",
            parser=path,
            help="CSV to write; JSON and PNG beside it.",
            show_default="OUT/next.csv",
        ),
    ] = None
    protocol: Annotated[
        str,
        Option(
            metavar="asce7-22",
            help="List the tests that a standard asks for and that were not made, in its order.",
        ),
    ] = ""
    draft: Annotated[
        Path | None,
        Option(
            "--write",
            parser=path,
            metavar="FILE.toml",
            help="Draft the next entries of campaign.toml.",
        ),
    ] = None
    tests: Annotated[int, Option(min=1, max=3, help="How many tests --write drafts.")] = 1
    draws: Annotated[int, Option(min=200, help="Draws of the posterior that are simulated.")] = 2000
    seed: Seed = 0
    force: Replace = False
    units: Units = ""
    quiet: Quiet = False
    trust_model: TrustModel = False
