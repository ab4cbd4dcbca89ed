"""Deflection of a spring whose slip sets in smoothly, for a whole motion at once.

In direction s the deflection ζ = s z follows dζ/dξ = f(ζ) = 1 − (G/g)₊ⁿ along the way ξ
(model.md section 9). A step h is taken by the two-point Hermite rule, which is of fourth order,

    ζ₁ = ζ₀ + h/2 (f₀ + f₁) + h²/12 (f₀′ f₀ − f₁′ f₁),

and all steps are solved together by Newton's method: each of its steps is a linear recurrence.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.recurrence import solve
from mfd_bayes.friction.spring import Spring

Array = NDArray[np.float64]
Chosen = NDArray[np.bool_]

CLOSE = 1e-6
"""Newton ends when its step is below this share of the length over which slip sets in.

It converges quadratically: what is left then is below a thousandth of that step.
"""

ITERATIONS = 40
"""Most of Newton's steps; four to six are the rule."""

FAR_OFF = 1.0
"""Such a step may have led beyond what friction can hold, and is cut there."""

CUTS = 6
"""Most times that this is done."""

TINY = 1e-12
"""Force, kip, that stands for one that does not push against friction."""

STIFF = 8.0
"""A step longer than this many lengths over which slip sets in ends in slip, or slides none."""

OVER = 1.0
"""Largest n ln(G/g) at which a step begins: what is above, after friction fell, goes at once."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Short steps of a motion, time first.

    Attributes
    ----------
    way : (R, 1) or (R, n), in
        Length of each step, 0 or more.
    sign : (R, 1)
        +1 or −1, the direction; also of a step of length zero.
    limit : (R, n)
        n ln g, of the slip force g in each step, kip.
    bound : (R, n), in
        About the deflection s z in slip.
    most : (R, n) or (1, n), in
        Deflection beyond `bound` that no step ends with.
    stiff : (R, n) or None
        Steps that are far too long for the rule.
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

    @cached_property
    def turned(self) -> NDArray[np.intp]:
        """First step of each stretch in one direction."""
        first = np.ones(len(self.sign), dtype=bool)
        np.not_equal(self.sign[1:, 0], self.sign[:-1, 0], out=first[1:])
        return np.flatnonzero(first)


@dataclass(frozen=True, eq=False)
class Material:
    """What does not change along the motion, (n,) each: spring, n, and 1/length of slip, 1/in."""

    spring: Spring
    exponent: Array
    rate: Array


def advance(material: Material, rows: Rows, first: Array) -> tuple[Array, Array]:
    """Spring force after each step, (R, n), kip, and the last deflection, (n,), in.

    Parameters
    ----------
    first : (n,), in
        Deflection before the first step.
    """
    z = np.empty((len(rows.sign) + 1, first.size))
    z[0] = first
    _guess(material, rows, z)
    for done in range(ITERATIONS):
        force, slope = material.spring.evaluate(z)
        decay, drive = _linear(material, rows, z, force, slope)
        step = solve(decay, drive, np.zeros(first.size))
        z[1:] += step
        most = np.maximum(step.max(axis=0), -step.min(axis=0))
        size = np.max(most * material.rate)
        if not size > CLOSE:
            break
        if size > FAR_OFF and done < CUTS:
            _bring_back(rows, z)
    slope = slope[1:]
    slope *= step
    force = force[1:]
    force += slope
    return force, z[-1]


def _guess(material: Material, rows: Rows, z: Array) -> None:
    """Fill z[1:] with about the deflection: unloading, with a rounded corner where slip sets in."""
    starts = rows.turned.tolist()
    for begin, end in zip(starts, [*starts[1:], len(rows.sign)], strict=True):
        sign = rows.sign[begin, 0]
        bound, way = rows.bound[begin:end], np.cumsum(rows.way[begin:end], axis=0)
        room = bound - way
        room -= sign * z[begin]
        slips = (room[0] * material.rate < 1.0) | rows.uneven
        bend = room * room  # about a softplus, which is as wide as the onset of slip
        bend += 2.0 / material.rate**2
        np.sqrt(bend, out=bend)
        bend += room
        bend *= 0.5
        np.subtract(bound, bend, out=bend)
        if np.any(slips):  # already: what remains of the corner is sharp
            bend[:, slips] = _slider(bound, way, sign * z[begin])[:, slips]
        np.multiply(bend, sign, out=z[begin + 1 : end + 1])


def _slider(bound: Array, way: Array, first: Array) -> Array:
    """Deflection were slip to set in at once, (R, n)."""
    room = bound - way
    np.minimum(room[0], first, out=room[0])
    np.minimum.accumulate(room, axis=0, out=room)
    room += way
    return room


def _bring_back(rows: Rows, z: Array) -> None:
    ahead = rows.sign * z[1:]
    np.minimum(ahead, rows.bound + rows.most, out=ahead)
    np.multiply(rows.sign, ahead, out=z[1:])


def _linear(
    material: Material, rows: Rows, z: Array, force: Array, slope: Array
) -> tuple[Array, Array]:
    """Newton's recurrence δ_k = decay_k δ_{k−1} + drive_k for z + δ, (R, n) each."""
    n = material.exponent
    (log0, b0), (log1, b1) = _pushes(material, rows, force, slope)
    over = _let_go(material, rows, log0, b0) if np.max(log0) > OVER else None
    p0 = np.exp(log0, out=log0)
    p1 = np.exp(np.minimum(log1, STIFF, out=log1), out=log1)
    c0, c1 = b0 * p0, b1 * p1
    f0, f1 = np.subtract(1.0, p0, out=p0), np.subtract(1.0, p1, out=p1)
    # c = −h f′, so the rule's weights of f₀ and f₁ are 1/2 ∓ c/12
    gain = _weighted(c0, -1.0 / 12.0, f0)
    gain += _weighted(c1, 1.0 / 12.0, f1)
    gain *= rows.way * rows.sign
    gain += z[:-1] if over is None else np.where(over[0], over[1], z[:-1])
    gain -= z[1:]
    decay, own = _slope(c0, f0, b0, n), _slope(c1, f1, b1, n)
    c0 *= 0.5
    decay -= c0
    decay += 1.0
    c1 *= 0.5
    own += c1
    own += 1.0
    decay /= own
    gain /= own
    if over is not None:
        decay[over[0]] = 0.0
    if rows.stiff is not None:
        _slide(material, rows, z, decay, gain)
    return decay, gain


def _weighted(c: Array, twelfth: float, f: Array) -> Array:
    found = c * twelfth
    found += 0.5
    found *= f
    return found


def _slope(c: Array, f: Array, b: Array, n: Array) -> Array:
    """Derivative of h² f′ f/12, with that of the spring's stiffness left out; in `b`."""
    b *= f
    b *= 1.0 - 1.0 / n
    np.subtract(c, b, out=b)
    b *= c
    b *= 1.0 / 12.0
    return b


def _pushes(
    material: Material, rows: Rows, force: Array, slope: Array
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Logarithm of (G/g)ⁿ, and n h G′/G, before and after each step, (R, n) each."""
    n, start = material.exponent, rows.turned
    after = _push(rows.sign * force[1:], slope[1:], n)
    before = np.empty_like(after[0]), np.empty_like(after[1])
    for old, new in zip(before, after, strict=True):
        old[1:] = new[:-1]
    turn = _push(rows.sign[start] * force[start], slope[start], n)
    for old, new in zip(before, turn, strict=True):
        old[start] = new
    for log, share in (before, after):
        log -= rows.limit
        share *= rows.way
    return before, after


def _push(ahead: Array, slope: Array, n: Array) -> tuple[Array, Array]:
    """N ln G and n G′/G where G pushes against the motion; `ahead` is overwritten."""
    share = slope * n
    share *= ahead > 0
    np.maximum(ahead, TINY, out=ahead)
    share /= ahead
    np.log(ahead, out=ahead)
    ahead *= n
    return ahead, share


def _let_go(material: Material, rows: Rows, log: Array, share: Array) -> tuple[Chosen, Array]:
    """Steps that begin beyond slip, (R, n), and their deflections once that is let go, in.

    There n ln(G/g) and n h G′/G, `log` and `share`, become those of that deflection.
    """
    over = (log > OVER) & (rows.way > 0)  # at rest nothing is let go
    row, column = np.nonzero(over)
    spring, n = material.spring.of(column), material.exponent[column]
    sign = rows.sign[row, 0]
    level = np.exp((rows.limit[row, column] + OVER) / n)
    z = np.zeros(over.shape)
    z[over] = spring.deflection(sign * level)
    np.minimum(log, OVER, out=log)
    way = np.broadcast_to(rows.way, over.shape)[over]
    share[over] = n * way * spring.evaluate(z[over])[1] / level
    return over, z


def _slide(material: Material, rows: Rows, z: Array, decay: Array, drive: Array) -> None:
    """Recurrence of the stiff steps: slip sets in at once."""
    stiff = np.asarray(rows.stiff)
    row, column = np.nonzero(stiff)
    sign = rows.sign[row, 0]
    level = np.exp(rows.limit[stiff] / material.exponent[column])
    slip = sign * material.spring.of(column).deflection(sign * level)
    ahead = sign * z[:-1][stiff] + np.broadcast_to(rows.way, stiff.shape)[stiff]
    decay[stiff] = ahead < slip
    drive[stiff] = sign * np.minimum(ahead, slip) - z[1:][stiff]
