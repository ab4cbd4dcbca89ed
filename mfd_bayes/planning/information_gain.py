"""What tests are expected to tell of goals: narrower bands and information, with their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special

Array = NDArray[np.float64]

FLAT = 1e-9  # a summary whose sd is below this share of its size does not vary
# a direction of the summaries with less than this share of their variance repeats others
SAME = 1e-6
BENT = 6  # directions of the summaries, the widest first, whose squares and products are used too
PENALTIES = (1e-6, 1e-2, 1e-1, 1.0, 1e1)  # of the ridge regression, over the number of draws
RESAMPLES = 200  # number of bootstrap resamples of the draws
# information is about the principal directions of the goals with this share of their variance, at
# most so many
EXPLAINED, MOST = 0.99, 5
SMALL = 1e-3  # penalty of the regression by which sets of tests are chosen


@dataclass(frozen=True, eq=False)
class Goals:
    """Goals as draws."""

    values: Array  # (n, m): draws of each goal, internal units
    probability: float = 0.95  # of the band whose width is to be reduced

    @cached_property
    def widths(self) -> Array:
        """Width of each goal's equal-tailed band as it is known now, (m,)."""
        tail = 0.5 * (1.0 - self.probability)
        low, high = np.quantile(self.values, [tail, 1.0 - tail], axis=0)
        return np.asarray(high - low)

    @property
    def width(self) -> float:
        """Mean of the widths."""
        return float(self.widths.mean())

    def narrower(self, share: Array) -> Array:
        """Reduction of the mean width, (…), by shares of the variances that are left, (…, m)."""
        widths = self.widths
        return np.asarray(1.0 - np.sqrt(share) @ widths / max(float(widths.sum()), 1e-300))


@dataclass(frozen=True)
class Gain:
    """What is expected of a test, or of several."""

    reduction: float  # expected reduction of the mean width, as a share of it; 0 or more
    error: float  # its standard error, by the bootstrap
    information: float  # Gaussian expected information gain about the goals, nat
    information_error: float


def directions_of(summaries: Array) -> Array:
    """Independent directions of summaries (n, k), each of mean 0 and sd 1, (n, up to k).

    Each summary is replaced by the normal score of its rank, so that its form and outliers do not
    matter; what does not vary, and what repeats others, is dropped.
    """
    size = np.maximum(np.abs(summaries).max(axis=0, initial=0.0), 1e-300)
    varies = summaries.std(axis=0) > FLAT * size
    if not varies.any():
        return np.empty((len(summaries), 0))
    from scipy.stats import rankdata  # which takes long to import

    ranks = rankdata(summaries[:, varies], axis=0)
    scores = special.ndtri((ranks - 0.5) / len(summaries))
    scores -= scores.mean(axis=0)
    left, sizes, _ = linalg.svd(scores, full_matrices=False)
    return np.asarray(left[:, sizes**2 > SAME * np.sum(sizes**2)] * np.sqrt(len(summaries)))


def fit_left_out(goals: Array, directions: Array, *, curved: bool = True) -> Array:
    """Goals (n, m) less their prediction from directions of summaries (n, k), (n, m).

    Each draw is predicted from all others, by ridge regression. Straight and curved forms (squares
    and products) and several penalties are tried; the one with the least error on draws left out
    one by one, in closed form (PRESS), summed over the goals in units of their variance, is taken.
    Where summaries tell nothing the mean of the goals is as good, and is what is taken.

    Source: Strong, Oakley and Brennan, Medical Decision Making 34 (2014) 311, with ridge
    regression instead of splines, since there are many summaries.
    """
    n = len(goals)
    centred = goals - goals.mean(axis=0)
    scale = np.maximum(np.mean(centred**2, axis=0), 1e-300)
    tried, designs = [centred * (n / (n - 1.0))], [directions]
    if curved and directions.shape[1]:
        one, other = np.triu_indices(min(directions.shape[1], BENT))
        products = directions[:, one] * directions[:, other]
        products = (products - products.mean(axis=0)) / np.sqrt(1.0 + (one == other))
        designs.append(np.concatenate([directions, products], axis=1))
    for design in designs if directions.shape[1] else ():
        left, sizes, _ = linalg.svd(design, full_matrices=False)
        told = left.T @ centred
        for penalty in PENALTIES:
            shrink = sizes**2 / (sizes**2 + penalty * n)
            leverage = 1.0 / n + left**2 @ shrink
            away = centred - left @ (shrink[:, None] * told)
            tried.append(away / np.maximum(1.0 - leverage, 1e-6)[:, None])
    return min(tried, key=lambda away: float(np.sum(np.mean(away**2, axis=0) / scale)))


def gain_of(goals: Goals, left: Array, rng: np.random.Generator) -> Gain:
    """Gain of the test that leaves so much of the goals, (n, m); see `fit_left_out`.

    The expected remaining variance of a goal is the mean square of what is left; a band's width
    goes with its root. Information is half the logarithm of the ratio of the determinants of the
    goals' covariance before and after, in their principal directions.
    """
    n = len(left)
    counts = rng.multinomial(n, np.full(n, 1.0 / n), RESAMPLES)
    weights = np.concatenate([np.ones((1, n)), counts])
    # both are means of squares over draws that were left out: without information they are equal
    away = (goals.values - goals.values.mean(axis=0)) * (n / (n - 1.0))
    share = weights @ left**2 / np.maximum(weights @ away**2, 1e-300)
    scale = np.maximum(away.std(axis=0), 1e-300)
    _, sizes, ways = np.linalg.svd(away / scale, full_matrices=False)
    explained = np.cumsum(sizes**2) / max(float(np.sum(sizes**2)), 1e-300)
    kept = min(int(np.searchsorted(explained, EXPLAINED)) + 1, MOST, len(sizes))

    def log_determinants(values: Array) -> Array:
        own = values / scale @ ways[:kept].T
        products = np.einsum("ni,nj->nij", own, own).reshape(n, -1)
        means = (weights @ products).reshape(-1, kept, kept) / weights.sum(axis=1)[:, None, None]
        return np.asarray(np.linalg.slogdet(means)[1])

    figures = []
    for values in (goals.narrower(share), 0.5 * (log_determinants(away) - log_determinants(left))):
        figures += [max(float(values[0]), 0.0), float(np.std(values[1:], ddof=1))]
    return Gain(*figures)


def greedy(goals: Goals, tests: Sequence[Array], size: int) -> list[tuple[int, ...]]:
    """Sets of 1, 2, … up to `size` tests, each with the one that adds most to the set before."""
    values = goals.values - goals.values.mean(axis=0)
    every, n = np.concatenate(tests, axis=1), len(values)
    ends = np.cumsum([0, *(test.shape[1] for test in tests)])
    gram, told, whole = every.T @ every, every.T @ values, np.sum(values**2, axis=0)

    def reduction(chosen: tuple[int, ...]) -> float:
        """Expected reduction of the mean width, corrected for the number of columns."""
        columns = np.concatenate([np.arange(ends[k], ends[k + 1]) for k in chosen])
        q = columns.size
        if not q or n <= q + 2:
            return 0.0
        matrix = gram[np.ix_(columns, columns)] + SMALL * n * np.eye(q)
        right = told[columns]
        explained = np.sum(right * linalg.solve(matrix, right, assume_a="pos"), axis=0)
        share = (whole - explained) / (n - 1.0 - q) * (n - 1.0) / np.maximum(whole, 1e-300)
        return float(goals.narrower(np.clip(share, 0.0, None)))

    found: list[tuple[int, ...]] = []
    chosen: tuple[int, ...] = ()
    for _ in range(min(size, len(tests))):
        free = (k for k in range(len(tests)) if k not in chosen)
        chosen = max(((*chosen, k) for k in free), key=reduction)
        found.append(chosen)
    return found
