"""What is asked of a prediction: its motion, and the files that it writes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mfd_bayes.errors import CampaignError
from mfd_bayes.pipeline.outputs import check_outputs
from mfd_bayes.records.record import Record, read_record
from mfd_bayes.records.sine import parse_sine
from mfd_bayes.records.time_axis import parse_window
from mfd_bayes.records.trace import Trace
from mfd_bayes.units import parse_quantity

MOST = 40_000
"""Most samples of a motion that is predicted as it is; more would take gigabytes."""


@dataclass(frozen=True)
class Question:
    """A requested prediction.

    Attributes
    ----------
    motion : Path or None
        A file with time and displacement; None for a harmonic motion.
    actuation : str
        Such as "1000 psi".
    kind : {"device", "new_test", "observation", "this_test"}
    bands : Path
        CSV to write; two PNGs and the derived quantities are written beside it.
    compare : bool
        Whether the force in the motion's file is compared with the prediction.
    test : str
        Id of the calibrated test, for the kind `this_test`.
    whole, explain : bool
        As in `Run.predict`.
    extrapolate : bool
        Whether to predict far outside of what was tested too.
    sine : str
        Harmonic motion instead of a file: "1 in, 0.5 Hz, 3 cycles".
    rate : str
        Rate to which the motion is thinned, "64 Hz"; every sample is kept by default.
    units : {"", "us", "si"}
        Units of all that is written; by default those of the campaign.
    design : bool
        Whether mean and bounding properties are computed too.
    given : str
        Part of the record in which the force in the motion's file is known: "0 s to 3 s".
    after : str
        Id of the test of the run that the motion follows without a reset.
    force : bool
        Whether files of other programs are replaced.
    others : tuple of Path
        Runs of the same tests with other models, which predict together with the first.
    """

    motion: Path | None
    actuation: str
    kind: str
    probability: float
    bands: Path
    compare: bool = False
    test: str = ""
    whole: bool = False
    explain: bool = False
    extrapolate: bool = False
    sine: str = ""
    rate: str = ""
    units: str = ""
    design: bool = False
    force: bool = False
    given: str = ""
    after: str = ""
    others: tuple[Path, ...] = ()

    @property
    def window(self) -> tuple[float, float] | None:
        """The given part, s; None where there is none."""
        return parse_window(self.given, of="--given") if self.given.strip() else None

    @property
    def picture(self) -> Path:
        """PNG of the band."""
        return self.bands.with_suffix(".png")

    @property
    def bounds(self) -> Path:
        """Table of mean and bounding properties."""
        return self.beside("design.csv")

    def beside(self, name: str) -> Path:
        """File beside the table, such as "bands_derived.csv" for "derived.csv"."""
        return self.bands.with_name(f"{self.bands.stem}_{name}")


def check_question(question: Question) -> None:
    """Refuse to write over what exists, but for `force`.

    Raises
    ------
    StoreError
        When one of the files may not be written.
    """
    inputs = [] if question.motion is None else [question.motion]
    names = ("history.png", "derived.csv", "design.csv")
    outputs = [question.bands, question.picture, *map(question.beside, names)]
    check_outputs(outputs, inputs, force=question.force)


def motion_of(question: Question) -> tuple[Trace, tuple[str, ...], Record | None]:
    """Motion that is asked for, a remark where it had to be thinned, and its record if any.

    Raises
    ------
    MfdError
        When there is none or more than one, or it cannot be used.
    """
    if (question.motion is None) == (not question.sine):
        raise CampaignError("give one motion: --motion FILE, or --sine '1 in, 0.5 Hz, 3 cycles'")
    if question.motion is None:
        if question.compare or question.rate or question.given:
            raise CampaignError("--compare, --given and --rate need a --motion file, not --sine")
        return parse_sine(question.sine).trace(0.0), (), None
    # the actuation is that of the question, whatever columns the file has
    record = read_record(question.motion, actuation=question.actuation)
    if question.compare and record.force is None:
        raise CampaignError(f"--compare needs a column of the force in {question.motion}")
    if question.given and record.force is None:
        raise CampaignError(
            f"--given {question.given!r} needs a column of the force in {question.motion}"
        )
    window = question.window
    if question.rate:
        rate = parse_quantity(question.rate, "rate", of="--rate")
        return _thinned(record, rate, window), (), record
    return *_at_most(record, window), record


def _thinned(record: Record, rate: float, window: tuple[float, float] | None) -> Trace:
    """Record at a rate; what is known of its force in a window does not depend on the rest.

    The filter before the thinning would mix both: inside the window it sees the force at the
    window's ends instead of that beyond them.
    """
    trace = record.trace(rate)
    if window is None or record.force is None or trace.force is None:
        return trace
    begin, end = window
    inside = (record.time >= begin) & (record.time <= end)
    if not np.any(inside):  # which the prediction refuses
        return trace
    held = np.interp(record.time, record.time[inside], record.force[inside])
    known = replace(record, force=held).trace(rate)
    at = (trace.time >= begin) & (trace.time <= end)
    return replace(trace, force=np.where(at, np.asarray(known.force), trace.force))


def _at_most(record: Record, window: tuple[float, float] | None) -> tuple[Trace, tuple[str, ...]]:
    """Every sample of a record, up to `MOST`; else as many as that, with a remark."""
    if record.time.size <= MOST:
        return record.trace(), ()
    rate = record.rate * MOST / record.time.size
    remark = (
        f"the motion has {record.time.size} samples, more than the {MOST} that are predicted at "
        f"once: the band is given at {rate:.4g} Hz; --rate sets another"
    )
    return _thinned(record, rate, window), (remark,)
