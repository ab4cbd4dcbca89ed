"""Regression of goals on summaries of simulated tests, judged on draws that it has not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special

Array = NDArray[np.float64]

FLAT = 1e-9
"""A summary whose sd is below this share of its size does not vary."""

SAME = 1e-6
"""A direction of the summaries with less than this share of their variance repeats others."""

BENT = 6
"""Directions of the summaries, the widest first, whose squares and products are used too."""

_PENALTIES = (1e-6, 1e-2, 1e-1, 1.0, 1e1)  # over the number of draws


@dataclass(frozen=True, eq=False)
class Fit:
    """Goals predicted from a test's summaries.

    Attributes
    ----------
    fitted : (n, m)
        E[goal | summaries] of each draw, with all draws.
    left : (n, m)
        Goal less its prediction from all other draws.
    """

    fitted: Array
    left: Array


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


def bent(directions: Array) -> Array:
    """Squares and products of the first `BENT` directions (n, k), centred, (n, products)."""
    first = directions[:, :BENT]
    one, other = np.triu_indices(first.shape[1])
    products = first[:, one] * first[:, other]
    return np.asarray((products - products.mean(axis=0)) / np.sqrt(1.0 + (one == other)))


def fit_left_out(goals: Array, directions: Array, *, curved: bool = True) -> Fit:
    """Goals (n, m) predicted from directions of summaries (n, k) by ridge regression.

    Straight and curved forms and several penalties are tried; the one with the least error on
    draws left out one by one, in closed form (PRESS), summed over the goals in units of their
    variance, is taken. Where summaries tell nothing the mean of the goals is as good, and is
    what is taken.

    Source: Strong, Oakley and Brennan, Medical Decision Making 34 (2014) 311, with ridge
    regression instead of splines, since there are many summaries.
    """
    n = len(goals)
    centred = goals - goals.mean(axis=0)
    scale = np.maximum(np.mean(centred**2, axis=0), 1e-300)
    best = Fit(np.zeros_like(goals) + goals.mean(axis=0), centred * (n / (n - 1.0)))
    least = float(np.sum(np.mean(best.left**2, axis=0) / scale))
    designs = [directions]
    if curved and directions.shape[1]:
        designs.append(np.concatenate([directions, bent(directions)], axis=1))
    for design in designs:
        for fit in _ridges(centred, design):
            error = float(np.sum(np.mean(fit.left**2, axis=0) / scale))
            if error < least:
                least, best = error, Fit(fit.fitted + goals.mean(axis=0), fit.left)
    return best


def _ridges(centred: Array, design: Array) -> list[Fit]:
    """Fits of centred goals (n, m) with a centred design (n, p), one for each penalty."""
    if not design.shape[1]:
        return []
    n = len(design)
    left, sizes, _ = linalg.svd(design, full_matrices=False)
    told = left.T @ centred
    found = []
    for penalty in _PENALTIES:
        shrink = sizes**2 / (sizes**2 + penalty * n)
        fitted = left @ (shrink[:, None] * told)
        leverage = 1.0 / n + (left**2) @ shrink
        away = np.maximum(1.0 - leverage, 1e-6)[:, None]
        found.append(Fit(fitted, (centred - fitted) / away))
    return found
