"""Least squares from many starts at once, by damped Gauss–Newton steps.

SciPy takes one start after the other; a force costs half as much a vector where many are computed
together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
Residual = Callable[[Array, Rows], Array]

STEP = 1e-4
"""Step of the differences."""

STEPS = 100
"""Most steps."""

TOLERANCE = 1e-6
"""A start is done when a step lowers its sum of squares by less than this share of it."""

LITTLE = 0.01
"""Damping below which a step is nearly that of Gauss and Newton."""

REFUSED = 8
"""Steps in a row that do not lower the sum of squares, after which a start is done."""

MOST = 4_000_000
"""Most numbers of residuals that are computed together."""


@dataclass
class _Search:
    """State of all starts: points (m, d), sums of squares (m,), damping and refused steps (m,).

    `normal` and `slope` are JᵀJ + 1 and Jᵀr + x at each point, for residuals r and slopes J.
    """

    points: Array
    squares: Array
    damping: Array
    refused: Rows
    normal: Array
    slope: Array


def fit_all(residual: Residual, begin: Array, reach: float) -> Array:
    """Points with the least sum of squares of residuals and coordinates, one from each start.

    Parameters
    ----------
    residual : callable
        Of points (n, d) and the numbers of their starts (n,), (n, T).
    begin : (m, d)
    reach : float
        Largest size of a coordinate.

    Returns
    -------
    (m, d)
    """
    m, d = begin.shape
    points = np.clip(begin, -reach, reach)
    found = _Search(
        points=points,
        squares=_sum_of_squares(residual, points, np.arange(m)),
        damping=np.full(m, 10.0),
        refused=np.zeros(m, dtype=np.intp),
        normal=np.empty((m, d, d)),
        slope=np.empty((m, d)),
    )
    going, moved = np.arange(m), np.arange(m)
    for _ in range(STEPS):
        _linearise(residual, found, moved)
        ahead = np.clip(found.points[going] + _steps(found, going, reach), -reach, reach)
        squares = _sum_of_squares(residual, ahead, going)
        before = found.squares[going]
        damping = found.damping[going]
        lower = squares < before  # False where it is no number
        moved = going[lower]
        found.points[moved], found.squares[moved] = ahead[lower], squares[lower]
        found.damping[going] *= np.where(lower, 0.1, 5.0)
        found.damping = np.clip(found.damping, 1e-9, 1e9)
        found.refused[going] = np.where(lower, 0, found.refused[going] + 1)
        little = lower & (before - squares < TOLERANCE * before) & (damping < LITTLE)
        going = going[~little & (found.refused[going] < REFUSED)]
        moved = np.intersect1d(moved, going)
        if not going.size:
            break
    return found.points


def _sum_of_squares(residual: Residual, points: Array, starts: Rows) -> Array:
    """Sum of squares of residuals and coordinates at points (n, d), (n,)."""
    misfits = residual(points, starts)
    total: Array = np.einsum("nt,nt->n", misfits, misfits) + np.sum(points**2, axis=1)
    return total


def _linearise(residual: Residual, found: _Search, those: Rows) -> None:
    """Compute the normal equations of some starts anew, several at a time."""
    d, begin = found.points.shape[1], 0
    size = 1
    while begin < those.size:
        some = those[begin : begin + size]
        points = np.repeat(found.points[some, None], d + 1, axis=1)
        points[:, range(1, d + 1), range(d)] += STEP
        values = residual(points.reshape(-1, d), np.repeat(some, d + 1))
        values = values.reshape(some.size, d + 1, -1)
        slopes = (values[:, 1:] - values[:, :1]) / STEP
        found.normal[some] = slopes @ slopes.swapaxes(1, 2) + np.eye(d)
        found.slope[some] = (slopes @ values[:, 0, :, None])[..., 0] + found.points[some]
        begin += some.size
        size = max(1, MOST // (values.shape[2] * (d + 1)))


def _steps(found: _Search, those: Rows, reach: float) -> Array:
    """Damped steps of some starts; what would leave the range stays."""
    points, slope = found.points[those], found.slope[those]
    d = points.shape[1]
    stays = ((points >= reach) & (slope < 0.0)) | ((points <= -reach) & (slope > 0.0))
    diagonal = np.einsum("nii->ni", found.normal[those]) * (1.0 + found.damping[those, None])
    free = ~stays
    normal = np.where(free[:, :, None] & free[:, None, :], found.normal[those], 0.0)
    normal[:, range(d), range(d)] = np.where(stays, 1.0, diagonal)
    pull = np.where(stays, 0.0, slope)
    steps: Array = -np.linalg.solve(normal, pull[..., None])[..., 0]
    return steps
