"""Noises: the density of what the force model leaves over, and draws of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.friction.quantity import Quantity

Array = NDArray[np.float64]
Values = Mapping[str, Array]

LOG_2PI = float(np.log(2 * np.pi))

SD = Quantity("noise_sd", "force", "s", "s", "standard deviation of the noise")
TIME = Quantity("noise_time", "time", r"\tau_c", "τ<sub>c</sub>", "correlation time of the noise")
DOF = Quantity(
    *("noise_dof", "dimensionless", r"\nu", "ν", "degrees of freedom of the noise"),
    pooled=False,
)


class Noise:
    """Independent Gaussian noise, and the base of all others.

    Attributes
    ----------
    name : str
        In campaign files.
    quantities : tuple of Quantity
        Its parameters, in the order in which they are sampled.
    needs_travel : bool
        Whether it depends on the travel since the last slip.
    """

    name: ClassVar[str] = "iid"
    quantities: ClassVar[tuple[Quantity, ...]] = (SD,)
    needs_travel: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its parameters."""
        return tuple(quantity.name for quantity in self.quantities)

    def log_density(
        self, residual: Array, time: Array, values: Values, travel: Array | None = None
    ) -> Array:
        """Normalised log density of residuals.

        Parameters
        ----------
        residual : (n, T), kip
        time : (T,), s
        values : mapping of str to (n,)
            The noise's parameters, and d2 and d3 where there is a gap.
        travel : (n, T), in, optional
            Travel since the last slip, for a noise that needs it.

        Returns
        -------
        (n,)
        """
        phi, shrink = self._correlation(time, values)
        scale = values["noise_sd"][:, None]
        standard = phi * residual[:, :-1]
        np.subtract(residual[:, 1:], standard, out=standard)
        standard /= scale * np.sqrt(shrink)
        total = self._density(residual[:, :1] / scale, values) + self._density(standard, values)
        total -= self._log_scale(shrink, time, values)
        return total

    def _log_scale(self, shrink: Array, time: Array, values: Values) -> Array:
        """Sum over the samples of the log scales of their innovations, (n,)."""
        repeats = (time.size - 1) // shrink.shape[1]  # one φ stands for all uniform steps
        steps: Array = 0.5 * repeats * np.log(shrink).sum(axis=1)
        return time.size * np.log(values["noise_sd"]) + steps

    def largest(self, time: Array, values: Values) -> Array:
        """Largest log density that any residuals have, (n,); ∞ where it depends on the travel."""
        n = values["noise_sd"].size
        if self.needs_travel:
            return np.full(n, np.inf)
        shrink = self._correlation(time, values)[1]
        nothing = self._density(np.zeros((n, 1)), values)
        return time.size * nothing - self._log_scale(shrink, time, values)

    def draw(
        self,
        rng: np.random.Generator,
        time: Array,
        values: Values,
        travel: Array | None = None,
    ) -> Array:
        """Noise records, one for each of the n values, (n, T), kip; see `log_density`."""
        noise = self._innovations(rng, (time.size, values["noise_sd"].size), values)
        self._correlate(noise, time, values, travel)
        noise *= values["noise_sd"]
        return noise.T

    def memory(
        self, time: Array, values: Values, travel: Array | None = None
    ) -> tuple[Array, Array]:
        """How much each sample depends on the one before, and its scale; see `log_density`.

        Returns
        -------
        decay : (n, T)
            −log φ of the step to each sample; ∞, φ = 0, at the first, and for independent noise.
        scale : (n, T), kip
            Marginal standard deviation; with Student-t innovations their scale.
        """
        shape = values["noise_sd"].size, time.size
        return np.full(shape, np.inf), np.broadcast_to(values["noise_sd"][:, None], shape)

    def _correlation(self, time: Array, values: Values) -> tuple[Array, Array]:
        """φ of neighbours, and 1 − φ²: (n, T − 1), or (n, 1) where all are alike."""
        n = values["noise_sd"].size
        return np.zeros((n, 1)), np.ones((n, 1))

    def _density(self, standard: Array, values: Values) -> Array:
        """Log density of standardised innovations (n, m), (n,)."""
        squares = np.einsum("nt,nt->n", standard, standard)
        density: Array = -0.5 * squares - 0.5 * LOG_2PI * standard.shape[1]
        return density

    def _innovations(
        self, rng: np.random.Generator, shape: tuple[int, int], values: Values
    ) -> Array:
        """Draws of standardised innovations, (T, n)."""
        return rng.standard_normal(shape)

    def _correlate(self, noise: Array, time: Array, values: Values, travel: Array | None) -> None:
        """Turn innovations (T, n) into noise of standard deviation 1, in place."""


class OU(Noise):
    """Stationary Ornstein–Uhlenbeck noise: AR(1), for irregular sampling too."""

    name: ClassVar[str] = "ou"
    quantities: ClassVar[tuple[Quantity, ...]] = (SD, TIME)

    def memory(
        self, time: Array, values: Values, travel: Array | None = None
    ) -> tuple[Array, Array]:
        """How much each sample depends on the one before, and its scale; see `Noise.memory`."""
        decay, scale = super().memory(time, values)
        decay[:, 1:] = 1.0 / values["noise_time"][:, None] * np.diff(time)
        return decay, scale

    def _correlation(self, time: Array, values: Values) -> tuple[Array, Array]:
        ratio = steps_of(time) / values["noise_time"][:, None]
        return np.exp(-ratio), -np.expm1(-2.0 * ratio)

    def _correlate(self, noise: Array, time: Array, values: Values, travel: Array | None) -> None:
        correlate(noise, *self._correlation(time, values))


class StudentT(OU):
    """AR(1) with Student-t innovations: noise_sd is their scale, robust to spikes."""

    name: ClassVar[str] = "student_t"
    quantities: ClassVar[tuple[Quantity, ...]] = (SD, TIME, DOF)

    def _density(self, standard: Array, values: Values) -> Array:
        dof = values["noise_dof"]
        peak = special.gammaln((dof + 1) / 2) - special.gammaln(dof / 2) - 0.5 * np.log(dof * np.pi)
        tails = np.log1p(standard**2 / dof[:, None]).sum(axis=1)
        density: Array = standard.shape[1] * peak - 0.5 * (dof + 1) * tails
        return density

    def _innovations(
        self, rng: np.random.Generator, shape: tuple[int, int], values: Values
    ) -> Array:
        dof = values["noise_dof"]
        noise = rng.standard_normal(shape)
        noise *= np.sqrt(dof / rng.chisquare(dof, shape))
        return noise


def steps_of(time: Array) -> Array:
    """Steps in time, (T − 1,), or the one step of uniform sampling, (1,)."""
    steps = np.diff(time)
    return steps[:1] if np.ptp(steps) <= 1e-6 * steps[0] else steps


def correlate(noise: Array, phi: Array, shrink: Array) -> None:
    """Make AR(1) noise of its innovations (T, n), in place; φ and 1 − φ² as (n, T − 1)."""
    samples, n = noise.shape
    phi, shrink = (np.broadcast_to(a.T, (samples - 1, n)) for a in (phi, shrink))
    noise[1:] *= np.sqrt(shrink)
    for k in range(1, samples):
        noise[k] += phi[k - 1] * noise[k - 1]
