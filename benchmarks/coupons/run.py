"""Steel coupons by a model in a user's own file: time, left-out coupons, and quoFEM's statistics.

    python -m benchmarks.coupons.run > benchmarks/coupons/coupons.txt

lays examples/coupons and the records (--data/coupons) into --out and runs the one command of the
example there (--quick: with little effort). Then every coupon is predicted from others, a fold of
one coupon of each bar left out at a time, beside one least-squares vector of these others, one of
those of its mill and one of those of its bar, which is what the population is told. Each vector
predicts a normal density with the sd of its residuals. Last, the population beside that of quoFEM's
example 28. A second run goes on.
"""

from benchmarks import common  # isort: skip  (one thread, before numpy)

import os
import shutil
import time

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import norm

import mfd_bayes as mb
from mfd_bayes.applications.comparison.crossvalidation import Fold, run_folds
from mfd_bayes.pipeline.options import RunOptions
from mfd_bayes.runs.run import sequence_of

QUOFEM = {
    # parameter: mean and sd between coupons in the state of its chain that quoFEM's example 28
    # ships (src/model/restart_file.json: hyper_mean and the diagonal of hyper_covariance, times
    # the sd of the prior, plus its mean), and mean and sd of the prior (src/input.json); its
    # results after more steps stand in pictures only
    "fy": (495.9, 43.6, 480.0, 48.0),
    "E": (208528.0, 6055.0, 208000.0, 20800.0),
    "b": (0.01804, 0.00052, 0.018, 0.0018),
    "cR1": (0.8883, 0.0189, 0.87, 0.087),
    "cR2": (0.0604, 0.00105, 0.06, 0.006),
    "a1": (0.0203, 0.00044, 0.02, 0.002),
    "a3": (0.0251, 0.00067, 0.025, 0.0025),
}
MIDDLE = np.array([2e5, 450.0, 0.02, 0.9, 0.1, 0.03, 0.03])


def fit(model: mb.Model, traces: list[mb.Trace]) -> np.ndarray:
    """Least-squares parameters of several coupons together, (p,)."""

    def values(x):  # positive, and cR1 below 1
        y = MIDDLE * np.exp(x)
        y[..., 3] = 1.0 / (1.0 + np.exp(-x[..., 3]) / 9.0)
        return y

    def residual(x):
        theta = values(np.atleast_2d(x))
        residuals = [model.force(theta, t) - np.asarray(t.force) for t in traces]
        return np.concatenate(residuals, axis=1) / 30.0

    def slopes(x):
        steps = residual(np.vstack([x, x + 1e-5 * np.eye(x.size)]))
        return (steps[1:] - steps[0]).T / 1e-5

    best = least_squares(lambda x: residual(x)[0], np.zeros(MIDDLE.size), slopes)
    return values(best.x)


def least_squares_crps(run: mb.Run, folds: list[Fold], letters: slice) -> dict[str, float]:
    """CRPS of each coupon under the fit to kept ones that share part of its name, and their sd."""
    traces, scores = {name: test.trace for name, test in run.tests.items()}, {}
    for fold in folds:
        for kind in {name[letters] for name in fold.left_out}:
            fitted = [traces[n] for n in fold.kept if n[letters] == kind]
            best = fit(run.model, fitted)
            sd = np.std(np.concatenate([residual(run.model, best, trace) for trace in fitted]))
            for name in (n for n in fold.left_out if n[letters] == kind):
                z = residual(run.model, best, traces[name]) / sd
                terms = z * (2.0 * norm.cdf(z) - 1.0) + 2.0 * norm.pdf(z) - 1.0 / np.sqrt(np.pi)
                scores[name] = float(sd * np.mean(terms))
    return scores


def residual(model: mb.Model, theta: np.ndarray, trace: mb.Trace) -> np.ndarray:
    """What one vector leaves of a coupon's stress, (T,), MPa."""
    return model.force(theta[None], trace)[0] - np.asarray(trace.force)


def folds_of(run: mb.Run, number: int, effort: str) -> list[Fold]:
    """Folds with one coupon of each bar each, as far as they go."""
    names = list(run.tests)
    position = {n: [m for m in names if m[:2] == n[:2]].index(n) for n in names}
    folds = []
    for k in range(number):
        left_out = tuple(n for n in names if position[n] % number == k)
        retained = tuple(n for n in names if n not in left_out)
        folds.append(Fold(f"{k + 1}", f"fold_{number}_{k + 1}.json", left_out, retained, effort, 1))
    return folds


def main() -> None:
    parser = common.parser_of(__doc__ or "", data=True, jobs=2, output="out_coupons")
    parser.add_argument("--folds", type=int, default=5)
    options = common.begin(parser)
    folder = options.out / options.effort
    shutil.copytree(common.PROJECT / "examples" / "coupons", folder, dirs_exist_ok=True)
    shutil.copytree(options.data / "coupons", folder, dirs_exist_ok=True)
    run_folder, began = folder / "out", time.perf_counter()
    if not (run_folder / "report.html").is_file():
        how = ("--resume", "--jobs", options.jobs, "--effort", options.effort)
        common.command("calibrate", folder / "campaign.toml", "-o", run_folder, *how)
        print(f"calibrate: {time.perf_counter() - began:.0f} s, load {os.getloadavg()[0]:.1f}")
    run = mb.open_run(run_folder)
    convergence = run.population.convergence
    print(f"population: R-hat {convergence.worst_r_hat:.4f}, ESS {convergence.worst_ess:.0f}")
    facts = [test.stored.facts["convergence"] for test in run.tests.values()]
    figures = np.array([three for fact in facts for three in fact.values()])
    print(f"coupons alone: R-hat <= {figures[:, 0].max():.4f}, ESS >= {figures[:, 1:].min():.0f}\n")

    folds = folds_of(run, options.folds, options.effort)[: 1 if options.quick else None]
    predictions = run_folds(run, folds, RunOptions(jobs=options.jobs), lambda _: None)
    scores = {p.test: p.score for p in predictions}
    baselines = [least_squares_crps(run, folds, slice(0, letters)) for letters in (2, 1, 0)]
    print("CRPS, MPa                                       least squares with its residual sd, of")
    print("coupon   covers 50 %   95 %   width        ours      its bar     its mill    all others")
    for name, s in scores.items():
        values = " ".join(f"{baseline[name]:12.1f}" for baseline in baselines)
        print(f"{name:6} {100 * s.coverage[0]:12.1f} {100 * s.coverage[-1]:6.1f} {s.width:7.0f} "
              f"{s.crps:11.1f} {values}")  # fmt: skip
    half, _, coverage = 100.0 * np.mean([s.coverage for s in scores.values()], axis=0)
    ours = np.array([s.crps for s in scores.values()])
    theirs = np.array([[baseline[name] for name in scores] for baseline in baselines])
    means = " ".join(f"{mean:12.1f}" for mean in theirs.mean(axis=1))
    print(f"mean   {half:12.1f} {coverage:6.1f} {'':7} {ours.mean():11.1f} {means}")

    print(
        "\nbetween coupons, jointly: ours, mean and sd   quoFEM, mean and sd   moved by, prior sds"
    )
    for name, (middle, sd, start, prior) in QUOFEM.items():
        medians = [np.median(sequence_of(run).values(test)[name]) for test in run.tests]
        fitted = np.mean(medians), np.std(medians, ddof=1)
        print(f"{name:12} {fitted[0]:14.5g} {fitted[1]:10.3g} {middle:14.5g} {sd:10.3g}"
              f"{(fitted[0] - start) / prior:12.1f} {(middle - start) / prior:6.1f}")  # fmt: skip
    failed = [] if 42.0 <= half <= 58.0 else [f"50 % bands hold {half:.1f} %"]
    failed += [] if 92.0 <= coverage <= 97.0 else [f"95 % bands hold {coverage:.1f} %"]
    for label, worse in zip(("bar", "mill", "all"), ours - theirs, strict=True):
        if np.mean(worse) > 2.0 * np.std(worse, ddof=1) / np.sqrt(worse.size):
            failed.append(f"least squares of {label} is nearer")
    common.finish([] if options.quick else failed)


if __name__ == "__main__":
    main()
