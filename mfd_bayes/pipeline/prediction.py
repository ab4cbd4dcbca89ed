"""A prediction from a finished run, written as files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mfd_bayes.assessment.bands import Compared, compare
from mfd_bayes.assessment.derived_rows import predicted_rows
from mfd_bayes.assessment.design import DesignRow, design_rows, design_warnings
from mfd_bayes.assessment.views import DerivedRow, Fan, Interval
from mfd_bayes.errors import CampaignError, StoreError
from mfd_bayes.population.kinds import KIND_NAMES
from mfd_bayes.population.predict import Band
from mfd_bayes.records.harmonic import parse_sine
from mfd_bayes.records.record import Record, read_record
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.conversion import convert_fan, convert_row, convert_trace
from mfd_bayes.reporting.tables import bands_csv, design_csv, predicted_csv
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.runs.systems import System, named_system
from mfd_bayes.runs.tested import far_sentences
from mfd_bayes.store.files import write_bytes, write_text
from mfd_bayes.units import parse_actuation, parse_quantity

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
    whole, recalibrate, explain : bool
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
    """

    motion: Path | None
    actuation: str
    kind: str
    probability: float
    bands: Path
    compare: bool = False
    test: str = ""
    whole: bool = False
    recalibrate: bool = False
    explain: bool = False
    extrapolate: bool = False
    sine: str = ""
    rate: str = ""
    units: str = ""
    design: bool = False

    def beside(self, name: str) -> Path:
        """File beside the table, such as "bands_derived.csv" for "derived.csv"."""
        return self.bands.with_name(f"{self.bands.stem}_{name}")


@dataclass(frozen=True, eq=False)
class Answer:
    """A prediction: its band, kip; its derived quantities in the units of `system`.

    `compared` is None where no measured force was to be compared, `design` empty where mean and
    bounding properties were not asked for.
    """

    band: Band
    derived: tuple[DerivedRow, ...]
    system: System
    compared: Compared | None = None
    design: tuple[DesignRow, ...] = ()

    @property
    def name(self) -> str:
        """What the band is about, in the words of design."""
        return KIND_NAMES[self.band.kind]


def predict(out: Path, question: Question) -> Answer:
    """Force band for a motion and an actuation, and derived quantities; both are written.

    Raises
    ------
    MfdError
        When the run, the motion, the actuation, the kind or the probability cannot be used, or
        the motion lies far outside of what was tested.
    """
    if question.bands.suffix.lower() == ".png":
        raise StoreError(
            f"{question.bands} must not end in .png: the picture goes beside the table"
        )
    run = open_run(out)
    system = named_system(question.units, run.system)
    motion, thinned = _motion(question)
    trace = replace(motion, actuation=_level(run, question), force=None)
    _check_reach(run, trace, question)
    band = run.predict(
        trace,
        question.kind,
        question.probability,
        test=question.test,
        whole=question.whole,
        recalibrate=question.recalibrate,
        explain=question.explain,
    )
    narrow = design_warnings(run) if question.design else ()
    band = replace(band, remarks=(*band.remarks, *thinned, *narrow))
    drawn = replace(trace, force=motion.force if question.compare else None)
    compared = None if drawn.force is None else compare(band, drawn.force)
    rows = tuple(convert_row(row, system) for row in predicted_rows(run, drawn, band))
    bounds = design_rows(run, trace, question.probability) if question.design else ()
    design = tuple(convert_row(row, system) for row in bounds)
    answer = Answer(band, rows, system, compared, design)
    _write(question, drawn, answer)
    return answer


def _motion(question: Question) -> tuple[Trace, tuple[str, ...]]:
    """Motion that is asked for, and a remark where it had to be thinned.

    Raises
    ------
    MfdError
        When there is none or more than one, or it cannot be used.
    """
    if (question.motion is None) == (not question.sine):
        raise CampaignError("give one motion: --motion FILE, or --sine '1 in, 0.5 Hz, 3 cycles'")
    if question.motion is None:
        if question.compare or question.rate:
            raise CampaignError("--compare and --rate need a --motion file, not --sine")
        return parse_sine(question.sine).trace(0.0), ()
    record = read_record(question.motion)
    if question.compare and record.force is None:
        raise CampaignError(f"--compare needs a column of the force in {question.motion}")
    if question.rate:
        return record.trace(parse_quantity(question.rate, "rate", of="--rate")), ()
    return _at_most(record)


def _at_most(record: Record) -> tuple[Trace, tuple[str, ...]]:
    """Every sample of a record, up to `MOST`; else as many as that, with a remark."""
    if record.time.size <= MOST:
        return record.trace(), ()
    rate = record.rate * MOST / record.time.size
    remark = (
        f"the motion has {record.time.size} samples, more than the {MOST} that are predicted at "
        f"once: the band is given at {rate:.4g} Hz; --rate sets another"
    )
    return record.trace(rate), (remark,)


def _level(run: Run, question: Question) -> float:
    """Actuation that is asked for, ksi or kip."""
    level, unit = parse_actuation(question.actuation, of="--actuation")
    if unit != run.actuation_unit:
        raise CampaignError(
            f"--actuation {question.actuation!r} must be a "
            f"{'pressure' if run.actuation_unit == 'ksi' else 'force'}, as in the campaign"
        )
    return level


def _check_reach(run: Run, trace: Trace, question: Question) -> None:
    """Refuse what lies far outside of the tested range, unless it is asked for expressly."""
    own = question.test if question.test in run.tests else ""
    far = far_sentences(run.departures(trace, own), run.system)
    if far and not question.extrapolate:
        raise CampaignError(f"{far}; give --extrapolate to predict it all the same")


def _write(question: Question, drawn: Trace, answer: Answer) -> None:
    """Write the tables and the pictures of a prediction."""
    from mfd_bayes.reporting.figures import draw_history, draw_loops, to_png

    band, system = answer.band, answer.system
    about = [f"actuation {question.actuation}"]
    if answer.compared is not None:
        about.append(f"compared: {answer.compared.sentence(system)}")
    write_text(question.bands, bands_csv(drawn, band, about, system))
    derived = predicted_csv(answer.derived, question.actuation, question.probability)
    write_text(question.beside("derived.csv"), derived)
    if answer.design:
        table = design_csv(answer.design, question.actuation)
        write_text(question.beside("design.csv"), table)
    title = f"Predicted force at {question.actuation}"
    shown = convert_trace(drawn, system), [convert_fan(_fan(band), system.factor("kip"))]
    write_bytes(question.bands.with_suffix(".png"), to_png(draw_loops(title, *shown, system)))
    history = draw_history(title, *shown, system=system)
    write_bytes(question.beside("history.png"), to_png(history))


def _fan(band: Band) -> Fan:
    """The band, and that of the whole history, as pictures show them."""
    intervals = [Interval(band.probability, band.lower, band.upper)]
    if band.whole_lower is not None and band.whole_upper is not None:
        bounds = np.asarray(band.whole_lower), np.asarray(band.whole_upper)
        intervals.append(Interval(band.probability, *bounds, whole=True))
    return Fan(band.kind, band.median, tuple(intervals))
