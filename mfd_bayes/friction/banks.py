"""Dampers stepped in time: the state of many of them, each with its own parameters and motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.friction.model import Array, Columns, Model, check_scales, check_start
from mfd_bayes.records.motion import vertex_of_turn
from mfd_bayes.records.numbers import real_number

Rows = NDArray[np.intp]
Scales = Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class State:
    """n dampers at a sample of their motions; a step makes a new state and leaves this one.

    Attributes
    ----------
    model : SteppedModel
    constants : dict
        What theta gives, by name: arrays whose last axis is the dampers, and what all share.
    memory : dict of (..., n)
        What the dampers remember between two samples.
    displacement, velocity : (n,), in, in/s
        At the sample; displacements are NaN before the first.
    scales : dict of (n,)
        Factors at the sample of the parameters that follow the actuation; 1 where there is none.
    reference : float, ksi or kip, or None
        Actuation that theta belongs to.
    """

    model: SteppedModel
    constants: dict[str, Any]
    memory: Columns
    displacement: Array
    velocity: Array
    scales: Columns
    reference: float | None = None

    @cached_property
    def force(self) -> Array:
        """Force of each damper, (n,), kip."""
        return self.model.total(self)

    @property
    def begun(self) -> bool:
        """Whether there was a sample."""
        return not np.isnan(self.displacement[:1]).all()

    def step(
        self, displacement: Array, velocity: Array, dt: float, scales: Scales | None = None
    ) -> Self:
        """State at the next sample of each damper's motion; all arguments but dt are (n,).

        A motion that turns before the sample goes there through its vertex, as in `Trace.path`.
        This state may be stepped again: that is what equilibrium iterations do.

        Parameters
        ----------
        displacement, velocity : (n,), in, in/s
        dt : float, s
        scales : mapping of (n,), optional
            Factors of the parameters that follow the actuation.
        """
        later = dict(scales or {})
        state, left = self, np.full(displacement.size, dt)
        (rows,) = (self.velocity * velocity < 0).nonzero()
        if rows.size:
            ends = self.displacement[rows], displacement[rows]
            share, vertex, regular = vertex_of_turn(dt, *ends, self.velocity[rows], velocity[rows])
            if not regular.all():
                rows, share, vertex = rows[regular], share[regular], vertex[regular]
        if rows.size:
            part = self.chosen(rows)
            near = {
                name: np.where(share < 0.5, part.scales.get(name, 1.0), factor[rows])
                for name, factor in later.items()
            }
            part = part.moved(vertex, np.zeros(rows.size), share * dt, near)
            state = self.replaced(rows, part)
            left[rows] *= 1.0 - share
        return state.moved(displacement, velocity, left, later)

    def moved(self, displacement: Array, velocity: Array, dt: Array, scales: Columns) -> Self:
        """State after a straight way of each damper, in its own time, (n,) s."""
        memory = self.model.advance(self, displacement, velocity, dt, scales)
        return self.at(memory, displacement, velocity, scales)

    def at(self, memory: Columns, displacement: Array, velocity: Array, scales: Columns) -> Self:
        """The same dampers at a sample."""
        return type(self)(
            self.model, self.constants, memory, displacement, velocity, scales, self.reference
        )

    def chosen(self, rows: Rows) -> Self:
        """The state of some of the dampers."""
        constants, memory, scales = (
            {k: v[..., rows] if isinstance(v, np.ndarray) else v for k, v in part.items()}
            for part in (self.constants, self.memory, self.scales)
        )
        place = self.displacement[rows], self.velocity[rows]
        return type(self)(self.model, constants, memory, *place, scales, self.reference)

    def replaced(self, rows: Rows, part: Self) -> Self:
        """The same with the state of some of the dampers replaced, after the same samples.

        That is how only those are stepped again that are not in equilibrium yet.
        """
        one = np.ones(self.displacement.size)
        old = {name: self.scales.get(name, one) for name in {**self.scales, **part.scales}}
        scales = {k: with_rows(v, rows, part.scales.get(k, 1.0)) for k, v in old.items()}
        memory = {k: with_rows(v, rows, part.memory[k]) for k, v in self.memory.items()}
        displacement = with_rows(self.displacement, rows, part.displacement)
        velocity = with_rows(self.velocity, rows, part.velocity)
        return self.at(memory, displacement, velocity, scales)


def with_rows(whole: Array, rows: Rows, part: Array | float) -> Array:
    """A copy, (..., n), with the values of some rows of its last axis replaced."""
    whole = whole.copy()
    whole[..., rows] = part
    return whole


class SteppedModel(Model):
    """A model that can be stepped in time; one of one's own gives the four methods below."""

    def constants(self, theta: ArrayLike) -> dict[str, Any]:
        """What theta, (n, p), gives: `State.constants`."""
        raise NotImplementedError

    def begin(self, state: State, start: Array, direction: Array | None) -> Columns:
        """Memory of the dampers of a state at its first sample.

        `start` is their place in the gap, (n,), and `direction` ±1, (n,), where that is known.
        """
        raise NotImplementedError

    def advance(
        self, state: State, displacement: Array, velocity: Array, dt: Array, scales: Columns
    ) -> Columns:
        """Memory after a straight way of each damper to a sample, all (n,)."""
        raise NotImplementedError

    def total(self, state: State) -> Array:
        """Force of each damper of a state, (n,), kip."""
        raise NotImplementedError

    def start(
        self,
        theta: ArrayLike,
        start: ArrayLike | None = None,
        *,
        direction: ArrayLike | None = None,
        reference_actuation: float | None = None,
    ) -> State:
        """State of every parameter vector before the first sample of a motion.

        Parameters
        ----------
        theta, start
            As in `force`.
        direction : int or (n,), optional
            +1 or -1, that of the first motion; by default that of the first velocity.
        reference_actuation : float, ksi or kip, optional
            Actuation to which theta belongs; by default that of the first step with one.

        Raises
        ------
        FitError
            When a shape or a value does not fit.
        """
        constants, n = self.constants(theta), len(self.vectors(theta))
        memory = {"start": check_start(start, n)}
        if direction is not None:
            way = np.asarray(direction)
            one = way.dtype.kind in "iuf" and way.shape in ((), (n,))
            if not (one and np.all(np.abs(way) == 1)):
                raise FitError(f"direction must be 1 or -1, got {direction}")
            memory["direction"] = np.broadcast_to(way.astype(np.float64), (n,))
        reference = reference_actuation
        if reference is not None:
            reference = real_number(
                "reference_actuation", reference, FitError, (0.0, inf), inside=True
            )
        nowhere = np.full(n, np.nan)
        return State(self, constants, memory, nowhere, np.zeros(n), {}, reference)

    def step(
        self,
        state: State,
        displacement: float,
        velocity: float,
        dt: float,
        actuation: float | None = None,
        *,
        scales: Mapping[str, ArrayLike] | None = None,
    ) -> tuple[Array, State]:
        """Force of every parameter vector at the next sample of one motion, and the state there.

        It equals `force` on the same samples, velocities and actuation if the trace has no
        reversal smaller than its hysteresis (`hysteresis=0` makes it so): while a reversal
        happens, it is not known whether it will stay that small.

        Parameters
        ----------
        state : State
            From `start` or the previous step; it is not changed and may be used again.
        displacement, velocity : float, in, in/s
        dt : float, s
            Time since the previous sample; any number at the first, where it does not matter.
        actuation : float, ksi or kip, optional
            Friction is proportional to it; when left out, theta is used unchanged. To get
            a record's `force`, give the record's `reference_actuation` to `start`.
        scales : mapping of (n,), (1,) or a number, optional
            Factors of the parameters that follow the actuation, used instead of it.

        Returns
        -------
        (n,), kip, and the new state

        Raises
        ------
        FitError
            When a number is not finite, dt not positive, the actuation negative, or a name
            or a value in `scales` does not fit.
        """
        if not (isinstance(state, State) and state.model == self):
            kind = type(state).__name__
            raise FitError(
                f"state must come from start or step of {self.name}; this {kind} does not"
            )
        begun, n = state.begun, state.displacement.size
        x = np.full(n, real_number("displacement of a step", displacement, FitError))
        v = np.full(n, real_number("velocity of a step", velocity, FitError))
        dt = real_number("dt of a step", dt, FitError, (0.0, inf), inside=begun)
        factors: Columns = {}
        if actuation is not None:
            level = real_number("actuation of a step", actuation, FitError, (0.0, inf))
            state = replace(state, reference=state.reference or level or None)
            if level != state.reference:
                factors = self.proportional(np.full(n, level), state.reference)
        if scales is not None:
            own = check_scales(scales, ((), (1,), (n,)), self.actuated)
            factors = {name: np.broadcast_to(f, (n,)).copy() for name, f in own.items()}
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            if begun:
                state = state.step(x, v, dt, factors)
            else:
                first = state.at(state.memory, x, v, factors)
                direction = state.memory.get("direction")
                memory = self.begin(first, state.memory["start"], direction)
                state = first.at(memory, x, v, factors)
            return state.force, state


def bank_of(
    model: Model, theta: ArrayLike, start: ArrayLike | None = None, direction: Array | None = None
) -> State:
    """Dampers of a model, at rest at displacement 0.

    Parameters
    ----------
    model : SteppedModel
    theta : (n, p)
        Parameters of each damper.
    start : (n,), optional
        Place of each in its gap; ½ when left out.
    direction : (n,), optional
        ±1, direction of each one's first motion, where it is known; what a damper holds at rest
        inside its gap depends on it.

    Raises
    ------
    FitError
        When a shape or a value does not fit, or the model cannot be stepped in time.
    """
    if not isinstance(model, SteppedModel):
        raise FitError(f"the model {model.name} has no step in time, which a building needs")
    return model.step(model.start(theta, start, direction=direction), 0.0, 0.0, 0.0)[1]


class _ElastoPlastic(SteppedModel):
    """Springs of stiffness k that slip at ±F_y: dF = k dx while |F| < F_y."""

    name = "elastoplastic"
    quantities = ()

    def advance(
        self, state: State, displacement: Array, velocity: Array, dt: Array, scales: Columns
    ) -> Columns:
        """Force of each spring after a way."""
        c = state.constants
        force = state.memory["spring"] + c["stiffness"] * (displacement - state.displacement)
        return {"spring": np.minimum(np.maximum(force, -c["strength"]), c["strength"])}

    def total(self, state: State) -> Array:
        """Force beside that of the linear structure, (n,), kip."""
        elastic = state.constants["elastic"] * state.displacement
        return np.asarray(state.memory["spring"] - elastic)


class PlasticBank(State):
    """Elastic, perfectly plastic forces: storeys that yield, and friction that is almost rigid."""

    @classmethod
    def at_rest(cls, stiffness: Array, strength: Array, elastic: Array | None = None) -> Self:
        """Springs without force at displacement 0.

        Parameters
        ----------
        stiffness, strength : (n,), kip/in, kip
        elastic : (n,), kip/in, optional
            Stiffness whose elastic force is subtracted: that of a storey which the linear structure
            has already, so that the force here is 0 until it yields.
        """
        zero = np.zeros(stiffness.size)
        constants = {"stiffness": stiffness, "strength": strength}
        constants["elastic"] = zero if elastic is None else elastic
        return cls(_ElastoPlastic(), constants, {"spring": zero}, zero, zero, {})

    @property
    def stiffness(self) -> Array:
        """Stiffness of each spring, (n,), kip/in."""
        return np.asarray(self.constants["stiffness"])

    @property
    def spring(self) -> Array:
        """Force of each spring, (n,), kip."""
        return self.memory["spring"]
