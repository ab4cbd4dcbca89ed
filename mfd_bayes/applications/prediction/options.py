"""The options of the command `predict`; the docstring is its help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from typer import Option

from mfd_bayes.options import (
    Cycles,
    Date,
    Quiet,
    Replace,
    RunFolder,
    Temperature,
    TrustModel,
    Units,
    path,
)


@dataclass(frozen=True)
class PredictOptions:
    """Predict the force of a motion at an actuation, tested or not.

    Writes the band as CSV where -o says, a PNG of the loops beside it, one of the
    history (..._history.png), and what derives from the force, such as energy and
    peaks (..._derived.csv). It warns where stroke, speed, frequency or actuation
    lie outside the tested range, or the run is not usable; far outside it
    refuses unless --extrapolate is given. --compare prints the share of the
    measured force inside the band, and keeps it in the CSV. --design prints mean
    and bounding properties (slip force, energy, peaks), for the mean property,
    this device tested again, another device and a measurement, and writes
    ..._design.csv. --explain takes some seconds. --condition-on uses the force in a
    part of the motion's file, for the kinds new_test and observation: the band of
    the rest is narrower, and the tables and pictures mark the part. --after names
    a test of the run that was made directly before, with no reset in between: the
    motion begins where in its gap that test ended. --with names a run of the same
    tests with another model, such as compare writes: both give half of the band's
    draws, so that it holds what each of them says.

    Example:
      mfd-bayes predict out --motion quake.csv --actuation "1000 psi" -o bands.csv
      mfd-bayes predict out --sine "1in, 1Hz, 3 cycles" --actuation 1ksi -o b.csv
      mfd-bayes predict a --with b --motion quake.csv --actuation "1 ksi" -o b.csv
    """

    out: RunFolder
    bands: Annotated[Path, Option("-o", "--out", parser=path, help="CSV to write; PNGs beside it.")]
    actuation: Annotated[
        str, Option(help='Such as "1000 psi"; needed where the tests have one.')
    ] = ""
    motion: Annotated[
        Path | None, Option(parser=path, help="A file with time_s and displacement_in, …")
    ] = None
    sine: Annotated[str, Option(help='A harmonic motion instead: "1 in, 0.5 Hz, 3 cycles".')] = ""
    kind: Annotated[
        Literal["mean", "new_test", "observation", "this_test"],
        Option(
            help="What the band is about: the mean property, this device tested again, a "
            "measurement of it, or one calibrated test."
        ),
    ] = "new_test"
    probability: Annotated[float, Option(help="Probability of the equal-tailed band.")] = 0.95
    compare: Annotated[
        bool, Option("--compare", help="Compare with the force in the motion's file.")
    ] = False
    test: Annotated[
        str, Option(metavar="ID", help="The calibrated test, for --kind this_test.")
    ] = ""
    device: Annotated[
        str, Option(metavar='"no. 3"', help="A device of the campaign; else a new one, if several.")
    ] = ""
    session: Annotated[
        str, Option(help="A session of the campaign; else a new one, if several.")
    ] = ""
    date: Date = ""
    cycles: Cycles = None
    temperature: Temperature = ""
    simultaneous: Annotated[
        bool, Option("--simultaneous", help="Add a band that holds the whole history.")
    ] = False
    explain: Annotated[bool, Option("--explain", help="Say what makes the band wide.")] = False
    design: Annotated[
        bool,
        Option("--design", help="Print mean and bounding properties, also of a standard."),
    ] = False
    extrapolate: Annotated[
        bool, Option("--extrapolate", help="Predict also far outside of the tested range.")
    ] = False
    rate: Annotated[
        str, Option(metavar='"64 Hz"', help="Thin the motion; else every sample is kept.")
    ] = ""
    condition_on: Annotated[
        str, Option(metavar='"0 s to 3 s"', help="The time in which the file's force is used.")
    ] = ""
    after: Annotated[
        str, Option(metavar="ID", help="The test before, where the device was not reset.")
    ] = ""
    others: Annotated[
        tuple[Path, ...],
        Option(
            "--with",
            metavar="OUT",
            parser=path,
            help="Predict together with this run of another model; may be repeated.",
        ),
    ] = ()
    figures: Annotated[bool, Option("--figures/--no-figures", help="Draw the PNGs.")] = True
    force: Replace = False
    units: Units = ""
    quiet: Quiet = False
    trust_model: TrustModel = False

    @property
    def picture(self) -> Path:
        """PNG of the band."""
        return self.bands.with_suffix(".png")

    def beside(self, name: str) -> Path:
        """File beside the table, such as "bands_derived.csv" for "derived.csv"."""
        return self.bands.with_name(f"{self.bands.stem}_{name}")
