"""A prediction from a finished run, written as files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mfd_bayes.errors import CampaignError, StoreError
from mfd_bayes.evaluation.design import DesignRow, design_rows, design_warnings, n_draws
from mfd_bayes.evaluation.scores import Compared, compare
from mfd_bayes.evaluation.test_summary import predicted_rows
from mfd_bayes.evaluation.views import DerivedRow, Fan, Interval
from mfd_bayes.pipeline.question import Question, check_question, motion_of
from mfd_bayes.population.bands import DRAWS, Band
from mfd_bayes.population.settings import KIND_NAMES
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.conversion import convert_fan, convert_row, convert_trace
from mfd_bayes.reporting.tables import bands_csv, design_csv, predicted_csv
from mfd_bayes.runs.manifest import unchanged
from mfd_bayes.runs.model_average import ModelAverage
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.runs.tested_range import far_sentences
from mfd_bayes.runs.unit_system import System
from mfd_bayes.store.files import remove_file, write_bytes, write_text
from mfd_bayes.units import actuation_kind, parse_actuation


@dataclass(frozen=True, eq=False)
class Answer:
    """A prediction: its band, kip; its derived quantities in the units of `system`.

    `compared` is None where no measured force was to be compared, `design` empty where mean and
    bounding properties were not asked for. `judged` says which measured values lie outside their
    intervals, and `disagrees` whether the prediction does not hold for the record.
    """

    band: Band
    derived: tuple[DerivedRow, ...]
    system: System
    compared: Compared | None = None
    design: tuple[DesignRow, ...] = ()
    judged: str = ""
    disagrees: bool = False

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
    _check_combined(question)
    check_question(question)
    run, *others = (_opened(folder, question.units) for folder in (out, *question.others))
    source = ModelAverage((run, *others)) if others else run
    system = run.system
    level = _level(run, question)
    motion, thinned, record = motion_of(question)
    told = replace(motion, actuation=level)
    trace = replace(told, force=None)
    _check_reach(run, trace, question)
    drawn = told if question.compare else trace
    with unchanged(run.folder, run.manifest):
        band = _band(source, told if question.given else trace, question)
        known = record if question.compare else None
        rows = predicted_rows(source, trace, band, known, question.after, told)
        narrow = design_warnings(run) if question.design else ()
        bounds = design_rows(run, trace, question.probability) if question.design else ()
    band = replace(band, remarks=(*band.remarks, *thinned, *narrow))
    compared, judged = None, ("", False)
    if drawn.force is not None:
        compared = compare(band, drawn)
        judged = compared.judged(rows), compared.disagrees(rows)
    derived = tuple(convert_row(row, system) for row in rows)
    design = tuple(convert_row(row, system) for row in bounds)
    answer = Answer(band, derived, system, compared, design, *judged)
    _write(question, drawn, answer, told)
    return answer


def _opened(folder: Path, units: str) -> Run:
    """Run that tells everything in a system of units, where one is asked for."""
    run = open_run(folder)
    return replace(run, units=units) if units else run


def _check_combined(question: Question) -> None:
    """Refuse options that exclude each other."""
    of_a_test = (
        ("--given", question.window, "the one whose first part is given"),
        ("--after", question.after, "one that follows another"),
    )
    for option, given, which in of_a_test:
        if given and question.design:
            raise CampaignError(
                f"--design cannot be combined with {option}: its properties are those of any test, "
                f"not of {which}"
            )
    of_one = {
        "--test": question.test,
        "--explain": question.explain,
        "--design": question.design,
    }
    asked = [option for option, given in of_one.items() if given]
    if question.others and asked:
        raise CampaignError(f"{asked[0]} cannot be combined with --with: it is of one model alone")


def _band(source: Run | ModelAverage, trace: Trace, question: Question) -> Band:
    """Band that is asked for."""
    asked = trace, question.kind, question.probability
    whole, given, after = question.whole, question.window, question.after
    if isinstance(source, ModelAverage):
        return source.predict(*asked, whole=whole, given=given, after=after)
    return source.predict(
        *asked,
        # without sessions the tables of --design are then of the same draws
        draws=max(n_draws(source), DRAWS) if question.design else DRAWS,
        test=question.test,
        whole=whole,
        explain=question.explain,
        given=given,
        after=after,
    )


def _level(run: Run, question: Question) -> float:
    """Actuation that is asked for, ksi or kip."""
    level, unit = parse_actuation(question.actuation, of="--actuation")
    if unit != run.actuation_unit:
        raise CampaignError(
            f"--actuation {question.actuation!r} must be {actuation_kind(run.actuation_unit)}, as "
            "in the campaign"
        )
    return level


def _check_reach(run: Run, trace: Trace, question: Question) -> None:
    """Refuse what lies far outside of the tested range, unless it is asked for expressly."""
    own = question.test if question.test in run.tests else ""
    far = far_sentences(run.departures(trace, own), run.system)
    if far and not question.extrapolate:
        raise CampaignError(f"{far}; give --extrapolate to predict it all the same")


def _write(question: Question, drawn: Trace, answer: Answer, told: Trace) -> None:
    """Write the tables and the pictures of a prediction; `told` has the force of a given part."""
    from mfd_bayes.reporting.figures import Marks, draw_history, draw_loops, to_png

    band, system = answer.band, answer.system
    title = f"Predicted force at {question.actuation}"
    about = [f"actuation {question.actuation}"]
    if band.given is not None:
        title += f", given {question.given}"
    if answer.compared is not None:
        about.append(f"compared: {answer.compared.sentence(system)}")
        about += [answer.judged] * bool(answer.judged)
    write_text(question.bands, bands_csv(drawn, band, about, system))
    derived = predicted_csv(answer.derived, question.actuation, question.probability)
    write_text(question.beside("derived.csv"), derived)
    if answer.design:
        write_text(question.bounds, design_csv(answer.design, question.actuation))
    else:
        remove_file(question.bounds)  # it is of an earlier question
    fans = [convert_fan(_fan(band), system.factor("kip"))]
    loops = draw_loops(title, convert_trace(drawn, system), fans, system)
    write_bytes(question.picture, to_png(loops))
    given = band.given.window if band.given else None
    shown = convert_trace(_with_given(drawn, told, band), system)
    history = draw_history(title, shown, fans, system, Marks(given=given))
    write_bytes(question.beside("history.png"), to_png(history))


def _with_given(drawn: Trace, told: Trace, band: Band) -> Trace:
    """The trace with the force of the given part alone, where no force is compared."""
    if band.given is None or drawn.force is not None:
        return drawn
    known = np.where(band.given.holds(band.time), np.asarray(told.force), np.nan)
    return replace(drawn, force=known)


def _fan(band: Band) -> Fan:
    """The band, and that of the whole history, as pictures show them."""
    intervals = [Interval(band.probability, band.lower, band.upper)]
    if band.whole_lower is not None and band.whole_upper is not None:
        bounds = np.asarray(band.whole_lower), np.asarray(band.whole_upper)
        intervals.append(Interval(band.probability, *bounds, whole=True))
    return Fan(band.kind, band.median, tuple(intervals))
