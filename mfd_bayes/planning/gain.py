"""What a test is expected to tell of goals: narrower bands and information, with their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.planning.regression import Fit

Array = NDArray[np.float64]

RESAMPLES = 200
"""Number of bootstrap resamples of the draws."""

EXPLAINED = 0.99
MOST = 5
"""Information is about the principal directions of the goals with this share of their variance,
at most so many."""


@dataclass(frozen=True, eq=False)
class Goals:
    """Goals as draws.

    Attributes
    ----------
    values : (n, m)
        Draws of each goal, internal units.
    probability : float
        Of the band whose width is to be reduced.
    """

    values: Array
    probability: float = 0.95

    @property
    def widths(self) -> Array:
        """Width of each goal's equal-tailed band as it is known now, (m,)."""
        tail = 0.5 * (1.0 - self.probability)
        low, high = np.quantile(self.values, [tail, 1.0 - tail], axis=0)
        return np.asarray(high - low)

    @property
    def width(self) -> float:
        """Mean of the widths."""
        return float(self.widths.mean())

    @property
    def varying(self) -> Goals:
        """The goals without those that do not vary."""
        size = np.maximum(np.abs(self.values).max(axis=0, initial=0.0), 1e-300)
        return Goals(self.values[:, np.ptp(self.values, axis=0) > 1e-9 * size], self.probability)


@dataclass(frozen=True)
class Gain:
    """What is expected of a test, or of several.

    Attributes
    ----------
    reduction : float
        Expected reduction of the mean width, as a share of it; 0 or more.
    error : float
        Its standard error, by the bootstrap.
    information : float
        Gaussian expected information gain about the goals, nat.
    information_error : float
    """

    reduction: float
    error: float
    information: float
    information_error: float


def gain_of(goals: Goals, fit: Fit, rng: np.random.Generator) -> Gain:
    """Gain of the test whose summaries gave a fit of the goals.

    The expected remaining variance of a goal is the mean square of what the fit leaves; a band's
    width goes with its root. Information is half the logarithm of the ratio of the determinants of
    the goals' covariance before and after, in their principal directions.
    """
    counts = rng.multinomial(len(fit.left), np.full(len(fit.left), 1.0 / len(fit.left)), RESAMPLES)
    weights = np.concatenate([np.ones((1, len(fit.left))), counts])
    reductions = _reductions(goals, fit, weights)
    information = _information(goals, fit, weights)
    return Gain(
        max(float(reductions[0]), 0.0),
        float(np.std(reductions[1:], ddof=1)),
        max(float(information[0]), 0.0),
        float(np.std(information[1:], ddof=1)),
    )


def share_left(goals: Array, left: Array, weights: Array | None = None) -> Array:
    """Expected remaining variance over the variance now, (b, m), by weights of draws (b, n).

    Both are means of squares over draws that were left out, so that without any information it is 1
    but for chance.
    """
    n = len(goals)
    weights = np.ones((1, n)) if weights is None else weights
    away = (goals - goals.mean(axis=0)) * (n / (n - 1.0))
    now = weights @ away**2
    return np.asarray(weights @ left**2 / np.maximum(now, 1e-300))


def _reductions(goals: Goals, fit: Fit, weights: Array) -> Array:
    """Reduction of the mean width for each row of weights, (b,)."""
    after = np.sqrt(share_left(goals.values, fit.left, weights))
    widths = goals.widths
    return np.asarray(1.0 - after @ widths / max(float(widths.sum()), 1e-300))


def _information(goals: Goals, fit: Fit, weights: Array) -> Array:
    """Gaussian information about the goals' principal directions for each row of weights, (b,)."""
    n = len(goals.values)
    away = (goals.values - goals.values.mean(axis=0)) * (n / (n - 1.0))
    scale = np.maximum(away.std(axis=0), 1e-300)
    _, sizes, ways = np.linalg.svd(away / scale, full_matrices=False)
    share = np.cumsum(sizes**2) / max(float(np.sum(sizes**2)), 1e-300)
    kept = min(int(np.searchsorted(share, EXPLAINED)) + 1, MOST, len(sizes))
    to = (ways[:kept] / scale).T
    before, after = away @ to, fit.left @ to
    return 0.5 * (_log_determinants(before, weights) - _log_determinants(after, weights))


def _log_determinants(values: Array, weights: Array) -> Array:
    """Log determinants of the mean squares and products of values (n, k), (b,)."""
    products = np.einsum("ni,nj->nij", values, values).reshape(len(values), -1)
    k = values.shape[1]
    means = (weights @ products).reshape(-1, k, k) / weights.sum(axis=1)[:, None, None]
    return np.asarray(np.linalg.slogdet(means)[1])
