"""Roots of many monotone functions at once: secants, then halving of brackets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SECANTS = 8
"""Iterations by secants alone; nearly all steps need three or four."""


@dataclass(eq=False)
class Search:
    """Search of the forces f at which each device answers with the force that it was given.

    A device that is pulled less moves more, so its answer less f falls with f. Where it jumps
    across 0 (a motion that turns at the very end of the step), its bracket closes on the jump, and
    the force there is in equilibrium too.

    Attributes
    ----------
    slope : (n, m)
        Change of the answers by the force.
    low, high : (n, m), kip
        Bracket of each force.
    """

    slope: Array
    low: Array
    high: Array
    last: tuple[Array, Array] | None = None
    number: int = 0

    @classmethod
    def of(cls, shape: tuple[int, ...]) -> Search:
        """Search without brackets."""
        return cls(np.zeros(shape), np.full(shape, -np.inf), np.full(shape, np.inf))

    def next(self, force: Array, answer: Array, tolerance: Array) -> Array:
        """Forces to try next, after the answers to the last ones; (n, m), kip."""
        off = answer - force
        np.copyto(self.low, force, where=(off > 0) & (force > self.low))
        np.copyto(self.high, force, where=(off < 0) & (force < self.high))
        if self.last is not None:
            moved = force - self.last[0]
            with np.errstate(divide="ignore", invalid="ignore"):
                secant = (answer - self.last[1]) / moved
            usable = np.isfinite(secant) & (np.abs(moved) > 0.1 * tolerance)
            self.slope = np.where(usable, np.clip(secant, -1e4, 0.5), self.slope)
        self.last = force, answer
        self.number += 1
        new = force + off / (1.0 - self.slope)
        if self.number <= SECANTS:
            return np.asarray(new)
        middle = 0.5 * (self.low + self.high)
        return np.asarray(np.where(np.isfinite(middle), middle, new))

    def closed(self, tolerance: Array) -> NDArray[np.bool_]:
        """Whether each bracket has closed, or crossed as other devices moved."""
        return np.asarray(self.high - self.low <= tolerance)
