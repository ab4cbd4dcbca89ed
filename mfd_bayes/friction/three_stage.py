"""The three-stage model: slip, stick and build-up, joined by smooth transitions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.friction.columns import named_columns
from mfd_bayes.friction.gap import (
    SATURATED,
    Gap,
    along,
    blend,
    dragged,
    edges_along,
    gap_of,
    turned,
)
from mfd_bayes.friction.lugre import PaperModel
from mfd_bayes.friction.model import Array, Columns, State
from mfd_bayes.friction.parameters import PARAMETERS, quantities_of
from mfd_bayes.friction.quantity import Quantity
from mfd_bayes.records.trace import Trace

PIECE = 1 << 15  # size of the arrays that are blended at a time, in numbers: they stay in the cache


@dataclass(frozen=True)
class ThreeStage(PaperModel):
    """Friction damper with a gap (Cao et al., Eqs. 1 to 4; model.md sections 2 to 4)."""

    name: ClassVar[str] = "three_stage"
    parameters: ClassVar[tuple[str, ...]] = PARAMETERS
    quantities: ClassVar[tuple[Quantity, ...]] = quantities_of(PARAMETERS)
    has_gap: ClassVar[bool] = True
    keeps_prior: ClassVar[tuple[str, ...]] = ("gamma1",)  # only ℓ = γ2/γ1 reaches the force

    def compute_force(self, c: Columns, trace: Trace, start: Array, factors: Columns) -> Array:
        """Force at the samples, (T, n), kip."""
        path, n = trace.path, start.size
        slip = self.slip_along(c, trace, factors)
        c = gap_of(c)
        gap = along(c, path, start, slip[path.turning_points])
        force, x, stretch = slip.take(path.samples, axis=0), trace.displacement, path.stretch
        # elsewhere the force is F1: the carried force has faded, and the gap is crossed
        far = SATURATED * c["ell"]
        low, high = (gap.edge - far).min(axis=1), (gap.edge + (c["width"] + far)).max(axis=1)
        (near,) = ((x >= low[stretch]) & (x <= high[stretch])).nonzero()
        length = max(PIECE // max(n, 1), 1)
        for begin in range(0, near.size, length):
            rows = near[begin : begin + length]
            side, origin, carry = (a[stretch[rows]] for a in (gap.side, gap.origin, gap.carry))
            force[rows] = blend(c, side, x[rows, None] - origin, carry, force[rows])
        return force

    def compute_travel(self, c: Columns, trace: Trace, start: Array) -> Array:
        """Travel u since the last slip, (T, n), in.

        From 0 to d2 + d3 the gap is crossed; beyond, the device slips.
        """
        gap, *_ = edges_along(gap_of(c), trace.path, start)
        own = trace.path.stretch
        return gap.side[own] * (trace.displacement[:, None] - gap.origin[own])

    def compute_end(self, c: Columns, trace: Trace, start: Array, factors: Columns) -> Array:
        """Place in the gap at the last sample, ½ + y/D, (n,), 1; see `Model.end`.

        A motion that begins there does not know the deflection of the bristles, the force that
        fades after an early turn, and, inside the gap, on which side the device last slipped: it
        takes the side that its first direction leads away from. All that is forgotten at its
        first turn after slip.
        """
        c = gap_of(c)
        gap, *_ = edges_along(c, trace.path, start)
        last = trace.path.displacement[-1]
        width, edge = c["width"], dragged(c, gap.edge[-1], last)
        place = np.divide(last - edge, width, out=np.full(edge.shape, 0.5), where=width > 0)
        return np.asarray(np.clip(place, 0.0, 1.0))

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
        travel, columns = self.travel(theta, trace, start), self.columns(theta)
        d2, d3 = columns["d2"][:, None], columns["d3"][:, None]
        return np.select([travel >= d2 + d3, travel >= d2], [1, 3], 2).astype(np.int8)

    def constants(self, c: Columns) -> dict[str, Any]:
        """Those of LuGre, and of the gap."""
        return super().constants(c) | gap_of(c)

    def begin(self, state: State, start: Array, direction: Array | None) -> Columns:
        """Undeflected bristles, and the gap at a share of its width."""
        memory = super().begin(state, start, direction)
        gap = Gap.begun(state.constants, state.displacement, memory["direction"], start)
        return memory | gap._asdict()

    def advance(
        self, state: State, displacement: Array, velocity: Array, dt: Array, scales: Columns
    ) -> Columns:
        """Bristles after a straight way, and gaps of those that turned before it."""
        memory = super().advance(state, displacement, velocity, dt, scales)
        back = memory["direction"] != state.memory["direction"]
        if back.any():
            c, x, direction = state.constants, state.displacement, memory["direction"]
            before = _gap(state)
            after = turned(c, before, x, state.memory["slip"], direction)
            moved = state.memory["moved"]
            if not moved.all():  # the direction was assumed, and was the other one
                begun = Gap.begun(c, x, direction, memory["start"])
                pairs = zip(after, begun, strict=True)
                after = Gap(*(np.where(moved, new, first) for new, first in pairs))
            pairs = zip(before, after, strict=True)
            memory |= Gap(*(np.where(back, new, old) for old, new in pairs))._asdict()
        return memory

    def total(self, state: State) -> Array:
        """Force of the three stages, (n,), kip."""
        gap = _gap(state)
        y = state.displacement - gap.origin
        return blend(state.constants, gap.side, y, gap.carry, state.memory["slip"])


def _gap(state: State) -> Gap:
    """Where the gaps of a state are."""
    return Gap(*(state.memory[name] for name in Gap._fields))
