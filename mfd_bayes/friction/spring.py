"""The spring of the backlash model: two stiff sides with a rounded gap between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

INVERSIONS = 60
"""Most steps of the inverse."""

FEW = 4
"""Most steps of a first guess."""

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
        ends = self.k_fwd * self.ell, self.k_bwd * self.ell
        steepest = self.k_fwd + self.k_bwd + self.k_0
        return scale, 0.5 * self.gap * scale, np.exp(-self.gap * scale), *ends, steepest

    def of(self, rows: NDArray[np.intp]) -> Spring:
        """Spring of some of the vectors, by their number; one may come several times."""
        parts = (self.k_fwd, self.k_bwd, self.gap, self.ell, self.k_0)
        return Spring(*(part[rows] for part in parts))

    def evaluate(self, z: Array, room: list[Array] | None = None) -> tuple[Array, Array]:
        """Force G, kip, and stiffness dG/dz, kip/in, at deflections z, (..., n), in.

        With `room`, four arrays of z's shape, they are the first two of those.
        """
        force, a, b, work = room or [np.empty(z.shape) for _ in range(4)]
        scale, half, ratio, fwd, bwd, steepest = self._constants
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            np.multiply(z, scale, out=a)
            a -= half
            least = a.min(initial=0.0)
            np.exp(a, out=a)  # one exponential serves both sides
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
            np.subtract(steepest, a, out=a)
            if not (least > LEAST and np.isfinite(force.sum())):
                forward, forward_slope = _softplus((z - 0.5 * self.gap) * scale)
                backward, backward_slope = _softplus((z + 0.5 * self.gap) * -scale)
                force[...] = fwd * forward - bwd * backward + self.k_0 * z
                a[...] = self.k_fwd * forward_slope + self.k_bwd * backward_slope + self.k_0
        return force, a

    def deflection(self, force: Array, close: float = 1e-13) -> Array:
        """Deflection at which the force is G, (..., n): the inverse of G.

        Bisection between bounds, with Newton's step wherever it stays inside them, until a step
        is below `close` times ℓ + |z|.
        """
        softest = np.minimum(self.k_fwd, self.k_bwd)
        uneven = np.log1p(np.maximum(self.k_fwd, self.k_bwd) / softest)
        high = 0.5 * self.gap + self.ell * (2.0 + uneven) + np.abs(force) / softest
        low = -high
        stiff = np.where(force > 0, self.k_fwd, self.k_bwd)
        z = np.sign(force) * np.minimum(0.5 * self.gap + np.abs(force) / stiff, high)
        for _ in range(INVERSIONS):
            now, slope = self.evaluate(z)
            error = now - force
            step = error / np.maximum(slope, 1e-300)
            if np.all(np.abs(step) <= close * (self.ell + np.abs(z))):
                return z - step
            low, high = np.where(error < 0, z, low), np.where(error > 0, z, high)
            new = z - step
            z = np.where((new >= low) & (new <= high), new, 0.5 * (low + high))
        return z

    def about(self, force: Array, sign: Array, close: Array) -> Array:
        """Deflection s z at which the force s G is `force` > 0, (..., n), in, within about `close`.

        The inverse of one side alone, where k_0 takes its share of the force as with a sharp
        corner, and then Newton's method.
        """
        forward, half = sign > 0, 0.5 * self.gap
        stiff = np.where(forward, self.k_fwd, self.k_bwd)
        sharp = (half + force / stiff) / (1.0 + self.k_0 / stiff)
        own = np.maximum((force - self.k_0 * sharp) / (stiff * self.ell), 1e-6)
        ahead: Array = half + self.ell * (own + np.log(-np.expm1(-own)))
        for _ in range(FEW):
            now, slope = self.evaluate(sign * ahead)
            off = (sign * now - force) / np.maximum(slope, 1e-300)
            ahead -= off
            if np.all(np.abs(off) <= close):
                break
        return ahead


def _softplus(a: Array) -> tuple[Array, Array]:
    """ln(1 + e^a) and its slope, of any a."""
    e = np.exp(-np.abs(a))
    return np.maximum(a, 0.0) + np.log1p(e), np.where(a > 0, 1.0, e) / (1.0 + e)
