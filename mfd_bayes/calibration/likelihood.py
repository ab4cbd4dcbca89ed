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

PIECE = 1 << 15
"""Numbers per array that are worked on together, so that a piece's arrays stay in the cache."""


@dataclass(frozen=True)
class Noise:
    """A noise model.

    Attributes
    ----------
    name : str
    parameters : tuple of str
        Those among noise_sd (kip), noise_time (s), noise_dof (1), noise_build (kip),
        noise_fade (in) and noise_build_time (s) that it has.
    """

    name: str
    parameters: tuple[str, ...]

    @property
    def staged(self) -> bool:
        """Whether the noise depends on the travel since the last slip."""
        return "noise_build" in self.parameters

    def log_density(
        self,
        residual: Array,
        time: Array,
        values: Mapping[str, Array],
        travel: Array | None = None,
    ) -> Array:
        """Normalised log density of residuals.

        Parameters
        ----------
        residual : (n, T), kip
        time : (T,), s
        values : mapping of str to (n,)
            The noise parameters, and d2 and d3 where there is a gap.
        travel : (n, T), in, optional
            Travel since the last slip; needed by staged noise.

        Returns
        -------
        (n,)
        """
        if self.staged:
            return _staged_density(residual, time, values, travel)
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

    def draw(
        self,
        rng: np.random.Generator,
        time: Array,
        values: Mapping[str, Array],
        travel: Array | None = None,
    ) -> Array:
        """Noise records, one for each of the n values, (n, T), kip; see `log_density`."""
        n = values["noise_sd"].size
        noise = rng.standard_normal((time.size, n))
        if "noise_dof" in self.parameters:
            dof = values["noise_dof"]
            noise *= np.sqrt(dof / rng.chisquare(dof, (time.size, n)))
        if "noise_time" in self.parameters:
            weight = _build_up(values, travel) if self.staged else None
            if weight is None:
                phi, shrink = self._correlation(time, values)
            else:
                phi, shrink = _staged_correlation(time, values, weight)
            phi, shrink = (np.broadcast_to(a.T, (time.size - 1, n)) for a in (phi, shrink))
            noise[1:] *= np.sqrt(shrink)
            for k in range(1, time.size):
                noise[k] += phi[k - 1] * noise[k - 1]
            if weight is not None:
                noise *= 1.0 + values["noise_build"] / values["noise_sd"] * weight.T
        noise *= values["noise_sd"]
        return noise.T

    def _correlation(self, time: Array, values: Mapping[str, Array]) -> tuple[Array, Array]:
        """φ of neighbours, and 1 − φ²: (n, T − 1), or (n, 1) where sampling is uniform."""
        if "noise_time" not in self.parameters:
            n = values["noise_sd"].size
            return np.zeros((n, 1)), np.ones((n, 1))
        ratio = _steps(time) / values["noise_time"][:, None]
        return np.exp(-ratio), -np.expm1(-2.0 * ratio)


def _steps(time: Array) -> Array:
    """Steps in time, (T − 1,), or the one step of uniform sampling, (1,)."""
    steps = np.diff(time)
    return steps[:1] if np.ptp(steps) <= 1e-6 * steps[0] else steps


def _build_up(values: Mapping[str, Array], travel: Array | None) -> Array:
    """Weight h of the build-up at each sample, (n, T): from 0 at d2 to 1 at D, then fading."""
    if travel is None:
        raise FitError("staged noise needs the travel since the last slip")
    weight = np.empty(travel.shape[::-1])
    _weigh(values, travel.T, out=weight, work=np.empty(weight.shape))
    return weight.T


def _weigh(values: Mapping[str, Array], travel: Array, out: Array, work: Array) -> None:
    """H = clip((u − d2)/d3, 0, 1) exp(−(u − D)₊/λ) of travels u with time first, (T, n).

    Without a gap, h = exp(−u/λ) from the turn on.
    """
    gap = "d3" in values
    width = values["d2"] + values["d3"] if gap else np.zeros(travel.shape[1])
    np.subtract(width, travel, out=out)
    out /= values["noise_fade"]
    np.exp(np.minimum(out, 0.0, out=out), out=out)
    if gap:
        np.subtract(travel, values["d2"], out=work)
        work /= np.maximum(values["d3"], 1e-12)
        out *= np.clip(work, 0.0, 1.0, out=work)


def _staged_correlation(
    time: Array, values: Mapping[str, Array], weight: Array
) -> tuple[Array, Array]:
    """φ of neighbours, and 1 − φ², (n, T − 1): the rate of forgetting follows the weight."""
    slow = 1.0 / values["noise_time"][:, None]
    fast = 1.0 / values["noise_build_time"][:, None]
    ratio = (slow + (fast - slow) * weight[:, 1:]) * _steps(time)
    return np.exp(-ratio), -np.expm1(-2.0 * ratio)


def _staged_density(
    residual: Array, time: Array, values: Mapping[str, Array], travel: Array | None
) -> Array:
    """Log density where s(t) = s + s_b h(t) and the correlation time follows h too, (n,).

    Time comes first inside, in pieces that stay in the cache.
    """
    if travel is None:
        raise FitError("staged noise needs the travel since the last slip")
    r, u = residual.T, travel.T
    n = r.shape[1]
    steps = np.diff(time, prepend=np.nan)[:, None]
    slow = 1.0 / values["noise_time"]
    faster = 1.0 / values["noise_build_time"] - slow
    squares, log_scale = np.zeros(n), np.zeros(n)
    before = np.zeros(n)
    length = max(PIECE // n // 8, 1) * 8
    room = np.empty((4, length, n))
    for begin in range(0, time.size, length):
        rows = slice(begin, begin + length)
        weight, work, phi, shrink = room[:, : len(r[rows])]
        _weigh(values, u[rows], out=weight, work=work)
        # φ = exp(−Δt [1/τ + h (1/τ_b − 1/τ)])
        np.multiply(weight, faster, out=phi)
        phi += slow
        phi *= -steps[rows]
        np.exp(phi, out=phi)
        if begin == 0:
            phi[0] = 0.0  # the first sample remembers nothing
        np.subtract(1.0, phi, out=shrink)
        np.add(phi, 1.0, out=work)
        shrink *= work
        weight *= values["noise_build"] / values["noise_sd"]
        weight += 1.0
        standard = np.divide(r[rows], weight, out=work)
        phi[1:] *= standard[:-1]
        phi[0] *= before
        before = standard[-1].copy()
        np.subtract(standard, phi, out=phi)
        phi *= phi
        phi /= shrink
        squares += phi.sum(axis=0)
        # log of s² (1 − φ²) without s
        weight *= weight
        weight *= shrink
        log_scale += _log_product(weight)
    sd = values["noise_sd"]
    total: Array = -0.5 * (squares / sd**2 + log_scale)
    total -= time.size * (np.log(sd) + 0.5 * _LOG_2PI)
    return total


def _log_product(factors: Array) -> Array:
    """Sum of the logarithms of factors (T, n), (n,); eight of them at a time, overwritten."""
    for _ in range(3):
        half = len(factors) // 2
        if 2 * half != len(factors):
            break
        factors = np.multiply(factors[:half], factors[half:], out=factors[:half])
    return np.asarray(np.log(factors).sum(axis=0))


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
        # OU that is larger, and forgets faster, where the force builds up and after it
        Noise(
            "staged",
            ("noise_sd", "noise_time", "noise_build", "noise_fade", "noise_build_time"),
        ),
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


def memory(
    noise: Noise, time: Array, values: Mapping[str, Array], travel: Array | None = None
) -> tuple[Array, Array]:
    """What each sample keeps of the one before, and the scale of each; see `log_density`.

    Returns
    -------
    decay : (n, T)
        −log φ of the step to each sample; ∞, φ = 0, at the first, and of noise without memory.
    scale : (n, T), kip
        Marginal standard deviation; with Student-t innovations a scale.
    """
    shape = values["noise_sd"].size, time.size
    decay = np.full(shape, np.inf)
    scale = np.broadcast_to(values["noise_sd"][:, None], shape)
    if "noise_time" not in noise.parameters:
        return decay, scale
    rate = 1.0 / values["noise_time"][:, None]
    if noise.staged:
        weight = _build_up(values, travel)
        scale = scale + values["noise_build"][:, None] * weight
        rate = rate + (1.0 / values["noise_build_time"][:, None] - rate) * weight[:, 1:]
    decay[:, 1:] = rate * np.diff(time)
    return decay, scale
