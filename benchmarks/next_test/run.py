"""What advice on the next test is worth: closed forms, and the time it takes.

    python -m benchmarks.next_test.run --run OUT > benchmarks/next_test/next_test.txt

draws linear-Gaussian populations, in which the expected remaining variance and the information
have a closed form, and compares; then times 200 candidates with 1000 draws on a finished run OUT.
Whether predictions come true on campaigns that are calibrated again is asked by honest.py
(benchmarks/next_test/honest.txt); the controls, a copy of a test with tiny and with large scatter
and candidates that limits forbid, are in tests/planning/test_study.py.
"""

from __future__ import annotations

import os

# Read when numpy is imported.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import mfd_bayes as mb
from benchmarks.common.machine import load, platform_line, print_bars, processor, versions
from mfd_bayes.planning.information_gain import Gain, Goals, directions_of, fit_left_out, gain_of

CASES, DRAWS = 20, 200_000
"""With 30,000 draws a small information has a standard error of 2.5 %, too much to judge 3 %."""

NOTHING = 0.005
"""A reduction up to this is none: chance of the regression."""

SECONDS = 60.0


@dataclass(frozen=True)
class Case:
    """Goals A u and summaries B u + noise, u standard normal."""

    a: np.ndarray
    b: np.ndarray
    noise: np.ndarray

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Case:
        """One to three goals of two to eight unknowns, one to ten summaries, noise of any size."""
        unknown, goals, summaries = (int(rng.integers(*ends)) for ends in ((3, 9), (1, 4), (1, 11)))
        noise = np.exp(rng.uniform(-1.5, 1.5)) * rng.uniform(0.5, 2.0, summaries)
        a, b = (rng.standard_normal((rows, unknown)) for rows in (goals, summaries))
        return cls(a, b, noise)

    def closed(self) -> tuple[float, float]:
        """Reduction of the mean width, and information, nat."""
        told = np.linalg.inv(self.b @ self.b.T + np.diag(self.noise**2))
        now = self.a @ self.a.T
        after = now - self.a @ self.b.T @ told @ self.b @ self.a.T
        widths = (float(np.sqrt(np.diag(c)).sum()) for c in (after, now))
        logs = (float(np.linalg.slogdet(c)[1]) for c in (now, after))
        left, whole = widths
        before, then = logs
        return 1.0 - left / whole, 0.5 * (before - then)

    def found(self, rng: np.random.Generator, *, uninformed: bool = False) -> Gain:
        """Gain as the advice computes it, from draws; or of summaries of other draws."""
        u = rng.standard_normal((DRAWS, self.a.shape[1]))
        other = rng.standard_normal(u.shape) if uninformed else u
        summaries = other @ self.b.T + self.noise * rng.standard_normal((DRAWS, self.noise.size))
        goals = Goals(u @ self.a.T)
        return gain_of(goals, fit_left_out(goals.values, directions_of(summaries)), rng)


def closed_forms() -> list[str]:
    """Table of the cases; the bars that do not hold."""
    print(f"{CASES} linear-Gaussian populations, {DRAWS} draws\n")
    print(
        "  case   width left: closed   found    se     diff/se  diff %   information: closed  found"
    )
    failed, beyond = [], 0
    for number in range(1, CASES + 1):
        case = Case.draw(np.random.default_rng([23, number]))
        rng = np.random.default_rng([23, number, 1])
        (reduction, information), gain = case.closed(), case.found(rng)
        away = (gain.reduction - reduction) / gain.error
        share = 100.0 * (reduction - gain.reduction) / (1.0 - reduction)
        told = 100.0 * (gain.information / information - 1.0)
        apart = (gain.information - information) / gain.information_error
        beyond += (abs(away) > 2.0) + (abs(apart) > 2.0)
        if abs(share) > 3.0 or abs(told) > 3.0:
            failed.append(f"case {number} is {share:.1f} % and {told:.1f} % from its closed form")
        nothing = case.found(rng, uninformed=True)
        if not 0.0 <= nothing.reduction <= NOTHING:
            failed.append(f"case {number} without information gains {nothing.reduction:.4f}")
        print(
            f"  {number:4d}   {1 - reduction:18.4f}  {1 - gain.reduction:6.4f}  {gain.error:6.4f}  "
            f"{away:7.2f}  {share:7.2f}   {information:11.4f}  "
            f"{gain.information:6.4f}  {apart:6.2f}"
        )
    print(f"\n  within 2 standard errors: {2 * CASES - beyond} of {2 * CASES} (chance alone: 38)")
    return failed + ([f"{beyond} figures beyond 2 standard errors"] if beyond > 6 else [])


def speed(out: Path) -> list[str]:
    """Time of 200 candidates with 1000 draws; the bar if it is missed."""
    run = mb.open_run(out)
    levels = np.linspace(0.5, 2.0, 10) * run.tested[-1].highest
    unit = "ksi" if run.actuation_unit == "ksi" else "kip"
    text = (
        "|".join(f"{level:.4g}" for level in levels)
        + f" {unit}, 0.05|0.1|0.2|0.5|1 Hz, 0.5|1 in, sine|triangle"
    )
    _ = run.population
    began = time.perf_counter()
    advice = run.next_test(candidates=text, draws=1000)
    seconds = time.perf_counter() - began
    print(f"\n{len(advice)} candidates, {advice.draws} draws: {seconds:.1f} s ({load()})")
    return [] if seconds <= SECONDS and len(advice) == 200 else [f"{seconds:.0f} s"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--run", type=Path, help="a finished run, for the time that advice takes")
    options = parser.parse_args()
    print(f"{processor()}, {platform_line()}")
    print(f"{versions('numpy', 'scipy')}\n")
    failed = closed_forms()
    if options.run is not None:
        failed += speed(options.run)
    print_bars(failed)


if __name__ == "__main__":
    main()
