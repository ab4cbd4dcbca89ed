"""A bank of dampers whose friction falls with the travel since a turn, around any other bank."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.banks.bank import Array, Scales, with_state
from mfd_bayes.friction.banks.turns import turns_within
from mfd_bayes.friction.weakened import Weakened
from mfd_bayes.friction.weakening import fall

Rows = NDArray[np.intp]

STILL = 1.0
"""Time of a step in which nothing moves, s: any time will do."""


@dataclass(frozen=True, eq=False)
class WeakenedBank:
    """Dampers with slip weakening; equals `Weakened.step` of each.

    Attributes
    ----------
    model : Weakened
    bank : Bank
        Of the dampers without weakening.
    weakening : mapping of str to (n,)
        w of each direction whose friction falls.
    displacement, velocity : (n,), in, in/s
    direction : (n,)
        ±1, of the motion.
    turn : (n,), in
        Displacement of the last turn.
    """

    model: Weakened
    bank: Any
    weakening: Mapping[str, Array]
    displacement: Array
    velocity: Array
    direction: Array
    turn: Array

    @classmethod
    def at_rest(
        cls,
        model: Weakened,
        bank: Any,
        weakening: Mapping[str, Array],
        direction: Array | None = None,
    ) -> WeakenedBank:
        """Dampers at rest at displacement 0, of those without weakening at rest."""
        zero = np.zeros(bank.force.size)
        way = np.ones(zero.size) if direction is None else direction
        found = cls(model, bank, weakening, zero, zero, way, zero)
        return found.step(zero, zero, STILL)

    @property
    def force(self) -> Array:
        """Force of each damper at its last sample, (n,), kip."""
        return np.asarray(self.bank.force)

    def step(
        self, displacement: Array, velocity: Array, dt: float, scales: Scales | None = None
    ) -> WeakenedBank:
        """State at the next sample; see `Bank.step`."""
        x, direction, turn = self.displacement, self.direction, self.turn
        turns = turns_within(x, self.velocity, displacement, velocity, dt)
        if turns.rows.size:
            vertex = x.copy()
            vertex[turns.rows] = turns.vertex
            direction, turn = _passed(direction, turn, x, vertex)
            x = vertex
        direction, turn = _passed(direction, turn, x, displacement)
        travel = np.abs(displacement - turn)
        factors = {
            side: 1.0 + fall(travel, direction, side) * w for side, w in self.weakening.items()
        }
        return replace(
            self,
            bank=self.bank.step(displacement, velocity, dt, self.model.scaled(scales, factors)),
            displacement=displacement,
            velocity=velocity,
            direction=direction,
            turn=turn,
        )

    def chosen(self, rows: Rows) -> WeakenedBank:
        """The bank of some of its dampers."""
        return WeakenedBank(
            self.model,
            self.bank.chosen(rows),
            {side: w[rows] for side, w in self.weakening.items()},
            *(getattr(self, name)[rows] for name in _STATE),
        )

    def replaced(self, rows: Rows, part: WeakenedBank) -> WeakenedBank:
        """The bank with the state of some of its dampers replaced; see `Bank.replaced`."""
        whole = with_state(self, _STATE, rows, part)
        return replace(whole, bank=self.bank.replaced(rows, part.bank))


_STATE = ("displacement", "velocity", "direction", "turn")


def _passed(direction: Array, turn: Array, x: Array, x_next: Array) -> tuple[Array, Array]:
    """Direction and last turn after a straight way, (n,) each."""
    back = (x_next - x) * direction < 0
    return np.where(back, -direction, direction), np.where(back, x, turn)
