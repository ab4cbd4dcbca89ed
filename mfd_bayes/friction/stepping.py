"""Friction models stepped in time, for hybrid simulation and structural analysis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.friction.bristles import Friction, Motion, advance
from mfd_bayes.friction.evaluation import check_state
from mfd_bayes.friction.gap import begin, turn
from mfd_bayes.friction.paper import ACTUATED, FRICTION_FORCES, PaperModel
from mfd_bayes.friction.recurrence import Blocks
from mfd_bayes.friction.transitions import Crossing, Gap, blend
from mfd_bayes.friction.yield_shares import (
    check_level,
    check_reference,
    check_shares,
    check_step,
    reference_of,
)
from mfd_bayes.records.motion import vertices
from mfd_bayes.records.numbers import real_number

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Damper:
    """What does not change from step to step.

    Attributes
    ----------
    friction : Friction
        At the reference actuation, (1, n) each.
    start : (n,), optional
        u/D at the first sample.
    direction : int, optional
        +1 or -1, direction of the first motion.
    reference : float, optional
        Actuation to which the parameters belong; that of the first step when left out.
    """

    friction: Friction
    gap: Gap | None = None
    start: Array | None = None
    direction: int | None = None
    reference: float | None = None

    def __post_init__(self) -> None:
        if self.direction not in (None, 1, -1):
            raise FitError(f"direction must be 1 or -1, got {self.direction}")
        object.__setattr__(self, "reference", check_reference(self.reference))


@dataclass(frozen=True)
class State:
    """All that n dampers remember between two samples; a step makes a new one.

    Attributes
    ----------
    friction : Friction
        At the actuation of the last sample, (1, n) each.
    displacement, velocity : float, in, in/s
        At the last sample; NaN before the first.
    direction : int
        +1 or -1; 0 before the first sample.
    moved : bool
        Whether the damper has moved, or its direction was given; else it is assumed.
    bristles : (n,), in
        Deflection z.
    slip : (1, n), kip
        F1.
    crossing : Crossing, optional
        State of the gap in the current stretch of motion.
    """

    damper: Damper
    friction: Friction
    displacement: float
    velocity: float
    direction: int
    moved: bool
    bristles: Array
    slip: Array
    crossing: Crossing | None = None

    @classmethod
    def at_rest(cls, damper: Damper) -> State:
        """State before the first sample."""
        zero = np.zeros(damper.friction.vectors)
        moved = damper.direction is not None
        direction = damper.direction or 0
        return cls(damper, damper.friction, np.nan, np.nan, direction, moved, zero, zero[None])

    @property
    def force(self) -> Array:
        """Force of every parameter vector, (n,), kip."""
        force: Array = self.slip.copy()
        if self.damper.gap is not None and self.crossing is not None:
            here = np.array([self.displacement])
            blend(self.damper.gap, self.crossing, np.zeros(1, dtype=np.intp), here, force)
        return force.ravel()

    def step(
        self,
        displacement: float,
        velocity: float,
        dt: float,
        actuation: float | None = None,
        scales: Mapping[str, ArrayLike] | None = None,
    ) -> State:
        """State at the next sample; see `Stepped.step`."""
        first = self.displacement != self.displacement  # NaN
        displacement, velocity, dt = check_step(displacement, velocity, dt, first=first)
        level = check_level(actuation)
        state = self._referred(level)
        friction = _actuated(state.damper, level, scales)
        if first:
            real_number("dt of a step", dt, FitError, (0.0, inf))
            return state._first(friction, displacement, velocity)
        # the path to the sample, through the vertex if the motion turns before it
        t = np.array([0.0, dt])
        x = np.array([self.displacement, displacement])
        v = np.array([self.velocity, velocity])
        history = [self.friction, friction]
        if self.velocity * velocity < 0:
            left, share, vertex = vertices(t, x, v)
            t, x, v = (np.insert(c, left + 1, w) for c, w in ((t, share * dt), (x, vertex), (v, 0)))
            history[1:1] = [history[0 if s < 0.5 else 1] for s in share]
        way = np.diff(x)
        motion = Motion.of(np.arange(1, x.size), way, way / np.diff(t), v[1:])
        slip, bristles = advance(Friction.of(history), motion, self.bristles, Blocks.of(way.size))
        slip = slip.copy()
        for k in range(way.size):
            state = state._moved(float(x[k + 1]), slip[k : k + 1])
        return replace(state, friction=friction, velocity=velocity, bristles=bristles)

    def _referred(self, actuation: float | None) -> State:
        """The state with this actuation as the reference, if none is known yet."""
        known = self.damper.reference
        reference = reference_of(known, actuation)
        if reference == known:
            return self
        return replace(self, damper=replace(self.damper, reference=reference))

    def _first(self, friction: Friction, displacement: float, velocity: float) -> State:
        direction = self.direction or (-1 if velocity < 0 else 1)
        state = replace(
            self,
            friction=friction,
            displacement=displacement,
            velocity=velocity,
            direction=direction,
            slip=velocity * (friction.sigma1 + friction.sigma2),
        )
        return state._begun(direction)

    def _begun(self, direction: int) -> State:
        crossing, gap, start = None, self.damper.gap, self.damper.start
        if gap is not None and start is not None:
            crossing = begin(gap, self.displacement, direction, start)
        return replace(self, direction=direction, crossing=crossing)

    def _moved(self, displacement: float, slip: Array) -> State:
        """State at the next point of the path; a reversal of the motion is handled first."""
        state = self
        way = displacement - self.displacement
        if way * self.direction < 0:
            state = self._turned() if self.moved else self._begun(-self.direction)
        moved = self.moved or way != 0
        return replace(state, displacement=displacement, slip=slip, moved=moved)

    def _turned(self) -> State:
        crossing = self.crossing
        if self.damper.gap is not None and crossing is not None:
            here = np.array([self.displacement])
            both = turn(self.damper.gap, crossing, here, self.direction, self.slip)
            crossing = Crossing(both.side[1:], both.edge[1:], both.carry[1:])
        return replace(self, direction=-self.direction, crossing=crossing)


class Stepped(PaperModel):
    """Base of the models that are stepped with `State`."""

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
        """Force of every parameter vector at the next sample of a motion, and the state there.

        It equals `force` on the same samples, velocities and actuation if the trace has no
        reversal smaller than its hysteresis (`hysteresis=0` makes it so): while a reversal
        happens, it is not known whether it will stay that small.

        Parameters
        ----------
        state : State
            From `start` or the previous step; it is not changed and may be used again.
        displacement, velocity : in, in/s
        dt : s
            Time since the previous sample; 0 or any other at the first, where it does not matter.
        actuation : ksi or kip, optional
            Friction is proportional to it; when left out, theta is used unchanged. To get
            a record's `force`, give the record's `reference_actuation` to `start`.
        scales : mapping of scalars or (n,), optional
            Factors of the parameters that follow the actuation, used instead of it.

        Returns
        -------
        (n,), kip, and the new state

        Raises
        ------
        FitError
            When a number is not finite, dt not positive, or actuation negative.
        """
        own = isinstance(state, State) and (state.damper.gap is not None) == self.has_gap
        check_state(state, State, self.name, own=own)
        state = state.step(displacement, velocity, dt, actuation, scales)
        return state.force, state


def _actuated(
    damper: Damper, actuation: float | None, scales: Mapping[str, ArrayLike] | None
) -> Friction:
    """Friction at a sample: proportional to its actuation, or by the given factors."""
    if scales is None:
        if actuation is None:
            return damper.friction
        share = actuation / (damper.reference or 1.0)
        if share == 1.0:
            return damper.friction
        scales = dict.fromkeys(FRICTION_FORCES, share)
    shares = check_shares(scales, ((), (damper.friction.vectors,)), ACTUATED)
    columns = {name: getattr(damper.friction, name) * share for name, share in shares.items()}
    return replace(damper.friction, **columns)
