"""Deflection of a spring whose slip sets in smoothly, for a whole motion at once.

In direction s the deflection ζ = s z follows dζ/dξ = f(ζ) = 1 − (G/g)₊ⁿ along the way ξ
(model.md section 9). A step h is taken by the two-point Hermite rule, which is of fourth order,

    ζ₁ = ζ₀ + h/2 (f₀ + f₁) + h²/12 (f₀′ f₀ − f₁′ f₁),

and all steps are solved together by Newton's method: each of its steps is a linear recurrence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.newton import Chosen, Index, Material, Steps, newton
from mfd_bayes.friction.spring import Spring

Array = NDArray[np.float64]

CLOSE = 3e-6
"""A step of a motion is solved when Newton moves it by less than this share of the length over
which slip sets in. Newton converges quadratically: what is left then is below a hundredth of that.
"""

ITERATIONS = 40
"""Most of Newton's steps; four to six are the rule."""

FEWER = 0.8
"""Newton goes on with the unsolved steps alone when they are fewer than this share."""

SURE = 0.03
"""Newton's step, over the same length, below which a solved step of the motion stays solved."""

FAR_OFF = 1.0
"""Newton's step, over the same length, that may lead beyond what friction can hold: it is cut."""

TAIL = 24
"""Steps at the end of a stretch where the first guess follows the slip force late."""

SHORT = 4
"""In a stretch of no more steps than this it does not."""

CUTS = 6
"""Most times that this is done."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Short steps of a motion, time first.

    Attributes
    ----------
    way, sign, limit, stiff
        As in `Steps`.
    bound : (R, n), in
        About the deflection s z in slip.
    most : (R, n) or (1, n), in
        Deflection beyond `bound` that no step ends with.
    uneven : bool
        Whether the slip force follows an actuation.
    """

    way: Array
    sign: Array
    limit: Array
    bound: Array
    most: Array
    stiff: Chosen | None = None
    uneven: bool = False

    def steps(self, spring: Spring, first: Array) -> Steps:
        """All of them, from a deflection (n,), in."""
        start, before = np.zeros(1, dtype=np.intp), first[None]
        known = spring.evaluate(before)
        return Steps(self.way, self.sign, self.limit, self.stiff, start, before, known)

    def some(self, spring: Spring, kept: Index, z: Array, first: Array) -> Steps:
        """Some of them; the deflections after all others, (R, n), in, are known."""
        breaks = np.flatnonzero(np.diff(kept, prepend=-2) != 1)
        before = z[kept[breaks] - 1]
        if kept[0] == 0:
            before[0] = first
        stiff = None if self.stiff is None else self.stiff[kept]
        parts = (self.way[kept], self.sign[kept], self.limit[kept])
        return Steps(*parts, stiff, breaks, before, spring.evaluate(before))


def advance(material: Material, rows: Rows, first: Array) -> tuple[Array, Array]:
    """Spring force after each step, (R, n), kip, and the last deflection, (n,), in.

    Parameters
    ----------
    first : (n,), in
        Deflection before the first step.
    """
    steps = rows.steps(material.spring, first)
    z = _guess(material, rows, steps.starts, first)
    kept: Index | slice = slice(None)
    force, now, size = z.copy(), z, np.empty(0)
    for done in range(ITERATIONS):
        found, step = newton(material, steps, now)
        now += step
        np.abs(step, out=step)
        step *= material.rate
        size = step.max(axis=1)
        largest = size.max()
        if largest > FAR_OFF and done < CUTS:
            _bring_back(rows, kept, now)
        z[kept], force[kept] = now, found
        if not largest > CLOSE:
            break
        moving = np.flatnonzero(size > CLOSE)
        if largest < SURE and not rows.uneven and moving.size < FEWER * size.size:
            kept = moving if isinstance(kept, slice) else kept[moving]
            steps, now = rows.some(material.spring, kept, z, first), z[kept]
    return force, z[-1]


def _guess(material: Material, rows: Rows, starts: Index, first: Array) -> Array:
    """About the deflections, (R, n): unloading, with a rounded corner where slip sets in."""
    z = np.empty(rows.bound.shape)
    last = first
    ends = [*starts[1:].tolist(), len(z)]
    for begin, end in zip(starts.tolist(), ends, strict=True):
        sign = rows.sign[begin, 0]
        bound, way = rows.bound[begin:end], np.cumsum(rows.way[begin:end], axis=0)
        room = bound - way
        room -= sign * last
        slips = (room[0] * material.rate < 1.0) | rows.uneven
        bend = room * room  # about a softplus, which is as wide as the onset of slip
        bend += 2.0 / material.rate**2
        np.sqrt(bend, out=bend)
        bend += room
        bend *= 0.5
        np.subtract(bound, bend, out=bend)
        if slips.any():  # already: what remains of the corner is sharp
            bend[:, slips] = _slider(bound, way, sign * last)[:, slips]
        if end - begin > SHORT:
            tail = slice(-TAIL, None)
            slipped = np.where(room[tail][0] * material.rate < -1.0, 1.0, 0.0)
            _lag(bend[tail], bound[tail], way[tail], material.rate, slipped)
        np.multiply(bend, sign, out=z[begin:end])
        last = z[end - 1]
    return z


def _lag(z: Array, bound: Array, way: Array, rate: Array, slipped: Array) -> None:
    """Let deflections in slip, (R, n), in place, follow late a slip force that changes."""
    grown = np.exp(np.minimum((way - way[0]) * rate, 600.0))
    rise = np.diff(bound, axis=0)
    rise *= grown[1:]
    rise *= slipped
    np.cumsum(rise, axis=0, out=rise)
    rise /= grown[1:]
    z[1:] -= rise


def _slider(bound: Array, way: Array, first: Array) -> Array:
    """Deflection were slip to set in at once, (R, n)."""
    room = bound - way
    np.minimum(room[0], first, out=room[0])
    np.minimum.accumulate(room, axis=0, out=room)
    room += way
    return room


def _bring_back(rows: Rows, kept: Index | slice, z: Array) -> None:
    """Cut the deflections of some steps, in place, at the largest that friction can hold."""
    sign, bound = rows.sign[kept], rows.bound[kept]
    most = rows.most if len(rows.most) == 1 else rows.most[kept]
    ahead = sign * z
    np.minimum(ahead, bound + most, out=ahead)
    np.multiply(sign, ahead, out=z)
