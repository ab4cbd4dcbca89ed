"""The spring of the backlash model: two stiff sides with a rounded gap between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isfinite

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_INVERSIONS = 60

LEAST = -690.0
"""Exponent of e below which a number loses digits."""


@dataclass(frozen=True, eq=False)
class Spring:
    """Spring of n vectors, (n,) each (model.md section 9).

    G(z) = k_f ℓ ln(1 + e^((z − D/2)/ℓ)) − k_b ℓ ln(1 + e^(−(z + D/2)/ℓ)) + k_0 z
    """

    k_fwd: Array
    k_bwd: Array
    gap: Array
    ell: Array
    k_0: Array

    @cached_property
    def _constants(self) -> tuple[Array, ...]:
        scale = 1.0 / self.ell
        return (
            scale,
            0.5 * self.gap * scale,
            np.exp(-self.gap * scale),
            self.k_fwd * self.ell,
            self.k_bwd * self.ell,
            self.k_fwd + self.k_bwd + self.k_0,
        )

    def of(self, columns: NDArray[np.intp]) -> Spring:
        """Spring of some of the vectors, by their number; one may come several times."""
        parts = (self.k_fwd, self.k_bwd, self.gap, self.ell, self.k_0)
        return Spring(*(part[columns] for part in parts))

    def force(self, z: Array) -> Array:
        """Force G(z), (..., n), kip."""
        return self.evaluate(z)[0]

    def evaluate(self, z: Array, room: list[Array] | None = None) -> tuple[Array, Array]:
        """Force G, kip, and stiffness dG/dz, kip/in, at deflections z, (..., n), in.

        With `room`, four arrays of z's shape, they are the first two of those.
        """
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            force, slope, least = self._plain(z, room or [np.empty(z.shape) for _ in range(4)])
        if not (least > LEAST and isfinite(np.add.reduce(force, axis=None))):
            steep = self._where_steep(z, force)
            force[..., steep], slope[..., steep] = self.of(steep)._steep(z[..., steep])
        return force, slope

    def _where_steep(self, z: Array, force: Array) -> NDArray[np.intp]:
        """Vectors for which `_plain` is not exact, by their numbers."""
        scale, half = self._constants[:2]
        least = z.reshape(-1, z.shape[-1]).min(axis=0) * scale - half
        with np.errstate(invalid="ignore"):  # ∞ − ∞
            total = np.add.reduce(force.reshape(-1, force.shape[-1]), axis=0)
        return np.flatnonzero(~(np.isfinite(total) & (least > LEAST)))

    def _plain(self, z: Array, room: list[Array]) -> tuple[Array, Array, float]:
        """As `evaluate`, by one exponential, and the smallest exponent.

        It is exact if that exponent is above `LEAST` and all forces are finite.
        """
        scale, half, ratio, fwd, bwd, steepest = self._constants
        force, a, b, work = room
        np.multiply(z, scale, out=a)
        a -= half
        least = float(np.minimum.reduce(a, axis=None, initial=0.0))
        np.exp(a, out=a)
        np.divide(ratio, a, out=b)
        a += 1.0
        b += 1.0
        np.log(a, out=force)
        force *= fwd
        np.log(b, out=work)
        work *= bwd
        force -= work
        force += np.multiply(self.k_0, z, out=work)
        np.divide(self.k_fwd, a, out=a)
        np.divide(self.k_bwd, b, out=b)
        a += b
        return force, np.subtract(steepest, a, out=a), least

    def _steep(self, z: Array) -> tuple[Array, Array]:
        """As `evaluate`, where exponents of e are too large for a number."""
        fwd, fwd_slope = _softplus((z - 0.5 * self.gap) / self.ell)
        bwd, bwd_slope = _softplus((z + 0.5 * self.gap) / -self.ell)
        force = self.ell * (self.k_fwd * fwd - self.k_bwd * bwd) + self.k_0 * z
        return force, self.k_fwd * fwd_slope + self.k_bwd * bwd_slope + self.k_0

    def deflection(self, force: Array, close: float = 1e-13) -> Array:
        """Deflection at which the force is G, (..., n): the inverse of `force`.

        Bisection between bounds, with Newton's step wherever it stays inside them, until a step
        is below `close` times ℓ + |z|.
        """
        softest = np.minimum(self.k_fwd, self.k_bwd)
        uneven = np.log1p(np.maximum(self.k_fwd, self.k_bwd) / softest)
        high = 0.5 * self.gap + self.ell * (2.0 + uneven) + np.abs(force) / softest
        low = -high
        stiff = np.where(force > 0, self.k_fwd, self.k_bwd)
        z = np.sign(force) * np.minimum(0.5 * self.gap + np.abs(force) / stiff, high)
        for _ in range(_INVERSIONS):
            found, slope = self.evaluate(z)
            error = found - force
            step = error / np.maximum(slope, 1e-300)
            if np.all(np.abs(step) <= close * (self.ell + np.abs(z))):
                return z - step
            low, high = np.where(error < 0, z, low), np.where(error > 0, z, high)
            new = z - step
            z = np.where((new >= low) & (new <= high), new, 0.5 * (low + high))
        return z


def _softplus(a: Array) -> tuple[Array, Array]:
    """ln(1 + e^a) and its slope, of any a."""
    e = np.exp(-np.abs(a))
    return np.maximum(a, 0.0) + np.log1p(e), np.where(a > 0, 1.0, e) / (1.0 + e)
