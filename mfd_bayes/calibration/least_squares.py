"""Least squares from several starts at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

STEPS, TOLERANCE, REFUSED = 100, 1e-6, 8
"""Least squares: most steps; least relative gain of a good step; refused steps that end a start."""

MOST = 4_000_000
"""Most numbers of residuals that are computed together."""


def least_squares(residual: Callable[[Array, Rows], Array], begin: Array, reach: float) -> Array:
    """Points with the least sum of squares of residuals and coordinates, one from each start.

    Damped Gauss-Newton steps (Levenberg, Marquardt) of all starts at once: a force costs half as
    much a vector where many are computed together.

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

    def misfit(at: Array, starts: Rows) -> Array:
        left = residual(at, starts)
        squares = np.einsum("nt,nt->n", left, left) + np.sum(at**2, axis=1)
        return np.where(np.isnan(squares), np.inf, squares)

    (m, d), step = begin.shape, 1e-4
    points = np.clip(begin, -reach, reach)
    squares, damping = misfit(points, np.arange(m)), np.full(m, 10.0)
    refused = np.zeros(m, dtype=np.intp)
    normal, slope = np.tile(np.eye(d), (m, 1, 1)), np.zeros((m, d))  # JᵀJ + 1 and Jᵀr + x
    moved = going = np.arange(m)
    for _ in range(STEPS):
        size = 1
        while moved.size:
            some, moved = moved[:size], moved[size:]
            near = np.repeat(points[some, None], d + 1, axis=1)
            near[:, range(1, d + 1), range(d)] += step
            left = residual(near.reshape(-1, d), np.repeat(some, d + 1))
            left = left.reshape(some.size, d + 1, -1)
            with np.errstate(invalid="ignore"):
                slopes = (left[:, 1:] - left[:, :1]) / step
                slopes[~np.isfinite(slopes).all(axis=2)] = 0.0  # a slope that is no number: stay
                there = np.nan_to_num(left[:, 0], posinf=0.0, neginf=0.0)
            normal[some] = slopes @ slopes.swapaxes(1, 2) + np.eye(d)
            slope[some] = (slopes @ there[..., None])[..., 0] + points[some]
            size = max(1, MOST // (left.shape[2] * (d + 1)))
        at, pull = points[going], slope[going]
        stays = ((at >= reach) & (pull < 0.0)) | ((at <= -reach) & (pull > 0.0))
        system = np.where(stays[:, :, None] | stays[:, None, :], 0.0, normal[going])
        diagonal = np.einsum("nii->ni", normal[going]) * (1.0 + damping[going, None])
        system[:, range(d), range(d)] = np.where(stays, 1.0, diagonal)
        step_of = -np.linalg.solve(system, np.where(stays, 0.0, pull)[..., None])[..., 0]
        ahead = np.clip(at + step_of, -reach, reach)
        new = misfit(ahead, going)
        gain = squares[going] - new
        better = gain > 0.0
        small = better & (gain < TOLERANCE * squares[going]) & (damping[going] < 0.01)
        moved = going[better]
        points[moved], squares[moved] = ahead[better], new[better]
        damping[going] = np.clip(damping[going] * np.where(better, 0.1, 5.0), 1e-9, 1e9)
        refused[going] = np.where(better, 0, refused[going] + 1)
        going = going[~small & (refused[going] < REFUSED)]
        moved = np.intersect1d(moved, going)
        if not going.size:
            break
    return points
