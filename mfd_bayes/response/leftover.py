"""The model's discrepancy as a force of the device, which belongs to its motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.discrepancy import FINE, KNOTS, TravelBasis

Array = NDArray[np.float64]

SETTLE = float(np.expm1(np.log1p(FINE) / (KNOTS - 1)) / FINE)
"""Share of the longest stroke after a turn, over which the force goes to its new side."""


@dataclass(frozen=True, eq=False)
class Leftover:
    """Discrepancies of the dampers of n buildings.

    Attributes
    ----------
    basis : TravelBasis
    coefficients : (n, K), kip
        Common to the dampers of a building, as they are to the tests of a device.
    relative : (n, m)
        Slip force of each damper over the one at which the discrepancy stands as it is.
    """

    basis: TravelBasis
    coefficients: Array
    relative: Array

    def chosen(self, rows: NDArray[np.intp]) -> Leftover:
        """Those of some buildings."""
        return replace(self, coefficients=self.coefficients[rows], relative=self.relative[rows])

    def at_rest(self) -> LeftoverState:
        """State before any motion: no stroke is known, so there is no force."""
        zero = np.zeros(self.relative.shape)
        return LeftoverState(self, zero, np.ones(zero.shape), zero, zero, zero, zero)


@dataclass(frozen=True, eq=False)
class LeftoverState:
    """Turns of the dampers' motions so far, and their discrepancy; (n, m) each.

    A turn would let the force jump from one side to the other. It goes there over the first
    `SETTLE` of the longest stroke instead, so that the force is continuous in time.

    Attributes
    ----------
    place, turn : in
        Displacement now and at the last turn.
    direction : ±1
    stroke : in
        Length of the stroke before the last turn.
    held : kip
        Force at the last turn.
    force : kip
    """

    leftover: Leftover
    place: Array
    direction: Array
    turn: Array
    stroke: Array
    held: Array
    force: Array

    def chosen(self, rows: NDArray[np.intp]) -> LeftoverState:
        """That of some buildings."""
        columns = (self.place, self.direction, self.turn, self.stroke, self.held, self.force)
        return LeftoverState(self.leftover.chosen(rows), *(column[rows] for column in columns))

    def replaced(self, rows: NDArray[np.intp], part: LeftoverState) -> LeftoverState:
        """The same with that of some buildings replaced."""
        new = {}
        for name in ("place", "direction", "turn", "stroke", "held", "force"):
            new[name] = getattr(self, name).copy()
            new[name][rows] = getattr(part, name)
        return replace(self, **new)

    def step(self, place: Array) -> LeftoverState:
        """State at the next displacements, (n, m), in."""
        way = place - self.place
        back = way * self.direction < 0
        direction = np.where(back, -self.direction, self.direction)
        stroke = np.where(back, np.abs(self.place - self.turn), self.stroke)
        turn = np.where(back, self.place, self.turn)
        held = np.where(back, self.force, self.held)
        travel = np.abs(place - turn)
        full = self.leftover.relative * self._learned(travel, stroke, direction > 0)
        share = np.minimum(travel / (SETTLE * self.leftover.basis.longest), 1.0)
        force = share * full + (1.0 - share) * held
        return LeftoverState(self.leftover, place, direction, turn, stroke, held, force)

    def _learned(self, travel: Array, stroke: Array, forward: NDArray[np.bool_]) -> Array:
        """Discrepancy at the typical slip force, kip; as `TravelBasis.values` has it."""
        basis = self.leftover.basis
        at = np.log1p(FINE * travel / basis.longest) / (np.log1p(FINE) / (KNOTS - 1))
        left = np.minimum(at, KNOTS).astype(np.intp)
        share = at - left
        padded = np.zeros((len(travel), 2, KNOTS + 2))
        padded[:, :, :KNOTS] = self.leftover.coefficients.reshape(len(travel), 2, KNOTS)
        row, side = np.arange(len(travel))[:, None], np.where(forward, 0, 1)
        value = (1.0 - share) * padded[row, side, left] + share * padded[row, side, left + 1]
        value[at >= KNOTS] = 0.0
        return np.asarray(value * np.clip(4.0 * stroke / basis.shortest - 2.0, 0.0, 1.0))
