"""The devices of a building: its dampers and the storeys that yield, as one bank."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.banks import PlasticBank, State, bank_of
from mfd_bayes.friction.model import Model
from mfd_bayes.response.leftover import Leftover, LeftoverState

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Dampers:
    """Dampers of n buildings, m in each.

    Attributes
    ----------
    model : Model or None
        None for dampers that are almost rigid until they slip; theta is the slip force then.
    theta : (n, m, p)
    start : (n, m)
        Places in the gap at the start.
    leftover : Leftover, optional
        What the model leaves over in every cycle, as a force of the device.
    slip : (n, m), kip
        Mean slip forces.
    scales : mapping of (n, m, T), optional
        Factors of what follows the actuation, at the times `times`; none for constant actuations.
    about : mapping of (n, m)
        Values by which the draws differ, by the name of the source, for `influence`.
    direction : (m,), optional
        ±1, direction in which each begins to move.
    """

    model: Model | None
    theta: Array
    start: Array
    slip: Array
    leftover: Leftover | None = None
    scales: Mapping[str, Array] = field(default_factory=dict)
    times: Array | None = None
    about: Mapping[str, Array] = field(default_factory=dict)
    direction: Array | None = None

    @property
    def draws(self) -> int:
        """Number of buildings n."""
        return len(self.theta)

    @property
    def count(self) -> int:
        """Number of dampers in each, m."""
        return int(self.theta.shape[1])

    def chosen(self, rows: NDArray[np.intp]) -> Dampers:
        """Those of some buildings."""
        return replace(
            self,
            theta=self.theta[rows],
            start=self.start[rows],
            slip=self.slip[rows],
            leftover=None if self.leftover is None else self.leftover.chosen(rows),
            scales={name: s[rows] for name, s in self.scales.items()},
            about={name: a[rows] for name, a in self.about.items()},
        )

    def towards(self, way: Array) -> Dampers:
        """The dampers, about to move in the directions of the signs of `way`, (m,)."""
        return replace(self, direction=np.where(way < 0, -1.0, 1.0))

    def bank(self) -> State:
        """The dampers at rest, as a bank of n m."""
        if self.model is None:
            slip = self.slip.ravel()
            return PlasticBank.at_rest(slip / RIGID, slip)
        theta = self.theta.reshape(-1, self.theta.shape[2])
        way = None if self.direction is None else np.tile(self.direction, self.draws)
        return bank_of(self.model, theta, self.start.ravel(), way)

    def scales_at(self, time: float) -> dict[str, Array] | None:
        """Factors of what follows the actuation at a time, (n m,) each."""
        if self.times is None:
            return None
        place = float(np.interp(time, self.times, np.arange(self.times.size)))
        left = min(int(place), self.times.size - 2)
        share = place - left
        return {
            name: ((1.0 - share) * s[..., left] + share * s[..., left + 1]).ravel()
            for name, s in self.scales.items()
        }


RIGID = 0.001
"""Travel, in, at which almost rigid friction slips."""


@dataclass(frozen=True, eq=False)
class Devices:
    """All devices of n buildings at their last samples: m dampers, then s yielding storeys."""

    dampers: Dampers
    bank: State
    storeys: PlasticBank | None
    leftover: LeftoverState | None = None

    @classmethod
    def at_rest(cls, dampers: Dampers, stiffness: Array, strength: Array) -> Devices:
        """Devices at rest; the storeys that yield have a stiffness and a strength, (s,) each."""
        n, storeys = dampers.draws, None
        if strength.size:
            k, most = np.tile(stiffness, n), np.tile(strength, n)
            storeys = PlasticBank.at_rest(k, most, elastic=k)
        left = None if dampers.leftover is None else dampers.leftover.at_rest()
        return cls(dampers, dampers.bank(), storeys, left)

    @property
    def force(self) -> Array:
        """Forces of all, (n, m + s), kip."""
        n, m = self.dampers.draws, self.dampers.count
        force = self.bank.force.reshape(n, m)
        if self.leftover is not None:
            force = force + self.leftover.force
        if self.storeys is None:
            return force
        return np.concatenate([force, self.storeys.force.reshape(n, -1)], axis=1)

    def chosen(self, rows: NDArray[np.intp]) -> Devices:
        """The devices of some buildings."""
        flat = self._flat(rows, self.dampers.count)
        storeys, left = self.storeys, self.leftover
        if storeys is not None:
            count = storeys.stiffness.size // self.dampers.draws
            storeys = storeys.chosen(self._flat(rows, count))
        return Devices(
            self.dampers.chosen(rows),
            self.bank.chosen(flat),
            storeys,
            None if left is None else left.chosen(rows),
        )

    def replaced(self, rows: NDArray[np.intp], part: Devices) -> Devices:
        """The devices with the state of those of some buildings replaced."""
        storeys, left = self.storeys, self.leftover
        if storeys is not None and part.storeys is not None:
            count = storeys.stiffness.size // self.dampers.draws
            storeys = storeys.replaced(self._flat(rows, count), part.storeys)
        if left is not None and part.leftover is not None:
            left = left.replaced(rows, part.leftover)
        flat = self._flat(rows, self.dampers.count)
        return Devices(self.dampers, self.bank.replaced(flat, part.bank), storeys, left)

    @staticmethod
    def _flat(rows: NDArray[np.intp], count: int) -> NDArray[np.intp]:
        """Places in a bank of the devices of some buildings that have `count` each."""
        return (rows[:, None] * count + np.arange(count)).ravel()

    def step(self, travel: Array, velocity: Array, dt: float, time: float) -> Devices:
        """State at the next sample, from travels and velocities (n, m + s)."""
        m = self.dampers.count
        bank, storeys, left = self.bank, self.storeys, self.leftover
        if m:
            x, v = travel[:, :m].ravel(), velocity[:, :m].ravel()
            bank = bank.step(x, v, dt, self.dampers.scales_at(time))
        if left is not None:
            left = left.step(travel[:, :m])
        if storeys is not None:
            storeys = storeys.step(travel[:, m:].ravel(), velocity[:, m:].ravel(), dt)
        return Devices(self.dampers, bank, storeys, left)
