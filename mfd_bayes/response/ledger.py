"""Keeps peaks, energies and histories while a building is stepped in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.response.building import Building
from mfd_bayes.response.devices import Devices
from mfd_bayes.response.ground import Ground
from mfd_bayes.response.stepping import Frame
from mfd_bayes.response.tally import Energies, Peaks, work

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Moment:
    """All draws at one time.

    Attributes
    ----------
    time, ground : float, s, in/s²
    state : (n, 2N)
        Displacements and velocities relative to the ground, in and in/s.
    devices : Devices
    force : (n, m + s), kip
    """

    time: float
    ground: float
    state: Array
    devices: Devices
    force: Array


@dataclass(eq=False)
class Ledger:
    """Running figures of all draws; those of the last moment are kept for the next.

    The devices' forces do work against the forces that they hold at rest, in which the building is
    in equilibrium.
    """

    building: Building
    frame: Frame
    rest: Array
    brace: Array
    dampers: int
    peaks: Peaks
    drifts: Array
    travels: Array
    forces: Array
    late: float
    past: Moment | None = None
    powers: tuple[Array, ...] = ()

    @classmethod
    def of(
        cls, building: Building, frame: Frame, ground: Ground, devices: Devices, kept: int
    ) -> Ledger:
        """Ledger before the first moment."""
        n, m, samples = devices.dampers.draws, devices.dampers.count, ground.acceleration.size
        kept = min(kept, n)
        storeys = len(building.drifts)
        period = float(building.modes.periods[0])
        return cls(
            building,
            frame,
            devices.force,
            np.array([1.0 / device.brace for device in building.devices]),
            m,
            Peaks.zero(n, storeys, building.freedoms, m),
            np.zeros((n, samples, storeys), dtype=np.float32),
            np.zeros((kept, samples, m), dtype=np.float32),
            np.zeros((kept, samples, m), dtype=np.float32),
            float(ground.time[-1]) - min(2.0 * period, 0.5 * float(ground.time[-1])),
        )

    def begin(self, moment: Moment) -> None:
        """Take in the moment before the first step."""
        n, m = len(moment.state), moment.force.shape[1]
        self._input, self._damping, self._most = np.zeros(n), np.zeros(n), np.zeros(n)
        self._devices, self._lost = np.zeros((n, m)), np.zeros(n)
        self._sum, self._count = np.zeros(self.peaks.drift.shape), 0
        self.powers = self._powers(moment, moment.force, 1.0)
        self.past = moment

    def include(self, moment: Moment) -> None:
        """Take in a moment at the end of a step."""
        past = self.past or moment
        step = moment.time - past.time
        rate = (moment.force - past.force) / step
        before = self._with_slopes(past, self.powers, rate)
        self.powers = self._powers(moment, past.force, step)
        after = self._with_slopes(moment, self.powers, rate)
        slope = (moment.ground - past.ground) / step
        self._add(before, after, slope, step)
        self._record(moment)
        self.past = moment

    def _powers(self, moment: Moment, force: Array, step: float) -> tuple[Array, ...]:
        """Acceleration, velocity, travel rate and its rate of the devices, at a moment."""
        n = self.building.freedoms
        pulled = moment.force - self.rest
        acceleration = self.frame.acceleration(moment.state, pulled, moment.ground)
        velocity = moment.state[:, n:]
        places = self.frame.places.T
        return acceleration, velocity, velocity @ places, acceleration @ places

    def _with_slopes(
        self, moment: Moment, powers: tuple[Array, ...], rate: Array
    ) -> tuple[Array, ...]:
        """Powers of ground, damping and devices at one end of a step, and their slopes."""
        acceleration, velocity, way, bend = powers
        weights = self.building.mass @ self.building.influence
        push, lean = -velocity @ weights, -acceleration @ weights
        drag = velocity @ self.building.damping
        damping = np.einsum("ni,ni->n", drag, velocity)
        slope = 2.0 * np.einsum("ni,ni->n", drag, acceleration)
        pulled = moment.force - self.rest
        return push, lean, damping, slope, pulled * way, rate * way + pulled * bend

    def _add(
        self, before: tuple[Array, ...], after: tuple[Array, ...], slope: float, step: float
    ) -> None:
        past = self.past
        a = past.ground if past is not None else 0.0
        b = a + slope * step
        self._input += work(
            a * before[0],
            b * after[0],
            slope * before[0] + a * before[1],
            slope * after[0] + b * after[1],
            step,
        )
        self._damping += work(before[2], after[2], before[3], after[3], step)
        self._devices += work(before[4], after[4], before[5], after[5], step)

    def _record(self, moment: Moment) -> None:
        """Peaks, residual drift and energy balance at a moment."""
        n, m = self.building.freedoms, self.dampers
        acceleration = self.powers[0] + moment.ground * self.building.influence
        drift = moment.state[:, :n] @ self.building.drifts.T
        shear = acceleration @ (self.building.mass @ self.building.influence)
        force = moment.force[:, :m]
        self.peaks.include(Peaks(drift, acceleration, shear, force, self._travel(moment)))
        if moment.time >= self.late:
            self._sum += drift
            self._count += 1
        energies = self.energies_at(moment)
        np.maximum(self._most, np.abs(energies.input), out=self._most)
        np.maximum(self._lost, np.abs(energies.lost), out=self._lost)

    def _travel(self, moment: Moment) -> Array:
        """Travel of the dampers without their braces, (n, m), in."""
        n, m = self.building.freedoms, self.dampers
        whole = moment.state[:, :n] @ self.frame.places[:m].T
        return np.asarray(whole - (moment.force - self.rest)[:, :m] * self.brace)

    def keep(self, sample: int, moment: Moment) -> None:
        """Keep drifts, and travels and forces of some draws, at a sample of the ground motion."""
        n, kept = self.building.freedoms, len(self.travels)
        self.drifts[:, sample] = moment.state[:, :n] @ self.building.drifts.T
        if kept:
            self.travels[:, sample] = self._travel(moment)[:kept]
            self.forces[:, sample] = moment.force[:kept, : self.dampers]

    def energies_at(self, moment: Moment) -> Energies:
        """Energies up to a moment."""
        n, m = self.building.freedoms, self.dampers
        x, v = moment.state[:, :n], moment.state[:, n:]
        pulled = (moment.force - self.rest)[:, :m]
        brace = 0.5 * self.brace * pulled**2
        # of storeys that yielded, the linear structure holds more than their springs do
        excess = self._excess(moment)
        return Energies(
            self._input.copy(),
            0.5 * np.einsum("ni,ni->n", v @ self.building.mass, v),
            0.5 * np.einsum("ni,ni->n", x @ self.building.stiffness, x) - excess,
            self._damping.copy(),
            self._devices[:, :m] - brace,
            self._devices[:, m:].sum(axis=1) + excess,
            brace.sum(axis=1),
        )

    def _excess(self, moment: Moment) -> Array:
        """Elastic energy of whole drifts less that of the springs that yield, (n,), kip in."""
        n, m = self.building.freedoms, self.dampers
        bank = moment.devices.storeys
        if bank is None:
            return np.zeros(len(moment.state))
        drift = moment.state[:, :n] @ self.frame.places[m:].T
        stiffness = bank.stiffness.reshape(drift.shape)
        spring = bank.spring.reshape(drift.shape)
        return np.asarray(0.5 * (stiffness * drift**2 - spring**2 / stiffness).sum(axis=1))

    @property
    def energies(self) -> Energies:
        """Energies at the last moment."""
        if self.past is None:
            raise ValueError("nothing was included yet")
        return self.energies_at(self.past)

    @property
    def residual(self) -> Array:
        """Mean drift near the end, (n, S), in."""
        return np.asarray(self._sum / max(self._count, 1))

    @property
    def imbalance(self) -> Array:
        """Largest energy that is not accounted for, over the largest input, (n,)."""
        return np.asarray(self._lost / np.maximum(self._most, 1e-300))

    @property
    def loops(self) -> tuple[Array, Array]:
        """Travels and forces of the dampers that are kept, (k, T, m) each."""
        return self.travels, self.forces
