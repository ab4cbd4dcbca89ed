"""Tests some of whose quantities are left out of the population.

A law without an intercept says nothing of a test at zero actuation. The test's own value of the
quantity then has the prior of a test by itself. In its place among the shared coordinates stands
one that the likelihood does not depend on: it follows the population, and is integrated out, so
that the test informs neither level nor scatter nor law of the quantity. All moves stay as they
are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.priors import Prior
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.test_likelihood import (
    LEAST_INFORMATION,
    LeastSquares,
    TestLikelihood,
    without_prior,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Apart:
    """Coordinates of a test, (n, D + K), of whose shared quantities K are left out.

    Their own coordinates, in prior units, come last.

    Attributes
    ----------
    layout : Layout
    columns : tuple of int
        The quantities that are left out.
    middle, scale : (K,)
        Mean and sd of their coordinates under their priors.
    """

    layout: Layout
    columns: tuple[int, ...]
    middle: Array
    scale: Array

    @classmethod
    def of(cls, layout: Layout, j: int) -> Apart:
        """Those of test j; there may be none."""
        columns = tuple(np.flatnonzero(~layout.informs[j]).tolist())
        found = cls(layout, columns, np.zeros(len(columns)), np.ones(len(columns)))
        drawn = found.draw(4000)
        return cls(layout, columns, drawn.mean(axis=0), drawn.std(axis=0))

    @property
    def priors(self) -> list[Prior]:
        """Priors of the quantities that are left out."""
        known = self.layout.coordinates
        return [known.priors[known.names[k]] for k in self.columns]

    def draw(self, n: int) -> Array:
        """Prior draws of the coordinates of what is left out, (n, K)."""
        rng = np.random.default_rng(0)
        drawn = [prior.coordinate(prior.draw(rng, n)) for prior in self.priors]
        return np.reshape(drawn, (len(drawn), n)).T

    def log_prior(self, y: Array) -> Array:
        """Log prior density of the own coordinates of what is left out (n, K), (n,)."""
        q, total = self.middle + self.scale * y, np.zeros(len(y))
        for i, prior in enumerate(self.priors):
            total += prior.log_density(q[:, i])
        return total

    def split(self, x: Array) -> Array:
        """Coordinates (n, D + K) of a test's (n, D), with prior draws where nothing is shared."""
        own = self._own(x)
        y = (own[:, self.columns] - self.middle) / self.scale
        own[:, self.columns] = self.draw(len(x))
        return np.concatenate([self._shared(own), x[:, own.shape[1] :], y], axis=1)

    def join(self, x: Array) -> Array:
        """The test's coordinates, (n, D), of (n, D + K)."""
        end = x.shape[1] - len(self.columns)
        own = self._own(x)
        own[:, self.columns] = self.middle + self.scale * x[:, end:]
        return np.concatenate([self._shared(own), x[:, own.shape[1] : end]], axis=1)

    def _own(self, x: Array) -> Array:
        """Shared quantities in the coordinates of their priors, (n, d)."""
        d = len(self.layout.names)
        return self.layout.coordinates.to_own(self.layout.centre + self.layout.spread * x[:, :d])

    def _shared(self, own: Array) -> Array:
        return (self.layout.coordinates.from_own(own) - self.layout.centre) / self.layout.spread


@dataclass(frozen=True, eq=False)
class Joined:
    """Log likelihood of a test's coordinates (n, D + K), (n,); a process can be sent it."""

    apart: Apart
    log_likelihood: Callable[[Array], Array]

    def __call__(self, x: Array) -> Array:
        """Log likelihood, (n,)."""
        return self.log_likelihood(self.apart.join(x))


@dataclass(frozen=True, eq=False)
class JoinedSquares(Joined):
    """The same where the likelihood depends on the force by a sum of squares."""

    log_likelihood: LeastSquares

    def standard(self, x: Array) -> Array:
        """As in `LeastSquares`."""
        return self.log_likelihood.standard(self.apart.join(x))

    def by_squares(self, x: Array, squares: Array) -> Array:
        """As in `LeastSquares`."""
        return self.log_likelihood.by_squares(self.apart.join(x), squares)


@dataclass(frozen=True, eq=False)
class JoinedPrior:
    """Log prior density of a test's own coordinates (n, D − d + K), (n,)."""

    apart: Apart
    log_own_prior: Callable[[Array], Array]

    def __call__(self, x: Array) -> Array:
        """Log density, (n,)."""
        end = x.shape[1] - len(self.apart.columns)
        return self.log_own_prior(x[:, :end]) + self.apart.log_prior(x[:, end:])


def set_apart(layout: Layout, tests: Sequence[TestLikelihood]) -> list[TestLikelihood]:
    """The tests' likelihoods, without what does not inform the population."""
    aparts = [Apart.of(layout, j) for j in range(len(tests))]
    return [_one(a, test) if a.columns else test for a, test in zip(aparts, tests, strict=True)]


def _one(apart: Apart, test: TestLikelihood) -> TestLikelihood:
    draws = apart.split(_draws(test))

    told = np.setdiff1d(np.arange(draws.shape[1]), apart.columns)
    mean, covariance = np.zeros(draws.shape[1]), np.eye(draws.shape[1]) / LEAST_INFORMATION
    mean[told], covariance[np.ix_(told, told)] = without_prior(draws[:, told])
    whole = test.log_likelihood
    if isinstance(whole, LeastSquares):
        likelihood: Joined = JoinedSquares(apart, whole)
    else:
        likelihood = Joined(apart, whole)
    return TestLikelihood(likelihood, JoinedPrior(apart, test.log_own_prior), mean, covariance)


def _draws(test: TestLikelihood) -> Array:
    """Draws near the test's posterior under a N(0, 1) prior, (n, D), by its Gaussian."""
    precision = test.precision + np.eye(len(test.mean))
    mean = np.linalg.solve(precision, test.precision @ test.mean)
    rng = np.random.default_rng(0)
    return rng.multivariate_normal(mean, np.linalg.inv(precision), size=4000, method="cholesky")


def joined(layout: Layout, j: int, draws: Array) -> Array:
    """Draws of test j (chain, draw, D) with its own values of what is left out, as it has them."""
    apart = Apart.of(layout, j)
    if not apart.columns:
        return draws
    found = apart.join(draws.reshape(-1, draws.shape[2]))
    return found.reshape(*draws.shape[:2], -1)
