"""Nonlinear time-history analysis of a building with dampers, for many draws at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.response.building import Building
from mfd_bayes.response.devices import Dampers, Devices
from mfd_bayes.response.equilibrium import Free, balanced
from mfd_bayes.response.ground import Ground
from mfd_bayes.response.ledger import Ledger, Moment
from mfd_bayes.response.stepping import Frame, Step, halfway
from mfd_bayes.response.tally import Energies, Peaks

Array = NDArray[np.float64]

CLOSE = 1e-5
"""A force is in equilibrium when it changes by less than this share of the slip force."""

RUNAWAY = 1e5
"""Travel, in, beyond which a draw is unstable."""


@dataclass(frozen=True, eq=False)
class History:
    """What was computed of n draws under one ground motion with one step.

    Attributes
    ----------
    step : float, s
        The shortest one.
    peaks : Peaks
    residual : (n, S), in
        Mean drift over the last two fundamental periods.
    energies : Energies
        At the end.
    imbalance : (n,)
        Largest energy that is not accounted for, over the largest input.
    unstable : (n,) bool
        Draws that ran away.
    open : (n,)
        Share of the steps that ended without equilibrium.
    drifts : (n, T, S), in
        At the samples of the ground motion.
    travels, forces : (k, T, m), in, kip
        Of the dampers of the first k draws.
    iterations : float
        Mean over the steps of the most equilibrium iterations of a draw.
    """

    step: float
    peaks: Peaks
    residual: Array
    energies: Energies
    imbalance: Array
    unstable: NDArray[np.bool_]
    open: Array
    drifts: Array
    travels: Array
    forces: Array
    iterations: float


def integrate(
    building: Building,
    ground: Ground,
    dampers: Dampers,
    parts: int | NDArray[np.intp],
    *,
    kept: int = 0,
) -> History:
    """History of every draw, with each interval of the ground motion cut into `parts` steps.

    The structure's linear part is stepped exactly, with the ground's acceleration and the devices'
    forces linear in time within a step. The forces at its end are found by Newton's method, with a
    secant of each device.

    Parameters
    ----------
    dampers : Dampers
        Of n draws.
    parts : int or (T - 1,)
        Of all intervals, or of each.
    kept : int
        Number of first draws whose dampers' histories are kept.
    """
    strong = np.flatnonzero(np.isfinite(building.yields))
    places = np.concatenate([building.travels, building.drifts[strong]])
    frame = Frame.of(building, places)
    counts = np.broadcast_to(parts, ground.acceleration.size - 1)
    steps = {count: Step.of(frame, ground.step / count) for count in np.unique(counts).tolist()}
    way = -np.sign(ground.acceleration[np.flatnonzero(ground.acceleration)[0]])
    sway = np.linalg.solve(building.stiffness, building.mass @ building.influence)
    begin = dampers.towards(way * (building.travels @ sway))
    devices = Devices.at_rest(begin, building.storeys[strong], building.yields[strong])
    mover = _Mover.of(building, frame, devices, ground.step / int(counts.max()))
    ledger = Ledger.of(frame, ground, devices, kept)
    state = np.zeros((dampers.draws, 2 * building.freedoms))
    moment = Moment(0.0, ground.acceleration[0], state, devices, devices.force, devices.force)
    ledger.begin(moment)
    with np.errstate(over="ignore", invalid="ignore"):
        for k, count in enumerate(counts.tolist()):
            low, high = ground.acceleration[k : k + 2]
            step = steps[count]
            ledger.pace(step.size)
            for i in range(1, count + 1):
                moment = mover.move(moment, low + (high - low) * i / count, step)
                ledger.include(moment, k + 1 if i == count else None)
        ledger.close()
    return _history(ground.step / int(counts.max()), ledger, mover)


def _history(size: float, ledger: Ledger, mover: _Mover) -> History:
    travels, forces = ledger.loops
    return History(
        size,
        ledger.peaks,
        ledger.residual,
        ledger.energies,
        ledger.imbalance,
        mover.unstable,
        mover.open / max(mover.steps, 1),
        ledger.drifts,
        travels,
        forces,
        mover.iterations / max(mover.steps, 1),
    )


@dataclass(eq=False)
class _Mover:
    """Moves all draws by a step; counts what went wrong."""

    frame: Frame
    shortest: float
    rest: Array
    tolerance: Array
    slope: Array
    unstable: NDArray[np.bool_]
    open: Array
    earlier: tuple[Array, float] | None = None
    iterations: int = 0
    steps: int = 0

    @classmethod
    def of(cls, building: Building, frame: Frame, devices: Devices, shortest: float) -> _Mover:
        n, m = devices.dampers.draws, devices.dampers.count
        scale = np.empty((n, len(frame.places)))
        scale[:, :m] = devices.dampers.slip
        scale[:, m:] = building.yields[np.isfinite(building.yields)]
        no, slope = np.zeros(n, dtype=bool), np.zeros(scale.shape)
        return cls(frame, shortest, devices.force, CLOSE * scale, slope, no, np.zeros(n))

    def move(self, before: Moment, ground: float, step: Step) -> Moment:
        """The moment a step later."""
        n, time = self.frame.building.freedoms, before.time + step.size
        free = step.free(before.state, before.force - self.rest, before.ground, ground)
        if not len(self.frame.places):
            return Moment(time, ground, free, before.devices, before.force, before.force)
        travel, velocity = free[:, :n] @ self.frame.places.T, free[:, n:] @ self.frame.places.T
        devices, force = self._balance(before, travel, velocity, step)
        state = free + (force - self.rest) @ step.response
        gone = ~np.all(np.abs(state[:, :n]) < RUNAWAY, axis=1) | ~np.all(np.isfinite(force), axis=1)
        if gone.any():
            self.unstable |= gone
            state[self.unstable] = 0.0
            force = np.where(self.unstable[:, None], self.rest, force)
        middle = self._middle(before, state, force, step)
        return Moment(time, ground, state, devices, force, middle)

    def _middle(self, before: Moment, state: Array, force: Array, step: Step) -> Array:
        """Forces half-way: they bend within a step, most at the end of a gap and at a turn.

        They are looked at for peaks, and do not change the motion. They are the mean of those at
        the ends in longer steps, where forces bend little, and behind a brace, whose share of the
        travel would have to be found too.
        """
        n = self.frame.building.freedoms
        if step.braced or step.size > self.shortest:
            return 0.5 * (before.force + force)
        ends = np.stack([before.state, state])
        place, velocity = (
            each[0] @ self.frame.places.T
            for each in halfway(ends[..., :n], ends[..., n:], step.size)
        )
        half = 0.5 * step.size
        found = before.devices.step(place, velocity, half, before.time + half).force
        return np.where(self.unstable[:, None], self.rest, found)

    def _balance(
        self, before: Moment, travel: Array, velocity: Array, step: Step
    ) -> tuple[Devices, Array]:
        """Devices and their forces at the end of a step."""
        ends = travel, velocity, self.rest, self.tolerance, ~self.unstable
        free = Free(before.devices, before.force, *ends, step, before.time + step.size)
        guess = before.force
        if self.earlier is not None:
            force, size = self.earlier
            guess = guess + (step.size / size) * (guess - force)
        found = balanced(free, guess, self.slope)
        self.slope, self.earlier = found.slope, (before.force, step.size)
        self.open += found.open
        self.iterations += found.iterations
        self.steps += 1
        return found.devices, found.force
