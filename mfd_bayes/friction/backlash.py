"""LuGre friction in series with a spring that has a gap: no rule for turns, no energy gained.

In direction s the deflection ζ = s z follows dζ/dξ = f(ζ) = 1 − (G/g)₊ⁿ along the way ξ
(model.md section 9). A step h is taken by the two-point Hermite rule, which is of fourth order,

    ζ₁ = ζ₀ + h/2 (f₀ + f₁) + h²/12 (f₀′ f₀ − f₁′ f₁),

and all steps of a motion are solved together by Newton's method: each of its steps is a linear
recurrence. A record, a step in time and a building go through the same cuts and the same solver.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.friction.model import (
    PIECE,
    Array,
    Columns,
    Model,
    State,
    named_columns,
    through_vertices,
)
from mfd_bayes.friction.quantities import QUANTITIES
from mfd_bayes.friction.three_stage import of_direction, solve
from mfd_bayes.records.trace import Trace

Index = NDArray[np.intp]

SPRING = ("k_fwd", "k_bwd", "gap", "ell", "k_0")
ACTUATED = ("Fc_fwd", "Fc_bwd")  # they follow the actuation; the spring is steel, and does not
FLOOR = 1e-6  # least share of the slip force that is left at zero actuation

LITTLE = 0.2
"""Share of the slip force that a device at rest without load bears at most.

The load cell shows less than 0.1 at the start of all 32 records of shared/data/brfd. The limit is
twice as much, since the corners of fitted springs are not exact: at the start of tests whose load
cell shows 0.02, some of these springs bear 0.1.
"""

# How a motion is cut into steps. Lengths are over the one in which slip sets in.
# longest step near a turn, and n times it: 0.07 % off steps a tenth as long; up to 0.5 % where n is
# 1 without a gap: the force then crosses 0, where f has a corner, inside a step
RESOLVED = (1.7, 0.34)
SURE = 7.0  # way after which it surely slips
FARTHEST = 256.0  # steps near a turn, at most
FAR, MOST_FAR = 2.0, 8  # in slip a step may be longer by FAR, and a sample has so many at most
MOST = 128  # a way that would have more is not cut: slip then sets in within a small part of it
STIFF = 8.0  # a longer step ends in slip, or slides none

# Inverse of the spring
INVERSIONS = 60  # most steps
LEAST = -690.0  # exponent of e below which a number loses digits

# Newton's method
OVER = 1.0  # largest n ln(G/g) at which a step begins: what is above goes at once
TINY = 1e-12  # force, kip, that stands for one that does not push against friction
ITERATIONS = 100  # most steps; three are the rule
CUTS = 6  # most times that deflections are cut at what friction can hold
CLOSE, CLOSE_BLUNT = 8e-7, 2e-7  # a step is solved when Newton moves it less; where n < 2
FAR_OFF = 1e13  # error, over its limit, from which Newton may be beyond what friction can hold

TOGETHER = 32  # dampers that are cut into steps together


def _softplus(a: Array) -> Array:
    """ln(1 + e^a) of any a."""
    e = np.abs(a)
    np.exp(np.negative(e, out=e), out=e)
    e += 1.0
    np.log(e, out=e)
    e += np.maximum(a, 0.0)
    return e


@dataclass(frozen=True, eq=False)
class SpringAndBristle:
    """n dampers by their parameters, (n,) each, at the reference actuation."""

    columns: Mapping[str, Array]

    def of(self, rows: Index | NDArray[np.bool_]) -> SpringAndBristle:
        """Some of the dampers."""
        subset = SpringAndBristle(
            {name: column[..., rows] for name, column in self.columns.items()}
        )
        vars(subset)["onset"] = self.onset[:, rows]  # the search for it takes longer
        return subset

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        """Force G of the spring, kip, and stiffness dG/dz, kip/in, at deflections z, (..., n), in.

        G(z) = k_f ℓ ln(1 + e^((z − D/2)/ℓ)) − k_b ℓ ln(1 + e^(−(z + D/2)/ℓ)) + k_0 z
        """
        k_fwd, k_bwd, gap, ell, k_0 = (self.columns[name] for name in SPRING)
        a, half, fwd, bwd = z / ell, 0.5 * gap / ell, k_fwd * ell, k_bwd * ell
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            e = np.exp(a - half)  # one exponential serves both sides
            e_bwd = np.exp(-2.0 * half) / e
            e += 1.0
            e_bwd += 1.0
            force = fwd * np.log(e)
            force -= bwd * np.log(e_bwd)
            force += k_0 * z
            slope = (k_fwd + k_bwd + k_0) - k_fwd / e - k_bwd / e_bwd
        if not (a.min(initial=0.0) > LEAST and np.isfinite(force.sum())):
            a_fwd, a_bwd = a - half, -a - half
            force = fwd * np.logaddexp(0.0, a_fwd) - bwd * np.logaddexp(0.0, a_bwd) + k_0 * z
            slope = k_fwd * scipy.special.expit(a_fwd) + k_bwd * scipy.special.expit(a_bwd) + k_0
        return force, slope

    def approximate_inverse(self, force: Array, sign: Array) -> Array:
        """About the deflection s z, (..., n), in, where s G is `force` ≥ 0.

        The inverse of one side alone, where k_0 takes its share of the force as with a sharp
        corner, and a step of Newton's method.
        """
        k_fwd, k_bwd, gap, ell, k_0 = (self.columns[name] for name in SPRING)
        half, stiff = 0.5 * gap, np.where(sign > 0, k_fwd, k_bwd)
        sharp = (half + force / stiff) / (1.0 + k_0 / stiff)
        load = np.maximum((force - k_0 * sharp) / (stiff * ell), 1e-6)
        ahead: Array = half + ell * (load + np.log(-np.expm1(-load)))
        now, slope = self.evaluate(sign * ahead)
        ahead -= (sign * now - force) / np.maximum(slope, 1e-300)
        return ahead

    def deflection(self, force: Array, close: float = 1e-13) -> Array:
        """Deflection at which the force is G, (..., n), in: the inverse of G.

        Newton's step is taken wherever it stays inside the bounds, else they are bisected, until a
        step is below `close` times ℓ + |z|.
        """
        k_fwd, k_bwd, gap, ell, _ = (self.columns[name] for name in SPRING)
        softest, size = np.minimum(k_fwd, k_bwd), np.abs(force)
        uneven = np.log1p(np.maximum(k_fwd, k_bwd) / softest)
        high = 0.5 * gap + ell * (2.0 + uneven) + size / softest
        sign = np.sign(force)
        z = sign * np.clip(self.approximate_inverse(size, sign), 0.0, high)
        low = -high
        for _ in range(INVERSIONS):
            now, slope = self.evaluate(z)
            error = now - force
            step = error / np.maximum(slope, 1e-300)
            if np.all(np.abs(step) <= close * (ell + np.abs(z))):
                return z - step
            low, high = np.where(error < 0, z, low), np.where(error > 0, z, high)
            trial = z - step
            z = np.where((trial >= low) & (trial <= high), trial, 0.5 * (low + high))
        return z

    @cached_property
    def kinetic(self) -> Array:
        """F_c forward and backward, (2, n), kip."""
        return np.stack([self.columns["Fc_fwd"], self.columns["Fc_bwd"]])

    @cached_property
    def excess(self) -> Array:
        """Excess of static over kinetic friction, forward and backward, (2, n)."""
        return np.stack([self.columns[f"static_excess_{side}"] for side in ("fwd", "bwd")])

    @cached_property
    def onset(self) -> Array:
        """1/length over which slip sets in, n G′/F_c at G = F_c, on each side, (2, n), 1/in."""
        slip = self.kinetic * np.array([[1.0], [-1.0]])
        slope = self.evaluate(self.deflection(slip, close=1e-4))[1]
        return self.columns["n"] * slope / self.kinetic

    @cached_property
    def rate(self) -> Array:
        """The larger of both sides' `onset`, (n,), 1/in."""
        return np.asarray(self.onset.max(axis=0))

    @cached_property
    def steps(self) -> tuple[Array, Array]:
        """Longest step near a turn, and way after a turn beyond which it surely slips, (n,), in.

        They depend on a damper's own parameters alone, so that its force does not depend on the
        others.
        """
        c, (fine, coarse) = self.columns, RESOLVED
        step = np.minimum(fine, coarse * c["n"]) / self.rate
        static = self.kinetic * (1.0 + self.excess) / np.stack([c["k_fwd"], c["k_bwd"]])
        window = c["gap"] + (static[0] + static[1]) + SURE / self.rate
        return step, np.clip(window, step, FARTHEST * step)

    def slip(self, sign: Array, rate: Array, shares: Columns) -> tuple[Array, Array, Array]:
        """`level`, `bound` and `length` of `Steps`.

        g(v) = F_c [1 + e exp(−(v/v_s)²)] in the directions `sign` at mean velocities, in/s, with
        factors `shares` of F_c; all (R, 1) or (n,).
        """
        backward, c = sign < 0, self.columns
        force: Array = np.square(rate) * (-1.0 / np.square(c["v_s"]))
        np.exp(force, out=force)
        force *= of_direction(backward, self.excess)
        force += 1.0
        force *= of_direction(backward, self.kinetic)
        length = 1.0 / self.rate[None]
        if shares:
            share_fwd, share_bwd = (np.maximum(shares.get(name, 1.0), FLOOR) for name in ACTUATED)
            share = np.where(backward, share_bwd, share_fwd)
            force *= share
            length = np.minimum(share, 1.0) * length
        return np.log(force), self.approximate_inverse(force, sign), length

    @cached_property
    def range(self) -> tuple[Array, Array]:
        """Deflections z, (n,) each, in, between which a motion may begin."""
        c = self.columns
        half = 0.5 * c["gap"]
        return -half - c["Fc_bwd"] / c["k_bwd"], half + c["Fc_fwd"] / c["k_fwd"]

    def begin(self, start: Array) -> Array:
        """Deflection z at the first sample, (n,), in, at a share of its range."""
        low, high = self.range
        return low + start * (high - low)

    def place(self, z: Array) -> Array:
        """Share of the range at a deflection z, (n,), in; what lies beyond is at its end."""
        low, high = self.range
        return np.clip((z - low) / (high - low), 0.0, 1.0)


class Cut(NamedTuple):
    """Steps into which a motion is cut, time first.

    Attributes
    ----------
    way, share : (R, n)
        Length of each step, in, 0 or more, and where its middle lies in the uncut step.
    origin : (R,), int
        The step of the uncut motion that it is part of.
    ends : (M,), int
        Number of steps up to the end of each of those.
    """

    way: Array
    share: Array
    origin: Index
    ends: Index


def cut(length: Array, travel: Array, step: Array, window: Array) -> Cut:
    """Steps that are short where slip sets in, and long in slip; (M, 1) against (n,), or (1, n).

    Parameters
    ----------
    length : in
        Of each step of the motion.
    travel : in
        Way since the last turn at its beginning.
    step, window : (n,), in
        `Damper.steps`. Where a damper has fewer steps than another, some have length zero.
    """
    fine = np.minimum(np.maximum(window - travel, 0.0), length)
    coarse = length - fine
    close, loose = fine / step, coarse / (FAR * step)
    close = np.where(close <= MOST, np.ceil(close), 1.0)
    loose = np.where(loose <= MOST, np.ceil(np.minimum(loose, MOST_FAR)), 1.0)
    close[close + loose == 0.0] = 1.0
    count = close + loose
    counts = count.max(axis=1).astype(np.intp)
    ends = np.cumsum(counts)
    origin = np.repeat(np.arange(counts.size), counts)
    number = (np.arange(origin.size) - ends[origin])[:, None] + count[origin]  # < 0: length 0
    is_fine = number < close[origin]
    a, b = fine / np.maximum(close, 1.0), coarse / np.maximum(loose, 1.0)
    way = np.where(is_fine, a[origin], b[origin])
    way[number < 0.0] = 0.0
    offset = np.where(is_fine, 0.0, (fine - close * b)[origin])
    share = (offset + (number + 0.5) * way) / np.maximum(length, 1e-300)[origin]
    return Cut(way, np.minimum(np.maximum(share, 0.0), 1.0), origin, ends)


class Steps(NamedTuple):
    """Short steps of a motion, time first.

    Attributes
    ----------
    way, sign : (R, 1) or (R, n), in, ±1
        Length, 0 or more, and direction.
    level : (R, n)
        ln g, of the slip force g in each step, kip.
    bound : (R, n), in
        About the deflection s z in slip.
    length : (R, n) or (1, n), in
        Over which slip sets in, at least.
    """

    way: Array
    sign: Array
    level: Array
    bound: Array
    length: Array

    def of(self, rows: Index | NDArray[np.bool_]) -> Steps:
        """Those of some of the dampers."""
        return Steps(*(a if a.shape[1] == 1 else a[:, rows] for a in self))


def advance(damper: SpringAndBristle, steps: Steps, z0: Array) -> tuple[Array, Array]:
    """Spring force after each step, (R, n), kip, and the last deflection, (n,), in.

    Both are NaN for dampers that Newton's method cannot solve. `z0` is the deflection before.
    One that is solved waits for the others, without effect, until they are less than half.
    """
    n, slip = damper.columns["n"], _at_once(damper, steps)
    turned = (steps.sign[1:] != steps.sign[:-1]).any(axis=1)
    turns = np.flatnonzero(np.append(True, turned))  # the first step too
    z = np.concatenate([z0[None], guess(damper, steps, turns, z0)])
    error = np.square(damper.rate / np.where(n < 2.0, CLOSE_BLUNT, CLOSE))
    force, end = np.full(steps.level.shape, np.nan), np.full(n.size, np.nan)
    rows, waits = np.arange(n.size), np.ones(n.size, dtype=bool)
    for iteration in range(ITERATIONS):
        spring, slope, decay, drive = newton(damper, steps, slip, turns, z)
        step = solve(decay, drive, np.zeros(rows.size))
        now = z[1:]
        now += step
        slope *= step
        spring += slope
        moved = np.square(step).max(axis=0) * error  # NaN where there is no solution
        solved = waits & (moved <= 1.0)
        force[:, rows[solved]], end[rows[solved]] = spring[:, solved], now[-1, solved]
        waits &= moved > 1.0
        if not waits.any():
            break
        if 2 * np.count_nonzero(waits) <= rows.size or np.isnan(moved).any():
            rows, error, z, moved = rows[waits], error[waits], z[:, waits], moved[waits]
            damper, steps = damper.of(waits), steps.of(waits)
            slip = None if slip is None else slip[:, waits]
            waits = waits[waits]
        far_off = moved > FAR_OFF
        if far_off.any() and iteration < CUTS:
            limit = np.minimum(steps.sign * z[1:], steps.bound + 2.0 * steps.length)
            # at rest more may stay
            np.multiply(steps.sign, limit, out=z[1:], where=far_off & (steps.way > 0.0))
    return force, end


def newton(
    damper: SpringAndBristle, steps: Steps, slip: Array | None, turns: Index, ends: Array
) -> tuple[Array, Array, Array, Array]:
    """Force and stiffness, and Newton's recurrence δ_k = decay_k δ_{k−1} + drive_k of deflections.

    With p = (G/g)ⁿ, f = 1 − p and c = −h f′ = b p, b = n h G′/G, the rule times 12 is

        12 (ζ₁ − ζ₀) = h [(6 − c₀) f₀ + (6 + c₁) f₁],

    and its derivatives neglect the bend of the spring.

    `slip` is that of `_at_once`, `turns` are the first step and those that turn, and `ends`,
    (R + 1, n), in, the deflections before and after each step.
    """
    n, way, sign = damper.columns["n"], steps.way, steps.sign
    z, z0, bend = ends[1:], ends[:-1], 1.0 - 1.0 / n
    force, slope = damper.evaluate(z)
    # ln Gⁿ and n G′/G where G pushes against the motion, after each step
    log, share = _push(sign * force, slope, n)
    # before it the same, but for those that turn
    log0, share0 = np.empty_like(log), np.empty_like(share)
    log0[1:], share0[1:] = log[:-1], share[:-1]
    values, stiff = damper.evaluate(ends[turns])
    log0[turns], share0[turns] = _push(sign[turns] * values, stiff, n)
    limit = n * steps.level
    log0 -= limit
    exceeds = None
    if log0.max() > OVER:
        exceeds = (log0 > OVER) & (way > 0.0)  # at rest nothing is let go
        z0 = z0.copy()
        project_to_slip(damper, steps, exceeds, share0, z0)
        np.minimum(log0, OVER, out=log0)
    # the end of each step
    log -= limit
    p = np.exp(np.minimum(log, STIFF, out=log), out=log)
    f, b = 1.0 - p, np.multiply(share, way, out=share)
    c = b * p
    gain = f * (6.0 + c)
    t = c * (6.0 + c - bend * b * f) + 12.0
    # its beginning
    p = np.exp(log0, out=log0)
    f, b = 1.0 - p, np.multiply(share0, way, out=share0)
    c = b * p
    gain += f * (6.0 - c)
    decay = (12.0 - c * (6.0 - c + bend * b * f)) / t
    gain *= sign * way
    gain += 12.0 * (z0 - z)
    gain /= t
    if exceeds is not None:
        decay[exceeds] = 0.0
    if slip is not None:
        row, column = np.nonzero(np.isfinite(slip))
        ways, signs = (np.broadcast_to(a, z.shape)[row, column] for a in (way, sign))
        elastic, values = signs * ends[row, column] + ways, slip[row, column]
        decay[row, column] = elastic < values
        gain[row, column] = signs * np.minimum(elastic, values) - z[row, column]
    decay[0] = 0.0
    return force, slope, decay, gain


def _push(ahead: Array, slope: Array, n: Array) -> tuple[Array, Array]:
    """Logarithm ln Gⁿ and n G′/G of s G, where it pushes against the motion."""
    share = slope * n
    if n.min() < 2.0:  # else it vanishes with (G/g)ⁿ
        share *= ahead > 0
    ahead = np.maximum(ahead, TINY, out=ahead)
    share /= ahead
    np.log(ahead, out=ahead)
    ahead *= n
    return ahead, share


def project_to_slip(
    damper: SpringAndBristle, steps: Steps, exceeds: NDArray[np.bool_], share: Array, z0: Array
) -> None:
    """Let steps that begin beyond slip begin where n ln(G/g) is `OVER`; the last two change."""
    _, column = np.nonzero(exceeds)
    subset, n = damper.of(column), damper.columns["n"][column]
    level = np.exp(steps.level[exceeds] + OVER / n)
    z0[exceeds] = subset.deflection(np.broadcast_to(steps.sign, exceeds.shape)[exceeds] * level)
    share[exceeds] = n * subset.evaluate(z0[exceeds])[1] / level


def _at_once(damper: SpringAndBristle, steps: Steps) -> Array | None:
    """Deflection s z in slip of steps so long that it sets in at once, or not at all; else NaN."""
    if not steps.way.max() > STIFF * steps.length.min():
        return None
    shape = steps.level.shape
    row, column = np.nonzero(np.broadcast_to(steps.way > STIFF * steps.length, shape))
    sign = np.broadcast_to(steps.sign, shape)[row, column]
    slip = np.full(shape, np.nan)
    force = sign * np.exp(steps.level[row, column])
    slip[row, column] = sign * damper.of(column).deflection(force)
    return slip


def guess(damper: SpringAndBristle, steps: Steps, turns: Index, z0: Array) -> Array:
    """About the deflections, (R, n): unloading, a rounded corner where slip sets in, and slip."""
    rate, bound, sign = damper.rate, steps.bound, steps.sign
    ends = np.append(turns[1:], len(bound))
    way = np.cumsum(steps.way, axis=0)
    stretch = np.repeat(np.arange(turns.size), ends - turns)
    way = way - (way[turns] - steps.way[turns])[stretch]
    room = bound - way
    room *= rate
    z, offset = z0, np.empty((turns.size, rate.size))
    for k, (begin, end) in enumerate(zip(turns.tolist(), (ends - 1).tolist(), strict=True)):
        zeta = sign[begin] * z
        # a stretch that begins near slip has less of the corner ahead of it
        distance = np.maximum((bound[begin] - zeta) * rate, 1e-300)
        offset[k] = zeta * rate - np.log(-np.expm1(-distance))
        z = sign[end] * (bound[end] - _softplus(room[end] - offset[k]) / rate)
    room -= offset[stretch]
    bent = _softplus(room)
    bent /= rate
    np.subtract(bound, bent, out=bent)
    bent *= sign
    return bent


@dataclass(frozen=True)
class BacklashLuGre(Model):
    """LuGre friction in series with a spring that has a gap (model.md section 9).

        G(z) = k_f ℓ ln(1 + e^((z − D/2)/ℓ)) − k_b ℓ ln(1 + e^(−(z + D/2)/ℓ)) + k_0 z
        g(v) = F_c [1 + e exp(−(v/v_s)²)],   F_c and e of the direction of G
        ż = v (1 − ½ [1 + sgn(v G)] |G/g|ⁿ),   F = G(z) + σ2 v

    Between samples the velocity is taken as constant; a turn between samples has its vertex as in
    `Trace.path`. Unloading is elastic, so the force retraces wherever the motion turns. Under a
    varying actuation the slip force changes linearly between samples; the spring does not.
    """

    name = "backlash"
    parameters = (
        *(*SPRING, *ACTUATED, "n", "sigma2"),
        *("static_excess_fwd", "static_excess_bwd", "v_s"),
    )
    quantities = tuple(map(QUANTITIES.__getitem__, parameters))
    positive = frozenset({"k_fwd", "k_bwd", "ell", "Fc_fwd", "Fc_bwd", "v_s"})
    slip_forces = ACTUATED
    has_gap = True
    laws = MappingProxyType(dict.fromkeys(ACTUATED, "proportional"))

    def compute_force(self, c: Columns, trace: Trace, start: Array, factors: Columns) -> Array:
        """Force at the samples, (T, n), kip.

        Fc_fwd and Fc_bwd follow the actuation. `start` is the place between slip backward, 0,
        and slip forward, 1.
        """
        force, _ = self._along(SpringAndBristle(c), trace, start, factors)
        force += c["sigma2"] * trace.velocity[:, None]
        return force

    def _along(
        self, damper: SpringAndBristle, trace: Trace, start: Array, factors: Columns
    ) -> tuple[Array, Array]:
        """Spring force at the samples, (T, n), kip, and the deflection z at the last, (n,), in."""
        time, x, nearest, samples = through_vertices(trace)
        factors = {name: factor.take(nearest, axis=0) for name, factor in factors.items()}
        z0, moves = damper.begin(start), np.diff(x)
        sign, travel = strokes_of(moves)
        force, z = np.empty((trace.samples, start.size)), np.empty(start.size)
        force[0] = damper.evaluate(z0)[0]
        step, window = damper.steps
        # those with similar steps go together
        for rows in np.array_split(np.argsort(step), -(-step.size // TOGETHER)):
            cuts = cut(np.abs(moves)[:, None], travel[:, None], step[rows], window[rows])
            subset = {k: f if f.shape[1] == 1 else f[:, rows] for k, f in factors.items()}
            motion = sign[:, None], (moves / np.diff(time))[:, None]
            spring, z[rows] = follow(damper.of(rows), cuts, motion, subset, z0[rows])
            force[1:, rows] = spring[samples[1:] - 1]
        return force, z

    def compute_end(self, c: Columns, trace: Trace, start: Array, factors: Columns) -> Array:
        """Place of the deflection z at the last sample in the range of `start`, (n,), 1.

        A motion that begins there has the whole state of the device, but for a deflection beyond
        that range, which static friction, or an actuation above the reference, may hold: it is
        taken as the end of the range.
        """
        damper = SpringAndBristle(c)
        return damper.place(self._along(damper, trace, start, factors)[1])

    def start_at(
        self,
        position: Array,
        trace: Trace,
        previous_theta: ArrayLike | None = None,
        theta: ArrayLike | None = None,
    ) -> Array:
        """`start` of a motion at a place in the gap, (n,).

        Between dampers that differ, what is inside the gap is the same share of the gap, and beyond
        it the spring keeps its deflection.
        """
        if previous_theta is None or theta is None:
            return position
        ended, damper = (
            SpringAndBristle(self.columns(previous_theta)),
            SpringAndBristle(self.columns(theta)),
        )
        z = ended.begin(position)
        previous_half, half = 0.5 * ended.columns["gap"], 0.5 * damper.columns["gap"]
        in_gap = np.clip(z, -previous_half, previous_half)
        share = np.divide(in_gap, previous_half, out=np.zeros(z.shape), where=previous_half > 0)
        return damper.place(share * half + z - in_gap)

    def gap(self, values: Mapping[str, Array]) -> Array:
        """Width of the gap D, (n,), in."""
        return named_columns(values, ("gap",))["gap"]

    def slip_to_slip(self, values: Mapping[str, Array]) -> Array:
        """Travel from slip to slip, D + F_c,fwd/k_f + F_c,bwd/k_b, (n,), in."""
        c = named_columns(values, ("gap", "Fc_fwd", "Fc_bwd", "k_fwd", "k_bwd"))
        return c["gap"] + c["Fc_fwd"] / c["k_fwd"] + c["Fc_bwd"] / c["k_bwd"]

    def unloaded(self, values: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        """Where the spring bears at most `LITTLE` of the slip force: see `Model.unloaded`.

        The load doubles over the edge. The upper end is at least a thousandth above the lower one,
        also where it is then beyond the range.
        """
        damper = SpringAndBristle(named_columns(values, (*SPRING, *ACTUATED)))
        low, high = damper.range
        slip = np.stack([-damper.columns["Fc_bwd"], damper.columns["Fc_fwd"]])
        shares = np.array([LITTLE, 2.0 * LITTLE])[:, None, None]
        z = damper.deflection(shares * slip, close=1e-4)
        lower, upper = np.clip((z[0] - low) / (high - low), 0.0, 1.0)
        edge = 0.5 * np.abs(z[1] - z[0]).sum(axis=0) / (high - low)
        return lower, np.maximum(upper, lower + 1e-3), edge

    def stages(
        self, theta: ArrayLike, trace: Trace, start: ArrayLike | None = None
    ) -> NDArray[np.int8]:
        """Stage at each sample, (n, T): 1 slip, 2 stick, 3 build-up, 4 in the gap.

        It slips where the spring takes up less than half of the motion. Beyond the gap the force
        builds up where the motion loads the spring, and the device sticks where it unloads it.
        """
        damper = SpringAndBristle(self.columns(theta))
        force = self.force(theta, trace, start).T
        force -= trace.velocity[:, None] * damper.columns["sigma2"]
        z = damper.deflection(force)
        moved = np.diff(trace.displacement, prepend=trace.displacement[0])[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.abs(np.diff(z, axis=0, prepend=z[:1]) / moved)
        loads = moved * force > 0
        in_gap = np.abs(z) < 0.5 * damper.columns["gap"]
        stage = np.select([loads & (share < 0.5), in_gap, loads], [1, 4, 3], 2)
        return stage.T.astype(np.int8)

    def constants(self, c: Columns) -> dict[str, Any]:
        """Columns, and what is searched for once."""
        damper = SpringAndBristle(c)
        step, window = damper.steps
        return c | {"onset": damper.onset, "step": step, "window": window}

    def begin(self, state: State, start: Array, direction: Array | None) -> Columns:
        """A deflection in its range; no direction has to be known before the motion."""
        damper = SpringAndBristle(state.constants)
        z, zero = damper.begin(start), np.zeros(start.size)
        spring = damper.evaluate(z)[0]
        return {"z": z, "spring": spring, "sign": zero, "travelled": zero}

    def advance(
        self, state: State, displacement: Array, velocity: Array, dt: Array, scales: Columns
    ) -> Columns:
        """Deflection after a straight way; the way since the last turn."""
        c, memory = state.constants, state.memory
        way = displacement - state.displacement
        sign = np.where(way == 0.0, memory["sign"], np.sign(way))
        sign[sign == 0.0] = 1.0
        travel = np.where(sign == memory["sign"], memory["travelled"], 0.0)
        damper = SpringAndBristle(c)
        vars(damper)["onset"] = c["onset"]
        z = memory["z"] + way
        spring = damper.evaluate(z)[0]
        # where the spring still pushes with the motion at the end, nothing slid
        (rows,) = (~(sign * spring <= 0.0)).nonzero()
        if rows.size:
            length = np.abs(way)
            cuts = cut(length[None, rows], travel[None, rows], c["step"][rows], c["window"][rows])
            names = {*state.scales, *scales}
            ones = np.ones(way.size)
            factors = {
                name: np.stack([s.get(name, ones)[rows] for s in (state.scales, scales)])
                for name in names
            }
            motion = sign[None, rows], (way / dt)[None, rows]
            force, z_end = follow(damper.of(rows), cuts, motion, factors, memory["z"][rows])
            z[rows], spring[rows] = z_end, force[-1]
        return {"z": z, "spring": spring, "sign": sign, "travelled": travel + np.abs(way)}

    def total(self, state: State) -> Array:
        """F = G(z) + σ2 v, (n,), kip."""
        return np.asarray(state.memory["spring"] + state.constants["sigma2"] * state.velocity)


def strokes_of(moves: Array) -> tuple[Array, Array]:
    """Direction of each step of a motion, and way since the last turn at its beginning, in.

    A step of length zero has the direction of the one before it; the first ones go forward.
    """
    sign = np.append(1.0, np.sign(moves))
    index = np.where(sign != 0, np.arange(sign.size), 0)
    sign = sign[np.maximum.accumulate(index)][1:]
    total = np.append(0.0, np.cumsum(np.abs(moves)))
    turns = np.append(0, 1 + np.flatnonzero(sign[1:] != sign[:-1]))
    stretch = np.searchsorted(turns, np.arange(moves.size), side="right") - 1
    return sign, total[:-1] - total[turns][stretch]


def follow(
    damper: SpringAndBristle, cuts: Cut, motion: tuple[Array, Array], factors: Columns, z0: Array
) -> tuple[Array, Array]:
    """Spring force after each step of the uncut motion, (M, n), kip, and the last z, (n,), in.

    Parameters
    ----------
    motion : (M, 1) or (1, n), ±1 and in/s
        Direction and mean velocity in each of those.
    factors : dict of (M + 1, n) or (M + 1, 1)
        Factors of the slip forces at their ends, by name; empty when constant.
    z0 : (n,), in
        Deflection before them.
    """
    sign, rate = motion
    force, z = np.empty((cuts.ends.size, z0.size)), z0
    lost = np.zeros(z0.size, dtype=bool)
    constant = damper.slip(sign, rate, {})
    size = max(PIECE // max(z0.size, 1), 1)
    for begin in range(0, cuts.origin.size, size):
        end = min(begin + size, cuts.origin.size)
        origin, way, share = cuts.origin[begin:end], cuts.way[begin:end], cuts.share[begin:end]
        if factors:
            now = {k: f[origin] + share * (f[origin + 1] - f[origin]) for k, f in factors.items()}
            level, bound, length = damper.slip(sign[origin], rate[origin], now)
        else:
            level, bound, length = *(a.take(origin, axis=0) for a in constant[:2]), constant[2]
        segment, z = advance(damper, Steps(way, sign[origin], level, bound, length), z)
        lost |= np.isnan(z)
        z = np.where(lost, 0.0, z)
        low, high = np.searchsorted(cuts.ends, [begin + 1, end + 1])
        force[low:high] = segment[cuts.ends[low:high] - begin - 1]
    force[:, lost] = np.nan
    return force, np.where(lost, np.nan, z)
