"""The likelihood of a test that the population works with.

Samples are taken as independent with the shape of the noise and the discrepancy that all tests
have in common, so that no test can hide a bias in slowly varying noise; its logarithm is
multiplied by the share of independent samples in a record, so that intervals are not too narrow
(magnitude adjustment: Pauli, Racugno and Ventura, 2011; Ribatet, Cooley and Davison, 2012).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.noise import LOG_2PI
from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.calibration.prior_table import PriorTable
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.swing import Swing, swing_of

Array = NDArray[np.float64]

ORDINARY = 20.0
"""Coordinates nearer to 0 than this have a finite prior density under every prior."""


@dataclass(frozen=True, eq=False)
class WorkingLikelihood:
    """Log likelihood of one test in prior units; a process can be sent it.

    Attributes
    ----------
    posterior : Posterior
        Of the test, with independent noise.
    layout : Layout
    middle, scale : (D,)
        Origin and length of the prior units: the d shared quantities, the test's own, and the
        shapes of its swing.
    order : tuple of int
        Column of each of the posterior's coordinates.
    discrepancy : (T,), kip
    shape : (T,)
        Of the noise's standard deviation.
    information : float
        Share of independent samples.
    swing : Swing, optional
        Where the actuation changes and its law is not strictly proportional.
    """

    posterior: Posterior
    layout: Layout
    middle: Array
    scale: Array
    order: tuple[int, ...]
    discrepancy: Array
    shape: Array
    information: float = 1.0
    swing: Swing | None = None

    @cached_property
    def own(self) -> tuple[str, ...]:
        """Quantities of the test alone."""
        return tuple(name for name in self.posterior.names if name not in self.layout.names)

    @cached_property
    def _own_priors(self) -> PriorTable:
        """Priors of the quantities of the test alone."""
        return PriorTable([self.posterior.priors[name] for name in self.own])

    @property
    def kept(self) -> slice:
        """Samples that count."""
        return slice(self.posterior.first, None)

    def points(self, x: Array) -> Array:
        """The posterior's coordinates of (n, D) coordinates, (n, D)."""
        q = self.middle + self.scale * x
        d = len(self.layout.names)
        q[:, :d] = self.layout.coordinates.to_own(q[:, :d])
        return self.posterior.from_own(q[:, self.order])

    def residual(self, x: Array) -> Array:
        """What model and discrepancy leave over, (n, T), kip."""
        left = self.posterior.residual(self.points(x), self.scales(x))
        return np.asarray(left - self.discrepancy)

    def scales(self, x: Array) -> dict[str, Array] | None:
        """Factors along the record of what follows a changing actuation, (n, T) each."""
        if self.swing is None:
            return None
        return self.swing.scales(self._shapes(x[:, len(self.order) :]))

    def _shapes(self, x: Array) -> Array:
        """Coordinates of the swing's shapes, (n, K), from prior units."""
        k = len(self.order)
        return np.asarray(self.middle[k:] + self.scale[k:] * x)

    def noise_sd(self, x: Array) -> Array:
        """Standard deviation of the noise, (n,), kip."""
        k = self.layout.names.index("noise_sd")
        prior = self.posterior.priors["noise_sd"]
        return prior.value(self.middle[k] + self.scale[k] * x[:, k])

    def log_own_prior(self, own: Array) -> Array:
        """Log prior density of the test's own coordinates, (n, D − d) -> (n,)."""
        d, k = len(self.layout.names), len(self.own)
        q = self.middle[d : d + k] + self.scale[d : d + k] * own[:, :k]
        total = self._own_priors.log_density(q)
        if self.swing is not None:
            total += self.swing.log_prior(self._shapes(own[:, k:]))
        return total

    def __call__(self, x: Array) -> Array:
        """Log likelihood of (n, D) coordinates, (n,); −inf outside the support of the priors."""
        density = np.full(len(x), -np.inf)
        inside = self._inside(x)
        if np.any(inside):
            with np.errstate(over="ignore", invalid="ignore"):
                found = self._log_density(x[inside])
            density[inside] = np.where(np.isnan(found), -np.inf, found)
        return density

    def _inside(self, x: Array) -> NDArray[np.bool_]:
        """Whether the priors allow the coordinates; they are asked only where in doubt."""
        q = self.middle + self.scale * x
        inside: NDArray[np.bool_] = np.all(np.abs(q) < ORDINARY, axis=1)
        beyond = ~inside & np.all(np.isfinite(q), axis=1)
        if np.any(beyond):
            d = len(self.layout.names)
            own = q[beyond]
            own[:, :d] = self.layout.coordinates.to_own(own[:, :d])
            density = self.posterior.log_prior_own(own[:, self.order])
            inside[beyond] = np.isfinite(density)
        return inside

    def _log_density(self, x: Array) -> Array:
        standard = self.standard(x)
        return self.by_squares(x, np.einsum("nt,nt->n", standard, standard))

    def standard(self, x: Array) -> Array:
        """What model and discrepancy leave of the samples that count, over their shape, (n, T)."""
        return np.asarray(self.residual(x)[:, self.kept] / self.shape[self.kept])

    def by_squares(self, x: Array, squares: Array) -> Array:
        """Log likelihood of (n, D) coordinates where `standard` has these sums of squares, (n,)."""
        sd = self.noise_sd(x)
        log_scale = self._samples * (np.log(sd) + 0.5 * LOG_2PI) + self._log_shape
        return np.asarray(-self.information * (0.5 * squares / sd**2 + log_scale))

    @cached_property
    def _samples(self) -> int:
        """Number of samples that count."""
        return self.shape[self.kept].size

    @cached_property
    def _log_shape(self) -> float:
        """Sum of the logarithms of the shape at the samples that count."""
        return float(np.log(self.shape[self.kept]).sum())


def working_likelihood(
    layout: Layout, posterior: Posterior, priors: PriorFile
) -> WorkingLikelihood:
    """Working likelihood of a calibrated test, without discrepancy and with even noise so far."""
    start = "mask" if posterior.first else "sample"
    plain = Posterior(posterior.trace, priors, "iid", posterior.model, start=start)
    own = [name for name in plain.names if name not in layout.names]
    units = [_prior_units(plain, name) for name in own]
    order = [*layout.names, *own]
    samples = plain.trace.samples
    swing = swing_of(layout, plain.model, plain.trace)
    units += [] if swing is None else list(zip(*swing.units, strict=True))
    return WorkingLikelihood(
        posterior=plain,
        layout=layout,
        middle=np.array([*layout.centre, *(centre for centre, _ in units)]),
        scale=np.array([*layout.spread, *(spread for _, spread in units)]),
        swing=swing,
        order=tuple(order.index(name) for name in plain.names),
        discrepancy=np.zeros(samples),
        shape=np.ones(samples),
    )


def _prior_units(posterior: Posterior, name: str) -> tuple[float, float]:
    """Mean and sd of a quantity's coordinate under its prior."""
    prior = posterior.priors[name]
    drawn = prior.coordinate(prior.draw(np.random.default_rng(0), 4000))
    return float(drawn.mean()), float(drawn.std())
