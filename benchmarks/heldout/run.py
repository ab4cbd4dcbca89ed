"""Do predicted bands hold the force of real tests that were left out, without being too wide?

    python -m benchmarks.heldout.run > benchmarks/heldout/heldout.txt
    python -m benchmarks.heldout.run --kinds >> benchmarks/heldout/heldout.txt
    python -m benchmarks.heldout.run --given three_stage backlash > benchmarks/heldout/given.txt

calibrates the sessions of the band brake (half an hour each on two cores) and predicts what was
left out: the 36 lb harmonic tests, each in turn, and the earthquakes from all of them; of the 2022
session each tension in turn, and each test whose tension another test has too. --kinds: kinds of
motion; the 30 lb tests and the earthquakes from all 36 lb tests. --given: the earthquakes alone and
given the seconds before the shaking, by each model and by all in equal parts; then milliseconds of
an update with 64 samples of a record at 1024 Hz, and of a band of the next 64 (follow.txt).
--quick: three tests of one tension and an earthquake, with little effort, two minutes. Exit status
1: a limit was missed, or an update takes longer than its samples take to arrive. Records come from
--data.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import time
from collections.abc import Callable

import numpy as np
import pandas as pd

import mfd_bayes as mb
from mfd_bayes.applications.comparison.crossvalidation import folds_of, run_folds
from mfd_bayes.evaluation.scores import rrse, score
from mfd_bayes.pipeline.options import RunOptions
from mfd_bayes.runs.manifest import Score

DRAWS = 800
PUBLISHED = {
    "36lb_0.25Hz_0.5in": 0.245,
    "36lb_0.50Hz_0.5in": 0.256,
    "36lb_0.10Hz_1.0in_SI": 0.233,
    "36lb_0.25Hz_1.0in": 0.206,
    "36lb_0.50Hz_1.0in": 0.201,
    "36lb_0.50Hz_1.5in": 0.205,
    "36lb_1.00Hz_1.0in": 0.205,
    "36lb_ImperialValleyDBE": 0.440,
    "36lb_KocaeliDBE": 0.794,
    "36lb_0.25Hz_1.5in": 0.180,
}
"""RRSE of the LuGre model that the dataset's authors published (shared/data/brfd/README.md)."""
QUAKES = {"36lb_ImperialValleyDBE": (3.0, 7.5), "36lb_KocaeliDBE": (6.0, 14.0)}
"""Where they are scored, s, after the part that may be given; other records as a whole."""

KINDS: dict[str, Callable[[str], bool]] = {
    "all at 1 Hz": lambda name: "1.00Hz" in name,
    "all at 0.5 Hz": lambda name: "0.50Hz" in name,
    "all slow ones (0.25 and 0.1 Hz)": lambda name: "0.25Hz" in name or "0.10Hz" in name,
    "all of 0.5 in": lambda name: "0.5in" in name,
    "all of 1.5 in": lambda name: "1.5in" in name,
}
"""Kinds of harmonic motion that are left out, by the ids of their tests."""
SAMPLES, SECONDS, SAMPLED = 64, 12.0, 1024.0  # of an update and of the record; Hz

missed: list[str] = []


def bar(what: str, value: float, least: float, most: float) -> None:
    """Print a value with its limits, and note it if it misses them."""
    good = least <= value <= most
    print(f"  {'holds ' if good else 'MISSED'}  {what}: {value:.3f} ({least:g} to {most:g})")
    if not good:
        missed.append(what)


def row(name: str, found: Score, **more: object) -> dict:
    """Line of a table; coverage in %, width and CRPS in kip."""
    values = (found.width, found.interval_score, found.crps, found.rrse)
    numbers = (*(100.0 * share for share in found.coverage), *values)
    columns = ("50 %", "90 %", "95 %", "width", "interval", "CRPS", "RRSE")
    return {"test": name, **dict(zip(columns, numbers, strict=True)), **more}


def table(title: str, rows: list[dict]) -> pd.DataFrame:
    """Print a table, with what was published and the mean of its lines; the table."""
    frame = pd.DataFrame(rows).set_index("test")
    frame["published"] = frame.index.map(PUBLISHED)
    frame = frame.dropna(axis=1, how="all")
    shown = pd.concat([frame, frame.mean(numeric_only=True).to_frame("mean").T])
    print(f"\n{title}\n{shown.to_string(float_format='%.3f', na_rep='')}", flush=True)
    return frame


def left_out(run: mb.Run, by: str, jobs: int, chosen=lambda _: True) -> list:
    """Predictions of the parts of a run that are left out, from populations of little effort."""
    folds = [f for f in folds_of(run, by, "quick") if any(map(chosen, f.left_out))]
    return list(run_folds(run, folds, RunOptions(jobs=jobs), lambda _: None))


def score_of(source: mb.Run, name: str, trace: mb.Trace) -> Score:
    """Score of the predicted band of a record."""
    band = source.predict(trace, "observation", draws=DRAWS, seed=1)
    at = scored(name, trace)
    return score(band.draws[:, at], np.asarray(trace.force)[at])


def scored(name: str, trace: mb.Trace) -> np.ndarray:
    """At which samples a record is scored."""
    begin, end = QUAKES.get(name, (-np.inf, np.inf))
    return (trace.time >= begin) & (trace.time <= end)


def rows_of(predictions: list) -> list[dict]:
    """Lines of tests left out, beside the bands of their own fits."""
    return [
        row(p.test, p.score, fitted=p.fitted.width, fitted_crps=p.fitted.crps) for p in predictions
    ]


def one_level(run: mb.Run, options) -> None:
    """The 36 lb session: each test left out, and the earthquakes."""
    found = table("36 lb, 2023: each from the others", rows_of(left_out(run, "test", options.jobs)))
    rows = [row(name, score_of(run, name, trace)) for name, trace in run.held_out.items()]
    quakes = table("36 lb, 2023: earthquakes from the harmonic tests", rows)
    if options.quick:
        return
    total, shares = found.mean(), found["RRSE"] / found["published"]
    bar("mean of RRSE over that published", shares.mean(), 0.0, 0.55)
    bar("largest RRSE over that published", shares.max(), 0.0, 0.75)
    bar("coverage of 95 % bands", total["95 %"], 92.0, 97.0)
    bar("coverage of 50 % bands", total["50 %"], 45.0, 58.0)
    bar("least coverage", found["95 %"].min(), 85.0, 100.0)
    bar("mean width of 95 % bands, kip", total["width"], 0.0, 1.40)
    bar("mean CRPS, kip", total["CRPS"], 0.0, 0.182)
    bar("RRSE of Imperial Valley", quakes["RRSE"]["36lb_ImperialValleyDBE"], 0.0, 0.30)


def many_levels(run: mb.Run, jobs: int) -> None:
    """The 2022 session: each tension left out, and each test whose tension another has."""
    away = left_out(run, "level", jobs)
    found = table("2022: each tension from the others", rows_of(away))
    parts = [p.part for p in away]
    repeated = {p.test for p in away if parts.count(p.part) > 1}
    near = rows_of(left_out(run, "test", jobs, repeated.__contains__))
    seen = table("2022: each test whose tension another frequency shows", near).mean()
    total = found.mean()
    bar("coverage of 95 % bands, tension left out", total["95 %"], 92.0, 98.0)
    bar("coverage of 50 % bands, tension left out", total["50 %"], 42.0, 58.0)
    bar("least coverage", found["95 %"].min(), 80.0, 100.0)
    bar("mean width over that of a fitted test", total["width"] / total["fitted"], 0.0, 3.0)
    bar("mean CRPS, kip", total["CRPS"], 0.0, 0.20)
    bar("width at a tension seen over a fitted test's", seen["width"] / seen["fitted"], 0.0, 2.0)


def kinds(run: mb.Run, other: mb.Run, seed: int) -> None:
    """Whole kinds of motion left out: the least and the mean coverage of each kind's tests."""
    sources = {}
    for kind, belongs in KINDS.items():
        kept = [name for name in run.tests if not belongs(name)]
        if kept and len(kept) < len(run.tests):
            away = {n: test.trace for n, test in run.tests.items() if n not in kept}
            sources[kind] = common.without(run, kept, "quick", (seed, 4)), away
    sources["30 lb from 36 lb"] = run, {n: test.trace for n, test in other.tests.items()}
    sources["earthquakes from 36 lb"] = run, run.held_out
    for kind, (source, traces) in sources.items():
        rows = [row(name, score_of(source, name, trace)) for name, trace in traces.items()]
        found = table(f"36 lb, 2023: {kind}", rows)
        bar(f"coverage of 95 % bands, {kind}", found["95 %"].mean(), 90.0, 100.0)


def given(runs: list[mb.Run], draws: int) -> None:
    """Earthquakes that the runs left out, alone and given their first seconds."""
    sources = {run.manifest.settings.model: run for run in runs}
    if len(runs) > 1:
        sources["equal parts"] = mb.ModelAverage(runs)
    for model, source in sources.items():
        rows = []
        for name, trace in runs[0].held_out.items():
            begin, at = QUAKES[name][0], scored(name, trace)
            for window in (None, (float(trace.time[0]), begin)):
                band = source.predict(trace, "observation", draws=draws, given=window)
                inside, force = band.draws[:, at], np.asarray(trace.force)[at]
                words = f"given {begin:g} s by {band.given.method}" if window else "alone"
                of_mean = rrse(inside.mean(axis=0), force)
                rows.append(row(name, score(inside, force), of_mean=of_mean, how=words))
        table(f"Model {model}", rows)


def follow(run: mb.Run, trace: mb.Trace, draws: int) -> None:
    """Print the times of following a record; note it where samples arrive faster.

    An update only keeps its samples: a band weighs the draws by all samples so far.
    """
    forecaster = run.follow(0.036, amplitude=0.18, velocity=1.5, draws=draws, refresh=False)
    updates, bands = [], []
    for number in range(int(SECONDS * SAMPLED) // SAMPLES):
        new, ahead = (slice(k * SAMPLES, (k + 1) * SAMPLES) for k in (number, number + 1))
        columns = trace.time[new], trace.displacement[new], None, np.asarray(trace.force)[new]
        updates.append(timed(forecaster.update, *columns))
        motion = mb.Trace.from_arrays(trace.time[ahead], trace.displacement[ahead])
        if number % 16 == 15:
            bands.append(timed(forecaster.band, motion))
    shown = np.median(updates), max(updates), np.median(bands), max(bands)
    print(f"{draws:6}" + "".join(f"{each:14.2f}" for each in (*shown, timed(forecaster.refresh))))
    arrive = 1e3 * SAMPLES / SAMPLED
    if max(updates) > arrive:
        missed.append(f"{draws} draws: an update takes more than {arrive} ms")


def timed(call: Callable, *arguments: object) -> float:
    """Processor milliseconds of a call."""
    began = time.process_time()
    call(*arguments)
    return 1e3 * (time.process_time() - began)


def main() -> None:
    parser = common.parser_of(__doc__ or "", data=True, jobs=2, out="out_heldout")
    parser.add_argument("--model", default="three_stage", help="as in a campaign file")
    parser.add_argument("--kinds", action="store_true", help="kinds of motion left out, alone")
    parser.add_argument("--given", nargs="+", metavar="MODEL", help="earthquakes given, alone")
    options = common.begin(parser)
    models = options.given or [options.model]
    runs = [common.calibrated(options, "36lb", model) for model in models]
    if options.kinds:
        kinds(runs[0], common.calibrated(options, "30lb", options.model), options.seed)
    elif options.given:
        given(runs, 200 if options.quick else 1000)
        trace = mb.read_record(options.data / "brfd" / "2023_36lb_KocaeliDBE.csv").trace()
        print(f"\nFollowed, {SAMPLES} samples at a time, processor ms")
        heads = ("update", "slowest", "band of 64", "slowest", "refresh")
        print(f"{'draws':>6}" + "".join(f"{head:>14}" for head in heads))
        for draws in (256, 1000)[: 1 if options.quick else 2]:
            follow(runs[0], trace, draws)
    else:
        one_level(runs[0], options)
        if not options.quick:
            many_levels(common.calibrated(options, "2022-07", options.model), options.jobs)
    common.finish([] if options.quick else missed)


if __name__ == "__main__":
    main()
