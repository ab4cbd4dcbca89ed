"""Whether bounds of properties hold the measured values of levels that were held out.

    python -m benchmarks.heldout.properties RUN

Each level of a calibrated run is held out, its tests are predicted from the others, and slip force,
peak force, energy, effective stiffness and damping are counted inside their 50, 80 and 95 % bounds:
the mean over the cycles at full stroke of each test, as recorded. The factor between the model's
peak and the measured one is learned without the level. Exit status 1: a count is outside of its
binomial limits.
"""

from __future__ import annotations

import os

# Read when numpy is imported.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy import stats

from mfd_bayes.evaluation.crossvalidate import Fold, folds_of
from mfd_bayes.evaluation.properties import cycles_of, measured_of, peak_factors
from mfd_bayes.population.bands import Forecast, Predictor
from mfd_bayes.population.inference import infer_population
from mfd_bayes.records.loops import mean_of
from mfd_bayes.runs.run import Run, open_run

DRAWS = 800
PROBABILITIES = (0.5, 0.8, 0.95)
NAMES = (
    *("slip_fwd", "slip_bwd", "peak_fwd", "peak_bwd"),
    *("energy", "effective_stiffness", "effective_damping", "gap"),
)


def held_out(run: Run, fold: Fold, inside: dict[str, np.ndarray]) -> None:
    """Count what of the tests of a part lies inside the bounds that the others give."""
    others = {name: run.tests[name] for name in fold.kept}
    settings = run.manifest.settings.inference(fold.effort, (fold.seed, 2))
    population = infer_population(others, run.priors, settings, lambda _: None).population
    peaks = peak_factors(run.manifest, others)
    for name in fold.left_out:
        test, session = run.tests[name], run.session(name)
        predictor = Predictor(population, test.posterior.model, test.posterior.noise)
        seen, alone = (
            predictor.predict(test.trace, Forecast(kind, draws=DRAWS, session=session))
            for kind in ("observation", "new_test")
        )
        smooth = alone.draws + np.asarray(alone.values["offset"])[:, None]
        drawn = cycles_of(test.trace, seen.draws, peaks, smooth=smooth)
        measured = measured_of(run.manifest, name)
        for what, counts in inside.items():
            values, value = mean_of(drawn[what]), getattr(measured, what)[measured.full_stroke]
            for k, probability in enumerate(PROBABILITIES):
                tails = 0.5 * (1.0 - probability), 0.5 * (1.0 + probability)
                low, high = np.nanquantile(values, tails)
                counts[k] += low <= np.nanmean(value) <= high


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--most", type=int, default=100, help="levels that are held out")
    options = parser.parse_args()
    run = open_run(options.run)
    inside = {name: np.zeros(len(PROBABILITIES), dtype=int) for name in NAMES}
    folds = folds_of(run, "level", "quick")[: options.most]
    for fold in folds:
        held_out(run, fold, inside)
        print(fold.part, file=sys.stderr, flush=True)
    count = sum(len(fold.left_out) for fold in folds)
    ends = [stats.binom.ppf([0.025, 0.975], count, p).astype(int) for p in PROBABILITIES]
    pairs = zip(PROBABILITIES, ends, strict=True)
    limits = "  ".join(f"{p:.0%}: {low}–{high}" for p, (low, high) in pairs)
    print(f"of {count} tests, each predicted without its level; binomial limits {limits}")
    missed = 0
    for name, counts in inside.items():
        good = [low <= n <= high for n, (low, high) in zip(counts, ends, strict=True)]
        missed += not all(good)
        print(f"  {'holds ' if all(good) else 'MISSED'}  {name:20s} {counts}")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
