"""Nonlinear time-history analysis of a building with dampers, for many draws at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.response.building import Building
from mfd_bayes.response.devices import Dampers, Devices
from mfd_bayes.response.equilibrium import Free, balanced
from mfd_bayes.response.ground import Ground
from mfd_bayes.response.ledger import Ledger, Moment
from mfd_bayes.response.stepping import Frame, Step
from mfd_bayes.response.tally import Energies, Peaks

Array = NDArray[np.float64]

CLOSE = 1e-6
"""A force is in equilibrium when it changes by less than this share of the slip force."""

RUNAWAY = 1e5
"""Travel, in, beyond which a draw is unstable."""


@dataclass(frozen=True, eq=False)
class History:
    """What was computed of n draws under one ground motion with one step.

    Attributes
    ----------
    step : float, s
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
    parts: int,
    *,
    kept: int = 0,
    tick: Callable[[float], object] = lambda share: None,
) -> History:
    """History of every draw, with steps of the ground's step over `parts`.

    The structure's linear part is stepped exactly, with the ground's acceleration and the devices'
    forces linear in time within a step. The forces at its end are found by Newton's method, with a
    secant of each device.

    Parameters
    ----------
    dampers : Dampers
        Of n draws.
    kept : int
        Number of first draws whose dampers' histories are kept.
    tick : callable
        Is told the share that is done, now and then.
    """
    strong = np.flatnonzero(np.isfinite(building.yields))
    places = np.concatenate([building.travels, building.drifts[strong]])
    frame = Frame.of(building, places)
    step = Step.of(frame, ground.step / parts)
    way = -np.sign(ground.acceleration[np.flatnonzero(ground.acceleration)[0]])
    begin = dampers.towards(way * (building.travels @ building.influence))
    devices = Devices.at_rest(begin, building.storeys[strong], building.yields[strong])
    mover = _Mover.of(building, frame, step, devices)
    ledger = Ledger.of(frame, ground, parts, devices, kept)
    state = np.zeros((dampers.draws, 2 * building.freedoms))
    moment = Moment(0.0, ground.acceleration[0], state, devices, devices.force)
    ledger.begin(moment)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(1, ground.acceleration.size):
            low, high = ground.acceleration[k - 1], ground.acceleration[k]
            for i in range(1, parts + 1):
                at = low + (high - low) * i / parts
                moment = mover.move(moment, at)
                ledger.include(moment)
            if k % 64 == 0:
                tick(k / ground.acceleration.size)
        ledger.close()
    return _history(step.size, ledger, mover)


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
    step: Step
    rest: Array
    brace: Array
    tolerance: Array
    slope: Array
    unstable: NDArray[np.bool_]
    open: Array
    earlier: Array | None = None
    iterations: int = 0
    steps: int = 0

    @classmethod
    def of(cls, building: Building, frame: Frame, step: Step, devices: Devices) -> _Mover:
        n, m = devices.dampers.draws, devices.dampers.count
        soft = np.zeros(len(frame.places))
        soft[:m] = [1.0 / device.brace for device in building.devices]
        scale = np.empty((n, len(frame.places)))
        scale[:, :m] = devices.dampers.slip
        scale[:, m:] = building.yields[np.isfinite(building.yields)]
        no, slope = np.zeros(n, dtype=bool), np.zeros(scale.shape)
        return cls(frame, step, devices.force, soft, CLOSE * scale, slope, no, np.zeros(n))

    def move(self, before: Moment, ground: float) -> Moment:
        """The moment a step later."""
        n, size = self.frame.building.freedoms, self.step.size
        time = before.time + size
        count = len(before.state)
        ends = np.broadcast_to([before.ground, ground], (count, 2))
        pulled = before.force - self.rest
        free = np.concatenate([before.state, ends, pulled], axis=1) @ self.step.carried
        if not len(self.frame.places):
            return Moment(time, ground, free, before.devices, before.force)
        travel, velocity = free[:, :n] @ self.frame.places.T, free[:, n:] @ self.frame.places.T
        devices, force = self._balance(before, travel, velocity, time)
        state = free + (force - self.rest) @ self.step.response
        gone = ~np.all(np.abs(state[:, :n]) < RUNAWAY, axis=1) | ~np.all(np.isfinite(force), axis=1)
        if gone.any():
            self.unstable |= gone
            state[self.unstable] = 0.0
            force = np.where(self.unstable[:, None], self.rest, force)
        return Moment(time, ground, state, devices, force)

    def _balance(
        self, before: Moment, travel: Array, velocity: Array, time: float
    ) -> tuple[Devices, Array]:
        """Devices and their forces at the end of a step."""
        ends = travel, velocity, self.rest, self.tolerance, ~self.unstable
        free = Free(before.devices, before.force, *ends, self.step, self.brace, time)
        guess = before.force if self.earlier is None else 2.0 * before.force - self.earlier
        found = balanced(free, guess, self.slope)
        self.slope, self.earlier = found.slope, before.force
        self.open += found.open
        self.iterations += found.iterations
        self.steps += 1
        return found.devices, found.force
