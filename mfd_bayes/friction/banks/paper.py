"""A bank of LuGre or three-stage dampers (model.md sections 2 to 4)."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.friction.banks.bank import Array, Scales, with_rows, with_state
from mfd_bayes.friction.banks.gaps import Gaps, Places, blended, turned
from mfd_bayes.friction.banks.turns import Turns, turns_within
from mfd_bayes.friction.bristles import FLOOR, NO_STEP
from mfd_bayes.friction.paper import PaperModel, check_theta

Rows = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Bristles:
    """LuGre's parameters, (n,) each."""

    sigma0: Array
    sigma1: Array
    sigma2: Array
    Fs_fwd: Array
    Fc_fwd: Array
    Fs_bwd: Array
    Fc_bwd: Array
    v_s: Array

    @cached_property
    def drag(self) -> Array:
        """Viscous force over the velocity, σ1 + σ2."""
        return self.sigma1 + self.sigma2

    @cached_property
    def steady(self) -> tuple[Array, Array, Array, Array]:
        """Bristles' deflection in slow motion is `a` less than at rest by `b`: a, b of each way.

        The order is a forward, b forward, a backward, b backward; in.
        """
        stiff = np.maximum(self.sigma0, FLOOR)
        pairs = (self.Fs_fwd, self.Fc_fwd), (self.Fs_bwd, self.Fc_bwd)
        kinetic = [np.maximum(kinetic, FLOOR) for _, kinetic in pairs]
        excess = [np.maximum(s - k, 0.0) for (s, _), k in zip(pairs, kinetic, strict=True)]
        forward, backward = ((k / stiff, e / stiff) for k, e in zip(kinetic, excess, strict=True))
        return *forward, *backward

    def chosen(self, rows: Rows) -> Bristles:
        """Those of some dampers."""
        some = Bristles(*(getattr(self, name)[rows] for name in NAMES))
        some.__dict__["steady"] = tuple(column[rows] for column in self.steady)
        return some

    def scaled(self, scales: Scales) -> Bristles:
        """Those under a changed actuation."""
        return replace(self, **{name: getattr(self, name) * s for name, s in scales.items()})

    def midway(self, other: Bristles) -> Bristles:
        """Their mean with those of another sample."""
        if other is self:
            return self
        pairs = {f.name: (getattr(self, f.name), getattr(other, f.name)) for f in fields(self)}
        return Bristles(**{name: 0.5 * (a + b) for name, (a, b) in pairs.items()})


NAMES = tuple(field.name for field in fields(Bristles))


@dataclass(frozen=True, eq=False)
class PaperBank:
    """LuGre or three-stage dampers, each with its own motion; equals `Stepped.step` of each.

    Attributes
    ----------
    base, bristles : Bristles
        At the reference actuation, and at that of the last sample.
    gaps : Gaps or None
        None for LuGre alone.
    displacement, velocity, z, slip : (n,), in, in/s, in, kip
        `z` is the bristles' deflection, `slip` the force F1.
    direction : (n,)
        ±1.
    moved : (n,) bool
        Whether a damper has moved; before, its direction is assumed.
    places : Places or None
        State of each gap.
    start : (n,)
        Place in the gap at the start.
    """

    base: Bristles
    bristles: Bristles
    gaps: Gaps | None
    displacement: Array
    velocity: Array
    z: Array
    slip: Array
    direction: Array
    moved: NDArray[np.bool_]
    places: Places | None
    start: Array

    @classmethod
    def at_rest(
        cls,
        model: PaperModel,
        theta: ArrayLike,
        start: ArrayLike | None = None,
        direction: Array | None = None,
    ) -> PaperBank:
        """Dampers at rest at displacement 0, about to move forward unless a direction is given.

        Raises
        ------
        FitError
            When theta does not fit.
        """
        columns = {name: column[0] for name, column in check_theta(model, theta).items()}
        own = Bristles(**{f.name: columns[f.name] for f in fields(Bristles)})
        zero = np.zeros(own.v_s.size)
        one = np.ones(zero.size) if direction is None else direction
        begin = np.broadcast_to(0.5 if start is None else np.asarray(start), zero.shape)
        gaps = Gaps.of(columns) if model.has_gap else None
        places = None if gaps is None else Places.begun(gaps, zero, one, begin)
        still = np.full(zero.size, direction is not None)
        return cls(own, own, gaps, zero, zero, zero, zero, one, still, places, begin)

    @property
    def force(self) -> Array:
        """Force of each damper, (n,), kip."""
        if self.gaps is None or self.places is None:
            return self.slip
        return blended(self.gaps, self.places, self.displacement, self.slip)

    def step(
        self, displacement: Array, velocity: Array, dt: float, scales: Scales | None = None
    ) -> PaperBank:
        """State at the next sample; see `Bank.step`."""
        after = self.base if scales is None else self.base.scaled(scales)
        turns = turns_within(self.displacement, self.velocity, displacement, velocity, dt)
        bank, left = self, np.full(displacement.size, dt)
        if turns.rows.size:
            bank = self._to_turns(turns, dt, after)
            left[turns.rows] *= 1.0 - turns.share
        return bank._moved(displacement, velocity, left, after)

    def _to_turns(self, turns: Turns, dt: float, after: Bristles) -> PaperBank:
        """The bank with those that turn within a step at their vertices, at rest."""
        rows = turns.rows
        before = middle = self.bristles.chosen(rows)
        if after is not self.bristles:
            middle = _either(turns.share < 0.5, middle, after.chosen(rows))
        way = turns.vertex - self.displacement[rows]
        back = way * self.direction[rows] < 0
        bank = self
        if back.any():
            direction = self.direction.copy()
            direction[rows] = np.where(back, -direction[rows], direction[rows])
            turned_back = np.zeros(direction.size, dtype=bool)
            turned_back[rows] = back
            bank = replace(self, direction=direction, places=self._places(turned_back, direction))
        at_rest = np.zeros(rows.size)
        slip, z = _relaxed((before, middle), way, turns.share * dt, at_rest, self.z[rows])
        bristles = self.bristles
        if middle is not before or bristles is not self.base:
            bristles = with_state(bristles, NAMES, rows, middle)
        moved = self.moved.copy()
        moved[rows] |= way != 0.0
        return replace(
            bank,
            bristles=bristles,
            displacement=with_rows(self.displacement, rows, turns.vertex),
            velocity=with_rows(self.velocity, rows, 0.0),
            z=with_rows(self.z, rows, z),
            slip=with_rows(self.slip, rows, slip),
            moved=moved,
        )

    def _moved(self, displacement: Array, velocity: Array, dt: Array, after: Bristles) -> PaperBank:
        """State after a straight way of each damper, each in its own time, (n,) s."""
        way = displacement - self.displacement
        back = way * self.direction < 0
        direction, places = self.direction, self.places
        if back.any():
            direction = np.where(back, -direction, direction)
            places = self._places(back, direction)
        slip, z = _relaxed((self.bristles, after), way, dt, velocity, self.z)
        return PaperBank(
            self.base,
            after,
            self.gaps,
            displacement,
            velocity,
            z,
            slip,
            direction,
            self.moved | (way != 0.0),
            places,
            self.start,
        )

    def _places(self, back: NDArray[np.bool_], direction: Array) -> Places | None:
        """Gaps after the dampers that go `back` have turned, or begun the other way."""
        if self.gaps is None or self.places is None:
            return self.places
        places = self.places
        (rows,) = (back & self.moved).nonzero()
        if rows.size:
            new = turned(
                self.gaps.chosen(rows),
                places.chosen(rows),
                self.displacement[rows],
                direction[rows],
                self.slip[rows],
            )
            places = places.replaced(rows, new)
        (rows,) = (back & ~self.moved).nonzero()
        if rows.size:
            at = self.displacement[rows], direction[rows], self.start[rows]
            places = places.replaced(rows, Places.begun(self.gaps.chosen(rows), *at))
        return places

    def replaced(self, rows: Rows, part: PaperBank) -> PaperBank:
        """The bank with the state of some of its dampers replaced; see `Bank.replaced`."""
        names = ("displacement", "velocity", "z", "slip", "direction", "moved")
        places = self.places
        if places is not None and part.places is not None:
            places = places.replaced(rows, part.places)
        bristles = self.bristles
        if bristles is not self.base or part.bristles is not part.base:
            bristles = with_state(bristles, NAMES, rows, part.bristles)
        moved = with_state(self, names, rows, part)
        return replace(moved, places=places, bristles=bristles)

    def chosen(self, rows: Rows) -> PaperBank:
        """The bank of some of its dampers."""
        base = self.base.chosen(rows)
        return PaperBank(
            base,
            base if self.bristles is self.base else self.bristles.chosen(rows),
            None if self.gaps is None else self.gaps.chosen(rows),
            self.displacement[rows],
            self.velocity[rows],
            self.z[rows],
            self.slip[rows],
            self.direction[rows],
            self.moved[rows],
            None if self.places is None else self.places.chosen(rows),
            self.start[rows],
        )


def _either(early: NDArray[np.bool_], before: Bristles, after: Bristles) -> Bristles:
    """The parameters of the nearer sample."""
    return Bristles(
        *(np.where(early, getattr(before, f.name), getattr(after, f.name)) for f in fields(before))
    )


def _relaxed(
    bristles: tuple[Bristles, Bristles], way: Array, dt: Array, velocity: Array, z: Array
) -> tuple[Array, Array]:
    """Force F1 and deflection z after a step, (n,) kip and in; see `bristles.slip_force`.

    The bristles are those before and after the step.
    """
    before, after = bristles
    middle = before.midway(after)
    backward = way < 0.0
    kinetic_fwd, excess_fwd, kinetic_bwd, excess_bwd = middle.steady
    # the deflection that the bristles approach: sgn(v) g(v)/σ0
    steady = np.where(backward, excess_bwd, excess_fwd)
    steady *= np.exp(-np.square(way / (dt * middle.v_s)))
    steady += np.where(backward, kinetic_bwd, kinetic_fwd)
    step = way + NO_STEP  # never 0
    target = np.copysign(steady, step)
    z = target + np.exp(-np.abs(step) / steady) * (z - target)
    rate = np.abs(velocity) / steady * after.sigma1
    if before is not after:  # where the actuation fell while at rest, σ0 |z|/g is limited
        most = np.maximum(np.maximum(after.Fs_fwd, after.Fs_bwd), FLOOR)
        most = most / np.maximum(np.minimum(after.Fc_fwd, after.Fc_bwd), FLOOR)
        rate *= np.minimum(1.0, most / np.maximum(np.abs(z) / steady, 1e-300))
    slip = (after.sigma0 - rate) * z + after.drag * velocity
    return slip, z
