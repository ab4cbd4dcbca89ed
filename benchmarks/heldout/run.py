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


def bar(label: str, value: float, lower: float, upper: float) -> None:
    """Print a value with its limits, and note it if it misses them."""
    hit = lower <= value <= upper
    print(f"  {'holds ' if hit else 'MISSED'}  {label}: {value:.3f} ({lower:g} to {upper:g})")
    if not hit:
        missed.append(label)


def row(name: str, result: Score, **extra: object) -> dict:
    """Line of a table; coverage in %, width and CRPS in kip."""
    values = (result.width, result.interval_score, result.crps, result.rrse)
    numbers = (*(100.0 * share for share in result.coverage), *values)
    columns = ("50 %", "90 %", "95 %", "width", "interval", "CRPS", "RRSE")
    return {"test": name, **dict(zip(columns, numbers, strict=True)), **extra}


def table(title: str, rows: list[dict]) -> pd.DataFrame:
    """Print a table, with what was published and the mean of its lines; the table."""
    frame = pd.DataFrame(rows).set_index("test")
    frame["published"] = frame.index.map(PUBLISHED)
    frame = frame.dropna(axis=1, how="all")
    display = pd.concat([frame, frame.mean(numeric_only=True).to_frame("mean").T])
    print(f"\n{title}\n{display.to_string(float_format='%.3f', na_rep='')}", flush=True)
    return frame


def left_out(run: mb.Run, criterion: str, jobs: int, select=lambda _: True) -> list:
    """Predictions of the parts of a run that are left out, from populations of little effort."""
    folds = [f for f in folds_of(run, criterion, "quick") if any(map(select, f.left_out))]
    return list(run_folds(run, folds, RunOptions(jobs=jobs), lambda _: None))


def score_of(source: mb.Run, name: str, trace: mb.Trace) -> Score:
    """Score of the predicted band of a record."""
    band = source.predict(trace, "observation", draws=DRAWS, seed=1)
    mask = scored(name, trace)
    return score(band.draws[:, mask], np.asarray(trace.force)[mask])


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
    frame = table("36 lb, 2023: each from the others", rows_of(left_out(run, "test", options.jobs)))
    rows = [row(name, score_of(run, name, trace)) for name, trace in run.held_out.items()]
    quakes = table("36 lb, 2023: earthquakes from the harmonic tests", rows)
    if options.quick:
        return
    total, shares = frame.mean(), frame["RRSE"] / frame["published"]
    bar("mean of RRSE over that published", shares.mean(), 0.0, 0.55)
    bar("largest RRSE over that published", shares.max(), 0.0, 0.75)
    bar("coverage of 95 % bands", total["95 %"], 92.0, 97.0)
    bar("coverage of 50 % bands", total["50 %"], 45.0, 58.0)
    bar("least coverage", frame["95 %"].min(), 85.0, 100.0)
    bar("mean width of 95 % bands, kip", total["width"], 0.0, 1.40)
    bar("mean CRPS, kip", total["CRPS"], 0.0, 0.182)
    bar("RRSE of Imperial Valley", quakes["RRSE"]["36lb_ImperialValleyDBE"], 0.0, 0.30)


def many_levels(run: mb.Run, jobs: int) -> None:
    """The 2022 session: each tension left out, and each test whose tension another has."""
    predictions = left_out(run, "level", jobs)
    scores = table("2022: each tension from the others", rows_of(predictions))
    levels = [p.part for p in predictions]
    repeated = {p.test for p in predictions if levels.count(p.part) > 1}
    repeats = rows_of(left_out(run, "test", jobs, repeated.__contains__))
    means = table("2022: each test whose tension another frequency shows", repeats).mean()
    total = scores.mean()
    bar("coverage of 95 % bands, tension left out", total["95 %"], 92.0, 98.0)
    bar("coverage of 50 % bands, tension left out", total["50 %"], 42.0, 58.0)
    bar("least coverage", scores["95 %"].min(), 80.0, 100.0)
    bar("mean width over that of a fitted test", total["width"] / total["fitted"], 0.0, 3.0)
    bar("mean CRPS, kip", total["CRPS"], 0.0, 0.20)
    bar("width at a tension seen over a fitted test's", means["width"] / means["fitted"], 0.0, 2.0)


def kinds(run: mb.Run, second: mb.Run, seed: int) -> None:
    """Whole kinds of motion left out: the least and the mean coverage of each kind's tests."""
    sources = {}
    for kind, belongs in KINDS.items():
        names = [name for name in run.tests if not belongs(name)]
        if names and len(names) < len(run.tests):
            unseen = {n: test.trace for n, test in run.tests.items() if n not in names}
            sources[kind] = common.without(run, names, "quick", (seed, 4)), unseen
    sources["30 lb from 36 lb"] = run, {n: test.trace for n, test in second.tests.items()}
    sources["earthquakes from 36 lb"] = run, run.held_out
    for kind, (source, traces) in sources.items():
        rows = [row(name, score_of(source, name, trace)) for name, trace in traces.items()]
        scores = table(f"36 lb, 2023: {kind}", rows)
        bar(f"coverage of 95 % bands, {kind}", scores["95 %"].mean(), 90.0, 100.0)


def given(runs: list[mb.Run], draws: int) -> None:
    """Earthquakes that the runs left out, alone and given their first seconds."""
    sources = {run.manifest.settings.model: run for run in runs}
    if len(runs) > 1:
        sources["equal parts"] = mb.ModelAverage(runs)
    for model, source in sources.items():
        rows = []
        for name, trace in runs[0].held_out.items():
            begin, mask = QUAKES[name][0], scored(name, trace)
            for window in (None, (float(trace.time[0]), begin)):
                band = source.predict(trace, "observation", draws=draws, condition_on=window)
                draws_scored, force = band.draws[:, mask], np.asarray(trace.force)[mask]
                words = f"given {begin:g} s by {band.conditioning.method}" if window else "alone"
                of_mean = rrse(draws_scored.mean(axis=0), force)
                rows.append(row(name, score(draws_scored, force), of_mean=of_mean, how=words))
        table(f"Model {model}", rows)


def follow(run: mb.Run, trace: mb.Trace, draws: int) -> None:
    """Print the times of following a record; note it where samples arrive faster.

    An update only keeps its samples: a band weighs the draws by all samples so far.
    """
    forecaster = run.follow(0.036, amplitude=0.18, velocity=1.5, draws=draws, refresh=False)
    updates, bands = [], []
    for number in range(int(SECONDS * SAMPLED) // SAMPLES):
        block, ahead = (slice(k * SAMPLES, (k + 1) * SAMPLES) for k in (number, number + 1))
        columns = trace.time[block], trace.displacement[block], None, np.asarray(trace.force)[block]
        updates.append(timed(forecaster.update, *columns))
        motion = mb.Trace.from_arrays(trace.time[ahead], trace.displacement[ahead])
        if number % 16 == 15:
            bands.append(timed(forecaster.band, motion))
    times = np.median(updates), max(updates), np.median(bands), max(bands)
    print(f"{draws:6}" + "".join(f"{ms:14.2f}" for ms in (*times, timed(forecaster.refresh))))
    arrive = 1e3 * SAMPLES / SAMPLED
    if max(updates) > arrive:
        missed.append(f"{draws} draws: an update takes more than {arrive} ms")


def timed(function: Callable, *arguments: object) -> float:
    """Processor milliseconds of a call."""
    began = time.process_time()
    function(*arguments)
    return 1e3 * (time.process_time() - began)


def main() -> None:
    parser = common.parser_of(__doc__ or "", data=True, jobs=2, output="out_heldout")
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
