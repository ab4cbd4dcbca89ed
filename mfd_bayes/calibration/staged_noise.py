"""Noise that is larger, and forgets faster, where the force builds up and after it."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.noise import LOG_2PI, OU, SD, TIME, Values, correlate, steps_of
from mfd_bayes.errors import FitError
from mfd_bayes.friction.quantity import Quantity

Array = NDArray[np.float64]

PIECE = 1 << 15
"""Numbers per array that are worked on together, so that a piece's arrays stay in the cache."""

_QUANTITIES = (
    Quantity(
        *("noise_build", "force", "s_b", "s<sub>b</sub>"),
        "added noise where the force builds up",
    ),
    Quantity(
        "noise_fade", "displacement", r"\lambda", "λ", "slip over which the added noise fades"
    ),
    Quantity(
        *("noise_build_time", "time", r"\tau_b", "τ<sub>b</sub>"),
        "correlation time of the added noise",
    ),
)


class Staged(OU):
    """Ornstein–Uhlenbeck noise of s + s_b h, with a weight h(u) of the travel since the last slip.

    h grows from 0 at d2 to 1 at D = d2 + d3, and fades over λ in slip; without a gap it fades
    from each turn on. The rate of forgetting goes from 1/τ to 1/τ_b with h.
    """

    name: ClassVar[str] = "staged"
    quantities: ClassVar[tuple[Quantity, ...]] = (SD, TIME, *_QUANTITIES)
    needs_travel: ClassVar[bool] = True

    def log_density(
        self, residual: Array, time: Array, values: Values, travel: Array | None = None
    ) -> Array:
        """Normalised log density of residuals, (n,); see `Noise.log_density`.

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
        total -= time.size * (np.log(sd) + 0.5 * LOG_2PI)
        return total

    def memory(
        self, time: Array, values: Values, travel: Array | None = None
    ) -> tuple[Array, Array]:
        """How much each sample depends on the one before, and its scale; see `Noise.memory`."""
        weight = _weight(values, travel)
        decay, scale = super().memory(time, values)
        scale = scale + values["noise_build"][:, None] * weight
        rate = 1.0 / values["noise_time"][:, None]
        rate = rate + (1.0 / values["noise_build_time"][:, None] - rate) * weight[:, 1:]
        decay[:, 1:] = rate * np.diff(time)
        return decay, scale

    def _correlate(self, noise: Array, time: Array, values: Values, travel: Array | None) -> None:
        weight = _weight(values, travel)
        slow = 1.0 / values["noise_time"][:, None]
        fast = 1.0 / values["noise_build_time"][:, None]
        ratio = (slow + (fast - slow) * weight[:, 1:]) * steps_of(time)
        correlate(noise, np.exp(-ratio), -np.expm1(-2.0 * ratio))
        noise *= 1.0 + values["noise_build"] / values["noise_sd"] * weight.T


def _weight(values: Values, travel: Array | None) -> Array:
    """Weight h at each sample, (n, T)."""
    if travel is None:
        raise FitError("staged noise needs the travel since the last slip")
    weight = np.empty(travel.shape[::-1])
    _weigh(values, travel.T, out=weight, work=np.empty(weight.shape))
    return weight.T


def _weigh(values: Values, travel: Array, out: Array, work: Array) -> None:
    """Weight h = clip((u − d2)/d3, 0, 1) exp(−(u − D)₊/λ) of travels u, time first, (T, n).

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


def _log_product(factors: Array) -> Array:
    """Sum of the logarithms of factors (T, n), (n,); eight of them at a time, overwritten."""
    for _ in range(3):
        half = len(factors) // 2
        if 2 * half != len(factors):
            break
        factors = np.multiply(factors[:half], factors[half:], out=factors[:half])
    return np.asarray(np.log(factors).sum(axis=0))
