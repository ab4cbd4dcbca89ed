"""What one test tells of the population: its likelihood, and a Gaussian that is close to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.population.coordinates import Coordinates
from mfd_bayes.population.layout import Layout

Array = NDArray[np.float64]

ROOM = 1 << 25
"""Numbers that are held of the stored draws of all tests, in single precision: 128 MiB."""

FEWEST = 500
"""Draws of a test that are held, however many tests there are."""

ORDINARY = 20.0
"""Coordinates nearer to 0 than this have a finite prior density, whatever the prior."""

LEAST_INFORMATION = 1e-3
"""Precision, in prior units, below which a test is taken to say nothing about a direction."""


@dataclass(frozen=True, eq=False)
class TestLikelihood:
    """One test, in prior units: its pooled coordinates first, then those of its own.

    Attributes
    ----------
    log_likelihood : callable
        Of (n, D) coordinates, (n,).
    log_interim_prior : callable
        Log density of (n, d) pooled coordinates under the prior of the test by itself, (n,).
    log_own_prior : callable
        Log prior density of the D − d coordinates of its own, (n, D − d) -> (n,).
    draws : (S, D) float32
        Draws of the test's posterior under the interim prior.
    draws_log_prior : (S,)
        Log density of their pooled coordinates under the interim prior.
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

    def approximated(self) -> TestLikelihood:
        """The same with the Gaussian in place of the likelihood."""
        precision = np.linalg.inv(self.covariance)

        def log_likelihood(x: Array) -> Array:
            away = x - self.mean
            density: Array = -0.5 * np.einsum("ni,ij,nj->n", away, precision, away)
            return density

        return replace(self, log_likelihood=log_likelihood, gaussian=True)


@dataclass(frozen=True, eq=False)
class LogLikelihood:
    """Log likelihood of one test's coordinates in prior units; it can be sent to a process.

    Attributes
    ----------
    posterior : Posterior
    coordinates : Coordinates
        Of the pooled quantities, which are the first.
    middle, scale : (D,)
        Origin and length of the units.
    back : tuple of int
        Where each of the posterior's coordinates is.
    """

    posterior: Posterior
    coordinates: Coordinates
    middle: Array
    scale: Array
    back: tuple[int, ...]

    def __call__(self, x: Array) -> Array:
        """Log likelihood of (n, D) coordinates, (n,); −inf out of the priors' support."""
        q = self.middle + self.scale * x
        d = len(self.coordinates.names)
        q[:, :d] = self.coordinates.to_own(q[:, :d])
        q = q[:, self.back]
        density = np.full(len(q), -np.inf)
        inside = np.all(np.abs(q) < ORDINARY, axis=1)  # of all priors, so they need not be asked
        beyond = ~inside & np.all(np.isfinite(q), axis=1)
        inside[beyond] = np.isfinite(self.posterior.log_prior_own(q[beyond]))
        if np.any(inside):
            own = self.posterior.from_own(q[inside])
            density[inside] = self.posterior.log_likelihood(own)
        return density


def likelihood_of(
    layout: Layout, posterior: Posterior, values: Mapping[str, Array]
) -> TestLikelihood:
    """What a calibrated test tells, from its stored draws by name, (S,) each.

    Of those of many tests fewer are held, evenly apart, so that all take no more than `ROOM`.
    """
    own = [name for name in posterior.names if name not in layout.names]
    order = [*layout.names, *own]
    back = [order.index(name) for name in posterior.names]
    d = len(layout.names)
    centre, spread = [*layout.centre], [*layout.spread]
    for name in own:
        prior = posterior.priors[name]
        drawn = prior.coordinate(prior.draw(np.random.default_rng(0), 4000))
        centre.append(float(drawn.mean()))
        spread.append(float(drawn.std()))
    middle, scale = np.array(centre), np.array(spread)

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
    mean, covariance = without_prior(draws)
    most = max(FEWEST, ROOM // (len(layout.settings) * draws.shape[1]))
    draws = draws[:: -(-len(draws) // most)].astype(np.float32)
    return TestLikelihood(
        LogLikelihood(posterior, layout.coordinates, middle, scale, tuple(back)),
        log_interim_prior,
        log_own_prior,
        draws,
        log_interim_prior(draws[:, :d].astype(np.float64)),
        mean,
        covariance,
    )


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
