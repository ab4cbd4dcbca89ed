"""Modes of a posterior, found from several starts, each with its Laplace covariance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from mfd_bayes.calibration.least_squares import fit_all
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.errors import FitError

Array = NDArray[np.float64]
Density = Callable[[Array], Array]

STEP = 1e-4
"""Finite-difference step, in prior standard deviations."""

APART = 0.05
"""Two least-squares results that differ less, in prior standard deviations, count as one."""

HOPELESS = 400.0
"""Least-squares results whose log posterior is this far below the best one are dropped."""


@dataclass(frozen=True, eq=False)
class Mode:
    """A local maximum of the log posterior.

    Attributes
    ----------
    q : (dim,)
    log_prob : float
    covariance : (dim, dim)
        Inverse curvature at the mode, made positive definite.
    """

    q: Array
    log_prob: float
    covariance: Array

    @property
    def log_evidence(self) -> float:
        """Laplace's approximation to the log mass of the mode."""
        _, log_det = np.linalg.slogdet(self.covariance)
        return self.log_prob + 0.5 * (len(self.q) * float(np.log(2 * np.pi)) + float(log_det))


def find_modes(
    posterior: Posterior, rng: np.random.Generator, *, starts: int = 24, candidates: int = 500
) -> tuple[Mode, ...]:
    """Distinct modes, best first.

    From many prior draws, those that fit well and differ most are chosen; least squares on
    residual and prior starts from each, then BFGS on the log posterior from each distinct
    result.

    Raises
    ------
    FitError
        When no prior draw has any posterior density.
    """
    scale = prior_scale(posterior, rng)
    begin = _starting_points(posterior, rng, starts, candidates)
    fits = _least_squares(posterior, begin, *scale)
    heights = posterior.log_prob(fits)
    order = np.argsort(-heights)
    ends: list[Array] = []
    for i in order[heights[order] > heights.max() - HOPELESS]:
        away = [np.max(np.abs(fits[i] - end) / scale[1]) for end in ends]
        if min(away, default=np.inf) > APART:
            ends.append(fits[i])
    modes: list[Mode] = []
    for end in ends:
        mode = climb(posterior.log_prob, end, scale[1], modes)
        if not any(is_same(mode, other) for other in modes):
            modes.append(mode)
    return tuple(sorted(modes, key=lambda mode: -mode.log_prob))


def prior_scale(posterior: Posterior, rng: np.random.Generator) -> tuple[Array, Array]:
    """Mean and standard deviation of each coordinate under the prior, (dim,) each."""
    q = posterior.coordinates(posterior.draw_prior(rng, 2000))
    return q.mean(axis=0), q.std(axis=0)


def _starting_points(
    posterior: Posterior, rng: np.random.Generator, starts: int, candidates: int
) -> Array:
    """Prior draws whose loops fit well and that are far from each other, (starts, dim)."""
    draws = posterior.coordinates(posterior.draw_prior(rng, candidates))
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


def _least_squares(posterior: Posterior, begin: Array, mean: Array, sd: Array) -> Array:
    """Modes of fits with iid noise and Gaussian prior; noise set from the residual, (m, dim)."""
    moves = np.array([not name.startswith("noise") for name in posterior.names])
    force = np.asarray(posterior.trace.force)[posterior.first :]
    unit = 0.1 * float(np.std(force)) + 1e-12
    inflation = np.sqrt(min(1.0, 200.0 / force.size))  # neighbouring samples are correlated

    def residual(points: Array, _: NDArray[np.intp]) -> Array:
        q = np.tile(begin[0], (len(points), 1))
        q[:, moves] = mean[moves] + sd[moves] * points
        return np.asarray(posterior.residual(q)[:, posterior.first :] * (inflation / unit))

    w0 = (begin[:, moves] - mean[moves]) / sd[moves]
    found = fit_all(residual, np.clip(w0, -5.0, 5.0), 8.0)
    q = begin.copy()
    q[:, moves] = mean[moves] + sd[moves] * found
    return np.array([_read_noise(posterior, one) for one in q])


def _read_noise(posterior: Posterior, q: Array) -> Array:
    """The coordinates with noise_sd and noise_time set from the residual, (dim,)."""
    residual = posterior.residual(q[None])[0, posterior.first :]
    values = {name: value.copy() for name, value in posterior.values(q[None]).items()}
    sd = float(np.std(residual)) + 1e-12
    values["noise_sd"][:] = sd
    if "noise_time" in values:
        lag_one = float(np.mean(residual[1:] * residual[:-1])) / sd**2
        step = float(np.median(np.diff(posterior.trace.time)))
        values["noise_time"][:] = -step / np.log(np.clip(lag_one, 0.05, 0.98))
    fitted = posterior.coordinates(values)[0]
    noisy = [name.startswith("noise_") and name != "noise_dof" for name in posterior.names]
    return np.where(noisy, fitted, q)


def climb(density: Density, begin: Array, sd: Array, known: Sequence[Mode] = ()) -> Mode:
    """Mode that BFGS reaches from `begin`, in whitened coordinates.

    Parameters
    ----------
    density : callable
        Log density, (n, dim) -> (n,).
    begin, sd : (dim,)
        Start, and the scale of each coordinate under its prior.
    known : sequence of Mode
        Where the climb comes near one of these, it ends, and that one is the result.
    """
    # whitening by the curvature at `begin` takes fewer steps, and finds fewer of two modes
    q, covariance = begin, np.diag((0.1 * sd) ** 2)
    for _ in range(2):  # the second time whitened by the curvature near the mode
        axes = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
        q, near = ascend(density, q, axes, known)
        if near is not None:
            return near
        covariance = laplace_covariance(density, q, sd)
    return Mode(q, float(density(q[None])[0]), covariance)


def ascend(
    density: Density, origin: Array, axes: Array, known: Sequence[Mode] = ()
) -> tuple[Array, Mode | None]:
    """Point that BFGS reaches from `origin` in coordinates along `axes`, (dim,).

    Where it comes near a known mode, and is not higher, it ends there: that mode comes second.
    """
    dim = len(origin)
    met: list[Mode] = []
    around = STEP * np.concatenate([np.zeros((1, dim)), np.eye(dim), -np.eye(dim)])

    def loss(w: Array) -> tuple[float, Array]:
        """Loss and its slope by central differences, in one batch: small ones cost the same."""
        here, *near = -np.maximum(density(origin + (w + around) @ axes.T), -1e15)
        higher, lower = np.reshape(near, (2, dim))
        return float(here), (higher - lower) / (2 * STEP)

    def look(intermediate_result: optimize.OptimizeResult) -> None:
        """Stop near a known mode; SciPy looks at the argument's name."""
        q, height = origin + axes @ intermediate_result.x, -float(intermediate_result.fun)
        met.extend(m for m in known if height <= m.log_prob and is_near(q, height, m))
        if met:
            raise StopIteration

    fit = optimize.minimize(
        loss,
        np.zeros_like(origin),
        jac=True,
        method="BFGS",
        callback=look,
        options={"maxiter": 150, "gtol": 1e-2},
    )
    return origin + axes @ fit.x, met[0] if met else None


def laplace_covariance(density: Density, q: Array, sd: Array) -> Array:
    """Inverse of the negative Hessian of a log density at q, (dim, dim).

    The Hessian's eigenvalues, in prior units, are limited so that each standard deviation is
    between 1e-4 and 4 times the prior's, and the result is positive definite.
    """

    def scaled(w: Array) -> Array:
        return np.maximum(density(q + w * sd), -1e15)

    dim, step = len(q), 3e-3
    corners = np.concatenate([step * np.eye(dim), -step * np.eye(dim)])
    gradients = _gradient(scaled, corners, step)
    curvature = -(gradients[:dim] - gradients[dim:]) / (2 * step)
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    covariance: Array = (vectors / np.clip(values, 1.0 / 16.0, 1e8)) @ vectors.T
    return covariance * sd * sd[:, None]


def _gradient(density: Density, points: Array, step: float) -> Array:
    """Central differences at all points in one batch, (n, dim) -> (n, dim)."""
    n, dim = points.shape
    shift = step * np.eye(dim)
    batch = np.concatenate([points[:, None] + shift, points[:, None] - shift], axis=1)
    values = density(batch.reshape(-1, dim)).reshape(n, 2, dim)
    gradient: Array = (values[:, 0] - values[:, 1]) / (2 * step)
    return gradient


def is_same(mode: Mode, other: Mode) -> bool:
    """Whether two modes are the same: near by the other's covariance, and equally high."""
    return is_near(mode.q, mode.log_prob, other)


def is_near(q: Array, log_prob: float, mode: Mode) -> bool:
    """Whether a point is near a mode by its covariance, and about as high."""
    gap = q - mode.q
    if not abs(log_prob - mode.log_prob) < 5.0:
        return False
    return bool(gap @ np.linalg.solve(mode.covariance, gap) < 4.0 * len(gap))
