"""The command `predict`: its options, and what is written."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mfd_bayes.applications.prediction.comparison import Compared, compare
from mfd_bayes.applications.prediction.tables import bands_csv, design_csv, predicted_csv
from mfd_bayes.campaign.guesses import guess_columns
from mfd_bayes.campaign.schema import CampaignFile
from mfd_bayes.errors import CampaignError, StoreError
from mfd_bayes.evaluation.bounds import design_rows, design_warnings, n_draws, places_of
from mfd_bayes.evaluation.properties import predicted_rows
from mfd_bayes.evaluation.scores import Rows, fan_of_band
from mfd_bayes.population.bands import DRAWS, KIND_NAMES, Band
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.record import Record, Source, parse_window, read_record
from mfd_bayes.records.trace import Trace, parse_sine
from mfd_bayes.reporting.tables import convert_rows
from mfd_bayes.runs.folder import check_outputs
from mfd_bayes.runs.model_average import ModelAverage
from mfd_bayes.runs.run import open_run
from mfd_bayes.runs.stated import stated_actuation, stated_conditions
from mfd_bayes.runs.tested_range import far_sentences
from mfd_bayes.runs.unit_system import System
from mfd_bayes.store.files import remove_file, write_bytes, write_text
from mfd_bayes.units import Axes, parse_quantity

MOST = 40_000
"""Most samples of a motion that is predicted as it is; more would take gigabytes."""


@dataclass(frozen=True)
class Question:
    """A requested prediction."""

    bands: Path
    actuation: str
    motion: Path | None = None
    kind: str = "new_test"
    probability: float = 0.95
    compare: bool = False
    test: str = ""
    whole: bool = False
    explain: bool = False
    extrapolate: bool = False
    sine: str = ""
    rate: str = ""
    units: str = ""
    design: bool = False
    figures: bool = True
    force: bool = False
    given: str = ""
    after: str = ""
    others: tuple[Path, ...] = ()
    device: str = ""
    session: str = ""
    date: str = ""
    cycles: float | None = None
    temperature: str = ""
    trust_model: bool = False

    @property
    def window(self) -> tuple[float, float] | None:
        """The given part, s; None where there is none."""
        text = self.given
        numbered = text.replace(" to ", "").replace(" ", "").isdigit()
        return parse_window(text, of="--given", timed=not numbered) if text.strip() else None

    @property
    def picture(self) -> Path:
        """PNG of the band."""
        return self.bands.with_suffix(".png")

    def beside(self, name: str) -> Path:
        """File beside the table, such as "bands_derived.csv" for "derived.csv"."""
        return self.bands.with_name(f"{self.bands.stem}_{name}")


@dataclass(frozen=True, eq=False)
class Answer:
    """A prediction: its band, kip; its derived quantities in the units of `system`.

    `compared` is None where no measured force was to be compared, `design` empty where mean and
    bounding properties were not asked for. `judged` says which measured values lie outside their
    intervals, and `disagrees` whether the prediction does not hold for the record.
    """

    band: Band
    derived: Rows
    system: System
    compared: Compared | None = None
    design: Rows = ()
    judged: str = ""
    disagrees: bool = False

    @property
    def name(self) -> str:
        """What the band is about, in the words of design."""
        return KIND_NAMES[self.band.kind]


def predict(out: Path, question: Question) -> Answer:
    """Force band for a motion and an actuation, and derived quantities; both are written."""
    check_question(question)
    run, *others = (
        open_run(folder, trust=question.trust_model) for folder in (out, *question.others)
    )
    question = replace(question, actuation=stated_actuation(run, question.actuation))
    conditions = stated_conditions(question)
    run, *others = (
        replace(each, conditions=conditions, units=question.units) for each in (run, *others)
    )
    source = ModelAverage((run, *others)) if others else run
    level = run.level_of(question.actuation)
    motion, remarks, record = _motion_of(question, run.manifest.settings, run.system.axes)
    measured = replace(motion, actuation=level)  # with its force, if the file has one
    trace = replace(measured, force=None)
    own = question.test if question.test in run.tests else ""
    far = far_sentences(run.departures(trace, own), run.system)
    if far and not question.extrapolate:
        raise CampaignError(f"{far}; give --extrapolate to predict it all the same")
    drawn = measured if question.compare else trace
    design: Rows = ()
    asked = measured if question.given else trace, question.kind, question.probability
    how: dict[str, Any] = {
        "whole": question.whole,
        "given": question.window,
        "after": question.after,
        "session": question.session,
    }
    if not others:
        how |= {"test": question.test, "device": question.device}
        # without sessions the tables of --design are then of the same draws
        how["draws"] = max(n_draws(places_of(run)), DRAWS) if question.design else DRAWS
    band = source.predict(*asked, **how)
    compared_with = record if question.compare else None
    about = question.after, measured, question.device, question.session
    rows = predicted_rows(source, trace, band, compared_with, *about)
    if question.design:
        remarks += design_warnings(run)
        design = design_rows(run, trace, question.probability)
    band = replace(band, remarks=(*band.remarks, *remarks))
    compared, judged, disagrees = None, "", False
    if drawn.force is not None:
        compared = compare(band, drawn)
        judged, disagrees = compared.judged(rows)
    answer = Answer(
        band,
        convert_rows(rows, run.system),
        run.system,
        compared,
        convert_rows(design, run.system),
        judged,
        disagrees,
    )
    _write(question, drawn, answer, measured)
    return answer


def check_question(question: Question) -> None:
    """Refuse options that exclude each other, and to write over what exists, but for `force`."""
    if question.bands.suffix.lower() == ".png":
        raise StoreError(
            f"{question.bands} must not end in .png: the picture goes beside the table"
        )
    for option, value, which in (
        ("--given", question.window, "the one whose first part is given"),
        ("--after", question.after, "one that follows another"),
        ("--session", question.session, "one of a session"),
    ):
        if value and question.design:
            raise CampaignError(
                f"--design cannot be combined with {option}: its properties are those of any test, "
                f"not of {which}"
            )
    for option in ("test", "explain", "design", "device"):
        if question.others and getattr(question, option):
            raise CampaignError(
                f"--{option} cannot be combined with --with: it is of one model alone"
            )
    names = ("history.png", "derived.csv", "design.csv")
    outputs = [question.bands, question.picture, *map(question.beside, names)]
    check_outputs(outputs, [question.motion] if question.motion else [], force=question.force)


def _motion_of(
    question: Question, settings: CampaignFile, axes: Axes
) -> tuple[Trace, tuple[str, ...], Record | None]:
    """Motion that is asked for, a remark where it had to be thinned, and its record, if any.

    Its actuation is that of the question, whatever columns its file has.
    """
    if (question.motion is None) == (not question.sine):
        raise CampaignError("give one motion: --motion FILE, or --sine '1 in, 0.5 Hz, 3 cycles'")
    if question.motion is None:
        if question.compare or question.rate or question.given:
            raise CampaignError("--compare, --given and --rate need a --motion file, not --sine")
        return parse_sine(question.sine, axes).trace(0.0), (), None
    columns = motion_columns(question.motion, settings, axes)
    record = read_record(question.motion, columns, actuation=question.actuation, axes=axes)
    shown = ", ".join(f"{axes.name(role)}: {n} [{u}]" for role, (n, u) in record.columns.items())
    read = (f"columns read from {question.motion.name}: {shown}",) if columns else ()
    given = f"--given {question.given!r}" if question.given else ""
    needs = "--compare" if question.compare else given
    if needs and record.force is None:
        raise CampaignError(
            f"{needs} needs a column of the {axes.response.name} in {question.motion}"
        )
    if question.rate and not axes.timed:
        raise CampaignError("--rate: samples are numbered, the model is rate-independent")
    if question.rate:
        rate = parse_quantity(question.rate, "rate", of="--rate")
        return _thinned(record, rate, question.window), read, record
    if record.time.size <= MOST:
        return record.trace(), read, record
    rate = record.rate * MOST / record.time.size
    remark = (
        f"the motion has {record.time.size} samples, more than the {MOST} that are predicted at "
        f"once: the band is given at {rate:.4g} Hz; --rate sets another"
    )
    return _thinned(record, rate, question.window), (*read, remark), record


def motion_columns(path: Path, settings: CampaignFile, axes: Axes) -> dict[str, Source] | None:
    """The campaign's columns that a file has, else those that init would take; None by its names.

    Of what init would only guess at from the numbers, or that lacks its unit, nothing is taken.
    """
    table = read_table(path)
    timed = bool(table.called("time"))
    stated = {r: c for r, c in settings.columns.given.items() if r != "actuation"}
    columns = {r: c.source for r, c in stated.items() if c.key in table.names or c.name is None}
    if not axes.of_damper:
        return columns or None
    if columns.keys() >= {"time", "displacement"} and not (columns["time"].rate and timed):
        return columns
    if {role for role in ("time", "displacement") if table.called(role)} == {
        "time",
        "displacement",
    }:
        return None
    roles = ("time", "displacement", "force")
    guesses = {r: g for r, g in guess_columns(table, axes).items() if r in roles}
    sure = {r: g.source for r, g in guesses.items() if g.unit and not g.doubts}
    return sure if sure.keys() >= {"time", "displacement"} else None


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


def _write(question: Question, drawn: Trace, answer: Answer, measured: Trace) -> None:
    """Write the tables and the pictures of a prediction; `measured` has a given part's force."""
    band, system = answer.band, answer.system
    actuated = system.axes.actuated
    title = system.text("Predicted force") + f" at {question.actuation}" * actuated
    about = [f"actuation {question.actuation}"] * actuated
    if answer.compared is not None:
        about.append(f"compared: {answer.compared.sentence(system)}")
        about += [answer.judged] if answer.judged else []
    write_text(question.bands, bands_csv(drawn, band, about, system))
    level = question.actuation if actuated else ""
    derived = predicted_csv(answer.derived, level, question.probability, system.axes.response.name)
    write_text(question.beside("derived.csv"), derived)
    if answer.design:
        design = design_csv(answer.design, level, question.probability)
        write_text(question.beside("design.csv"), design)
    else:
        remove_file(question.beside("design.csv"))  # it is of an earlier question
    if not question.figures:
        remove_file(question.picture)
        remove_file(question.beside("history.png"))
        return
    from mfd_bayes.reporting.figures import draw_history, draw_loops, to_png

    fan = fan_of_band(band)
    given = band.given.window if band.given else None
    history = drawn
    if band.given is not None:
        title += f", given {question.given}"
        if drawn.force is None:  # the force of the given part alone
            known = np.where(band.given.holds(band.time), np.asarray(measured.force), np.nan)
            history = replace(drawn, force=known)
    loops = draw_loops(title, drawn, [fan], system)
    write_bytes(question.picture, to_png(loops))
    figure = draw_history(title, history, [fan], system, given=given)
    write_bytes(question.beside("history.png"), to_png(figure))
