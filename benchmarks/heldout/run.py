"""Whether predicted bands hold the force of real tests that were left out, without being too wide.

    python -m benchmarks.heldout.run > benchmarks/heldout/heldout.txt

calibrates the sessions of the band brake and predicts what was left out:

-   the 36 lb harmonic tests, each in turn, and the earthquakes from all of them;
-   the 2022 session: each tension in turn, and each test whose tension another test has too;
-   with --kinds, instead: kinds of motion. All 36 lb tests at 1 Hz from the others, all with a
    stroke of 0.5 in, all of 1.5 in, all slow ones, all at 0.5 Hz; the 30 lb tests and the
    earthquakes from all 36 lb tests;
-   with --zero, instead: the two tests at zero tension from those at 30 and 36 lb, and each from
    all others.

The calibrated runs stay in out_heldout/, so that a second run does not sample them again; delete
the folder when records or code have changed. --noise staged shows what the stages of the noise are
worth. For comparison LuGre alone is fitted to each record by least squares. Exit status 1: a limit
was missed. The real records come from --data (MFD_BAYES_DATA, ../shared/data).
"""

from __future__ import annotations

import os

# Read when numpy is imported.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.common.data import PROJECT, add_data_option
from benchmarks.heldout import records
from mfd_bayes.evaluation.crossvalidate import folds_of, run_folds
from mfd_bayes.evaluation.scores import score
from mfd_bayes.pipeline.calibrate import calibrate
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.population.bands import Forecast, Predictor
from mfd_bayes.population.inference import infer_population
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.scores import Score

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
WINDOWS = {"36lb_ImperialValleyDBE": (3.0, 7.5), "36lb_KocaeliDBE": (6.0, 14.0)}
"""Where they are scored, s; other records as a whole."""

missed: list[str] = []


def bar(what: str, value: float, good: bool, limit: str) -> None:
    """Print one limit with its value, and note it if it was missed."""
    print(f"  {'holds ' if good else 'MISSED'}  {what}: {value:.3f} ({limit})")
    if not good:
        missed.append(what)


def line(name: str, found: Score, *more: str) -> None:
    half, most, nearly = found.coverage
    print(
        f"  {name:32s} {100 * half:5.1f} {100 * most:5.1f} {100 * nearly:5.1f}  "
        f"{found.width:6.2f} {found.interval_score:7.2f} {found.crps:6.3f} {found.rrse:6.3f}  "
        + "  ".join(more),
        flush=True,
    )


def header(title: str, *more: str) -> None:
    print(f"\n{title}")
    print(
        f"  {'':32s} covered by 50, 90, 95 %   width  interval  CRPS   RRSE  " + "  ".join(more),
        flush=True,
    )


def finished(folder: Path, session: str, options: argparse.Namespace) -> Run:
    """Calibrated run of a session's records."""
    kind = records.Kind(options.noise, options.model, tuple(options.dependence))
    out = folder / f"{session}_{kind.name}"
    place = folder / f"campaign_{out.name}"
    campaign = records.lay_out(options.data / "brfd", place, session, kind)
    chosen = Options(effort=options.effort, seed=1, jobs=options.jobs, resume=out.exists())
    plan = plan_campaign(campaign, chosen)
    return calibrate(plan, out, lambda s: print(s.id, s.stage, file=sys.stderr))


def mean(scores: list[Score]) -> Score:
    """Mean scores of records."""
    fields = ("width", "interval_score", "crps", "rrse")
    coverage = tuple(np.mean([s.coverage for s in scores], axis=0).tolist())
    return Score(coverage, *(float(np.mean([getattr(s, f) for s in scores])) for f in fields))


def one_level(run: Run, options: argparse.Namespace) -> None:
    """The 36 lb session: each test left out, and the earthquakes."""
    noise = run.manifest.settings.noise
    title = f"36 lb, 2023: each harmonic test from the others; earthquakes ({noise} noise)"
    header(title, "published", "least squares", "fitted width", "MAE of LuGre")
    found, fitted, lugre, squares = {}, {}, {}, {}
    folds = folds_of(run, "test", options.fold_effort)
    for p in run_folds(run, folds, Options(jobs=options.jobs), lambda _: None):
        found[p.test], fitted[p.test] = p.score, p.fitted.width
        lugre[p.test] = records.lugre_error(run.tests[p.test].trace)
        squares[p.test] = records.least_squares_error(run, p.test)
    harmonic = mean(list(found.values()))
    for name, trace in run.held_out.items():
        band = run.predict(trace, "observation", draws=DRAWS)
        begin, end = WINDOWS[name]
        inside = (trace.time >= begin) & (trace.time <= end)
        found[name] = score(band.draws[:, inside], np.asarray(trace.force)[inside])
        lugre[name] = records.lugre_error(trace, inside)
    for name, s in found.items():
        published = f"{PUBLISHED[name]:.3f}" if name in PUBLISHED else "   – "
        width = f"{fitted[name]:.2f}" if name in fitted else "  – "
        plain = f"{squares[name]:13.3f}" if name in squares else f"{'–':>13s}"
        line(name, s, f"{published:>9s}", plain, f"{width:>12s}", f"{lugre[name]:.3f}")
    line("mean of the harmonic tests", harmonic)
    judge_one_level(found, squares, harmonic)


def judge_one_level(found: dict[str, Score], squares: dict[str, float], total: Score) -> None:
    """The bars of the 36 lb session."""
    shares = {name: found[name].rrse / PUBLISHED[name] for name in squares}
    plain = float(np.mean([squares[name] / PUBLISHED[name] for name in squares]))
    ratio = float(np.mean(list(shares.values())))
    bar("mean of RRSE over that published", ratio, ratio <= 0.55, "at most 0.55")
    bar("that over least squares with one vector", ratio / plain, ratio <= 1.02 * plain, "1.02")
    worst = max(shares, key=lambda name: shares[name])
    bar(f"largest RRSE over that published ({worst})", shares[worst], shares[worst] <= 0.75, "0.75")
    half, _, covered = total.coverage
    bar("coverage of 95 % bands", covered, 0.92 <= covered <= 0.97, "0.92 to 0.97")
    bar("coverage of 50 % bands", half, 0.45 <= half <= 0.58, "0.45 to 0.58")
    least = min(squares, key=lambda name: found[name].coverage[2])
    value = found[least].coverage[2]
    bar(f"least coverage ({least})", value, value >= 0.85, "at least 0.85")
    bar("mean width of 95 % bands, kip", total.width, total.width <= 1.40, "at most 1.40")
    bar("mean CRPS, kip", total.crps, total.crps <= 0.182, "at most 0.182")
    quake = found["36lb_ImperialValleyDBE"].rrse
    bar("RRSE of Imperial Valley", quake, quake <= 0.30, "at most 0.30")


def many_levels(run: Run, options: argparse.Namespace) -> None:
    """The 2022 session: each tension left out, and each test whose tension another has."""
    noise = run.manifest.settings.noise
    header(f"2022: each tension from the others ({noise} noise)", "fitted width", "fitted CRPS")
    folds = folds_of(run, "level", options.fold_effort)
    predictions = run_folds(run, folds, Options(jobs=options.jobs), lambda _: None)
    for p in predictions:
        line(p.test, p.score, f"{p.fitted.width:12.2f}", f"{p.fitted.crps:.3f}")
    total, own = mean([p.score for p in predictions]), mean([p.fitted for p in predictions])
    line("mean", total, f"{own.width:12.2f}", f"{own.crps:.3f}")
    parts = [p.part for p in predictions]
    repeated = [p.test for p in predictions if parts.count(p.part) > 1]
    folds = folds_of(run, "test", options.fold_effort)
    again = [fold for fold in folds if fold.left_out[0] in repeated]
    seen = run_folds(run, again, Options(jobs=options.jobs), lambda _: None)
    header(f"2022: each test whose tension another frequency shows ({noise} noise)", "fitted width")
    for p in seen:
        line(p.test, p.score, f"{p.fitted.width:12.2f}")
    near, near_own = mean([p.score for p in seen]), mean([p.fitted for p in seen])
    line("mean", near, f"{near_own.width:12.2f}")
    covered = total.coverage[2]
    good = 0.92 <= covered <= 0.98
    bar("coverage of 95 % bands, tension left out", covered, good, "0.92 to 0.98")
    half = total.coverage[0]
    bar("coverage of 50 % bands, tension left out", half, 0.42 <= half <= 0.58, "0.42 to 0.58")
    least = min(predictions, key=lambda p: p.score.coverage[2])
    value = least.score.coverage[2]
    bar(f"least coverage ({least.test})", value, value >= 0.80, "at least 0.80")
    ratio = total.width / own.width
    bar("mean width over that of a fitted test", ratio, ratio <= 3.0, "at most 3")
    bar("mean CRPS, kip", total.crps, total.crps <= 0.20, "at most 0.20")
    ratio = near.width / near_own.width
    bar("width at a tension seen over that of a fitted test", ratio, ratio <= 2.0, "at most 2")


KINDS: dict[str, Callable[[str], bool]] = {
    "all at 1 Hz": lambda name: "1.00Hz" in name,
    "all at 0.5 Hz": lambda name: "0.50Hz" in name,
    "all slow ones (0.25 and 0.1 Hz)": lambda name: "0.25Hz" in name or "0.10Hz" in name,
    "all of 0.5 in": lambda name: "0.5in" in name,
    "all of 1.5 in": lambda name: "1.5in" in name,
}
"""Kinds of harmonic motion that are left out, by the ids of their tests."""


def kinds(options: argparse.Namespace) -> None:
    """Whole kinds of motion left out: the mean over each kind's tests, and the least coverage."""
    run, other = (finished(options.out, session, options) for session in ("36lb", "30lb"))
    header("36 lb, 2023: kinds of motion left out (means over the tests)", "least", "tests")
    some = next(iter(run.tests.values())).posterior
    for kind, belongs in KINDS.items():
        rest = {name: test for name, test in run.tests.items() if not belongs(name)}
        settings = run.manifest.settings.inference(options.fold_effort, (1, 4))
        population = infer_population(rest, run.priors, settings).population
        predictor = Predictor(population, some.model, some.noise)
        left_out = {name: test.trace for name, test in run.tests.items() if belongs(name)}
        judge_kind(kind, [score_of(predictor, trace) for trace in left_out.values()])
    predictor = Predictor(run.population, some.model, some.noise)
    traces = [test.trace for test in other.tests.values()]
    judge_kind("30 lb from 36 lb", [score_of(predictor, trace) for trace in traces])
    for name, trace in run.held_out.items():
        begin, end = WINDOWS[name]
        inside = (trace.time >= begin) & (trace.time <= end)
        judge_kind(name, [score_of(predictor, trace, inside)])


def score_of(predictor: Predictor, trace: Trace, inside: np.ndarray | slice = slice(None)) -> Score:
    """Score of the predicted band of a record."""
    band = predictor.predict(trace, Forecast("observation", draws=DRAWS, seed=1))
    return score(band.draws[:, inside], np.asarray(trace.force)[inside])


def judge_kind(kind: str, found: list[Score]) -> None:
    total, least = mean(found), min(s.coverage[2] for s in found)
    line(kind, total, f"{100 * least:5.1f}", f"{len(found):5d}")
    covered = total.coverage[2]
    bar(f"coverage of 95 % bands, {kind}", covered, covered >= 0.90, "at least 0.90")


def zero(run: Run, options: argparse.Namespace) -> None:
    """Three levels of one session, one of them zero: what the laws say there, with and without."""
    noise = run.manifest.settings.noise
    print(f"\n2023-04: 0, 30 and 36 lb, affine laws ({noise} noise)")
    for name, values in run.population.slopes.items():
        low, middle, high = np.quantile(values, [0.025, 0.5, 0.975])
        print(f"  {name:32s} {middle:9.4g} [{low:.4g}, {high:.4g}]")
    tests = ["0lb_0.50Hz_1.0in", "0lb_1.00Hz_1.0in"]
    for by, words in (("level", "from 30 and 36 lb"), ("test", "from all others")):
        header(f"2023-04: zero tension {words} ({noise} noise)", "fitted width")
        folds = [f for f in folds_of(run, by, options.fold_effort) if set(f.left_out) & set(tests)]
        found = run_folds(run, folds, Options(jobs=options.jobs), lambda _: None)
        for p in found:
            if p.test in tests:
                line(p.test, p.score, f"{p.fitted.width:12.2f}")


def speed(run: Run) -> None:
    """Time of a band at 500 draws."""
    test = next(iter(run.tests.values()))
    seconds = []
    for seed in range(7):
        began = time.perf_counter()
        run.predict(test.trace, "observation", draws=500, seed=seed)
        seconds.append(time.perf_counter() - began)
    per = float(np.median(seconds[2:])) / test.trace.samples * 1000.0
    print(f"\nband of 500 draws over {test.trace.samples} samples")
    bar("seconds per thousand samples", per, per <= 1.0, "at most 1")


def parse() -> argparse.Namespace:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_data_option(parser)
    parser.add_argument("--out", type=Path, default=PROJECT / "out_heldout")
    parser.add_argument("--effort", default="standard", help="of every test's calibration")
    parser.add_argument("--fold-effort", default="quick", help="of each population in a fold")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--noise", default="ou", help="as in a campaign file")
    parser.add_argument(
        "--model", default="three_stage", help="of the force, as in a campaign file"
    )
    dependence = "of friction, as in a campaign file: such as velocity"
    parser.add_argument("--dependence", nargs="+", default=[], help=dependence)
    parser.add_argument("--one-level", action="store_true", help="the 36 lb session alone")
    parser.add_argument("--kinds", action="store_true", help="kinds of motion left out, alone")
    parser.add_argument("--zero", action="store_true", help="zero tension in and out, alone")
    return parser.parse_args()


def main() -> None:
    options = parse()
    if options.kinds:
        kinds(options)
        return
    if options.zero:
        zero(finished(options.out, "2023-04", options), options)
        return
    if options.one_level:
        one_level(finished(options.out, "36lb", options), options)
        return
    runs = {s: finished(options.out, s, options) for s in ("36lb", "2022-07")}
    one_level(runs["36lb"], options)
    many_levels(runs["2022-07"], options)
    speed(runs["36lb"])
    print(f"\n{len(missed)} bars missed" if missed else "\nall bars hold")
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
