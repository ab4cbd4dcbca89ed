"""The three-stage model: slip, stick and build-up, joined by smooth transitions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.friction.bristles import friction_of, slip_force
from mfd_bayes.friction.columns import named_columns
from mfd_bayes.friction.evaluation import check_start
from mfd_bayes.friction.gap import follow, place_at_end, travel
from mfd_bayes.friction.paper import ACTUATED, PARAMETERS, actuate, check_theta, quantities_of
from mfd_bayes.friction.quantity import Quantity
from mfd_bayes.friction.stepping import Damper, State, Stepped
from mfd_bayes.friction.transitions import Gap, Transitions, blend
from mfd_bayes.friction.yield_shares import shares_along
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]


FEW = 1 << 12
"""Of fewer numbers, preparing the blend would take longer than blending."""


@dataclass(frozen=True)
class ThreeStage(Stepped):
    """Friction damper with a gap (Cao et al., Eqs. 1 to 4; model.md sections 2 to 4)."""

    name: ClassVar[str] = "three_stage"
    parameters: ClassVar[tuple[str, ...]] = PARAMETERS
    quantities: ClassVar[tuple[Quantity, ...]] = quantities_of(PARAMETERS)
    has_gap: ClassVar[bool] = True
    keeps_prior: ClassVar[tuple[str, ...]] = ("gamma1",)  # only ℓ = γ2/γ1 reaches the force

    def force(
        self,
        theta: ArrayLike,
        trace: Trace,
        start: ArrayLike | None = None,
        *,
        scales: Mapping[str, Array] | None = None,
    ) -> Array:
        """Force of every parameter vector (n, 14), (n, T), kip; see `Model.force`."""
        columns = check_theta(self, theta)
        n = columns["k2"].shape[1]
        w0 = check_start(start, n)
        columns = actuate(columns, trace, scales)
        return _force(columns, trace, w0).T

    def travel(self, theta: ArrayLike, trace: Trace, start: ArrayLike | None = None) -> Array:
        """Travel u since the last slip of every parameter vector, (n, T), in.

        From 0 to d2 + d3 the gap is crossed; beyond, the device slips.
        """
        columns = check_theta(self, theta)
        return travel(_gap(columns), trace.path, check_start(start, columns["k2"].shape[1])).T

    def end(
        self,
        theta: ArrayLike,
        trace: Trace,
        start: ArrayLike | None = None,
        *,
        scales: Mapping[str, Array] | None = None,
    ) -> Array:
        """Place in the gap at the last sample, ½ + y/D, (n,), 1; see `Model.end`.

        A motion that begins there does not know the deflection of the bristles, the force that
        fades after an early turn, and, inside the gap, on which side the device last slipped: it
        takes the side that its first direction leads away from. All that is forgotten at its
        first turn after slip.
        """
        columns = check_theta(self, theta)
        w0 = check_start(start, columns["k2"].shape[1])
        if scales is not None:
            shares_along(scales, trace, w0.size, ACTUATED)
        return place_at_end(_gap(columns), trace.path, w0)

    def start_at(
        self,
        place: Array,
        trace: Trace,
        before: ArrayLike | None = None,
        theta: ArrayLike | None = None,
    ) -> Array:
        """`start` of a motion at a place in the gap, (n,): it counts along its first direction."""
        return place if trace.path.direction > 0 else 1.0 - place

    def gap(self, values: Mapping[str, Array]) -> Array:
        """Width of the gap, D = d2 + d3, (n,), in."""
        own = named_columns(values, ("d2", "d3"))
        return own["d2"] + own["d3"]

    def stages(
        self, theta: ArrayLike, trace: Trace, start: ArrayLike | None = None
    ) -> NDArray[np.int8]:
        """Stage at each sample, (n, T): 1 slip, 2 stick, 3 build-up; see `Model.stages`."""
        travel = self.travel(theta, trace, start)
        d2, d3 = self.vectors(theta).T[[PARAMETERS.index(name) for name in ("d2", "d3")], :, None]
        return np.select([travel >= d2 + d3, travel >= d2], [1, 3], 2).astype(np.int8)

    def start(
        self,
        theta: ArrayLike,
        start: ArrayLike | None = None,
        *,
        direction: int | None = None,
        reference_actuation: float | None = None,
    ) -> State:
        """State of every parameter vector before the first sample of a motion.

        Parameters
        ----------
        theta, start
            As in `force`.
        direction : int, optional
            +1 or -1, that of the first motion; by default that of the first velocity.
        reference_actuation : float, ksi or kip, optional
            Actuation to which theta belongs; by default that of the first step.
        """
        columns = check_theta(self, theta)
        w0 = check_start(start, columns["k2"].shape[1])
        damper = Damper(friction_of(columns), _gap(columns), w0, direction, reference_actuation)
        return State.at_rest(damper)


def _gap(columns: dict[str, Array]) -> Gap:
    k2, k3, d2, d3 = (columns[name][0] for name in ("k2", "k3", "d2", "d3"))
    return Gap(k2, k3, d2, d3, (columns["gamma2"] / columns["gamma1"])[0])


def _force(columns: dict[str, Array], trace: Trace, start: Array) -> Array:
    """Force with time first, (T, n), kip."""
    path = trace.path
    force, at_turns = slip_force(friction_of(columns), path)
    gap = _gap(columns)
    crossing = follow(gap, path, start, at_turns)
    near = crossing.near(gap, trace.displacement, path.stretch)
    if near.size * start.size < FEW:
        part = force[near]
        blend(gap, crossing, path.stretch[near], trace.displacement[near], part)
        force[near] = part
    else:
        Transitions.of(gap, crossing).blend(path.stretch, trace.displacement, near, force)
    return force
