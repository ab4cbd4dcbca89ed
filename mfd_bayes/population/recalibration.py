"""Bands recalibrated by tests that were left out (cross-conformal prediction over tests).

Each test that was left out has one score: the factor by which the band of its prediction must be
widened about the median so that it covers the probability that it states. If the next test is like
those, its own factor is as likely to have any rank among theirs. So a band that is widened by the
⌈(J + 1) p⌉-th smallest of J scores covers enough of a new test's samples with a probability of
about p. Samples of one test are no repetitions of each other, and are never counted as such.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.units import percent

Array = NDArray[np.float64]

PROBABILITIES = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
"""Probabilities of bands for which scores are kept."""

WIDEST = 1e6
"""Largest factor: a band without width covers nothing, however it is widened."""


def factor_of(draws: Array, observed: Array, probability: float) -> float:
    """Factor by which a band must be widened about its median to cover enough of one test.

    Parameters
    ----------
    draws : (n, T), kip
    observed : (T,), kip
    probability : float
        Of the band, and the share of the samples that it is to cover.
    """
    tail = 0.5 * (1.0 - probability)
    lower, median, upper = np.quantile(draws, [tail, 0.5, 1.0 - tail], axis=0)
    away = observed - median
    reach = np.where(away >= 0, upper - median, median - lower)
    with np.errstate(divide="ignore", invalid="ignore"):
        needed = np.where(away == 0, 0.0, np.abs(away) / reach)
    enough = math.ceil(probability * observed.size - 1e-9)
    return float(min(np.sort(needed)[max(enough, 1) - 1], WIDEST))


def factors_of(draws: Array, observed: Array) -> tuple[float, ...]:
    """Factors of one test for the bands of `PROBABILITIES`; see `factor_of`."""
    return tuple(factor_of(draws, observed, probability) for probability in PROBABILITIES)


def chosen_factor(scores: Sequence[float], probability: float) -> tuple[float, float]:
    """Factor to apply, and the share of new tests for which it is promised.

    Parameters
    ----------
    scores : sequence of float
        One for each test that was left out.
    probability : float
        Of the band. Of J scores the ⌈(J + 1) p⌉-th smallest is taken; with too few the largest,
        which can promise no more than J / (J + 1).
    """
    ordered = sorted(scores)
    rank = math.ceil((len(ordered) + 1) * probability - 1e-9)
    if rank > len(ordered):
        return ordered[-1], len(ordered) / (len(ordered) + 1)
    return ordered[rank - 1], probability


def promise(scores: Sequence[float], probability: float, by: str) -> str:
    """What a recalibrated band promises, in a sentence.

    Parameters
    ----------
    scores, probability
        As in `chosen_factor`.
    by : str
        What was left out at a time: "test", "level" or "session".
    """
    factor, share = chosen_factor(scores, probability)
    count, asked = len(scores), f"{percent(probability)} %"
    text = (
        f"recalibrated: the band is {factor:.3g} times as wide as the population says, after "
        f"{count} tests that were left out, by {by}; it covers {asked} of the samples of about "
        f"{100 * share:.3g} % of tests like those"
    )
    if share < probability:
        text += f", and {count} tests can promise no more"
    return text
