"""One step of Newton's method on all steps of a motion together, for the backlash model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import psi

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

CLOSE = 3e-6
"""Where slip may set in at once, a step of a motion is solved when Newton moves it by less than
this share of the length over which slip sets in.
"""

LEFT = 3e-12
"""Error, over the same length, that may be left elsewhere. Newton converges quadratically."""

OVER = 1.0
"""Largest n ln(G/g) at which a step begins: what is above, after friction fell, goes at once."""


@dataclass(frozen=True, eq=False)
class Material:
    """What does not change along the motion, (n,) each: spring, n, and 1/length of slip, 1/in."""

    spring: Spring
    exponent: Array
    rate: Array

    @cached_property
    def late(self) -> Array:
        """Factor by which Gⁿ keeps the spring from reaching slip once it is near, (n,).

        A spring without a gap reaches w = G/g after ξ = ∫ dw/(1 − wⁿ) (g/k), so that at the end
        n (1 − w) = late exp(n − n ξ k/g) with late = exp(−γ − ψ(1/n) − n), Euler's γ and the
        digamma function ψ: from 1/e at n = 1 to 1.
        """
        n = self.exponent
        return np.exp(-np.euler_gamma - psi(1.0 / n) - n)

    @cached_property
    def error(self) -> Array:
        """What Newton's method leaves over the square of its step, (n,), 1/in².

        It comes from the bend of (G/g)ⁿ and from that of the spring, whose length is ℓ. Below
        n = 2 the bend of the former is not bounded: there the step itself must be small.
        """
        bend = 0.5 * (1.0 + 1.0 / (self.rate * self.spring.ell))
        return self.rate**2 * np.where(self.exponent < 2.0, LEFT / CLOSE**2, bend)


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
    slip : (R, n) or None, in
        Deflection s z in slip, of steps that are far too long for the rule; NaN of all others.
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
    slip: Array | None
    breaks: Index
    first: Array
    spring: tuple[Array, Array]

    @cached_property
    def ahead(self) -> Array:
        """Step with its sign, (R, 1) or (R, n), in."""
        return self.way * self.sign

    @cached_property
    def starts(self) -> Index:
        """Steps that break, or turn."""
        found = np.ones(len(self.sign), dtype=bool)
        np.not_equal(self.sign[1:, 0], self.sign[:-1, 0], out=found[1:])
        found[self.breaks] = True
        return np.flatnonzero(found)

    def before(self, z: Array) -> Array:
        """Deflection before each step, (R, n), of that before the first and after each."""
        found = z[:-1].copy()
        found[self.breaks] = self.first
        return found


def newton(material: Material, steps: Steps, z: Array) -> tuple[Array, Array, Array]:
    """Force G of improved deflections, kip, their improvement, in, and its decay, (R, n) each.

    The force and the decay are valid until the next call.

    Parameters
    ----------
    z : (R + 1, n), in
        Deflection before the first step, and after each.
    """
    room = scratch(9, *z.shape)
    force, slope = material.spring.evaluate(z, room[:4])
    decay, drive = _linear(material, steps, z, (force, slope), room[2:])
    if steps.slip is not None:
        _slide(steps, steps.slip, (steps.before(z), z[1:]), (decay, drive))
    decay[steps.breaks] = 0.0
    step = solve(decay, drive, np.zeros(z.shape[1]))
    slope[1:] *= step
    force[1:] += slope[1:]
    return force[1:], step, decay


def _linear(
    material: Material, steps: Steps, z: Array, spring: tuple[Array, Array], room: list[Array]
) -> tuple[Array, Array]:
    """Newton's recurrence δ_k = decay_k δ_{k−1} + drive_k for z + δ, (R, n) each, in `room`."""
    n = material.exponent
    (p0, b0), (p1, b1) = _pushes(material, steps, spring, room[:6])
    over = _let_go(material, steps, p0, b0) if p0.max() > OVER else None
    # c = −h f′: with all of the rule times 12, the weights of f₀ and f₁ are 6 ∓ c
    c, t, gain = (array[:-1] for array in (*room[:2], room[6]))
    np.exp(np.minimum(p1, STIFF, out=p1), out=p1)
    np.multiply(b1, p1, out=c)
    f = np.subtract(1.0, p1, out=p1)
    np.add(6.0, c, out=t)
    np.multiply(f, t, out=gain)
    t -= _bend(b1, f, n)
    t *= c
    t += 12.0
    # the same before each step; memory that is free again is still in the cache
    c, decay, work = b1, p1, c
    np.exp(p0, out=p0)
    np.multiply(b0, p0, out=c)
    f = np.subtract(1.0, p0, out=p0)
    np.subtract(6.0, c, out=decay)
    gain += np.multiply(f, decay, out=work)
    gain *= steps.ahead
    moved = np.subtract(z[:-1], z[1:], out=work)
    moved[steps.breaks] = steps.first - z[1:][steps.breaks]
    if over is not None:
        np.copyto(moved, over[1] - z[1:], where=over[0])
    moved *= 12.0
    gain += moved
    decay += _bend(b0, f, n)
    decay *= c
    np.subtract(12.0, decay, out=decay)
    decay /= t
    gain /= t
    if over is not None:
        decay[over[0]] = 0.0
    return decay, gain


def _bend(b: Array, f: Array, n: Array) -> Array:
    """Part h² f″ f of the derivative of h² f′ f over c, but for the spring's bend; in `b`."""
    b *= f
    b *= 1.0 - 1.0 / n
    return b


def _pushes(
    material: Material, steps: Steps, spring: tuple[Array, Array], room: list[Array]
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Logarithm of (G/g)ⁿ, and n h G′/G, before and after each step, (R, n) each."""
    n, start = material.exponent, steps.starts
    force, slope = spring
    ahead, share = room[:2]
    ahead[0] = TINY
    np.multiply(steps.sign, force[1:], out=ahead[1:])
    log, share = push(ahead, np.multiply(slope, n, out=share), n)
    before, after = [array[:-1] for array in room[2:4]], [array[:-1] for array in room[4:6]]
    for (each, large), rows in ((before, slice(None, -1)), (after, slice(1, None))):
        np.subtract(log[rows], steps.limit, out=each)
        np.multiply(share[rows], steps.way, out=large)
    known = force[start], slope[start]
    for some, values in zip(known, steps.spring, strict=True):
        some[np.searchsorted(start, steps.breaks)] = values
    log, share = push(steps.sign[start] * known[0], known[1] * n, n)
    log -= steps.limit[start]
    share *= steps.way[start]
    before[0][start], before[1][start] = log, share
    return (before[0], before[1]), (after[0], after[1])


def push(ahead: Array, share: Array, n: Array) -> tuple[Array, Array]:
    """Logarithm of Gⁿ, and n G′/G where G pushes against the motion; `ahead` is overwritten."""
    if n.min() < 2.0:  # else it vanishes with (G/g)ⁿ
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


def _slide(steps: Steps, slip: Array, z: tuple[Array, Array], linear: tuple[Array, Array]) -> None:
    """Recurrence, `linear`, of the steps where slip sets in at once; z before and after."""
    stiff = np.isfinite(slip)
    sign = np.broadcast_to(steps.sign, stiff.shape)[stiff]
    ahead = sign * z[0][stiff] + np.broadcast_to(steps.way, stiff.shape)[stiff]
    linear[0][stiff] = ahead < slip[stiff]
    linear[1][stiff] = sign * np.minimum(ahead, slip[stiff]) - z[1][stiff]
