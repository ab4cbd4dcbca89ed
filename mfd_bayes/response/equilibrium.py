"""The forces of all devices at the end of a step."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.response.balance import Search
from mfd_bayes.response.devices import Devices
from mfd_bayes.response.stepping import Step

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

ITERATIONS = 24
"""Most iterations of a step."""

ROUGH = 1e4
"""A step is open when a force is still off by more tolerances than this after all iterations."""

WORTH = 300
"""Devices in equilibrium that are worth leaving out of further iterations."""


@dataclass(frozen=True, eq=False)
class Free:
    """Devices before a step, and where they would be after it without force; (n, m) each.

    Attributes
    ----------
    devices : Devices
    force, travel, velocity : kip, in, in/s
        `force` is that before the step.
    rest, tolerance : kip
        Forces at rest, and how exactly forces are found.
    live : (n,) bool
        Draws that did not run away.
    step : Step
    time : float, s
    """

    devices: Devices
    force: Array
    travel: Array
    velocity: Array
    rest: Array
    tolerance: Array
    live: NDArray[np.bool_]
    step: Step
    time: float

    def answer(self, force: Array) -> tuple[Devices, Array]:
        """Devices that are pulled by these forces, and their travels."""
        pulled, size = force - self.rest, self.step.size
        x = self.travel - pulled @ self.step.flexibility.T
        v = self.velocity - pulled @ self.step.mobility.T
        if self.step.braced:
            x -= pulled * self.step.brace
            v -= (force - self.force) * (self.step.brace / size)
        return self.devices.step(x, v, size, self.time), x

    def chosen(self, rows: Rows) -> Free:
        """Those of some draws."""
        columns = ("force", "travel", "velocity", "rest", "tolerance", "live")
        some: dict[str, Any] = {name: getattr(self, name)[rows] for name in columns}
        return replace(self, devices=self.devices.chosen(rows), **some)


@dataclass(frozen=True, eq=False)
class Balance:
    """Devices in equilibrium: their forces and slopes, (n, m); draws that are not, (n,)."""

    devices: Devices
    force: Array
    slope: Array
    open: NDArray[np.bool_]
    iterations: int

    def replaced(self, rows: Rows, part: Balance) -> Balance:
        """The same with that of some draws; these arrays are changed."""
        self.force[rows], self.slope[rows], self.open[rows] = part.force, part.slope, part.open
        devices = self.devices.replaced(rows, part.devices)
        return replace(self, devices=devices, iterations=part.iterations)


def balanced(free: Free, guess: Array, slope: Array) -> Balance:
    """Devices at the forces with which they answer.

    Draws in equilibrium are left out of further iterations when that is worth it.

    Parameters
    ----------
    guess, slope : (n, m), kip, kip/in
        Forces to begin with, and changes of the answers by the travel.
    """
    rows, force, number = np.arange(len(guess)), guess, 0
    found: Balance | None = None
    search = Search.of(free.step.pull, slope)
    while True:
        number += 1
        devices, travel = free.answer(force)
        answer = devices.force
        far = search.far(answer - force, free.tolerance)
        (going,) = (far.any(axis=1) & free.live).nonzero()
        last = not going.size or number == ITERATIONS
        done = (rows.size - going.size) * guess.shape[1] >= WORTH
        if last or done:
            part = _balance(free, search, (devices, force, answer), number)
            found = part if found is None else found.replaced(rows, part)
            if last:
                return found
        force = search.next(force, travel, answer, free.tolerance)
        if done:
            rows, force = rows[going], force[going]
            free, search = free.chosen(going), search.chosen(going)


def _balance(
    free: Free, search: Search, tried: tuple[Devices, Array, Array], number: int
) -> Balance:
    devices, force, answer = tried
    off = answer - force
    beyond = np.abs(off) > free.tolerance
    if not beyond.any():
        return Balance(devices, answer, search.slope, np.zeros(len(off), dtype=bool), number)
    # where it jumps, the force between is in equilibrium
    kept = np.where(beyond, force, answer)
    wide = search.far(off, free.tolerance) & (np.abs(off) > ROUGH * free.tolerance)
    return Balance(devices, kept, search.slope, np.asarray(wide.any(axis=1)), number)
