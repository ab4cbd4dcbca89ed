"""Transitions between the three stages: slip, stick, build-up and slip again."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.arrays import Along, rows_of, scratch

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

SATURATED = 26.0
"""Transition lengths after which a transition is taken as complete: exp(−26) is 5e-12."""

SHARP = 150.0
"""Gap width, in transition lengths, above which each transition has an exponential of its own.

Up to it exp(u/ℓ) serves all three.
"""

FARTHEST = 200.0
"""Exponents u/ℓ are limited to this, so that the product of three exponentials is a number.

All transitions are complete there, to exp(SHARP − FARTHEST).
"""

LARGEST = 300.0
"""Exponents above 0 are limited to this where each transition has its own."""

PART = 1 << 14
"""Size of the arrays that are blended at a time: eight of them fit into the second cache."""

SIDES = np.array([1.0, -1.0])
"""Sides of the first two kinds of stretches."""

HALF = -math.log(2.0)
"""Logarithm of ½."""


@dataclass(frozen=True)
class Gap:
    """Parameters of the gap and of the transitions, (n,) each.

    `transition` is ℓ = γ2/γ1 in inches: only this quotient reaches the force.
    """

    k2: Array
    k3: Array
    d2: Array
    d3: Array
    transition: Array

    @property
    def width(self) -> Array:
        """D = d2 + d3, (n,), in."""
        return self.d2 + self.d3

    @property
    def sharp(self) -> bool:
        """Whether any vector's transition is very short compared with its gap."""
        return bool(np.any(self.width > SHARP * self.transition))


@dataclass(frozen=True)
class Crossing:
    """State of the gap in each monotone stretch of motion, (K + 1, n) each.

    The gap lies between the displacements `edge` and `edge` + D. It is crossed in the
    direction `side` = ±1, so that the travel since the last slip is u = x − edge forward and
    edge + D − x backward. `carry` is the jump of the force, kip, at the last turning point,
    which fades as the gap is crossed.
    """

    side: Array
    edge: Array
    carry: Array

    def origin(self, gap: Gap) -> Array:
        """Displacement at which the travel is 0, (K + 1, n), in."""
        return np.where(self.side > 0, self.edge, self.edge + gap.width)

    def near(self, gap: Gap, displacement: Array, stretch: Rows) -> Rows:
        """Samples at which some vector is inside a transition or the gap, (N,), int.

        Elsewhere the force is F1: the carried force has faded, and the gap is crossed.

        Parameters
        ----------
        displacement : (T,), in
        stretch : (T,), int
            Stretch to which each sample belongs.
        """
        margin = SATURATED * gap.transition
        low = (self.edge - margin).min(axis=1)
        high = (self.edge + (gap.width + margin)).max(axis=1)
        return np.flatnonzero((displacement >= low[stretch]) & (displacement <= high[stretch]))


@dataclass(frozen=True)
class Transitions:
    """The three stages in every stretch of a motion, as straight lines in displacement.

    Displacement counts from `zero`, the first vector's origin in each stretch. After slip it is
    the origin of all, so that all such stretches in one direction have the same lines.

    Attributes
    ----------
    zero : (K + 1,), in
    kind : (K + 1,), int
        Number of each stretch's lines: 0 forward and 1 backward after slip, then the others.
    travel, stick, build_up : (kinds, 2, n), slope per in and value at zero, 1, kip and kip
        Lines of u/ℓ − ln 2, F2 and F3.
    carry : (K + 1, n), kip
    early, late : (n,), 1
        d2/ℓ and D/ℓ.
    shortest : float, in
        Least ℓ.
    sharp : bool
        See `Gap`.
    """

    zero: Array
    kind: Rows
    travel: Array
    stick: Array
    build_up: Array
    carry: Array
    early: Array
    late: Array
    shortest: float
    sharp: bool

    @classmethod
    def of(cls, gap: Gap, crossing: Crossing) -> Transitions:
        """Transitions of a gap that moves."""
        zero, kind, side, origin = _kinds(crossing.side, crossing.origin(gap))
        rate = side / gap.transition
        jump = side * ((gap.k2 - gap.k3) * gap.d2)
        return cls(
            zero=zero,
            kind=kind,
            travel=_lines(rate, HALF - rate * origin),
            stick=_lines(gap.k2, -gap.k2 * origin),
            build_up=_lines(gap.k3, jump - gap.k3 * origin),
            carry=crossing.carry,
            early=gap.d2 / gap.transition,
            late=gap.width / gap.transition,
            shortest=float(gap.transition.min()),
            sharp=gap.sharp,
        )

    def blend(self, stretch: Rows, displacement: Array, rows: Rows, force: Array) -> None:
        """Turn F1 into the force of the three stages at some samples.

        Parameters
        ----------
        stretch : (T,), int
            Stretch to which each sample belongs.
        displacement : (T,), in
        rows : (N,), int
            The samples, in their order.
        force : (T, n), kip
            F1, overwritten by F.
        """
        length = max(PART // force.shape[1], 1)
        room = scratch(8, min(length, rows.size), force.shape[1])
        room[0][:] = 2.0 * np.exp(-self.early)
        room[1][:] = 2.0 * np.exp(-self.late)
        stretch = stretch[rows]
        along = Along.of(self.kind[stretch], displacement[rows] - self.zero[stretch])
        bounds = self._bounds(along)
        for begin in range(0, rows.size, length):
            some = slice(begin, begin + length)
            part = rows[some]
            here = [array[: part.size] for array in room]
            together = part[-1] - part[0] < part.size
            if together:
                here[-1] = force[part[0] : part[-1] + 1]
            else:
                rows_of(force, part, out=here[-1])
            self._blend(along.part(some), stretch[some], here, bounds)
            if not together:
                force[part] = here[-1]

    def _blend(
        self, along: Along, stretch: Rows, room: list[Array], bounds: tuple[float, float]
    ) -> None:
        """Turn F1, the last array, into the force of the three stages.

        These are Eqs. 1 and 2 of the paper (model.md section 4). With R = exp(u/ℓ) the weights
        are m12 = (R − 1)/(R + 1) for u ≥ 0, m23 = A/(1 + A) with A = R exp(−d2/ℓ) and
        m31 = B/(1 + B) with B = R exp(−D/ℓ), so that with q = (R + 1)/2

            F − F1 = {q [A (F3 − F1) + (F2 − F1)] − (F2 − F1)} / ((1 + A)(1 + B) q) + ΔF/q

        For u < 0 (`backwards`) m12 is 0, as if R were 1 in q, and ΔF fades with |u|.
        """
        early, late, half, a, b, f3, work, force = room
        along.lines(self.travel, out=half, work=work)
        lowest, highest = bounds
        if along.index.max() > 1:
            lowest, highest = float(half.min()) - HALF, float(half.max()) - HALF
        backwards = lowest < -1e-9
        if backwards:
            np.maximum(half, HALF - SATURATED, out=half)
        if self.sharp:
            self._exponentials(half, a, b)
        else:
            if highest > FARTHEST:
                np.minimum(half, FARTHEST, out=half)
            np.exp(half, out=half)
            np.multiply(half, early, out=a)
            np.multiply(half, late, out=b)
        along.lines(self.build_up, out=f3, work=work)
        f3 -= force
        f3 *= a
        a += 1.0
        b += 1.0
        b *= a
        f2 = along.lines(self.stick, out=a, work=work)
        f2 -= force
        f3 += f2
        carry = rows_of(self.carry, stretch, out=work)
        if backwards:
            carry /= np.maximum(half, 0.25 / np.maximum(half, 1e-300)) + 0.5
            np.maximum(half, 0.5, out=half)
        half += 0.5
        f3 *= half
        f3 -= f2
        if not backwards:  # ΔF over the same divisor
            carry *= b
            f3 += carry
        b *= half
        f3 /= b
        if backwards:
            f3 += carry
        force += f3

    def _bounds(self, along: Along) -> tuple[float, float]:
        """Bounds of u/ℓ in the stretches where all vectors' origins are the same."""
        u = (along.place * SIDES[np.minimum(along.index, 1)])[along.index < 2]
        lowest, highest = np.min(u, initial=0.0), np.max(u, initial=0.0)
        return float(lowest) / self.shortest, float(highest) / self.shortest

    def _exponentials(self, half: Array, a: Array, b: Array) -> None:
        """A, B and, in place of its logarithm, R/2: each limited, since their range is wide."""
        np.exp(np.minimum(half - (HALF + self.early), SHARP), out=a)
        np.exp(np.minimum(half - (HALF + self.late), SHARP), out=b)
        np.exp(np.minimum(half, SHARP), out=half)


def _kinds(side: Array, origin: Array) -> tuple[Array, Rows, Array, Array]:
    """`zero` and `kind` of stretches, and sides and origins, counted from zero, of the kinds."""
    n = side.shape[1]
    zero = origin[:, 0].copy()
    apart = origin - zero[:, None]
    # origins that should be equal were computed in two ways
    same = 1e-15 * float(np.abs(origin).max())
    alike = np.abs(apart).max(axis=1) <= same
    alike &= side.min(axis=1) == side.max(axis=1)
    others = np.flatnonzero(~alike)
    kind = (side[:, 0] < 0).astype(np.intp)
    kind[others] = np.arange(2, 2 + others.size)
    sides, origins = np.empty((2 + others.size, n)), np.zeros((2 + others.size, n))
    sides[:2] = SIDES[:, None]
    sides[2:], origins[2:] = side[others], apart[others]
    return zero, kind, sides, origins


def _lines(slope: Array, values: Array) -> Array:
    table = np.empty((len(values), 2, values.shape[1]))
    table[:, 0], table[:, 1] = slope, values
    return table


def blend(gap: Gap, crossing: Crossing, stretch: Rows, displacement: Array, force: Array) -> None:
    """Turn F1 into the force of the three stages, as `Transitions`, at a few samples.

    It is written in E = 1/R, 1/A and 1/B, as plain formulas: of few samples preparing would
    take longer than blending.
    """
    side = crossing.side[stretch]
    u = side * (displacement[:, None] - crossing.origin(gap)[stretch])
    x = np.minimum(-u / gap.transition, SATURATED)
    e = np.exp(x)
    a = np.exp(np.minimum(x + gap.d2 / gap.transition, LARGEST))
    b = np.exp(np.minimum(x + gap.width / gap.transition, LARGEST))
    inside = np.minimum(e, 1.0)
    plus = 1.0 + inside
    stick = side * (gap.k2 * u) - force
    build_up = side * ((gap.k2 - gap.k3) * gap.d2 + gap.k3 * u) - force
    total = (a * (1.0 - inside) * stick + plus * build_up) * b / ((1.0 + a) * (1.0 + b))
    fading = np.minimum(e, 1.0 / np.maximum(e, 1e-300))
    force += total / plus + 2.0 * crossing.carry[stretch] * fading / (1.0 + fading)
