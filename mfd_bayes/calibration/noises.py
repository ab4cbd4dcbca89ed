"""Models of the noise of a record."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

import numpy as np
import scipy
from numpy.typing import NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.friction.quantities import Quantity

Array = NDArray[np.float64]
Values = Mapping[str, Array]

LOG_2PI = float(np.log(2 * np.pi))
SD = Quantity("noise_sd", "force", "s", "standard deviation of the noise")
TIME = Quantity("noise_time", "time", r"\tau_c", "correlation time of the noise")
DOF = Quantity(
    "noise_dof", "dimensionless", r"\nu", "degrees of freedom of the noise", pooled=False
)
BUILD = Quantity("noise_build", "force", "s_b", "added noise where the force builds up")
FADE = Quantity("noise_fade", "displacement", r"\lambda", "slip over which the added noise fades")
BUILD_TIME = Quantity("noise_build_time", "time", r"\tau_b", "correlation time of the added noise")


class Noise:
    """Independent Gaussian noise, and the base of all others."""

    name: ClassVar[str] = "iid"  # in campaign files
    quantities: ClassVar[tuple[Quantity, ...]] = (SD,)  # in the order in which they are sampled
    needs_travel: ClassVar[bool] = False  # whether it depends on the travel since the last slip

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its parameters."""
        return tuple(quantity.name for quantity in self.quantities)

    def log_density(
        self, residual: Array, time: Array, values: Values, travel: Array | None = None
    ) -> Array:
        """Normalised log density of residuals (n, T), kip, at times (T,), s, (n,).

        `values` are the noise's parameters, (n,) each, with d2 and d3 where there is a gap;
        `travel` (n, T), in, is the one since the last slip, where it is needed.
        """
        decay, scale = self._steps(time, values, travel)
        scale0, scale1 = (scale, scale) if scale.shape[1] == 1 else (scale[:, :-1], scale[:, 1:])
        shrink = -np.expm1(-2.0 * decay)
        innovations = np.exp(-decay) * scale1 / scale0 * residual[:, :-1]
        np.subtract(residual[:, 1:], innovations, out=innovations)
        innovations /= scale1 * np.sqrt(shrink)
        initial = self._density(residual[:, :1] / scale[:, :1], values)
        total = initial + self._density(innovations, values)
        # one number may stand for all steps, or all samples
        total -= 0.5 * (time.size - 1) * np.log(shrink).mean(axis=1)
        return np.asarray(total - time.size * np.log(scale).mean(axis=1))

    def draw(
        self, rng: np.random.Generator, time: Array, values: Values, travel: Array | None = None
    ) -> Array:
        """Noise records, one for each of the n values, (n, T), kip; see `log_density`."""
        noise = self._innovations(rng, (time.size, values["noise_sd"].size), values)
        decay, scale = self.memory(time, values, travel)
        if np.isfinite(decay[:, 1:]).any():
            phi, shrink = np.exp(-decay.T), np.sqrt(-np.expm1(-2.0 * decay.T))
            for k in range(1, time.size):
                noise[k] = phi[k] * noise[k - 1] + shrink[k] * noise[k]
        return noise.T * scale

    def memory(
        self, time: Array, values: Values, travel: Array | None = None
    ) -> tuple[Array, Array]:
        """−log φ of the step to each sample (∞ at the first), and scale, kip, (n, T) each."""
        decay, scale = self._steps(time, values, travel)
        full = np.full((len(scale), time.size), np.inf)
        full[:, 1:] = decay
        return full, np.broadcast_to(scale, full.shape)

    def _steps(self, time: Array, values: Values, travel: Array | None) -> tuple[Array, Array]:
        """As `memory`, without the first sample; (n, 1) what is the same of all."""
        scale = values["noise_sd"][:, None]
        return np.full(scale.shape, np.inf), scale

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


class OU(Noise):
    """Stationary Ornstein–Uhlenbeck noise: AR(1), for irregular sampling too."""

    name: ClassVar[str] = "ou"
    quantities: ClassVar[tuple[Quantity, ...]] = (SD, TIME)

    def _steps(self, time: Array, values: Values, travel: Array | None) -> tuple[Array, Array]:
        steps = np.diff(time)
        if np.ptp(steps) <= 1e-6 * steps[0]:
            steps = steps[:1]
        return steps / values["noise_time"][:, None], values["noise_sd"][:, None]


class StudentT(OU):
    """AR(1) with Student-t innovations: noise_sd is their scale, robust to spikes."""

    name: ClassVar[str] = "student_t"
    quantities: ClassVar[tuple[Quantity, ...]] = (SD, TIME, DOF)

    def _density(self, standard: Array, values: Values) -> Array:
        dof = values["noise_dof"]
        peak = (
            scipy.special.gammaln((dof + 1) / 2)
            - scipy.special.gammaln(dof / 2)
            - 0.5 * np.log(dof * np.pi)
        )
        tails = np.log1p(standard**2 / dof[:, None]).sum(axis=1)
        density: Array = standard.shape[1] * peak - 0.5 * (dof + 1) * tails
        return density

    def _innovations(
        self, rng: np.random.Generator, shape: tuple[int, int], values: Values
    ) -> Array:
        dof = values["noise_dof"]
        return rng.standard_normal(shape) * np.sqrt(dof / rng.chisquare(dof, shape))


class Staged(OU):
    """Ornstein–Uhlenbeck noise of s + s_b h, with a weight h(u) of the travel since the last slip.

    h = clip((u − d2)/d3, 0, 1) exp(−(u − D)₊/λ): it grows from 0 at d2 to 1 at D = d2 + d3, and
    fades over λ in slip; without a gap it fades from each turn on. The rate of forgetting goes
    from 1/τ to 1/τ_b with h.
    """

    name: ClassVar[str] = "staged"
    quantities: ClassVar[tuple[Quantity, ...]] = (SD, TIME, BUILD, FADE, BUILD_TIME)
    needs_travel: ClassVar[bool] = True

    def _steps(self, time: Array, values: Values, travel: Array | None) -> tuple[Array, Array]:
        if travel is None:
            raise FitError("staged noise needs the travel since the last slip")
        column = {name: value[:, None] for name, value in values.items()}
        gap = "d3" in values
        weight = (column["d2"] + column["d3"] if gap else 0.0) - travel
        weight /= column["noise_fade"]
        np.exp(np.minimum(weight, 0.0, out=weight), out=weight)
        if gap:
            risen = (travel - column["d2"]) / np.maximum(column["d3"], 1e-12)
            weight *= np.clip(risen, 0.0, 1.0, out=risen)
        slow = 1.0 / column["noise_time"]
        rate = slow + (1.0 / column["noise_build_time"] - slow) * weight[:, 1:]
        scale = column["noise_sd"] + column["noise_build"] * weight
        return np.diff(time) * rate, scale


# every noise by its name in campaign files
NOISES: Mapping[str, Noise] = MappingProxyType(
    {noise.name: noise for noise in (OU(), Noise(), StudentT(), Staged())}
)


def find_noise(name: str) -> Noise:
    """Noise of that name, or a FitError that lists the names that there are."""
    if not isinstance(name, str) or name not in NOISES:
        raise FitError(f"unknown noise {name!r}: expected one of {', '.join(NOISES)}")
    return NOISES[name]
