"""A prediction from a finished run, written as files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from mfd_bayes.assessment.derived_rows import predicted_rows
from mfd_bayes.assessment.views import (
    DerivedRow,
    Fan,
    Interval,
)
from mfd_bayes.errors import CampaignError, StoreError
from mfd_bayes.population.predict import Band
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.tables import (
    bands_csv,
    predicted_csv,
)
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.runs.tested import far_sentences
from mfd_bayes.store.files import write_bytes, write_text
from mfd_bayes.units import parse_actuation


@dataclass(frozen=True)
class Question:
    """A requested prediction.

    Attributes
    ----------
    motion : Path
        A file with time and displacement.
    actuation : str
        Such as "1000 psi".
    kind : {"device", "new_test", "observation", "this_test"}
    bands : Path
        CSV to write; a PNG and the derived quantities are written beside it.
    compare : bool
        Whether the force in the motion's file is shown with the prediction.
    test : str
        Id of the calibrated test, for the kind `this_test`.
    whole, recalibrate, explain : bool
        As in `Run.predict`.
    extrapolate : bool
        Whether to predict far outside of what was tested too.
    """

    motion: Path
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

    @property
    def derived(self) -> Path:
        """CSV of the derived quantities."""
        return self.bands.with_name(f"{self.bands.stem}_derived.csv")


def predict(out: Path, question: Question) -> tuple[Band, tuple[DerivedRow, ...]]:
    """Force band for a motion and an actuation, and derived quantities; both are written.

    Raises
    ------
    MfdError
        When the run, the motion, the actuation, the kind or the probability cannot be used.
    """
    if question.bands.suffix.lower() == ".png":
        raise StoreError(
            f"{question.bands} must not end in .png: the picture goes beside the table"
        )
    run = open_run(out)
    level, unit = parse_actuation(question.actuation, of="--actuation")
    if unit != run.actuation_unit:
        raise CampaignError(
            f"--actuation {question.actuation!r} must be a "
            f"{'pressure' if run.actuation_unit == 'ksi' else 'force'}, as in the campaign"
        )
    record = read_record(question.motion)
    motion = record.trace(gap=run.priors.gap)
    trace = Trace.from_arrays(motion.time, motion.displacement, level, velocity=motion.velocity)
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
    drawn = replace(trace, force=motion.force if question.compare else None)
    rows = predicted_rows(run, drawn, band)
    write_text(question.bands, bands_csv(trace, band, question.actuation))
    write_text(question.derived, predicted_csv(rows, question.actuation, question.probability))
    from mfd_bayes.reporting.figures import draw_loops, to_png

    intervals = [Interval(band.probability, band.lower, band.upper)]
    if band.whole_lower is not None and band.whole_upper is not None:
        bounds = band.whole_lower, band.whole_upper
        intervals.append(Interval(band.probability, *bounds, whole=True))
    fan = Fan(band.kind, band.median, tuple(intervals))
    title = f"Predicted force at {question.actuation}"
    png = to_png(draw_loops(title, drawn, [fan]))
    write_bytes(question.bands.with_suffix(".png"), png)
    return band, rows


def _check_reach(run: Run, trace: Trace, question: Question) -> None:
    """Refuse what lies far outside of the tested range, unless it is asked for expressly."""
    own = question.test if question.test in run.tests else ""
    far = far_sentences(run.departures(trace, own), run.system)
    if far and not question.extrapolate:
        raise CampaignError(f"{far}; give --extrapolate to predict it all the same")
