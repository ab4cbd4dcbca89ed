"""Keeps peaks, energies and histories while a building is stepped in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.response.building import Building
from mfd_bayes.response.devices import Devices
from mfd_bayes.response.ground import Ground
from mfd_bayes.response.stepping import Frame, halfway
from mfd_bayes.response.tally import Energies, Peaks, work

Array = NDArray[np.float64]

CHUNK = 16
"""Steps that are taken in together; the balance of energy is looked at after each of them."""


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
    middle : (n, m + s), kip
        Half-way in the step that ends here, with the motion that was found.
    """

    time: float
    ground: float
    state: Array
    devices: Devices
    force: Array
    middle: Array


@dataclass(eq=False)
class Ledger:
    """Running figures of all draws, taken in some steps at a time.

    The devices' forces do work against the forces that they hold at rest, in which the building is
    in equilibrium.
    """

    building: Building
    frame: Frame
    rest: Array
    brace: Array
    dampers: int
    late: float
    peaks: Peaks
    drifts: Array
    travels: Array
    forces: Array

    @classmethod
    def of(cls, frame: Frame, ground: Ground, devices: Devices, kept: int) -> Ledger:
        """Ledger before the first moment."""
        n, m, samples = devices.dampers.draws, devices.dampers.count, ground.acceleration.size
        building, kept = frame.building, min(kept, n)
        storeys = len(building.drifts)
        period = float(building.modes.periods[0])
        return cls(
            building,
            frame,
            devices.force,
            frame.brace[:m],
            m,
            float(ground.time[-1]) - min(2.0 * period, 0.5 * float(ground.time[-1])),
            Peaks.zero(n, storeys, building.freedoms, m),
            np.zeros((n, samples, storeys), dtype=np.float32),
            np.zeros((kept, samples, m), dtype=np.float32),
            np.zeros((kept, samples, m), dtype=np.float32),
        )

    def begin(self, moment: Moment) -> None:
        """Take in the moment before the first step."""
        n, m = len(moment.state), moment.force.shape[1]
        self._input, self._damping, self._most = np.zeros(n), np.zeros(n), np.zeros(n)
        self._devices, self._lost = np.zeros((n, m)), np.zeros(n)
        self._sum, self._time = np.zeros(self.peaks.drift.shape), 0.0
        self._moments, self._step = [moment], np.nan
        self.forces[:, 0] = moment.force[: len(self.forces), : self.dampers]
        self._samples: list[int | None] = []

    def pace(self, step: float) -> None:
        """Take in what waits, where the next steps have another length, s."""
        if step != self._step:
            self.close()
            self._step = step

    def include(self, moment: Moment, sample: int | None = None) -> None:
        """Take in a moment at the end of a step; `sample` of the ground motion, where it is one."""
        self._moments.append(moment)
        self._samples.append(sample)
        if len(self._moments) > CHUNK:
            self.close()

    def close(self) -> None:
        """Take in all moments that wait; after the last one."""
        if len(self._moments) < 2:
            return
        some = Stretch.of(self._moments, self.frame, self.rest, self._step)
        self._input += some.input
        self._damping += some.damping
        self._devices += some.devices
        self._record(some)
        self._moments, self._samples = self._moments[-1:], []
        energies = self.energies
        np.maximum(self._most, np.abs(energies.input), out=self._most)
        np.maximum(self._lost, np.abs(energies.lost), out=self._lost)

    def _record(self, some: Stretch) -> None:
        """Peaks, residual drift and histories of some moments."""
        m, building = self.dampers, self.building
        acceleration = np.concatenate([some.absolute(self.frame), some.between(self.frame)])
        drift = some.displacement[1:] @ building.drifts.T
        shear = acceleration @ (building.mass @ building.influence)
        travel = some.displacement[1:] @ self.frame.places[:m].T
        travel -= some.pulled[1:, :, :m] * self.brace
        pulled = np.concatenate([some.pulled[1:, :, :m], some.middle[..., :m]])
        force = pulled + self.rest[:, :m]
        columns = (drift, acceleration, shear, force, travel)
        self.peaks.include(Peaks(*(np.abs(column).max(axis=0) for column in columns)))
        late = np.array([moment.time >= self.late for moment in self._moments[1:]])
        if late.any():
            self._sum += self._step * drift[late].sum(axis=0)
            self._time += self._step * float(late.sum())
        at = [i for i, sample in enumerate(self._samples) if sample is not None]
        samples = [sample for sample in self._samples if sample is not None]
        kept = len(self.travels)
        self.drifts[:, samples] = drift[at].swapaxes(0, 1)
        self.travels[:, samples] = travel[at, :kept].swapaxes(0, 1)
        self.forces[:, samples] = force[at, :kept].swapaxes(0, 1)

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
        return self.energies_at(self._moments[-1])

    @property
    def residual(self) -> Array:
        """Mean drift near the end, (n, S), in."""
        return np.asarray(self._sum / max(self._time, 1e-300))

    @property
    def imbalance(self) -> Array:
        """Largest energy that is not accounted for, over the largest input, (n,)."""
        return np.asarray(self._lost / np.maximum(self._most, 1e-300))

    @property
    def loops(self) -> tuple[Array, Array]:
        """Travels and forces of the dampers that are kept, (k, T, m) each."""
        return self.travels, self.forces


@dataclass(frozen=True, eq=False)
class Stretch:
    """Some moments, one after another, and the work done between them.

    Attributes
    ----------
    step : float, s
    ground : (K + 1,), in/s²
    displacement, velocity, acceleration : (K + 1, n, N), in, in/s, in/s²
        Relative to the ground.
    pulled : (K + 1, n, m), kip
        Forces of the devices less those at rest.
    middle : (K, n, m), kip
        The same half-way between.
    input, damping : (n,), kip in
    devices : (n, m), kip in
    """

    step: float
    ground: Array
    displacement: Array
    velocity: Array
    acceleration: Array
    pulled: Array
    middle: Array
    input: Array
    damping: Array
    devices: Array

    def absolute(self, frame: Frame) -> Array:
        """Absolute accelerations of the floors at the ends of the steps, (K, n, N), in/s²."""
        ground = self.ground[1:, None, None]
        return np.asarray(self.acceleration[1:] + ground * frame.building.influence)

    def between(self, frame: Frame) -> Array:
        """Absolute accelerations half-way."""
        place, velocity = halfway(self.displacement, self.velocity, self.step)
        return frame.acceleration(place, velocity, self.middle, 0.0)

    @classmethod
    def of(cls, moments: list[Moment], frame: Frame, rest: Array, step: float) -> Stretch:
        """The stretch of moments that are a `step` apart, with all loads linear between them."""
        building = frame.building
        ground = np.array([moment.ground for moment in moments])
        state = np.stack([moment.state for moment in moments])
        pulled = np.stack([moment.force for moment in moments]) - rest
        middle = np.stack([moment.middle for moment in moments[1:]]) - rest
        x, v = state[..., : building.freedoms], state[..., building.freedoms :]
        a = frame.acceleration(x, v, pulled, ground[:, None, None])
        weights = building.mass @ building.influence
        push, lean, drag = -v @ weights, -a @ weights, v @ building.damping
        at = ground[:, None]
        given = _work(at * push, push, at * lean, np.diff(at, axis=0) / step, step)
        damping = np.einsum("kni,kni->kn", drag, v)
        slope = 2.0 * np.einsum("kni,kni->kn", drag, a)
        damped = _work(damping, damping, slope, np.zeros((len(at) - 1, 1)), step)
        way, bend = v @ frame.places.T, a @ frame.places.T
        taken = _work(pulled * way, way, pulled * bend, np.diff(pulled, axis=0) / step, step)
        return cls(step, ground, x, v, a, pulled, middle, given, damped, taken)


def _work(power: Array, rate: Array, slope: Array, change: Array, step: float) -> Array:
    """Work of a load over some steps, from its power, p = load × rate, at their ends.

    `slope` is load × the rate's slope; `change` that of the load within each step.
    """
    before, after = change * rate[:-1] + slope[:-1], change * rate[1:] + slope[1:]
    return np.asarray(work(power[:-1], power[1:], before, after, step).sum(axis=0))
