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
from mfd_bayes.pipeline.outputs import (
    Output,
    check_outputs,
    is_marked,
    is_picture,
    known,
    table_with,
    write_picture,
)
from mfd_bayes.population.predict import Band
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.tables import (
    bands_csv,
    predicted_csv,
)
from mfd_bayes.runs.reading import reading
from mfd_bayes.runs.run import open_run
from mfd_bayes.store.files import write_text
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
    force : bool
        Whether files of other programs are replaced.
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
    force: bool = False

    @property
    def picture(self) -> Path:
        """PNG of the band."""
        return self.bands.with_suffix(".png")

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
    check_question(question)
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
    drawn = replace(trace, force=motion.force if question.compare else None)
    with reading(run.folder, run.manifest):
        band = run.predict(
            trace,
            question.kind,
            question.probability,
            test=question.test,
            whole=question.whole,
            recalibrate=question.recalibrate,
            explain=question.explain,
        )
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
    write_picture(question.picture, png)
    return band, rows


def check_question(question: Question) -> None:
    """Refuse to write over anything but what an earlier prediction wrote there."""
    bands = Output(question.bands, table_with("time_s", "displacement_in", "lower_kip"))
    check_outputs([bands], [question.motion], force=question.force)
    again = known(bands)
    picture = Output(question.picture, is_picture if again else is_marked)
    derived = Output(question.derived, table_with("quantity", "unit", "mean"))
    check_outputs([picture, derived], [question.motion], force=question.force)
