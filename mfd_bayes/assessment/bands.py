"""Bands, scores and summaries of draws."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.assessment.views import Fan, Interval, ScoreRow
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.results import Score
from mfd_bayes.validation.scores import score

Array = NDArray[np.float64]

PROBABILITIES = (0.5, 0.95)
"""Probabilities of the equal-tailed bands in figures."""


def fan_of(kind: str, draws: Array) -> Fan:
    """Median and bands of draws (n, T)."""
    tails = [0.5 * (1.0 - p) for p in PROBABILITIES]
    levels = [0.5, *tails, *(1.0 - t for t in tails)]
    median, *bounds = np.quantile(draws, levels, axis=0)
    n = len(tails)
    intervals = (Interval(p, bounds[i], bounds[n + i]) for i, p in enumerate(PROBABILITIES))
    return Fan(kind, median, tuple(intervals))


def spread_of(draws: Array, tail: float = 0.025) -> dict[str, float]:
    """Mean, sd, median, and the bounds that leave `tail` of the draws (n,) on either side."""
    lower, median, upper = (float(q) for q in np.quantile(draws, [tail, 0.5, 1.0 - tail]))
    mean, sd = float(draws.mean()), float(draws.std())
    return {"mean": mean, "sd": sd, "lower": lower, "median": median, "upper": upper}


def score_of(name: str, role: str, trace: Trace, draws: Array, first: int) -> ScoreRow:
    """Scores of force draws (n, T) against the force of a record, from sample `first` on."""
    found = score(draws[:, first:], np.asarray(trace.force)[first:])
    return score_row(name, role, found)


def score_row(name: str, role: str, found: Score) -> ScoreRow:
    """A score as a row of a table."""
    half, most, nearly = found.coverage
    scale = found.width, found.interval_score, found.crps
    return ScoreRow(name, role, half, most, nearly, *scale, found.rrse)
