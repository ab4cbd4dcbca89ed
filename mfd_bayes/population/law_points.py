"""Points at which a law's hyperparameters are integrated: near its posterior, by importance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.diagnostics import psis
from mfd_bayes.calibration.map_fit import climb
from mfd_bayes.calibration.mixture import Mixture
from mfd_bayes.population.law_samples import LawProblem, LawSample

Array = NDArray[np.float64]
Tests = Sequence[int] | slice

POINTS = 1 << 10
"""Points of each Student-t density."""

AT_ONCE = 1 << 19
"""Points times tests that are computed at once, to bound the memory."""

NEAR = 20
"""Most sets of tests whose own posterior gets a density of its own."""

DOF = 4.0

WIDER = 5.0
"""A second density about each mode has a covariance larger by this."""


@dataclass(frozen=True, eq=False)
class LawPoints:
    """Points of a law's hyperparameters with their weights under the prior.

    Attributes
    ----------
    problem : LawProblem
    z : (n, dim)
    log_weights : (n,)
        Log of prior density over that of the points, over n.
    """

    problem: LawProblem
    z: Array
    log_weights: Array

    def parts(self) -> Iterator[tuple[LawSample, Array]]:
        """Points in parts with their log weights: many tests take no more memory than few."""
        tests, m = self.problem.rows.shape
        pieces = -(-len(self.z) * max(tests, m * m) // AT_ONCE)
        for at in np.array_split(np.arange(len(self.z)), pieces):
            yield self.problem.sample(self.z[at]), self.log_weights[at]


def draw_points(problem: LawProblem, subsets: Sequence[Tests] = (), seed: int = 0) -> LawPoints:
    """Points for the posterior of all tests, and of each subset of them; always the same.

    They are of a mixture of Student-t densities: two about the mode of each posterior, with its
    Laplace covariance and a wider one, one as wide as the prior, and one with each posterior's
    moments as a first set of points gives them. Each part is a scrambled Sobol set. Of more than
    `NEAR` subsets only some have their own densities: each of them then leaves out few tests.

    Parameters
    ----------
    problem : LawProblem
    subsets : sequence of tests
        By index.
    seed : int
        Of the scrambling.
    """
    every = _mode(problem, slice(None), np.zeros(problem.dim))
    chosen = np.unique(np.linspace(0, len(subsets) - 1, min(len(subsets), NEAR)).astype(int))
    targets: list[Tests] = [slice(None), *(subsets[i] for i in chosen.tolist())]
    prior = np.zeros(problem.dim), np.eye(problem.dim)
    modes = [every, *(_mode(problem, those, every[0]) for those in targets[1:])]
    found = [prior, *modes, *((q, WIDER * covariance) for q, covariance in modes)]
    first = _drawn(problem, found, seed)
    learned = [_moments(first, those) for those in targets]
    return _drawn(problem, [*found, *learned], seed)


def _drawn(problem: LawProblem, densities: Sequence[tuple[Array, Array]], seed: int) -> LawPoints:
    """Points of Student-t densities of these means and covariances, as many of each."""
    means, covariances = (np.array(part) for part in zip(*densities, strict=True))
    k = len(densities)
    mixture = Mixture.of(np.full(k, 1.0 / k), means, covariances, np.full(k, DOF))
    z = []
    for i in range(k):
        u = _uniform(POINTS, problem.dim + 1, (seed, i))
        radius = np.sqrt(0.5 * DOF / special.gammaincinv(0.5 * DOF, u[:, -1:]))  # of chi-squared
        z.append(means[i] + (special.ndtri(u[:, :-1]) * radius) @ mixture.factors[i].T)
    points = np.concatenate(z)
    log_weights = problem.log_prior(points) - mixture.log_density(points) - np.log(len(points))
    return LawPoints(problem, points, log_weights)


def _moments(points: LawPoints, those: Tests) -> tuple[Array, Array]:
    """Mean and covariance of the posterior of some tests, by importance."""
    log_weights = [w + sample.log_density(sample.sums(those)) for sample, w in points.parts()]
    weights = special.softmax(np.concatenate(log_weights))
    mean = weights @ points.z
    away = points.z - mean
    covariance = (weights[:, None] * away).T @ away
    return mean, covariance + 1e-9 * np.eye(len(mean))


def _mode(problem: LawProblem, those: Tests, begin: Array) -> tuple[Array, Array]:
    """Mode of the posterior of some tests, (dim,), and its Laplace covariance."""

    def density(z: Array) -> Array:
        sample = problem.sample(z)
        return problem.log_prior(z) + sample.log_density(sample.sums(those))

    mode = climb(density, begin, np.ones(problem.dim))
    return mode.q, mode.covariance


def _uniform(n: int, dim: int, seed: Sequence[int]) -> Array:
    """Scrambled Sobol points inside the unit cube, (n, dim)."""
    from scipy.stats import qmc  # which takes long to import

    points = qmc.Sobol(dim, scramble=True, rng=np.random.default_rng(seed)).random(n)
    return np.clip(points, 1e-9, 1.0 - 1e-9)


def effective(log_weights: Array) -> Array:
    """Effective number of points of each column of log weights, (n, ...) -> (...)."""
    size = 2.0 * special.logsumexp(log_weights, axis=0) - special.logsumexp(
        2.0 * log_weights, axis=0
    )
    return np.asarray(np.exp(size))


def worst_k(log_weights: Array) -> float:
    """Largest Pareto k of the columns, (n, c), of which those of few effective points are tried."""
    least = np.argsort(effective(log_weights))[:NEAR]
    return max(psis(np.maximum(c, c.max() - 600.0))[1] for c in log_weights.T[least])
