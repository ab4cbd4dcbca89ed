"""Any other model with slip weakening: friction that falls with the travel since a turn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.friction.columns import named_vectors
from mfd_bayes.friction.evaluation import check_state
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.quantity import Quantity
from mfd_bayes.friction.weakening import ENDINGS, QUANTITIES, SIDES, Sliding, fall_along
from mfd_bayes.friction.yield_shares import (
    check_level,
    check_reference,
    check_scales,
    check_step,
    reference_of,
)
from mfd_bayes.records.numbers import real_numbers
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]
Given = Mapping[str, ArrayLike]


@dataclass(frozen=True, eq=False)
class State:
    """State of n dampers that are stepped in time; `Weakened.step` returns a new one.

    Attributes
    ----------
    base : Any
        State of the model without weakening.
    weakening : mapping of str to (n,)
        w of each direction whose friction falls.
    reference : float, ksi or kip, or None
        Actuation that theta belongs to.
    sliding : Sliding
        Where the motion is.
    """

    base: Any
    weakening: Mapping[str, Array]
    reference: float | None = None
    sliding: Sliding = field(default_factory=Sliding)


@dataclass(frozen=True)
class Weakened(Model):
    """A model whose slip force falls with the travel since the last turn of the motion.

    In a direction whose friction falls, static and kinetic friction are multiplied by

        1 + w [exp(−u/λ) − exp(−1)],   λ = 0.5 in

    u is the travel since the last turn, or since the first sample; the motion alone fixes it. So
    the parameters are those at u = λ, half an inch after a turn. The slip force falls from
    1 + 0.63 w of that to 1 − 0.37 w: by w in all, and by 0.86 w over the first inch. While the
    damper moves the other way the factor is that of u = 0.

    Attributes
    ----------
    base : Model
    sides : tuple of str
        Of "fwd" and "bwd".
    """

    base: Model
    sides: tuple[str, ...] = SIDES

    def __post_init__(self) -> None:
        if len(self.base.slip_forces) != len(SIDES):
            raise FitError(
                f"the model {self.base.name} does not say which parameters are its slip forces, "
                "which a dependence on travel needs"
            )
        ending = next(end for end, sides in ENDINGS.items() if sides == self.sides)
        own = {
            "name": f"{self.base.name}+{ending}",
            "quantities": (*self.base.quantities, *self._own),
            "has_gap": self.base.has_gap,
            "keeps_prior": self.base.keeps_prior,
            "slip_forces": self.base.slip_forces,
        }
        laws = {name: dict(getattr(self.base, name)) for name in ("laws", "laws_from", "tied_laws")}
        for key, value in {**own, **laws}.items():
            object.__setattr__(self, key, value)

    @property
    def _own(self) -> tuple[Quantity, ...]:
        return tuple(QUANTITIES[side] for side in self.sides)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of theta's columns: those of the base, then the weakening."""
        return (*self.base.parameters, *(quantity.name for quantity in self._own))

    def friction(self, side: str) -> tuple[str, ...]:
        """Parameters of the base that are friction in slip in a direction."""
        slip = self.slip_forces[SIDES.index(side)]
        return (slip, *(name for name, kinetic in self.tied_laws.items() if kinetic == slip))

    def force(
        self,
        theta: ArrayLike,
        trace: Trace,
        start: ArrayLike | None = None,
        *,
        scales: Mapping[str, Array] | None = None,
    ) -> Array:
        """Force of every parameter vector, (n, p), (n, T), kip; see `Model.force`."""
        own, weakening = self.parts(theta)
        along = self._along(weakening, trace, scales)
        return self.base.force_unbounded(own, trace, start, scales=along)

    def _along(
        self, weakening: Mapping[str, Array], trace: Trace, scales: Mapping[str, Array] | None
    ) -> dict[str, Array]:
        """Factors of the base's parameters along a record, (n, T), with the weakening."""
        given: Given | None = scales
        if scales is None and trace.varying:
            given = self._by_actuation(trace.actuation, trace.reference_actuation)
        factors = {
            side: (1.0 + np.multiply.outer(fall_along(trace, side), w)).T
            for side, w in weakening.items()
        }
        return self.scaled(given, factors)

    def end(
        self,
        theta: ArrayLike,
        trace: Trace,
        start: ArrayLike | None = None,
        *,
        scales: Mapping[str, Array] | None = None,
    ) -> Array:
        """Place in the gap at the last sample, (n,), 1; that of the base."""
        own, weakening = self.parts(theta)
        along = self._along(weakening, trace, scales)
        return self.base.end(own, trace, start, scales=along)

    def start_at(
        self,
        place: Array,
        trace: Trace,
        before: ArrayLike | None = None,
        theta: ArrayLike | None = None,
    ) -> Array:
        """`start` of a motion at a place in the gap, (n,); that of the base."""
        own = [None if t is None else self.parts(t)[0] for t in (before, theta)]
        return self.base.start_at(place, trace, *own)

    def travel(self, theta: ArrayLike, trace: Trace, start: ArrayLike | None = None) -> Array:
        """Travel since the last slip, or turn, (n, T), in; that of the base."""
        return self.base.travel(self.parts(theta)[0], trace, start)

    def theta(self, values: Mapping[str, Array]) -> Array:
        """Parameters in their order, (n, p)."""
        own = named_vectors(values, [quantity.name for quantity in self._own])
        return np.column_stack([self.base.theta(values), *own.values()])

    def composed(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Those of the base."""
        return self.base.composed(names)

    def gap(self, values: Mapping[str, Array]) -> Array | None:
        """Width of the gap, (n,), in; None without a gap."""
        return self.base.gap(values)

    def crossing(self, values: Mapping[str, Array]) -> Array | None:
        """Travel from slip to slip, (n,), in."""
        return self.base.crossing(values)

    def unloaded(self, values: Mapping[str, Array]) -> tuple[Array, Array, Array] | None:
        """Part of the range of `start` without load; that of the base."""
        return self.base.unloaded(values)

    def stages(
        self, theta: ArrayLike, trace: Trace, start: ArrayLike | None = None
    ) -> NDArray[np.int8] | None:
        """Stage at each sample, (n, T), of the base without weakening."""
        return self.base.stages(self.parts(theta)[0], trace, start)

    def start(
        self,
        theta: ArrayLike,
        start: ArrayLike | None = None,
        *,
        direction: int | None = None,
        reference_actuation: float | None = None,
    ) -> State:
        """State of n dampers before their first sample; as that of the base.

        Raises
        ------
        FitError
            When a shape or a value does not fit, or the base cannot be stepped in time.
        """
        base: Any = self.base
        if not (hasattr(base, "start") and hasattr(base, "step")):
            raise FitError(f"the model {base.name} has no steps in time")
        own, weakening = self.parts(theta)
        reference = check_reference(reference_actuation)
        begun = base.start(own, start, direction=direction, reference_actuation=reference)
        return State(begun, weakening, reference, Sliding(direction or 0))

    def step(
        self,
        state: State,
        displacement: float,
        velocity: float,
        dt: float,
        actuation: float | None = None,
        *,
        scales: Given | None = None,
    ) -> tuple[Array, State]:
        """Force at the next sample, (n,), kip, and the state after it; as that of the base.

        It equals `force` if the trace has no reversal smaller than its hysteresis.

        Raises
        ------
        FitError
            When a number is not finite, dt not positive, the actuation negative, or a name
            or a value in `scales` does not fit.
        """
        own = isinstance(state, State) and tuple(state.weakening) == self.sides
        check_state(state, State, self.name, own=own)
        begun = state.sliding.begun
        displacement, velocity, dt = check_step(displacement, velocity, dt, first=not begun)
        sliding, reference = state.sliding.moved(displacement, velocity, dt), state.reference
        level = check_level(actuation)
        if level is not None:
            reference = reference_of(reference, level)
            scales = self._by_actuation(level, reference) if scales is None else scales
        factors = {side: 1.0 + sliding.fall(side) * w for side, w in state.weakening.items()}
        base: Any = self.base
        force, moved = base.step(
            state.base, displacement, velocity, dt, scales=self.scaled(scales, factors)
        )
        return force, replace(state, base=moved, reference=reference, sliding=sliding)

    def parts(self, theta: ArrayLike) -> tuple[Array, dict[str, Array]]:
        """Theta of the base, (n, p), and w of each direction, (n,).

        Raises
        ------
        FitError
            When the shape does not fit, or a w is not between -1 and 1.
        """
        values = self.vectors(theta)
        weakening = dict(zip(self.sides, values.T[-len(self.sides) :].copy(), strict=True))
        for side, w in weakening.items():
            bad = ~(np.abs(w) <= QUANTITIES[side].most)
            if np.any(bad):
                raise FitError(
                    f"parameter {QUANTITIES[side].name} must lie between -1 and 1, got {w[bad][0]}"
                )
        return values[:, : -len(self.sides)], weakening

    def scaled(self, scales: Given | None, factors: Mapping[str, Array]) -> dict[str, Array]:
        """Factors of the base's parameters: those given, times those of each direction.

        Raises
        ------
        FitError
            When they are not given by name, are no numbers, or a shape does not fit.
        """
        given = {} if scales is None else check_scales(scales)
        found = {k: real_numbers(f"scales of {k}", scale, FitError) for k, scale in given.items()}
        for side, factor in factors.items():
            for name in self.friction(side):
                try:
                    found[name] = factor * found[name] if name in found else factor
                except ValueError as error:
                    raise FitError(
                        f"scales of {name} must fit the shape {np.shape(factor)}, "
                        f"got {found[name].shape}"
                    ) from error
        return found

    def _by_actuation(
        self, actuation: float | Array, reference: float | None
    ) -> dict[str, ArrayLike]:
        """Friction in proportion to the actuation, as models have it where nothing is given."""
        share = np.asarray(actuation) / (reference or 1.0)
        names = [name for side in SIDES for name in self.friction(side)]
        return dict.fromkeys(names, share[None] if share.ndim else share)
