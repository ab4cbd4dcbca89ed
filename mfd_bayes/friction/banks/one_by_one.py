"""A bank for any model that can be stepped in time: damper by damper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.friction.banks.bank import Array, Scales, with_rows
from mfd_bayes.friction.model import Model


@dataclass(frozen=True, eq=False)
class OneByOne:
    """Dampers whose model steps one motion at a time; each has a state of its own."""

    model: Any
    states: tuple[Any, ...]
    force: Array

    @classmethod
    def at_rest(
        cls,
        model: Model,
        theta: ArrayLike,
        start: ArrayLike | None = None,
        direction: Array | None = None,
    ) -> OneByOne:
        """Dampers at rest at displacement 0.

        Raises
        ------
        FitError
            When the model cannot be stepped in time.
        """
        if not (hasattr(model, "start") and hasattr(model, "step")):
            raise FitError(f"the model {model.name} has no step in time, which a building needs")
        rows = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        places = np.full(len(rows), 0.5) if start is None else np.asarray(start, dtype=np.float64)
        states, forces = [], []
        stepped: Any = model
        for i, (row, place) in enumerate(
            zip(rows, np.broadcast_to(places, len(rows)), strict=True)
        ):
            begin = (row[None], np.array([place])) if model.has_gap else (row[None],)
            way = None if direction is None else int(direction[i])
            force, state = stepped.step(stepped.start(*begin, direction=way), 0.0, 0.0, 0.0)
            states.append(state)
            forces.append(float(force[0]))
        return cls(model, tuple(states), np.array(forces))

    def step(
        self, displacement: Array, velocity: Array, dt: float, scales: Scales | None = None
    ) -> OneByOne:
        """State at the next sample; see `Bank.step`."""
        states, forces = [], []
        for i, state in enumerate(self.states):
            own = None if scales is None else {name: s[i : i + 1] for name, s in scales.items()}
            x, v = float(displacement[i]), float(velocity[i])
            if not (np.isfinite(x) and np.isfinite(v)):
                states.append(state)
                forces.append(np.nan)
                continue
            force, after = self.model.step(state, x, v, dt, scales=own)
            states.append(after)
            forces.append(float(force[0]))
        return OneByOne(self.model, tuple(states), np.array(forces))

    def chosen(self, rows: NDArray[np.intp]) -> OneByOne:
        """The bank of some of its dampers."""
        return OneByOne(self.model, tuple(self.states[i] for i in rows), self.force[rows])

    def replaced(self, rows: NDArray[np.intp], part: OneByOne) -> OneByOne:
        """The bank with the state of some of its dampers replaced; see `Bank.replaced`."""
        states = list(self.states)
        for place, state in zip(rows, part.states, strict=True):
            states[place] = state
        return OneByOne(self.model, tuple(states), with_rows(self.force, rows, part.force))
