"""Deflection of a spring whose slip sets in smoothly, for a whole motion at once.

In direction s the deflection ζ = s z follows dζ/dξ = f(ζ) = 1 − (G/g)₊ⁿ along the way ξ
(model.md section 9). A step h is taken by the two-point Hermite rule, which is of fourth order,

    ζ₁ = ζ₀ + h/2 (f₀ + f₁) + h²/12 (f₀′ f₀ − f₁′ f₁),

and all steps are solved together by Newton's method: each of its steps is a linear recurrence.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.newton import CLOSE, LEFT, Index, Material, Steps, newton
from mfd_bayes.friction.recurrence import solve
from mfd_bayes.friction.spring import Spring

Array = NDArray[np.float64]

ITERATIONS = 100
"""Most of Newton's steps; three are the rule, and later ones are of few steps of the motion."""

FEWER = 0.8
"""Newton goes on with the unsolved steps alone when they are fewer than this share."""

FAR_OFF = 1.0
"""Error that Newton's method leaves, over the length in which slip sets in and on average over the
vectors, from which on it may have gone beyond what friction can hold: it is cut.
"""

FEW = 16
"""Vectors of which numpy finds a row's largest value faster along columns."""

CUTS = 6
"""Most times that this is done."""

ONWARD = 32
"""Steps after an unsolved one that are solved again with it where slip may set in at once: what
they do next depends on how it ends.
"""


@dataclass(frozen=True, eq=False)
class Rows:
    """Short steps of a motion, time first.

    Attributes
    ----------
    way, sign, limit, slip
        As in `Steps`.
    bound : (R, n), in
        About the deflection s z in slip.
    most : (R, n) or (1, n), in
        Deflection beyond `bound` that no step ends with.
    uneven : bool
        Whether the slip force follows an actuation.
    onset : (2, n), kip/in, or None
        See `Damper.onset`; None where the slip force follows an actuation.
    """

    way: Array
    sign: Array
    limit: Array
    bound: Array
    most: Array
    slip: Array | None = None
    uneven: bool = False
    onset: Array | None = None

    @property
    def sudden(self) -> bool:
        """Whether slip may set in at once, or a slip force may fall below the spring's force.

        What Newton's method leaves then says nothing of the steps that follow.
        """
        return self.uneven or self.slip is not None

    def steps(self, spring: Spring, first: Array) -> Steps:
        """All of them, from a deflection (n,), in."""
        start, before = np.zeros(1, dtype=np.intp), first[None]
        known = spring.evaluate(before)
        return Steps(self.way, self.sign, self.limit, self.slip, start, before, known)

    def some(self, spring: Spring, kept: Index, z: Array, first: Array) -> Steps:
        """Some of them; the deflections after all others, (R, n), in, are known."""
        breaks = np.append(0, 1 + np.flatnonzero(kept[1:] - kept[:-1] != 1))
        before = z[kept[breaks] - 1]
        if kept[0] == 0:
            before[0] = first
        slip = None if self.slip is None else self.slip[kept]
        parts = (self.way[kept], self.sign[kept], self.limit[kept])
        return Steps(*parts, slip, breaks, before, spring.evaluate(before))


def advance(material: Material, rows: Rows, first: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Spring force after each step, (R, n), kip, and the last deflection, (n,), in.

    Which vectors Newton's method could not solve comes third, (n,): their numbers mean nothing.

    Parameters
    ----------
    first : (n,), in
        Deflection before the first step.
    """
    steps = every = rows.steps(material.spring, first)
    z = _guess(material, rows, steps.starts, first)
    kept: Index | slice = slice(None)
    force, now = np.empty(z.shape), np.concatenate([first[None], z])
    error, lost = material.error, np.zeros(first.size, dtype=bool)
    for done in range(ITERATIONS):
        found, step, decay = newton(material, steps, now)
        now[1:] += step
        step *= step
        left = step @ error
        if not math.isfinite(left.max()):
            lost |= _give_up(step, now)
            error = np.where(lost, 0.0, error)
            left = step @ error
        cut = left.max() > FAR_OFF * first.size and done < CUTS
        if cut:
            _bring_back(rows, kept, now[1:])
        z[kept], force[kept] = now[1:], found
        if cut:
            continue
        moving = _unsolved(rows, left, decay)
        if not moving.size:
            if isinstance(kept, slice) or not rows.sudden:
                break
            kept, steps = slice(None), every  # the others may have moved on
            now = np.concatenate([first[None], z])
        elif moving.size < FEWER * left.size:
            kept = moving if isinstance(kept, slice) else kept[moving]
            steps = rows.some(material.spring, kept, z, first)
            now = np.concatenate([first[None], z[kept]])
    else:
        lost |= np.any(step * error > CLOSE**2, axis=0)
    return force, z[-1], lost


def _give_up(step: Array, z: Array) -> NDArray[np.bool_]:
    """Which vectors have gone beyond all numbers, (n,); they are set to 0, beside the others."""
    beyond: NDArray[np.bool_] = ~np.all(np.isfinite(step), axis=0)
    step[:, beyond] = z[:, beyond] = 0.0
    return beyond


def _unsolved(rows: Rows, left: Array, decay: Array) -> Index:
    """Steps that Newton's method would still move, by the errors that it leaves in each, (R,).

    An error goes on to the steps that follow, as far as it does not decay. Where slip may set in at
    once, `ONWARD` steps follow each that Newton's method has just moved.
    """
    if rows.sudden:
        moved = np.cumsum(left > CLOSE**2, dtype=np.intp)
        moved[ONWARD + 1 :] -= moved[: -ONWARD - 1].copy()
        return np.flatnonzero(moved)
    few = decay.shape[1] < FEW
    passed = np.ascontiguousarray(decay.T).max(axis=0) if few else decay.max(axis=1)
    np.clip(passed, 1e-20, 1.0, out=passed)
    passed = np.cumsum(np.log(passed, out=passed))
    own = np.log(np.maximum(left, 1e-300)) - passed
    return np.flatnonzero(passed + np.maximum.accumulate(own) > math.log(LEFT))


def _guess(material: Material, rows: Rows, starts: Index, first: Array) -> Array:
    """About the deflections, (R, n): unloading, a rounded corner where slip sets in, and slip."""
    ends = np.append(starts[1:], len(rows.sign))
    way = np.cumsum(rows.way, axis=0)
    stretch = np.repeat(np.arange(starts.size), ends - starts)
    way -= (way[starts] - rows.way[starts])[stretch]
    if rows.onset is None:
        return _sharp(rows, way, starts, ends, first)
    rate = _rates(material, rows, way, starts, ends)
    rates = rate[stretch]
    lag = _lag(rows, rates, starts)
    last, offset = first, np.empty(rate.shape)
    for k, (begin, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        sign, bound = rows.sign[begin, 0], rows.bound
        held = sign * last
        # a stretch that begins near slip has less of the corner ahead of it
        near = np.maximum((bound[begin] - held) * rate[k], 1e-300)
        offset[k] = held * rate[k] - np.log(-np.expm1(-near))
        room = (bound[end - 1] - way[end - 1]) * rate[k] - offset[k]
        late = np.where(room < 0, lag[end - 1], 0.0)
        last = sign * (bound[end - 1] - _corner(room, material.late) / rate[k] - late)
    room = rows.bound - way
    room *= rates
    room -= offset[stretch]
    lag *= room < 0
    bend = _corner(room, material.late)
    bend /= rates
    np.subtract(rows.bound, bend, out=bend)
    bend -= lag
    bend *= rows.sign
    return bend


def _rates(material: Material, rows: Rows, way: Array, starts: Index, ends: Index) -> Array:
    """1/length over which slip sets in, (K, n), 1/in, where it does in each of K stretches.

    That is about where the way since the turn is twice the deflection in slip.
    """
    onset, n = np.asarray(rows.onset), material.exponent
    about = 2.0 * rows.bound[starts].mean(axis=1)
    before = way[:, 0] < np.repeat(about, ends - starts)
    at = np.minimum(starts + np.add.reduceat(before, starts, dtype=np.intp), ends - 1)
    rates: Array = onset[(rows.sign[starts, 0] < 0).astype(np.intp)] * np.exp(-rows.limit[at] / n)
    return rates


def _lag(rows: Rows, rates: Array, starts: Index) -> Array:
    """Way by which deflections in slip follow late a slip force that changes, (R, n), in.

    A change comes with the beginning of a step, and decays over the length of slip, 1/`rates`.
    """
    decay = rows.way * rates
    np.exp(np.negative(decay, out=decay), out=decay)
    rise = np.diff(rows.bound, axis=0, prepend=rows.bound[:1])
    rise[starts] = 0.0
    rise *= decay
    decay[starts] = 0.0
    return solve(decay, rise, np.zeros(rates.shape[1]))


def _corner(room: Array, late: Array) -> Array:
    """Way by which friction holds back less than its bound, (R, n), at a room for it, overwritten.

    Both in lengths over which slip sets in.
    """
    e = np.abs(room)
    np.negative(e, out=e)
    np.exp(e, out=e)
    share = late + e
    share *= e
    e += 1.0
    share /= e
    np.log1p(share, out=share)
    np.maximum(room, 0.0, out=room)
    room += share
    return room


def _sharp(rows: Rows, way: Array, starts: Index, ends: Index, first: Array) -> Array:
    """About the deflections, (R, n), were slip to set in at once."""
    z, last = np.empty(rows.bound.shape), first
    for begin, end in zip(starts.tolist(), ends.tolist(), strict=True):
        part, sign = slice(begin, end), rows.sign[begin, 0]
        np.multiply(_slider(rows.bound[part], way[part], sign * last), sign, out=z[part])
        last = z[end - 1]
    return z


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
