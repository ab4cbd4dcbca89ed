"""The three-stage model: slip, stick and build-up, joined by smooth transitions.

The gap is a play operator that remembers on which side it last slipped. It lies between the
displacements `edge` and `edge` + D and is crossed in the direction `side` = ±1; `origin` is where
the travel u since the last slip is 0: the edge forward, the other end backward. `carry` is the jump
of the force, kip, at the last turning point, which fades as the gap is crossed. The formulas
broadcast: stretches of a record (K, n) or samples (N, n) against parameters (n,), or a step's (n,)
against (n,).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit

from mfd_bayes.friction.lugre import PARAMETERS, PIECE, PaperModel, solve
from mfd_bayes.friction.model import Columns, State
from mfd_bayes.friction.quantity import Array, named_columns, sampled_for
from mfd_bayes.records.trace import MotionPath, Trace

SATURATED = 26.0
"""Transition lengths after which a transition is taken as complete: exp(−26) is 5e-12."""

FARTHEST = 150.0
"""Exponents are limited to it, so that the product of three exponentials is a number. Up to a gap
of as many transition lengths one exponential serves all three transitions."""

Constants = Mapping[str, Any]


def gap_of(columns: Mapping[str, Array]) -> dict[str, Any]:
    """What the formulas need of a model's columns, (n,) each.

    `early` and `late` are d2/ℓ and D/ℓ; only ℓ = γ2/γ1 reaches the force. `build_up` is the weight
    of stage 3 less that of slip at a turn, and `jump` the force of stage 3 there.
    """
    k2, k3, d2 = (columns[name] for name in ("k2", "k3", "d2"))
    width, ell = d2 + columns["d3"], columns["gamma2"] / columns["gamma1"]
    early, late = d2 / ell, width / ell
    return {
        "k2": k2,
        "k3": k3,
        "width": width,
        "ell": ell,
        "early": early,
        "late": late,
        "build_up": expit(late) * expit(-early),
        "jump": (k2 - k3) * d2,
        "after": np.exp(-np.stack([early, late])),
        "sharp": bool(late.max() > FARTHEST),
    }


class Gap(NamedTuple):
    """State of the gap, (n,), or in each stretch between turning points, (K + 1, n)."""

    side: Array
    edge: Array
    origin: Array
    carry: Array

    @classmethod
    def at(cls, c: Constants, side: Array, edge: Array, carry: Array) -> Gap:
        """The state, with its origin."""
        return cls(side, edge, np.where(side > 0.0, edge, edge + c["width"]), carry)

    @classmethod
    def begun(cls, c: Constants, displacement: Array, direction: Array, start: Array) -> Gap:
        """State before the first turning point; `start` is u/D along the first direction."""
        behind = np.where(direction > 0.0, start, 1.0 - start)
        edge = displacement - behind * c["width"]
        return cls.at(c, direction, edge, np.zeros(edge.shape))


def blend(c: Constants, side: Array, y: Array, carry: Array | float, slip: Array) -> Array:
    """Force of the three stages, kip, of the force F1 in slip (paper Eqs. 1 and 2).

    With R = exp(u/ℓ) the weights (model.md section 4) are m12 = (R − 1)/(R + 1) for u ≥ 0,
    m23 = A/(1 + A) with A = R exp(−d2/ℓ) and m31 = B/(1 + B) with B = R exp(−D/ℓ), so that with
    q = (R + 1)/2

        F − F1 = {q [A (F3 − F1) + (F2 − F1)] − (F2 − F1)} / ((1 + A)(1 + B) q) + ΔF/q

    For u < 0 m12 is 0, as if R were 1 in q, and ΔF fades with |u|.

    y is the displacement from the origin, in, so that F2 = k2 y and F3 = k3 y + side (k2 − k3) d2;
    `carry` is the jump ΔF at the last turn, kip.
    """
    u = side * y
    u /= c["ell"]
    if c["sharp"]:
        a, b = (np.exp(np.minimum(u - c[at], FARTHEST)) for at in ("early", "late"))
    r = np.maximum(np.minimum(u, FARTHEST, out=u), -SATURATED, out=u)
    np.exp(r, out=r)
    if not c["sharp"]:
        a, b = r * c["after"][0], r * c["after"][1]
    fading = np.maximum(r, 1.0 / r)
    fading += 1.0
    q = np.maximum(r, 1.0, out=r)
    q += 1.0
    q *= 0.5
    stick = c["k2"] * y
    stick -= slip
    force = c["k3"] * y
    force += side * c["jump"]
    force -= slip
    force *= a
    force += stick
    force *= q
    force -= stick
    a += 1.0
    b += 1.0
    a *= b
    a *= q
    force /= a
    force += 2.0 * carry / fading
    force += slip
    return np.asarray(force)


def dragged(c: Constants, edge: Array, at: Array) -> Array:
    """Edge of the gap after a turn: motion beyond either end drags the gap along."""
    return np.asarray(np.minimum(np.maximum(edge, at - c["width"]), at))


def left_over(
    c: Constants, before: Gap, at: Array, slip: Array, direction: Array
) -> tuple[Array, Array]:
    """Blended force before minus after a turn after slip, kip, without the carry; and its fading.

    After such a turn into `direction` the travel restarts at 0.
    """
    y = at - before.origin
    u = before.side * y
    left = c["build_up"] * (slip - direction * c["jump"])
    soon = u < c["width"] + SATURATED * c["ell"]
    if soon.any():
        left = np.where(soon, left + (blend(c, before.side, y, 0.0, slip) - slip), left)
    return left, 1.0 - np.tanh(np.abs(u) / (2.0 * c["ell"]))


def turned(c: Constants, before: Gap, at: Array, slip: Array, direction: Array) -> Gap:
    """State after a turn of each device at a displacement into a direction, (n,) each.

    After slip (u ≥ D or u ≤ 0) the travel restarts at 0, and the force before minus the force
    after that is carried on. Inside the gap nothing is reset, so that the force retraces.
    """
    edge = dragged(c, before.edge, at)
    slipped = (edge == at) | (edge == at - c["width"])
    left, fading = left_over(c, before, at, slip, direction)
    carry = np.where(slipped, fading * before.carry + left, before.carry)
    return Gap.at(c, np.where(slipped, direction, before.side), edge, carry)


def edges_along(
    c: Constants, path: MotionPath, start: Array
) -> tuple[Gap, NDArray[np.bool_], Array]:
    """As `along`, without the carry; whether each turn ends a slip, and the directions after."""
    x = path.displacement[path.turning_points]
    first = Gap.begun(c, path.displacement[0], np.full(start.size, float(path.direction)), start)
    edge = np.empty((x.size + 1, start.size))
    edge[0], beyond = first.edge, x[:, None] - c["width"]
    for k, place in enumerate(x.tolist()):
        np.maximum(edge[k], beyond[k], out=edge[k + 1])
        np.minimum(edge[k + 1], place, out=edge[k + 1])
    slipped = (edge[1:] == x[:, None]) | (edge[1:] == beyond)
    direction = np.where(np.arange(x.size + 1) % 2, -1.0, 1.0)[:, None] * path.direction
    latest = np.zeros(edge.shape, dtype=np.intp)  # turn that set the side of each stretch
    np.multiply(slipped, np.arange(1, x.size + 1)[:, None], out=latest[1:])
    np.maximum.accumulate(latest, axis=0, out=latest)
    side = direction[latest, 0]
    return Gap.at(c, side, edge, np.zeros(edge.shape)), slipped, direction[1:]


def along(c: Constants, path: MotionPath, start: Array, slip: Array) -> Gap:
    """State in every stretch between turning points, (K + 1, n), as `turned` at each of them.

    `start` is u/D at the first sample, (n,), and `slip` F1 at the turning points, (K, n), kip.
    """
    gap, slipped, direction = edges_along(c, path, start)
    x = path.displacement[path.turning_points, None]
    if len(x):
        before = Gap(*(column[:-1] for column in gap))
        left, fading = left_over(c, before, x, slip, direction)
        fading[~slipped], left[~slipped] = 1.0, 0.0
        gap.carry[1:] = solve(fading, left, gap.carry[0])
    return gap


@dataclass(frozen=True)
class ThreeStage(PaperModel):
    """Friction damper with a gap (Cao et al., Eqs. 1 to 4; model.md sections 2 to 4)."""

    name = "three_stage"
    parameters = PARAMETERS
    quantities = sampled_for(PARAMETERS)
    has_gap = True
    keeps_prior = ("gamma1",)  # only ℓ = γ2/γ1 reaches the force

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
        length = max(PIECE // n, 1)
        for begin in range(0, near.size, length):
            rows = near[begin : begin + length]
            side, origin, carry = (a[stretch[rows]] for a in (gap.side, gap.origin, gap.carry))
            force[rows] = blend(c, side, x[rows, None] - origin, carry, force[rows])
        return force

    def compute_travel(self, c: Columns, trace: Trace, start: Array, factors: Columns) -> Array:
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
