"""What a finished run is asked: predictions, devices and running tests, and which test is next."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from mfd_bayes.campaign.guesses import guess_columns
from mfd_bayes.campaign.schema import CampaignFile, TestTable
from mfd_bayes.errors import CampaignError, MfdError, RecordError, StoreError, why_no_file
from mfd_bayes.evaluation.acceptance import DRAWS as ACCEPTANCE_DRAWS
from mfd_bayes.evaluation.acceptance import LIMITS, accept
from mfd_bayes.evaluation.properties import (
    design_rows,
    design_warnings,
    n_draws,
    places_of,
    predicted_rows,
)
from mfd_bayes.evaluation.views import (
    Acceptance,
    AdviceInWords,
    Compared,
    Rows,
    compare,
    fan_of_band,
)
from mfd_bayes.population.bands import DRAWS, KIND_NAMES, Band
from mfd_bayes.population.design import CONDITIONS
from mfd_bayes.population.given import NARROWING, Estimate, Forecaster, is_enough
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.record import NO_ACTUATION, Record, Source, parse_window, read_record
from mfd_bayes.records.trace import Trace, parse_sine
from mfd_bayes.reporting.tables import (
    acceptance_table,
    bands_csv,
    convert_rows,
    design_csv,
    next_csv,
    predicted_csv,
    to_csv,
)
from mfd_bayes.runs.folder import ADVICE, alone_in, check_folder, check_outputs
from mfd_bayes.runs.run import ModelAverage, Run, open_run
from mfd_bayes.runs.tested_range import conditions_of, far_sentences
from mfd_bayes.runs.unit_system import System
from mfd_bayes.store.files import commented, json_text, quoted, remove_file, write_bytes, write_text
from mfd_bayes.units import Axes, actuation_kind, parse_quantity

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


def stated_conditions(command: Any) -> dict[str, float]:
    """Date, count of cycles and temperature of a command, as a campaign reads them."""
    given = {name: getattr(command, name) for name in CONDITIONS}
    given = {name: value for name, value in given.items() if value not in ("", None)}
    try:
        return TestTable.model_validate({"id": "x", "file": "x.csv", **given}).conditions
    except ValidationError as error:
        wrong = error.errors()[0]
        raise CampaignError(
            f"--{wrong['loc'][0]}: {wrong['msg'].removeprefix('Value error, ')}"
        ) from error


def stated_actuation(run: Run, text: str) -> str:
    """The actuation of a command; that of a model without one is not to be given."""
    if not run.system.axes.actuated:
        if text:
            raise CampaignError("--actuation: the campaign's tests have none; leave it out")
        return NO_ACTUATION
    if not text:
        raise CampaignError(f"--actuation is missing: give {actuation_kind(run.actuation_unit)}")
    return text


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


# --- devices are compared with the others

_LIMIT = re.compile(r"\s*(\w+)\s*=\s*(\d+(?:\.\d+)?)\s*(%?)\s*")


@dataclass(frozen=True)
class Inspection:
    """Records of devices that are to be compared with the others; the options of the command.

    `device` is that of all records, or of each; by default each record is of another one. `limit`
    is such as "slip=15 %", by default that of the campaign, else 15 % of all.
    """

    records: tuple[Path, ...]
    folder: Path
    actuation: str = ""
    device: tuple[str, ...] = ()
    limit: tuple[str, ...] = ()
    session: str = ""
    date: str = ""
    cycles: float | None = None
    temperature: str = ""
    draws: int = ACCEPTANCE_DRAWS
    seed: int = 0
    units: str = ""
    force: bool = False
    trust_model: bool = False


def parse_limits(texts: tuple[str, ...]) -> dict[str, float]:
    """Limits of texts such as "slip=15 %"."""
    found = {}
    for text in texts:
        read = _LIMIT.fullmatch(text)
        if read is None:
            raise CampaignError(
                f"--limit reads 'slip=15 %', with {', '.join(LIMITS)} or all, got {text!r}"
            )
        found[read[1]] = float(read[2]) / (100.0 if read[3] else 1.0)
    return found


def read_as_tests(run: Run, path: Path, actuation: str) -> Record:
    """A record by the campaign's columns where the file has them, else by its own headers."""
    stated = run.manifest.settings.columns.given
    names, axes = read_table(path).names, run.system.axes
    columns = {role: c.source for role, c in stated.items() if role != "actuation"}
    there = all(c.key in names or c.name is None for r, c in stated.items() if r in columns)
    return read_record(path, columns if columns and there else None, actuation=actuation, axes=axes)


def accept_records(out: Path, wish: Inspection) -> tuple[tuple[Acceptance, ...], tuple[Path, ...]]:
    """Compare devices with those of a run; table, pages (returned) and picture are written."""
    check_folder(wish.folder, force=wish.force)
    limits = parse_limits(wish.limit)
    run = replace(open_run(out, trust=wish.trust_model), units=wish.units)
    wish = replace(wish, actuation=stated_actuation(run, wish.actuation))
    run.level_of(wish.actuation)
    records = [read_as_tests(run, path, wish.actuation) for path in wish.records]
    device = wish.device[0] if len(wish.device) == 1 else wish.device or ""
    devices = accept(
        *(run, records),
        device=device,
        limits=limits or None,
        session=wish.session,
        conditions=stated_conditions(wish),
        draws=wish.draws,
        seed=wish.seed,
    )
    return devices, _write_acceptance(run, wish, devices)


def _write_acceptance(
    run: Run, wish: Inspection, devices: tuple[Acceptance, ...]
) -> tuple[Path, ...]:
    from mfd_bayes.reporting.figures import draw_batch, to_png
    from mfd_bayes.reporting.page import acceptance_page

    today, manifest, folder = datetime.now(UTC).date().isoformat(), run.manifest, wish.folder
    names = [name for name in run.devices if name]
    compared = f"{len(names)} devices ({', '.join(names)})" if names[1:] else "one device"
    made = (
        f"{manifest.title}, {run.folder.resolve().name} (seed {manifest.seed}, {manifest.finished})"
    )
    actuation = {"actuation": wish.actuation} if run.system.axes.actuated else {}
    heading = [f"run {made}", *(f"actuation {level}" for level in actuation.values())]
    heading.append(f"date {today}")
    heading += [f"{d.device}: {d.sentence}" for d in devices]
    write_text(folder / "acceptance.csv", to_csv(acceptance_table(devices, run.system), heading))
    pages: list[Path] = []
    for device in devices:
        about = {
            f"record {i}": f"{c.record.path.name}, SHA-256 {c.record.sha256}"
            for i, c in enumerate(device.comparisons, start=1)
        }
        about |= {
            **actuation,
            "compared with": f"{made}: {len(run.tests)} calibrated tests of {compared}",
            "program": f"mfd_bayes {manifest.versions.get('mfd_bayes', '')}",
        }
        name = re.sub(r"[^\w+-]+", "_", device.device).strip("_")[:80] or "device"
        path = folder / f"{name}.html"
        if path in pages:
            path = folder / f"{name}_{len(pages) + 1}.html"
        write_text(path, acceptance_page(device, about, today, len(devices), run.system))
        pages.append(path)
    picture = folder / "acceptance.png"
    if len(devices) > 1:
        write_bytes(picture, to_png(draw_batch(devices)))
    else:
        remove_file(picture)
    return tuple(pages)


# --- a test is watched while it runs

POLL = 1.0  # seconds between two looks at the file
SAMPLES = 64  # of the next cycle, of which the band is computed


@dataclass(frozen=True)
class Watched:
    """What is watched, and when it ends; the options of the command.

    `narrowing` is the share by which one more cycle must narrow an interval, to be worth it. The
    command ends when the file has not grown for `wait`.
    """

    record: Path
    actuation: str = ""
    session: str = ""
    device: str = ""
    date: str = ""
    cycles: float | None = None
    temperature: str = ""
    narrowing: str = f"{100 * NARROWING:g} %"
    wait: str = "10 s"
    trust_model: bool = False


@dataclass(frozen=True)
class Cycle:
    """A cycle that has ended, with the estimates of the test so far.

    `band` is the mean width, kip, of the 95 % band of the force in one more cycle of the same
    motion, `misfit` whether the force is not that of a test of this device, and `enough` the cycle
    after which the test was long enough, 0 where it is not yet.
    """

    number: int
    estimates: Mapping[str, Estimate]
    band: float
    misfit: bool
    enough: int
    system: System

    @property
    def sentence(self) -> str:
        """One line: properties with their intervals, beside the population, and what is next."""
        words = self.system.words
        parts = [
            f"{e.name} {words([e.median], e.unit, 3)} ({words([e.lower, e.upper], e.unit, 3)}; "
            f"{100 * e.percentile:.0f} % of new tests are below)"
            for e in self.estimates.values()
        ]
        most = max(self.estimates.values(), key=lambda e: e.narrowing)
        verdict = f"one more would narrow {most.name} by {100 * most.narrowing:.1f} %"
        if self.misfit:
            verdict = (
                "warning: the force does not fit this device, and these figures are not reliable: "
                "check the actuation, the columns and which device it is"
            )
        elif self.enough:
            verdict = f"enough after cycle {self.enough}"
        return (
            f"cycle {self.number}: {', '.join(parts)}; band {words([self.band], 'kip', 3)} wide; "
            f"{verdict}"
        )


def watch(out: Path, watched: Watched) -> Iterator[Cycle]:
    """Cycles of a test as they end in its file, which may still grow."""
    run = open_run(out, trust=watched.trust_model)
    run = replace(run, conditions=stated_conditions(watched))
    watched = replace(watched, actuation=stated_actuation(run, watched.actuation))
    level = run.level_of(watched.actuation)
    narrowing = parse_quantity(watched.narrowing, "dimensionless", of="--narrowing")
    wait = parse_quantity(watched.wait, "time", of="--wait")
    follower: Forecaster | None = None
    number = begin = enough = 0
    for trace in _growing(run, watched, wait):
        if trace.force is None:
            raise RecordError(f"{watched.record} has no column of the force")
        turns = trace.cycle_turns[::2]
        for first, end in pairwise(turns[turns >= begin - 1].tolist()):
            follower = follower or _follow(run, trace, level, watched)
            part = slice(begin, end + 1)
            follower.update(
                trace.time[part], trace.displacement[part], None, np.asarray(trace.force)[part]
            )
            number, begin = number + 1, end + 1
            estimates = follower.estimates(number)
            misfit = follower.is_misfit
            if not (enough or misfit) and is_enough(estimates, number, narrowing):
                enough = number
            width = _width(follower, trace, first, end)
            yield Cycle(number, estimates, width, misfit, enough, run.system)
    if not number:
        raise RecordError(
            f"{watched.record} has no full cycle: expected a motion that turns three times"
        )


def _follow(run: Run, trace: Trace, level: float, watched: Watched) -> Forecaster:
    """Forecaster of a test with the stroke and the speed of its first cycle."""
    reached = conditions_of(trace)
    return run.follow(
        level,
        amplitude=0.5 * reached["stroke"],
        velocity=reached.get("speed"),
        session=watched.session,
        device=watched.device,
    )


def _width(follower: Forecaster, trace: Trace, first: int, end: int) -> float:
    """Mean width of the band of the cycle between two samples, made once more, kip."""
    at = np.arange(first, end, max(1, (end - first) // SAMPLES))
    later = trace.time[end] - trace.time[first] + trace.time[at[1]] - trace.time[at[0]]
    again = Trace.from_arrays(trace.time[at] + later, trace.displacement[at], trace.actuation)
    band = follower.band(again)
    return float(np.mean(band.upper - band.lower))


def _growing(run: Run, watched: Watched, wait: float) -> Iterator[Trace]:
    """The record each time that its file has grown, until it has not for `wait` s.

    The last line of a file that is being written may be half a line: while the file grows, what
    cannot be read is read again.
    """
    seen = None
    while True:
        try:
            state = watched.record.stat()
        except OSError as error:
            raise RecordError(f"cannot read {watched.record}: {error.strerror}") from error
        idle = time.time() - state.st_mtime >= wait
        if idle or state.st_size != seen:
            seen = state.st_size
            try:
                yield read_as_tests(run, watched.record, watched.actuation).trace()
            except MfdError:
                if idle:
                    raise
        if idle:
            return
        time.sleep(POLL)


# --- which test to make next

_LARGEST = 2**20  # bytes of a file of candidates


@dataclass(frozen=True)
class Wish:
    """What is asked about the next test; the options of the command."""

    goal: str = ""
    candidates: str = ""
    limits: str = ""
    table: Path | None = None
    draft: Path | None = None
    tests: int = 1
    draws: int = 2000
    seed: int = 0
    units: str = ""
    force: bool = False
    trust_model: bool = False


def next_test(out: Path, wish: Wish) -> tuple[AdviceInWords, list[Path]]:
    """Which test to make next, and the files: the table, its JSON and a picture are written."""
    if wish.tests > 1 and wish.draft is None:
        raise CampaignError("--tests says how many tests --write drafts: give --write too")
    table = out / ADVICE[0] if wish.table is None else wish.table
    if table.suffix.lower() in (".json", ".png"):
        raise StoreError(f"{table} must not end in {table.suffix}: JSON and PNG go beside it")
    files = [table, table.with_suffix(".json"), table.with_suffix(".png")]
    drafts = [] if wish.draft is None else [wish.draft]
    inputs = [Path(wish.candidates)] if _is_path(wish.candidates) else []
    own = [] if wish.table is None else files  # else they are the run's own
    check_outputs([*own, *drafts], inputs, force=wish.force)
    candidates = _candidates(wish.candidates)
    run = replace(open_run(out, trust=wish.trust_model), units=wish.units)
    advice = run.next_test(
        wish.goal or None,
        candidates,
        limits=wish.limits or None,
        draws=wish.draws,
        seed=wish.seed,
    )
    words = AdviceInWords(advice, run.system, run.actuation_unit)
    if wish.table is None:
        with alone_in(out):
            _write_advice(words, files)
    else:
        _write_advice(words, files)
    for draft in drafts:
        write_text(draft, _drafted(words, wish.tests))
    return words, [*files, *drafts]


def _candidates(text: str) -> str | list[str] | None:
    """Candidates of a text, or of the lines of a file."""
    path = Path(text)
    if not _is_path(text):
        if path.suffix in (".txt", ".csv", ".toml", ".lst"):
            raise CampaignError(f"--candidates: there is no file {text}")
        return text or None
    if reason := why_no_file(path):
        raise CampaignError(f"--candidates: {path} {reason}")
    try:
        if path.stat().st_size > _LARGEST:
            raise CampaignError(f"--candidates: {path} is larger than 1 MB")
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise CampaignError(f"--candidates: cannot read {path}: {error}") from error
    tests = [test for test in (line.partition("#")[0].strip() for line in lines) if test]
    if not tests:
        raise CampaignError(f"--candidates: {path} has no test; one a line is expected")
    return tests


def _is_path(text: str) -> bool:
    """Whether candidates are the name of a file that exists."""
    if not text.strip() or len(text) > 1000 or "|" in text or "\0" in text:
        return False
    try:
        return Path(text).exists()
    except OSError:
        return False


def _write_advice(words: AdviceInWords, files: list[Path]) -> None:
    """Write table, JSON and picture."""
    from mfd_bayes.reporting.figures import draw_next, to_png

    write_text(files[0], next_csv(words))
    write_text(files[1], json_text(words.content(), indent=2) + "\n")
    title = f"Next test: {words.candidate(words.advice[0].candidate)}"
    write_bytes(files[2], to_png(draw_next(words.advice, words.system, words.unit, title)))


def _drafted(advice: AdviceInWords, number: int) -> str:
    """Entries of a campaign file for the best tests."""
    chosen = advice.advice.together
    together = chosen[min(number, len(chosen)) - 1]
    tests = (advice.advice[0].candidate,) if number == 1 else together.candidates
    lines = ["# Drafted by mfd-bayes next: add these to campaign.toml once the tests are made."]
    for k, test in enumerate(tests, 1):
        words = advice.candidate(test)
        name = f"next{k}_" + re.sub(r"[^A-Za-z0-9.]+", "_", words)
        lines += [
            "",
            commented(f"motion: {words}, {test.cycles:g} cycles ({test.waveform})"),
            "[[test]]",
            f"id = {quoted(name)}",
            f"file = {quoted(f'{name}.csv')}  # the record, once it is there",
            f"actuation = {quoted(words.split(',', maxsplit=1)[0])}",
            'role = "calibrate"',
        ]
        if test.device:
            lines.append(f"device = {quoted(test.device)}  # its name")
    return "\n".join(lines) + "\n"
