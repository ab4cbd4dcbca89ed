"""Whether the advice on the next test comes true for real records.

    python -m benchmarks.next_test.real RUN > benchmarks/next_test/real.txt

RUN is the calibrated 2022 session of the band brake, for instance that of benchmarks/heldout. Two
of its six tensions are taken as known. Each other tension is a candidate, with the motion of its
own record; the goal is the band over all that are left out. Then the record of each is added in
turn, and the population inferred again. Width: mean width of the goal's 95 % bands; CRPS: mean over
the tests of the tensions that neither is known nor was added, each predicted as a measurement.
"""

from __future__ import annotations

import os

# Read when numpy is imported.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import argparse
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from mfd_bayes.evaluation.scores import score
from mfd_bayes.planning.candidate import Limits, harmonic_of
from mfd_bayes.planning.goal import Goal, parse_goal
from mfd_bayes.planning.study import Effort, Situation, advise, goals_of
from mfd_bayes.population.bands import Forecast, Predictor
from mfd_bayes.population.inference import infer_population
from mfd_bayes.runs.run import Run, open_run

KNOWN = ((25, 35), (22, 70))
"""Tensions that are known first, lbf, in each of two studies."""

DRAWS = 800


def tension(run: Run, test: str) -> int:
    """Tension of a test, lbf."""
    return round(1000.0 * run.tests[test].trace.reference_actuation)


def situation(run: Run, names: Iterable[str], seed: int) -> Situation:
    """What is known from some of a run's tests."""
    tests = {name: run.tests[name] for name in names}
    settings = replace(run.manifest.settings.inference("quick", (23, seed)), sessions={})
    population = infer_population(tests, run.priors, settings).population
    some = next(iter(tests.values())).posterior
    done = tuple(harmonic_of(test.trace) for test in tests.values())
    return Situation(population, some.model, some.noise, done, ("",) * len(done))


def crps_of(run: Run, known: Situation, names: Iterable[str]) -> float:
    """Mean CRPS of tests that are predicted as measurements, kip."""
    predictor = Predictor(known.population, known.model, known.noise)
    found = []
    for name in names:
        trace = run.tests[name].trace
        band = predictor.predict(trace, Forecast("observation", draws=DRAWS))
        found.append(score(band.draws, np.asarray(trace.force)).crps)
    return float(np.mean(found))


def width_of(known: Situation, goal: Goal) -> float:
    """Mean width of the goal's bands, kip."""
    return goals_of(known, goal, Effort(4000, 1)).width


def study(run: Run, known: tuple[int, ...]) -> None:
    """One line for each tension that could be measured next."""
    names = [name for name in run.tests if tension(run, name) in known]
    others = sorted({tension(run, name) for name in run.tests} - set(known))
    goal = parse_goal(f"band at {'|'.join(map(str, others))} lbf, 0.5 Hz, 1 in", "kip")
    before = situation(run, names, 0)
    records = {  # of each tension the one at 0.5 Hz, which all have
        level: next(n for n in run.tests if tension(run, n) == level and "0.50Hz" in n)
        for level in others
    }
    candidates = {level: harmonic_of(run.tests[name].trace) for level, name in records.items()}
    advice = advise(before, goal, list(candidates.values()), Limits(), Effort(2000, 0))
    width = width_of(before, goal)
    print(f"\nknown: {' and '.join(map(str, known))} lbf, {len(names)} tests; goal {goal.quantity}")
    print(f"mean width before {width:.3f} kip")
    print("  next   width, reduction        CRPS of what is still unknown, kip")
    print("   lbf   predicted   realised    before    after   change")
    for row in advice:
        level = next(k for k, c in candidates.items() if c == row.candidate)
        after = situation(run, [*names, records[level]], level)
        rest = [n for n in run.tests if tension(run, n) not in (*known, level)]
        old, new = crps_of(run, before, rest), crps_of(run, after, rest)
        realised = 1.0 - width_of(after, goal) / width
        print(
            f"  {level:4d}   {row.reduction:5.3f} ±{row.error:5.3f}{realised:9.3f}"
            f"   {old:7.3f}  {new:7.3f}  {100 * (new / old - 1):+6.1f} %",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="calibrated run of the 2022 session")
    run = open_run(parser.parse_args().run)
    for known in KNOWN:
        study(run, known)


if __name__ == "__main__":
    main()
