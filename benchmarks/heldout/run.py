"""Do predicted bands hold the force of real tests that were left out, without being too wide?

    python -m benchmarks.heldout.run > benchmarks/heldout/heldout.txt
    python -m benchmarks.heldout.run --kinds >> benchmarks/heldout/heldout.txt

calibrates the sessions of the band brake (half an hour each on two cores) and predicts what was
left out: the 36 lb harmonic tests, each in turn, and the earthquakes from all of them; of the 2022
session each tension in turn, and each test whose tension another test has too. --kinds: kinds of
motion; the 30 lb tests and the earthquakes from all 36 lb tests. --quick: three tests of one
tension and an earthquake, with little effort, two minutes. Calibrated runs stay in --out: delete it
when records or code have changed. Exit status 1: a limit was missed. Records come from --data.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mfd_bayes.evaluation.crossvalidate import folds_of, run_folds
from mfd_bayes.evaluation.views import score
from mfd_bayes.pipeline.calibrate import calibrate
from mfd_bayes.pipeline.plan import Options, plan_campaign
from mfd_bayes.population.bands import Forecast, Predictor
from mfd_bayes.population.inference import infer_population
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.folder import Score
from mfd_bayes.runs.run import Run

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

KINDS: dict[str, Callable[[str], bool]] = {
    "all at 1 Hz": lambda name: "1.00Hz" in name,
    "all at 0.5 Hz": lambda name: "0.50Hz" in name,
    "all slow ones (0.25 and 0.1 Hz)": lambda name: "0.25Hz" in name or "0.10Hz" in name,
    "all of 0.5 in": lambda name: "0.5in" in name,
    "all of 1.5 in": lambda name: "1.5in" in name,
}
"""Kinds of harmonic motion that are left out, by the ids of their tests."""


missed: list[str] = []


def bar(what: str, value: float, least: float, most: float) -> None:
    """Print a value with its limits, and note it if it misses them."""
    good = least <= value <= most
    print(f"  {'holds ' if good else 'MISSED'}  {what}: {value:.3f} ({least:g} to {most:g})")
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
    print(f"  {'':32s} covered by 50, 90, 95 %   width  interval  CRPS   RRSE  " + "  ".join(more))


def finished(session: str, options) -> Run:
    """Calibrated run of a session's records."""
    out = options.out / f"{session}_{options.model}"
    place = options.out / f"campaign_{out.name}"
    campaign = common.lay_out(options.data, place, session, options.model)
    if options.quick:
        head, *tests = campaign.read_text(encoding="utf-8").split("\n[[test]]")
        quakes = [test for test in tests if "ImperialValley" in test]
        campaign.write_text("\n[[test]]".join([head, *tests[:3], *quakes]), encoding="utf-8")
    effort = "quick" if options.quick else "standard"
    chosen = Options(effort=effort, seed=options.seed, jobs=options.jobs, resume=out.exists())

    def report(step):
        print(step.id, step.stage, file=sys.stderr)

    return calibrate(plan_campaign(campaign, chosen), out, report)


def mean(scores: list[Score]) -> Score:
    """Mean scores of records."""
    fields = ("width", "interval_score", "crps", "rrse")
    coverage = tuple(np.mean([s.coverage for s in scores], axis=0).tolist())
    return Score(coverage, *(float(np.mean([getattr(s, f) for s in scores])) for f in fields))


def left_out(run: Run, by: str, options, chosen: Callable[[str], bool] = lambda _: True) -> list:
    """Predictions of the parts of a run that are left out, from populations of little effort."""
    folds = [f for f in folds_of(run, by, "quick") if any(map(chosen, f.left_out))]
    return list(run_folds(run, folds, Options(jobs=options.jobs), lambda _: None))


def one_level(run: Run, options) -> None:
    """The 36 lb session: each test left out, and the earthquakes."""
    title = "36 lb, 2023: each harmonic test from the others; earthquakes"
    header(title, "published", "fitted width")
    predictions = left_out(run, "test", options)
    found = {p.test: p.score for p in predictions}
    fitted = {p.test: f"{p.fitted.width:12.2f}" for p in predictions}
    total = mean(list(found.values()))
    predictor = predictor_of(run, run.population)
    for name, trace in run.held_out.items():
        found[name] = score_of(predictor, trace, *WINDOWS[name])
    for name, s in found.items():
        published = f"{PUBLISHED[name]:9.3f}" if name in PUBLISHED else f"{'–':>9s}"
        line(name, s, published, fitted.get(name, ""))
    line("mean of the harmonic tests", total)
    if options.quick:
        return
    shares = [found[name].rrse / PUBLISHED[name] for name in fitted if name in PUBLISHED]
    bar("mean of RRSE over that published", float(np.mean(shares)), 0.0, 0.55)
    bar("largest RRSE over that published", max(shares), 0.0, 0.75)
    bar("coverage of 95 % bands", total.coverage[2], 0.92, 0.97)
    bar("coverage of 50 % bands", total.coverage[0], 0.45, 0.58)
    bar("least coverage", min(found[name].coverage[2] for name in fitted), 0.85, 1.0)
    bar("mean width of 95 % bands, kip", total.width, 0.0, 1.40)
    bar("mean CRPS, kip", total.crps, 0.0, 0.182)
    bar("RRSE of Imperial Valley", found["36lb_ImperialValleyDBE"].rrse, 0.0, 0.30)


def many_levels(run: Run, options) -> None:
    """The 2022 session: each tension left out, and each test whose tension another has."""
    header("2022: each tension from the others", "fitted width", "fitted CRPS")
    away = left_out(run, "level", options)
    for p in away:
        line(p.test, p.score, f"{p.fitted.width:12.2f}", f"{p.fitted.crps:.3f}")
    total, own = mean([p.score for p in away]), mean([p.fitted for p in away])
    line("mean", total, f"{own.width:12.2f}", f"{own.crps:.3f}")
    header("2022: each test whose tension another frequency shows", "fitted width")
    parts = [p.part for p in away]
    repeated = {p.test for p in away if parts.count(p.part) > 1}
    seen = left_out(run, "test", options, repeated.__contains__)
    for p in seen:
        line(p.test, p.score, f"{p.fitted.width:12.2f}")
    near, near_own = mean([p.score for p in seen]), mean([p.fitted for p in seen])
    line("mean", near, f"{near_own.width:12.2f}")
    bar("coverage of 95 % bands, tension left out", total.coverage[2], 0.92, 0.98)
    bar("coverage of 50 % bands, tension left out", total.coverage[0], 0.42, 0.58)
    bar("least coverage", min(p.score.coverage[2] for p in away), 0.80, 1.0)
    bar("mean width over that of a fitted test", total.width / own.width, 0.0, 3.0)
    bar("mean CRPS, kip", total.crps, 0.0, 0.20)
    bar("width at a tension seen over a fitted test's", near.width / near_own.width, 0.0, 2.0)


def kinds(options) -> None:
    """Whole kinds of motion left out: the mean over each kind's tests, and the least coverage."""
    run, other = (finished(session, options) for session in ("36lb", "30lb"))
    header("36 lb, 2023: kinds of motion left out (means over the tests)", "least", "tests")
    for kind, belongs in KINDS.items():
        rest = {name: test for name, test in run.tests.items() if not belongs(name)}
        if not rest or len(rest) == len(run.tests):
            continue
        settings = run.manifest.settings.inference("quick", (options.seed, 4))
        predictor = predictor_of(run, infer_population(rest, run.priors, settings).population)
        traces = [test.trace for name, test in run.tests.items() if belongs(name)]
        judge_kind(kind, [score_of(predictor, trace) for trace in traces])
    predictor = predictor_of(run, run.population)
    traces = [test.trace for test in other.tests.values()]
    judge_kind("30 lb from 36 lb", [score_of(predictor, trace) for trace in traces])
    for name, trace in run.held_out.items():
        judge_kind(name, [score_of(predictor, trace, *WINDOWS[name])])


def predictor_of(run: Run, population) -> Predictor:
    some = next(iter(run.tests.values())).posterior
    return Predictor(population, some.model, some.noise)


def score_of(predictor: Predictor, trace: Trace, begin=-np.inf, end=np.inf) -> Score:
    """Score of the predicted band of a record within a time."""
    band = predictor.predict(trace, Forecast("observation", draws=DRAWS, seed=1))
    inside = (trace.time >= begin) & (trace.time <= end)
    return score(band.draws[:, inside], np.asarray(trace.force)[inside])


def judge_kind(kind: str, found: list[Score]) -> None:
    total, least = mean(found), min(s.coverage[2] for s in found)
    line(kind, total, f"{100 * least:5.1f}", f"{len(found):5d}")
    bar(f"coverage of 95 % bands, {kind}", total.coverage[2], 0.90, 1.0)


def main() -> None:
    parser = common.parser_of(__doc__ or "", data=True)
    parser.add_argument("--out", type=Path, default=common.PROJECT / "out_heldout")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--model", default="three_stage", help="as in a campaign file")
    parser.add_argument("--kinds", action="store_true", help="kinds of motion left out, alone")
    options = parser.parse_args()
    common.heading((__doc__ or "").splitlines()[0])
    if options.kinds:
        kinds(options)
    else:
        one_level(finished("36lb", options), options)
        if not options.quick:
            many_levels(finished("2022-07", options), options)
    common.finish([] if options.quick else missed)


if __name__ == "__main__":
    main()
