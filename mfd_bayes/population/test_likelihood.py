"""The likelihood of one test in the coordinates of the population, and a Gaussian close to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEAST_INFORMATION = 1e-3
"""Precision, in prior units, below which a test counts as uninformative in a direction."""


@runtime_checkable
class LeastSquares(Protocol):
    """A log likelihood that depends on the model's force by a sum of squares."""

    def __call__(self, x: Array) -> Array:
        """Log likelihood at (n, D), (n,)."""

    def standard(self, x: Array) -> Array:
        """What the model leaves over at (n, D), over the shape of the noise, (n, T)."""

    def by_squares(self, x: Array, squares: Array) -> Array:
        """Log likelihood of coordinates (n, D) that leave such sums of squares over, (n,)."""


@dataclass(frozen=True, eq=False)
class TestLikelihood:
    """Likelihood of one test, in prior units: the d shared coordinates first, then its own.

    Attributes
    ----------
    log_likelihood : callable
        Of (n, D) coordinates, (n,).
    log_own_prior : callable
        Log prior density of the D − d coordinates of its own, (n, D − d) -> (n,).
    mean, covariance : (D,), (D, D)
        Of a Gaussian close to the likelihood.
    gaussian : bool
        Whether the likelihood is this Gaussian.
    """

    log_likelihood: Callable[[Array], Array]
    log_own_prior: Callable[[Array], Array]
    mean: Array
    covariance: Array
    gaussian: bool = False

    __test__ = False  # pytest is not to collect it

    @cached_property
    def precision(self) -> Array:
        """Precision of the Gaussian, (D, D)."""
        return np.asarray(np.linalg.inv(self.covariance))

    @cached_property
    def root(self) -> Array:
        """Cholesky factor of the precision, (D, D)."""
        return np.asarray(np.linalg.cholesky(self.precision))

    def approximated(self) -> TestLikelihood:
        """The same test with the Gaussian in place of the likelihood."""

        def log_likelihood(x: Array) -> Array:
            away = x - self.mean
            density: Array = -0.5 * np.sum(away @ self.precision * away, axis=1)
            return density

        return replace(self, log_likelihood=log_likelihood, gaussian=True)

    def density(self, shared: int) -> OwnDensity:
        """Likelihood and prior of the coordinates of its own; the first ones are shared."""
        return OwnDensity(self.log_likelihood, self.log_own_prior, shared)


@dataclass(frozen=True, eq=False)
class OwnDensity:
    """What is a test's own in the joint density; a process can be sent it.

    Attributes
    ----------
    log_likelihood, log_own_prior : callable
        As in `TestLikelihood`.
    shared : int
        Number of the shared coordinates.
    """

    log_likelihood: Callable[[Array], Array]
    log_own_prior: Callable[[Array], Array]
    shared: int

    def __call__(self, x: Array) -> Array:
        """Log likelihood and log prior density of a test's own coordinates at (n, D), (n,)."""
        return self.log_likelihood(x) + self.log_own_prior(x[:, self.shared :])


def without_prior(draws: Array) -> tuple[Array, Array]:
    """Mean (D,) and covariance (D, D) of the likelihood behind draws (S, D) in prior units.

    The interim prior, of mean 0 and precision 1, is divided out of the draws' moments.
    """
    mean = draws.mean(axis=0)
    variances, axes = np.linalg.eigh(np.atleast_2d(np.cov(draws, rowvar=False)))
    information = 1.0 / variances - 1.0
    informed = information > LEAST_INFORMATION
    precision = np.where(informed, information, LEAST_INFORMATION)
    along = axes.T @ mean
    centre = np.where(informed, along / variances / precision, along)
    return axes @ centre, (axes / precision) @ axes.T
