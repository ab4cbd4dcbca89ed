"""Modes of a posterior, found from several starts, each with its Laplace covariance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.errors import FitError

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
Density = Callable[[Array], Array]  # log density of points (n, dim), (n,)

# least squares: most steps; least relative gain of a good step; refused steps that end a start
STEPS, TOLERANCE, REFUSED = 100, 1e-6, 8
MOST = 4_000_000  # most numbers of residuals that are computed together
LOWEST = -1e15  # log density where there is none, for what takes differences
DISTINCT = 0.05  # least distance of two least-squares results, in prior standard deviations
HOPELESS = 400.0  # least-squares results are dropped whose log posterior is so far below the best


@dataclass(frozen=True, eq=False)
class Mode:
    """A local maximum of the log posterior."""

    q: Array  # (dim,)
    log_prob: float
    covariance: Array  # (dim, dim): inverse curvature at the mode, made positive definite

    @property
    def log_evidence(self) -> float:
        """Laplace's approximation to the log mass of the mode."""
        _, log_det = np.linalg.slogdet(self.covariance)
        return self.log_prob + 0.5 * (len(self.q) * float(np.log(2 * np.pi)) + float(log_det))

    def is_near(self, q: Array, log_prob: float) -> bool:
        """Whether a point is near by this mode's covariance, and about as high."""
        away = q - self.q
        near = away @ np.linalg.solve(self.covariance, away) < 4.0 * len(away)
        return bool(near and abs(log_prob - self.log_prob) < 5.0)


def find_modes(
    posterior: Posterior, rng: np.random.Generator, *, starts: int = 24
) -> tuple[Mode, ...]:
    """Distinct modes, best first.

    From many prior draws, those that fit well and differ most are chosen; least squares on
    residual and prior starts from each, then BFGS on the log posterior from each distinct result.
    """
    of_prior = posterior.coordinates(posterior.draw_prior(rng, 2000))
    mean, sd = of_prior.mean(axis=0), of_prior.std(axis=0)
    begin = _starting_points(posterior, rng, starts)
    fits = _fit_residuals(posterior, begin, mean, sd)
    heights = posterior.log_prob(fits)
    ends: list[Array] = []
    for i in np.argsort(-heights):
        if heights[i] > heights.max() - HOPELESS and all(
            np.max(np.abs(fits[i] - end) / sd) > DISTINCT for end in ends
        ):
            ends.append(fits[i])
    modes: list[Mode] = []
    for end in ends:
        mode = climb(posterior.log_prob, end, sd, modes)
        if not any(other.is_near(mode.q, mode.log_prob) for other in modes):
            modes.append(mode)
    return tuple(sorted(modes, key=lambda mode: -mode.log_prob))


def _starting_points(posterior: Posterior, rng: np.random.Generator, starts: int) -> Array:
    """Prior draws whose loops fit well and that are far from each other, (starts, dim)."""
    draws = posterior.coordinates(posterior.draw_prior(rng, 500))
    draws = draws[np.isfinite(posterior.log_prior(draws))]
    if len(draws) == 0:
        raise FitError("the prior has no mass at any start: widen the priors of this device")
    misfit = np.mean(posterior.residual(draws)[:, posterior.first :] ** 2, axis=1)
    good = draws[np.argsort(misfit)[: max(starts, len(draws) // 5)]]
    place = good / draws.std(axis=0)
    chosen, distance = [0], np.full(len(good), np.inf)
    while len(chosen) < min(starts, len(good)):
        distance = np.minimum(distance, np.linalg.norm(place - place[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(distance)))
    return good[chosen]


def _fit_residuals(posterior: Posterior, begin: Array, mean: Array, sd: Array) -> Array:
    """Fits with independent noise and a Gaussian prior, and their noise, (m, dim)."""
    moves = np.array([not name.startswith("noise") for name in posterior.names])
    force = np.asarray(posterior.trace.force)[posterior.first :]
    # neighbouring samples are correlated: they count as 200
    scale = np.sqrt(min(1.0, 200.0 / force.size)) / (0.1 * float(np.std(force)) + 1e-12)

    def residual(points: Array, _: Rows) -> Array:
        q = np.tile(begin[0], (len(points), 1))
        q[:, moves] = mean[moves] + sd[moves] * points
        return np.asarray(posterior.residual(q)[:, posterior.first :] * scale)

    scaled = np.clip((begin[:, moves] - mean[moves]) / sd[moves], -5.0, 5.0)
    q = begin.copy()
    q[:, moves] = mean[moves] + sd[moves] * least_squares(residual, scaled, 8.0)
    return np.array([_read_noise(posterior, point) for point in q])


def _read_noise(posterior: Posterior, q: Array) -> Array:
    """The coordinates with noise_sd and noise_time set from the residual, (dim,)."""
    residual = posterior.residual(q[None])[0, posterior.first :]
    values = posterior.values(q[None])
    sd = float(np.std(residual)) + 1e-12
    values["noise_sd"] = np.array([sd])
    if "noise_time" in values:
        lag_one = float(np.mean(residual[1:] * residual[:-1])) / sd**2
        step = float(np.median(np.diff(posterior.trace.time)))
        values["noise_time"] = np.array([-step / np.log(np.clip(lag_one, 0.05, 0.98))])
    noisy = [name.startswith("noise_") and name != "noise_dof" for name in posterior.names]
    return np.where(noisy, posterior.coordinates(values)[0], q)


def climb(density: Density, begin: Array, sd: Array, modes: Sequence[Mode] = ()) -> Mode:
    """Mode that BFGS reaches from a point, (dim,); `sd` (dim,) are the prior's.

    Where it comes near one of the known `modes`, and is not higher, it ends there.
    """
    from scipy.optimize import OptimizeResult, minimize  # which takes long to import

    dim, step = len(begin), 1e-4
    around = step * np.concatenate([np.zeros((1, dim)), np.eye(dim), -np.eye(dim)])
    met: list[Mode] = []

    def loss(w: Array) -> tuple[float, Array]:
        """Loss and its slope by central differences, in one batch."""
        here, *near = -np.maximum(density(begin + sd * (w + around)), LOWEST)
        higher, lower = np.reshape(near, (2, dim))
        return float(here), (higher - lower) / (2 * step)

    def look(intermediate_result: OptimizeResult) -> None:  # SciPy looks at this name
        q, height = begin + sd * intermediate_result.x, -float(intermediate_result.fun)
        met.extend(m for m in modes if height <= m.log_prob and m.is_near(q, height))
        if met:
            raise StopIteration

    fit = minimize(
        loss,
        np.zeros(dim),
        jac=True,
        method="BFGS",
        callback=look,
        options={"maxiter": 150, "gtol": 1e-2},
    )
    if met:
        return met[0]
    q = begin + sd * fit.x
    return Mode(q, float(density(q[None])[0]), laplace_covariance(density, q, sd))


def laplace_covariance(density: Density, q: Array, sd: Array) -> Array:
    """Inverse of the negative Hessian of a log density at q, (dim, dim).

    The Hessian's eigenvalues, in prior units, are limited so that each standard deviation is
    between 1e-4 and 4 times the prior's, and the result is positive definite.
    """
    dim, step = len(q), 3e-3
    shifts = step * sd * np.concatenate([np.eye(dim), -np.eye(dim)])
    i, j = np.triu_indices(2 * dim)
    heights = np.empty((2 * dim, 2 * dim))
    heights[i, j] = heights[j, i] = np.maximum(density(q + shifts[i] + shifts[j]), LOWEST)
    values = heights.reshape(2, dim, 2, dim)
    slopes = values[:, :, 0] - values[:, :, 1]
    curvature = -(slopes[0] - slopes[1]) / (2 * step) ** 2
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    covariance: Array = (vectors / np.clip(values, 1.0 / 16.0, 1e8)) @ vectors.T
    return covariance * sd * sd[:, None]


def least_squares(residual: Callable[[Array, Rows], Array], begin: Array, reach: float) -> Array:
    """Points (m, d) with the least sum of squares of residuals and coordinates, one a start.

    `residual` takes points (n, d) and the numbers of their starts (n,), and gives (n, T); no
    coordinate goes beyond ± `reach`.
    Damped Gauss-Newton steps (Levenberg, Marquardt) of all starts at once: a force costs half as
    much a vector where many are computed together.
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
