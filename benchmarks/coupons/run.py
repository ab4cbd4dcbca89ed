"""Steel coupons by a model in a user's own file: time, left-out coupons, and quoFEM's statistics.

    python -m benchmarks.coupons.run FOLDER [--jobs N]

lays examples/coupons and the records (MFD_BAYES_DATA/coupons) into FOLDER, runs the one command of
the example there, then `crossvalidate`, and prints how each coupon is predicted from the others,
beside one least-squares vector of all others and one of the others of its mill. Then it compares
the population with that of quoFEM's example 28. A second run goes on. coupons.txt: what it prints.
"""

import argparse
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

import mfd_bayes as mb
from benchmarks.common.data import PROJECT, data_folder

LIMITS = {"95": (92.0, 97.0), "50": (42.0, 58.0)}  # %
QUOFEM = {
    # parameter: mean and sd between coupons in the state of its chain that quoFEM's example 28
    # ships (src/model/restart_file.json: hyper_mean and the diagonal of hyper_covariance, times
    # the sd of the prior, plus its mean), and mean and sd of the prior (src/input.json)
    "fy": (495.9, 43.6, 480.0, 48.0),
    "E": (208528.0, 6055.0, 208000.0, 20800.0),
    "b": (0.01804, 0.00052, 0.018, 0.0018),
    "cR1": (0.8883, 0.0189, 0.87, 0.087),
    "cR2": (0.0604, 0.00105, 0.06, 0.006),
    "a1": (0.0203, 0.00044, 0.02, 0.002),
    "a3": (0.0251, 0.00067, 0.025, 0.0025),
}
MIDDLE = np.array([2e5, 450.0, 0.02, 0.9, 0.1, 0.03, 0.03])


def run_command(*words: object) -> float:
    """Run a command of the package; processor seconds of it and of its processes."""
    before = os.times()
    subprocess.run([sys.executable, "-m", "mfd_bayes", *map(str, words)], check=True)
    after = os.times()
    return sum(after[2:4]) - sum(before[2:4])


def fit(model: mb.Model, traces: list[mb.Trace]) -> np.ndarray:
    """Least-squares parameters of several coupons together, (p,)."""

    def values(x):  # positive, and cR1 below 1
        y = MIDDLE * np.exp(x)
        y[..., 3] = 1.0 / (1.0 + np.exp(-x[..., 3]) / 9.0)
        return y

    def residual(x):
        theta = values(np.atleast_2d(x))
        parts = [model.force(theta, t) - np.asarray(t.force) for t in traces]
        return np.concatenate(parts, axis=1) / 30.0

    def slopes(x):
        steps = residual(np.vstack([x, x + 1e-5 * np.eye(x.size)]))
        return (steps[1:] - steps[0]).T / 1e-5

    best = least_squares(lambda x: residual(x)[0], np.zeros(MIDDLE.size), slopes)
    return values(best.x)


def errors(run: mb.Run, same: slice) -> dict[str, float]:
    """Mean absolute error for each coupon of the fit to others that share part of its name."""
    traces = {name: test.trace for name, test in run.tests.items()}
    result = {}
    for name, trace in traces.items():
        others = [t for n, t in traces.items() if n != name and n[same] == name[same]]
        predicted = run.model.force(fit(run.model, others)[None], trace)[0]
        result[name] = float(np.mean(np.abs(predicted - np.asarray(trace.force))))
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    folder, jobs = arguments.folder, ("--jobs", arguments.jobs)
    shutil.copytree(PROJECT / "examples" / "coupons", folder, dirs_exist_ok=True)
    shutil.copytree(data_folder() / "coupons", folder, dirs_exist_ok=True)
    campaign, out = folder / "campaign.toml", folder / "out"
    if not (out / "report.html").is_file():
        began = time.perf_counter()
        used = run_command("calibrate", campaign, "-o", out, "--resume", *jobs)
        wall = time.perf_counter() - began
        print(f"calibrate: {wall:.0f} s, {used:.0f} s of processors, {used / 2:.0f} s on two")
    if mb.open_run(out).manifest.crossvalidation is None:
        run_command("crossvalidate", campaign, "-o", out, "--by", "test", "--resume", *jobs)
    run = mb.open_run(out)
    facts = [test.stored.facts["convergence"] for test in run.tests.values()]
    figures = np.array([three for each in facts for three in each.values()])
    print(f"R-hat <= {figures[:, 0].max():.4f}, ESS >= {figures[:, 1:].min():.0f}\n")

    scores = {p.test: p.score for p in run.manifest.crossvalidation.predictions}
    every, mill = errors(run, slice(0, 0)), errors(run, slice(0, 1))
    print("coupon   covers 50 %   95 %   width   CRPS, MPa   one vector   its mill's")
    for name, s in scores.items():
        print(f"{name:6} {100 * s.coverage[0]:12.1f} {100 * s.coverage[-1]:6.1f} {s.width:7.0f} "
              f"{s.crps:11.1f} {every[name]:12.1f} {mill[name]:12.1f}")  # fmt: skip
    half, _, most = 100.0 * np.mean([s.coverage for s in scores.values()], axis=0)
    mean = [
        np.mean([s.crps for s in scores.values()]),
        *(np.mean([*e.values()]) for e in (every, mill)),
    ]
    print(
        f"mean   {half:12.1f} {most:6.1f} {'':7} {mean[0]:11.1f} {mean[1]:12.1f} {mean[2]:12.1f}\n"
    )

    print("between coupons     ours, mean and sd       quoFEM, mean and sd    moved by, prior sds")
    draws = {name: [np.median(t.draws[name]) for t in run.tests.values()] for name in QUOFEM}
    for name, (middle, sd, start, prior) in QUOFEM.items():
        own = np.mean(draws[name]), np.std(draws[name], ddof=1)
        print(f"{name:12} {own[0]:14.5g} {own[1]:10.3g} {middle:14.5g} {sd:10.3g}"
              f"{(own[0] - start) / prior:12.1f} {(middle - start) / prior:6.1f}")  # fmt: skip
    low, high = LIMITS["95"]
    good = low <= most <= high and LIMITS["50"][0] <= half <= LIMITS["50"][1]
    sys.exit(not (good and mean[0] < min(mean[1:])))


if __name__ == "__main__":
    main()
