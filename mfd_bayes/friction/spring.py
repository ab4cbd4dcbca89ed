"""The spring of the backlash model: two stiff sides with a rounded gap between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

INVERSIONS = 60  # most steps of the inverse
FEW = 4  # most steps of a first guess
LEAST = -690.0  # exponent of e below which a number loses digits


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
    def corners(self) -> tuple[Array, Array]:
        """Forces k_f ℓ and k_b ℓ of the rounded corners, (n,) each, kip."""
        return self.k_fwd * self.ell, self.k_bwd * self.ell

    def of(self, rows: NDArray[np.intp]) -> Spring:
        """Spring of some of the vectors, by their number; one may come several times."""
        parts = (self.k_fwd, self.k_bwd, self.gap, self.ell, self.k_0)
        return Spring(*(part[rows] for part in parts))

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        """Force G, kip, and stiffness dG/dz, kip/in, at deflections z, (..., n), in."""
        a, half, (fwd, bwd) = z / self.ell, 0.5 * self.gap / self.ell, self.corners
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            e = np.exp(a - half)  # one exponential serves both sides
            other = np.exp(-2.0 * half) / e
            e += 1.0
            other += 1.0
            force = fwd * np.log(e)
            force -= bwd * np.log(other)
            force += self.k_0 * z
            slope = (self.k_fwd + self.k_bwd + self.k_0) - self.k_fwd / e - self.k_bwd / other
        if not (a.min(initial=0.0) > LEAST and np.isfinite(force.sum())):
            forward, forward_slope = _softplus(a - half)
            backward, backward_slope = _softplus(-a - half)
            force = fwd * forward - bwd * backward + self.k_0 * z
            slope = self.k_fwd * forward_slope + self.k_bwd * backward_slope + self.k_0
        return force, slope

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
