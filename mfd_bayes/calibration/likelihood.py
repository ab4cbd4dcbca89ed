"""Noise models: the density of what the force model leaves over, and draws from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.errors import FitError

Array = NDArray[np.float64]

_LOG_2PI = float(np.log(2 * np.pi))


@dataclass(frozen=True)
class Noise:
    """A noise model.

    Attributes
    ----------
    name : str
    parameters : tuple of str
        Those among noise_sd (kip), noise_time (s) and noise_dof (1) that it has.
    """

    name: str
    parameters: tuple[str, ...]

    def log_density(self, residual: Array, time: Array, values: Mapping[str, Array]) -> Array:
        """Normalised log density of residuals.

        Parameters
        ----------
        residual : (n, T), kip
        time : (T,), s
        values : mapping of str to (n,)
            The noise parameters.

        Returns
        -------
        (n,)
        """
        phi, shrink = self._correlation(time, values)
        innovation = residual[:, 1:] - phi * residual[:, :-1]
        scale = values["noise_sd"][:, None]
        standard = innovation / (scale * np.sqrt(shrink))
        first = residual[:, :1] / scale
        log_scale = residual.shape[1] * np.log(scale[:, 0])
        repeats = (time.size - 1) // shrink.shape[1]  # one φ stands for all uniform steps
        log_scale += 0.5 * repeats * np.log(shrink).sum(axis=1)
        density = _DENSITIES["student_t" if "noise_dof" in values else "normal"]
        total: Array = density(first, values) + density(standard, values) - log_scale
        return total

    def draw(self, rng: np.random.Generator, time: Array, values: Mapping[str, Array]) -> Array:
        """Noise records, one for each of the n values, (n, T), kip."""
        n = values["noise_sd"].size
        noise = rng.standard_normal((time.size, n))
        if "noise_dof" in values:
            dof = values["noise_dof"]
            noise *= np.sqrt(dof / rng.chisquare(dof, (time.size, n)))
        noise *= values["noise_sd"]
        if "noise_time" in values:
            both = self._correlation(time, values)
            phi, shrink = (np.broadcast_to(a.T, (time.size - 1, n)) for a in both)
            noise[1:] *= np.sqrt(shrink)
            for k in range(1, time.size):
                noise[k] += phi[k - 1] * noise[k - 1]
        return noise.T

    def _correlation(self, time: Array, values: Mapping[str, Array]) -> tuple[Array, Array]:
        """φ of neighbours, and 1 − φ²: (n, T − 1), or (n, 1) where sampling is uniform."""
        if "noise_time" not in self.parameters:
            n = values["noise_sd"].size
            return np.zeros((n, 1)), np.ones((n, 1))
        steps = np.diff(time)
        if np.ptp(steps) <= 1e-6 * steps[0]:
            steps = steps[:1]
        ratio = steps / values["noise_time"][:, None]
        return np.exp(-ratio), -np.expm1(-2.0 * ratio)


def _normal(standard: Array, _: Mapping[str, Array]) -> Array:
    squares = np.einsum("nt,nt->n", standard, standard)
    density: Array = -0.5 * squares - 0.5 * _LOG_2PI * standard.shape[1]
    return density


def _student_t(standard: Array, values: Mapping[str, Array]) -> Array:
    dof = values["noise_dof"]
    peak = special.gammaln((dof + 1) / 2) - special.gammaln(dof / 2) - 0.5 * np.log(dof * np.pi)
    tails = np.log1p(standard**2 / dof[:, None]).sum(axis=1)
    density: Array = standard.shape[1] * peak - 0.5 * (dof + 1) * tails
    return density


_DENSITIES: dict[str, Callable[[Array, Mapping[str, Array]], Array]] = {
    "normal": _normal,
    "student_t": _student_t,
}

NOISES = {
    noise.name: noise
    for noise in (
        # stationary Ornstein–Uhlenbeck: AR(1) for irregular sampling too
        Noise("ou", ("noise_sd", "noise_time")),
        Noise("iid", ("noise_sd",)),
        # AR(1) with Student-t innovations; noise_sd is then a scale, robust to spikes
        Noise("student_t", ("noise_sd", "noise_time", "noise_dof")),
    )
}


def find_noise(name: str) -> Noise:
    """Noise model of that name.

    Raises
    ------
    FitError
        When there is none; the names that there are are listed.
    """
    if name not in NOISES:
        raise FitError(f"unknown noise {name!r}: expected one of {', '.join(NOISES)}")
    return NOISES[name]
