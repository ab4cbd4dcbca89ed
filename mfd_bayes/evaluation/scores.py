"""Scores of a predicted band and its draws against a measured force."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.predictive import COVERAGES
from mfd_bayes.runs.scores import Score

Array = NDArray[np.float64]


def score(draws: Array, observed: Array) -> Score:
    """Scores of draws (n, T) against an observed force (T,), kip."""
    coverage = []
    width = interval = np.nan
    for probability in COVERAGES:
        tail = 0.5 * (1.0 - probability)
        lower, upper = np.quantile(draws, [tail, 1.0 - tail], axis=0)
        coverage.append(float(np.mean((observed >= lower) & (observed <= upper))))
        width = float(np.mean(upper - lower))
        beyond = np.maximum(lower - observed, 0.0) + np.maximum(observed - upper, 0.0)
        interval = width + float(np.mean(beyond)) / tail
    return Score(
        coverage=tuple(coverage),
        width=width,
        interval_score=interval,
        crps=float(np.mean(crps(draws, observed))),
        rrse=rrse(np.median(draws, axis=0), observed),
    )


def crps(draws: Array, observed: Array) -> Array:
    """Continuous ranked probability score E|X − y| − ½ E|X − X'| of each sample, (T,), kip."""
    n = len(draws)
    ordered = np.sort(draws, axis=0)
    weights = (2.0 * np.arange(1, n + 1) - n - 1.0)[:, None] / n**2
    spread = np.sum(weights * ordered, axis=0)
    score: Array = np.mean(np.abs(draws - observed), axis=0) - spread
    return score


def rrse(predicted: Array, observed: Array) -> float:
    """Root relative squared error √(Σ(F − F̂)² / Σ(F − F̄)²), NaN for a constant force."""
    error, spread = np.sum((observed - predicted) ** 2), np.sum((observed - observed.mean()) ** 2)
    return float(np.sqrt(error / spread)) if spread > 0 else float("nan")
