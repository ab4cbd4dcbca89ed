"""One step of Newton's method on all steps of a motion together, for the backlash model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.arrays import scratch
from mfd_bayes.friction.recurrence import solve
from mfd_bayes.friction.spring import Spring

Array = NDArray[np.float64]
Chosen = NDArray[np.bool_]
Index = NDArray[np.intp]

TINY = 1e-12
"""Force, kip, that stands for one that does not push against friction."""

STIFF = 8.0
"""A step longer than this many lengths over which slip sets in ends in slip, or slides none."""

OVER = 1.0
"""Largest n ln(G/g) at which a step begins: what is above, after friction fell, goes at once."""


@dataclass(frozen=True, eq=False)
class Material:
    """What does not change along the motion, (n,) each: spring, n, and 1/length of slip, 1/in."""

    spring: Spring
    exponent: Array
    rate: Array


@dataclass(frozen=True, eq=False)
class Steps:
    """Some short steps of a motion, time first.

    Attributes
    ----------
    way : (R, 1) or (R, n), in
        Length of each step, 0 or more.
    sign : (R, 1)
        +1 or −1, the direction; also of a step of length zero.
    limit : (R, n)
        n ln g, of the slip force g in each step, kip.
    stiff : (R, n) or None
        Steps that are far too long for the rule.
    breaks : (B,), int
        Steps that do not follow the one before them here.
    first : (B, n), in
        Deflection before each of those.
    spring : (B, n), (B, n), kip, kip/in
        Force and stiffness of the spring there.
    """

    way: Array
    sign: Array
    limit: Array
    stiff: Chosen | None
    breaks: Index
    first: Array
    spring: tuple[Array, Array]

    @cached_property
    def starts(self) -> Index:
        """Steps that break, or turn."""
        found = np.ones(len(self.sign), dtype=bool)
        np.not_equal(self.sign[1:, 0], self.sign[:-1, 0], out=found[1:])
        found[self.breaks] = True
        return np.flatnonzero(found)

    def before(self, after: Array, out: Array) -> Array:
        """Deflection before each step, of that after each, written to `out`."""
        out[1:] = after[:-1]
        out[self.breaks] = self.first
        return out


def newton(material: Material, steps: Steps, z: Array) -> tuple[Array, Array]:
    """Force G of improved deflections, kip, and their improvement, in, (R, n) each.

    The force is valid until the next call.

    Parameters
    ----------
    z : (R, n), in
        Deflection after each step.
    """
    room = scratch(12, *z.shape)
    force, slope = material.spring.evaluate(z, room[:4])
    decay, drive = _linear(material, steps, z, (force, slope), room[2:])
    decay[steps.breaks] = 0.0
    step = solve(decay, drive, np.zeros(z.shape[1]))
    slope *= step
    force += slope
    return force, step


def _linear(
    material: Material, rows: Steps, z: Array, spring: tuple[Array, Array], room: list[Array]
) -> tuple[Array, Array]:
    """Newton's recurrence δ_k = decay_k δ_{k−1} + drive_k for z + δ, (R, n) each, in `room`."""
    n = material.exponent
    (log0, b0), (log1, b1) = _pushes(material, rows, spring, room[:4])
    over = _let_go(material, rows, log0, b0) if log0.max() > OVER else None
    p0 = np.exp(log0, out=log0)
    p1 = np.exp(np.minimum(log1, STIFF, out=log1), out=log1)
    c0, c1, t0, t1, gain, way = room[4:]
    np.multiply(b0, p0, out=c0)
    np.multiply(b1, p1, out=c1)
    f0, f1 = np.subtract(1.0, p0, out=p0), np.subtract(1.0, p1, out=p1)
    # c = −h f′: with all of the rule times 12, the weights of f₀ and f₁ are 6 ∓ c
    np.subtract(6.0, c0, out=t0)
    np.add(6.0, c1, out=t1)
    np.multiply(f0, t0, out=gain)
    gain += np.multiply(f1, t1, out=way)
    gain *= rows.way * rows.sign
    rows.before(z, out=way)
    if over is not None:
        np.copyto(way, over[1], where=over[0])
    way -= z
    way *= 12.0
    gain += way
    t0 += _bend(b0, f0, n)
    t0 *= c0
    decay = np.subtract(12.0, t0, out=t0)
    t1 -= _bend(b1, f1, n)
    t1 *= c1
    t1 += 12.0
    decay /= t1
    gain /= t1
    if over is not None:
        decay[over[0]] = 0.0
    if rows.stiff is not None:
        _slide(material, rows, (rows.before(z, out=way), z), (decay, gain))
    return decay, gain


def _bend(b: Array, f: Array, n: Array) -> Array:
    """Part h² f″ f of the derivative of h² f′ f over c, but for the spring's bend; in `b`."""
    b *= f
    b *= 1.0 - 1.0 / n
    return b


def _pushes(
    material: Material, rows: Steps, spring: tuple[Array, Array], room: list[Array]
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Logarithm of (G/g)ⁿ, and n h G′/G, before and after each step, (R, n) each."""
    n, start = material.exponent, rows.starts
    force, slope = spring
    ahead, share = np.multiply(rows.sign, force, out=room[0]), np.multiply(slope, n, out=room[1])
    after = push(ahead, share, n)
    before = room[2], room[3]
    for old, new in zip(before, after, strict=True):
        old[1:] = new[:-1]
    at = np.searchsorted(start, rows.breaks)
    known = [values[start - 1] for values in (force, slope)]
    for some, values in zip(known, rows.spring, strict=True):
        some[at] = values
    turn = push(rows.sign[start] * known[0], known[1] * n, n)
    for old, new in zip(before, turn, strict=True):
        old[start] = new
    for log, share in (before, after):
        log -= rows.limit
        share *= rows.way
    return before, after


def push(ahead: Array, share: Array, n: Array) -> tuple[Array, Array]:
    """Logarithm of Gⁿ, and n G′/G where G pushes against the motion; `ahead` is overwritten."""
    share *= ahead > 0
    np.maximum(ahead, TINY, out=ahead)
    share /= ahead
    np.log(ahead, out=ahead)
    ahead *= n
    return ahead, share


def _let_go(material: Material, rows: Steps, log: Array, share: Array) -> tuple[Chosen, Array]:
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


def _slide(
    material: Material, rows: Steps, z: tuple[Array, Array], linear: tuple[Array, Array]
) -> None:
    """Recurrence, `linear`, of the stiff steps, where slip sets in at once; z before and after."""
    stiff = np.asarray(rows.stiff)
    row, column = np.nonzero(stiff)
    sign = rows.sign[row, 0]
    level = np.exp(rows.limit[stiff] / material.exponent[column])
    slip = sign * material.spring.of(column).deflection(sign * level)
    ahead = sign * z[0][stiff] + np.broadcast_to(rows.way, stiff.shape)[stiff]
    linear[0][stiff] = ahead < slip
    linear[1][stiff] = sign * np.minimum(ahead, slip) - z[1][stiff]
