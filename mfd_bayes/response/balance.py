"""Roots of the forces of many devices at once: Newton's method with secants, then brackets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PLAIN = 3
"""Iterations by Newton's method alone; nearly all steps need two or three."""

SECANTS = 8
"""Iterations after which brackets are halved."""

JUMP = 30.0
"""Width, in tolerances, at which a bracket has closed on a jump."""

FEW = 64
"""Draws up to which the equations of their devices are solved exactly from the second time on."""

SWEEPS = 3
"""Sweeps over the equations otherwise."""


@dataclass(frozen=True, eq=False)
class Pull:
    """Loss of travel of each device by the force of each, in/kip.

    Attributes
    ----------
    whole : (m, m)
    own : (m,)
        By its own force.
    others : (m, m)
        Of each (column) by the forces of the others (rows).
    """

    whole: Array
    own: Array
    others: Array

    @classmethod
    def of(cls, whole: Array) -> Pull:
        """Pull of a matrix, (m, m)."""
        own = np.diag(whole).copy()
        return cls(whole, own, np.ascontiguousarray((whole - np.diag(own)).T))


@dataclass(eq=False)
class Search:
    """Search of the forces f at which each device answers with the force that it was given.

    A device that is pulled less moves more, so its answer less f falls with f. Where it jumps
    across 0 (a motion that turns at the very end of the step), its bracket closes on the jump, and
    the force there is in equilibrium too.

    Attributes
    ----------
    pull : Pull
    slope : (n, m), kip/in
        Change of the answers by the travel: of the last step at first, then secants.
    low, high : (n, m), kip
        Bracket of each force.
    last : (travel, answer), (n, m) each, optional
    """

    pull: Pull
    slope: Array
    low: Array
    high: Array
    last: tuple[Array, Array] | None = None
    number: int = 0

    @classmethod
    def of(cls, pull: Pull, slope: Array) -> Search:
        """Search without brackets."""
        shape = slope.shape
        return cls(pull, slope, np.full(shape, -np.inf), np.full(shape, np.inf))

    def chosen(self, rows: NDArray[np.intp]) -> Search:
        """The search of some draws."""
        columns = (self.slope[rows], self.low[rows], self.high[rows])
        last = None if self.last is None else (self.last[0][rows], self.last[1][rows])
        return Search(self.pull, *columns, last, self.number)

    def far(self, off: Array, tolerance: Array) -> NDArray[np.bool_]:
        """Devices that are not in equilibrium, nor at a jump, (n, m).

        Parameters
        ----------
        off : (n, m), kip
            Answers less forces.
        """
        far = ~(np.abs(off) <= tolerance)
        if self.number > PLAIN:
            far &= ~(self.high - self.low <= JUMP * tolerance)
        return np.asarray(far)

    def next(self, force: Array, travel: Array, answer: Array, tolerance: Array) -> Array:
        """Forces to try next, after travels and answers to the last ones; (n, m), kip."""
        off = answer - force
        self._learn(travel, answer, tolerance)
        self.last = travel, answer
        self.number += 1
        new = force + self._newton(off)
        if self.number > PLAIN:
            self._bracket(force, off)
            middle = 0.5 * (self.low + self.high)
            halved = np.isfinite(middle) & (np.abs(off) > tolerance)
            if self.number <= SECANTS:
                halved &= ~((new > self.low) & (new < self.high))
            new = np.where(halved, middle, new)
        return np.asarray(new)

    def _learn(self, travel: Array, answer: Array, tolerance: Array) -> None:
        """Slopes by secants where the travel changed enough."""
        if self.last is None:
            return
        moved, own = travel - self.last[0], self.pull.own
        usable = np.abs(moved) > 0.1 * tolerance * own
        secant = (answer - self.last[1]) / np.where(usable, moved, 1.0)
        usable &= np.isfinite(secant)
        limited = np.minimum(np.maximum(secant, -0.5 / own), 1e4 / own)
        self.slope = np.where(usable, limited, self.slope)

    def _newton(self, off: Array) -> Array:
        """Solution d of (I + K A) d = off, with the slopes K and the pull A, (n, m)."""
        own = self.pull.own
        scale = 1.0 / (1.0 + self.slope * own)
        change = off * scale
        if len(own) == 1:
            return np.asarray(change)
        if self.number > 1 and len(off) <= FEW:
            matrix = np.eye(len(own)) + self.slope[:, :, None] * self.pull.whole
            finite = np.isfinite(off).all(axis=1)
            change[finite] = np.linalg.solve(matrix[finite], off[finite][..., None])[..., 0]
            return np.asarray(change)
        first, weight = change, self.slope * scale
        for _ in range(SWEEPS):
            change = first - weight * (change @ self.pull.others)
        return np.asarray(change)

    def _bracket(self, force: Array, off: Array) -> None:
        """Narrow the brackets; one that was crossed as other devices moved is opened again."""
        np.copyto(self.high, np.inf, where=(off > 0) & (force >= self.high))
        np.copyto(self.low, -np.inf, where=(off < 0) & (force <= self.low))
        np.copyto(self.low, force, where=(off > 0) & (force > self.low))
        np.copyto(self.high, force, where=(off < 0) & (force < self.high))
