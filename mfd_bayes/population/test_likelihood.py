"""The likelihood of one test in the coordinates of the population, and a Gaussian close to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.population.coordinates import Coordinates
from mfd_bayes.population.layout import Layout

Array = NDArray[np.float64]

ROOM = 1 << 25
"""Most numbers of stored draws of all tests that are held, in single precision: 128 MiB."""

FEWEST = 500
"""Draws of a test that are held, however many tests there are."""

ORDINARY = 20.0
"""Coordinates nearer to 0 than this have a finite prior density under every prior."""

LEAST_INFORMATION = 1e-3
"""Precision, in prior units, below which a test counts as uninformative in a direction."""


@dataclass(frozen=True, eq=False)
class TestLikelihood:
    """Likelihood of one test, in prior units: the d shared coordinates first, then its own.

    Attributes
    ----------
    log_likelihood : callable
        Of (n, D) coordinates, (n,).
    log_interim_prior : callable
        Log density of (n, d) shared coordinates under the prior of the test by itself, (n,).
    log_own_prior : callable
        Log prior density of the D − d coordinates of its own, (n, D − d) -> (n,).
    draws : (S, D) float32
        Draws of the test's posterior under the interim prior.
    draws_log_prior : (S,)
        Log density of their shared coordinates under the interim prior.
    mean, covariance : (D,), (D, D)
        Gaussian close to the likelihood: the draws' moments without the interim prior.
    gaussian : bool
        Whether the likelihood is this Gaussian.
    """

    log_likelihood: Callable[[Array], Array]
    log_interim_prior: Callable[[Array], Array]
    log_own_prior: Callable[[Array], Array]
    draws: NDArray[np.float32]
    draws_log_prior: Array
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
            density: Array = -0.5 * np.einsum("ni,ij,nj->n", away, self.precision, away)
            return density

        return replace(self, log_likelihood=log_likelihood, gaussian=True)


@dataclass(frozen=True, eq=False)
class LogLikelihood:
    """Log likelihood of one test's coordinates in prior units; a process can be sent it.

    Attributes
    ----------
    posterior : Posterior
    coordinates : Coordinates
        Of the shared quantities, which come first.
    middle, scale : (D,)
        Origin and length of the prior units.
    order : tuple of int
        Column of each of the posterior's coordinates.
    """

    posterior: Posterior
    coordinates: Coordinates
    middle: Array
    scale: Array
    order: tuple[int, ...]

    def __call__(self, x: Array) -> Array:
        """Log likelihood of (n, D) coordinates, (n,); −inf outside the support of the priors."""
        q = self.middle + self.scale * x
        d = len(self.coordinates.names)
        q[:, :d] = self.coordinates.to_own(q[:, :d])
        q = q[:, self.order]
        density = np.full(len(q), -np.inf)
        inside = np.all(np.abs(q) < ORDINARY, axis=1)  # no need to evaluate the priors
        beyond = ~inside & np.all(np.isfinite(q), axis=1)
        inside[beyond] = np.isfinite(self.posterior.log_prior_own(q[beyond]))
        if np.any(inside):
            own = self.posterior.from_own(q[inside])
            density[inside] = self.posterior.log_likelihood(own)
        return density


def likelihood_of(
    layout: Layout, posterior: Posterior, values: Mapping[str, Array]
) -> TestLikelihood:
    """Likelihood of a calibrated test, from its posterior's stored draws by name, (S,) each.

    Of many tests the draws are thinned, so that all together take no more than `ROOM`.
    """
    own = [name for name in posterior.names if name not in layout.names]
    order = [*layout.names, *own]
    units = [_prior_units(posterior, name) for name in own]
    middle = np.array([*layout.centre, *(centre for centre, _ in units)])
    scale = np.array([*layout.spread, *(spread for _, spread in units)])
    d = len(layout.names)

    def log_own_prior(x: Array) -> Array:
        total = np.zeros(len(x))
        for i, name in enumerate(own):
            total += posterior.priors[name].log_density(middle[d + i] + scale[d + i] * x[:, i])
        return total

    def log_interim_prior(x: Array) -> Array:
        return layout.coordinates.log_prior(layout.centre + layout.spread * x)

    coordinates = [layout.coordinates.of(values)]
    coordinates += [posterior.priors[name].coordinate(values[name])[:, None] for name in own]
    draws = (np.concatenate(coordinates, axis=1) - middle) / scale
    most = max(FEWEST, ROOM // (len(layout.settings) * draws.shape[1]))
    thinned = draws[:: -(-len(draws) // most)].astype(np.float32)
    back = tuple(order.index(name) for name in posterior.names)
    return TestLikelihood(
        LogLikelihood(posterior, layout.coordinates, middle, scale, back),
        log_interim_prior,
        log_own_prior,
        thinned,
        log_interim_prior(thinned[:, :d].astype(np.float64)),
        *without_prior(draws),
    )


def _prior_units(posterior: Posterior, name: str) -> tuple[float, float]:
    """Mean and sd of a quantity's coordinate under its prior."""
    prior = posterior.priors[name]
    drawn = prior.coordinate(prior.draw(np.random.default_rng(0), 4000))
    return float(drawn.mean()), float(drawn.std())


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
