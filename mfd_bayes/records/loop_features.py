"""Slip force, stiffness, gap and scales read off the loops of a record, without a model."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.loops import STRONG, find_loops
from mfd_bayes.records.motion import Array
from mfd_bayes.records.spikes import without_spikes
from mfd_bayes.records.trace import Trace

SLIP = (0.5, 0.95)
"""Shares of a stroke between which the damper slips: the plateau is the median force there."""

RISE = (0.2, 0.8)
"""Shares of the plateau between which the force builds up after the gap."""


@dataclass(frozen=True)
class LoopFeatures:
    """What a person reads off the full strokes of a loop; NaN where it cannot be read.

    A stroke is the way from one of `Trace.cycle_turns` to the next; full strokes are those of at
    least `STRONG` of the longest. Every figure but the energy is the median over full strokes.

    Attributes
    ----------
    plateau_fwd, plateau_bwd : float, kip
        Slip force, as a positive number: the median force over the part `SLIP` of a stroke.
    slope : float, kip/in
        Slope of the build-up, between the shares `RISE` of the plateau.
    gap : float, in
        Travel after a turn at which the line of the build-up meets the plateau.
    energy : float, kip*in
        Dissipated in a cycle at full stroke (`Loops.strong`), their mean.
    """

    plateau_fwd: float
    plateau_bwd: float
    slope: float
    gap: float
    energy: float

    @property
    def plateau(self) -> float:
        """Mean of the slip forces of both directions, kip; free of the load cell's offset."""
        return 0.5 * (self.plateau_fwd + self.plateau_bwd)


@dataclass(frozen=True, eq=False)
class Strokes:
    """What each of the S strokes of a motion shows of forces (n, T); NaN where nothing is seen.

    Attributes
    ----------
    first, last : (S,) int
        Samples of the turns at both ends.
    sign : (S,)
        Direction, +1 or -1.
    full : (S,) bool
        Whether a stroke has at least `STRONG` of the longest.
    plateau : (n, S), kip
        Median force in the direction of the motion over the part `SLIP` of the stroke.
    slope, gap : (n, S), kip/in and in
        Of the line of the build-up, and the travel at which it meets the slip force.
    """

    first: NDArray[np.intp]
    last: NDArray[np.intp]
    sign: Array
    full: NDArray[np.bool_]
    plateau: Array
    slope: Array
    gap: Array

    def slip(self, sign: float) -> Array:
        """Slip force in a direction, (n,), kip: the median plateau of its full strokes."""
        return _median(self.plateau[:, self.full & (self.sign == sign)])


def stroke_estimates(trace: Trace, force: Array) -> Strokes:
    """What is read off each stroke of a motion under forces (n, T), kip."""
    x, turns = trace.displacement, trace.cycle_turns
    first, last = turns[:-1], turns[1:]
    way = x[last] - x[first]
    full = np.abs(way) >= STRONG * np.max(np.abs(way), initial=0.0)
    nothing = np.full((len(force), first.size), np.nan)
    found = Strokes(first, last, np.sign(way), full, nothing, nothing.copy(), nothing.copy())
    spans = list(zip(first.tolist(), last.tolist(), found.sign.tolist(), strict=True))
    for k, (a, b, sign) in enumerate(spans):
        share = (x[a : b + 1] - x[a]) / (x[b] - x[a])
        inside = (share >= SLIP[0]) & (share <= SLIP[1])
        if inside.any():
            found.plateau[:, k] = sign * np.median(force[:, a : b + 1][:, inside], axis=1)
    slip = {sign: found.slip(sign) for sign in (1.0, -1.0)}
    for k, (a, b, sign) in enumerate(spans):
        travel = np.abs(x[a : b + 1] - x[a])
        found.slope[:, k], found.gap[:, k] = _rise(sign * force[:, a : b + 1], travel, slip[sign])
    return found


def loop_estimate(trace: Trace, offset: float = 0.0) -> LoopFeatures:
    """What a record shows less the offset of its load cell, kip.

    A motion without a full stroke, or without a force, has none: all are NaN.
    """
    nan = float("nan")
    if trace.force is None or trace.cycle_turns.size < 2:
        return LoopFeatures(nan, nan, nan, nan, nan)
    found = stroke_estimates(trace, trace.force[None] - offset)
    slope, gap = (float(_median(v[:, found.full])[0]) for v in (found.slope, found.gap))
    loops = find_loops(trace)
    energy = np.asarray(loops.energy)[loops.strong]
    mean = float(energy.mean()) if energy.size else nan
    return LoopFeatures(float(found.slip(1.0)[0]), float(found.slip(-1.0)[0]), slope, gap, mean)


def asymmetry(trace: Trace) -> Array:
    """How far the loop is from the same in both directions, along a stroke, (P,), kip.

    The mean of the forward force and of the backward force, less its own mean: a record with both
    signs swapped has the opposite. NaN without full strokes in both directions.
    """
    along = np.linspace(0.02, 0.98, 60)
    force, sides = np.asarray(trace.force), []
    for sign in (1, -1):
        curves = []
        for first, last, way in _strokes(trace):
            x = trace.displacement[first : last + 1]
            travel = np.maximum.accumulate((x - x[0]) / (x[-1] - x[0]))
            if way == sign:
                curves.append(np.interp(along, travel, force[first : last + 1]))
        sides.append(np.median(curves, axis=0) if curves else np.full(along.size, np.nan))
    mean = 0.5 * (sides[0] + sides[1])
    return np.asarray(mean - mean.mean())


def _strokes(trace: Trace) -> list[tuple[int, int, int]]:
    """First and last sample, and direction, of every full stroke."""
    x = trace.displacement
    found = [(int(a), int(b), 1 if x[b] > x[a] else -1) for a, b in pairwise(trace.cycle_turns)]
    longest = max((abs(x[b] - x[a]) for a, b, _ in found), default=0.0)
    return [s for s in found if abs(x[s[1]] - x[s[0]]) >= STRONG * longest]


def _rise(force: Array, travel: Array, slip: Array) -> tuple[Array, Array]:
    """Slope of the build-up, kip/in, and travel at which it meets the slip force, in, (n,) each.

    Of forces (n, m) in the direction of the motion, over the travel (m,) of one stroke.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(slip[:, None] > 0.0, force / slip[:, None], np.nan)
        top = np.argmax(share >= RISE[1], axis=1)
        below = (share <= RISE[0]) & (np.arange(travel.size) < top[:, None])
        bottom = travel.size - 1 - np.argmax(below[:, ::-1], axis=1)
        bottom[~below.any(axis=1)] = 0
        low, high = (
            _crossing(share, travel, at, level)
            for at, level in ((bottom, RISE[0]), (np.maximum(top - 1, 0), RISE[1]))
        )
        good = below.any(axis=1) & (high > low)
        slope = np.where(good, (RISE[1] - RISE[0]) * slip / (high - low), np.nan)
        return slope, np.asarray(high + (1.0 - RISE[1]) * slip / slope)


def _crossing(share: Array, travel: Array, at: NDArray[np.intp], level: float) -> Array:
    """Travel, (n,), at which shares (n, m) cross a level between samples `at` and `at` + 1."""
    rows, behind = np.arange(len(share)), np.minimum(at + 1, travel.size - 1)
    before, after = share[rows, at], share[rows, behind]
    part = np.where(after > before, (level - before) / (after - before), 0.0)
    return np.asarray(travel[at] + part * (travel[behind] - travel[at]))


def _median(values: Array) -> Array:
    """Median over the last axis of values (n, S) that are known, (n,); NaN where none is."""
    if not values.shape[-1]:
        return np.full(len(values), np.nan)
    known = np.ma.masked_invalid(values)
    return np.asarray(np.ma.median(known, axis=-1).filled(np.nan))  # type: ignore[no-untyped-call]


UNLOADING = (0.8, 0.2)
"""Shares of the slip force between which the slope after a turn is read."""

_FASTEST = 0.9  # quantile of the speed that is the speed of a record
_FALLBACK = 0.05  # of the stroke: length of a build-up that cannot be read


@dataclass(frozen=True)
class Scales:
    """What a record shows of its device, internal units; all positive but the offset.

    Attributes
    ----------
    force : float, kip
        Slip force: the plateau of the loop, else half the range of the force.
    unloading : float, kip/in
        Slope of the force right after a turn.
    build_up : float, kip/in
        Slope at which the force comes back.
    length : float, in
        Travel from a turn until the force has come back, the gap included.
    stroke : float, in
        From one end of the motion to the other.
    speed : float, in/s
    noise : float, kip
        Standard deviation of what differs from sample to sample.
    offset : float, kip
        Middle of the plateaus of both directions.
    """

    force: float
    unloading: float
    build_up: float
    length: float
    stroke: float
    speed: float
    noise: float
    offset: float


def scales_of(trace: Trace) -> Scales | None:
    """Scales of one record; None where it has no force or no motion."""
    trace = without_spikes(trace)
    force = trace.force
    if force is None or not np.ptp(force) > 0.0 or not np.ptp(trace.displacement) > 0.0:
        return None
    loops = find_loops(trace)
    known = loops.offset is not None and loops.offset.size
    offset = float(np.median(np.asarray(loops.offset))) if known else float(np.mean(force))
    read = loop_estimate(trace, offset)
    slip = _positive(read.plateau, 0.5 * float(np.ptp(force)))
    # White noise whose second differences have the size of these.
    noise = float(np.median(np.abs(np.diff(force, 2))) / 0.6745 / np.sqrt(6.0))
    length = _positive(read.gap, _FALLBACK * float(np.ptp(trace.displacement)))
    return Scales(
        force=slip,
        unloading=_positive(_unloading(trace, np.asarray(force) - offset, slip), slip / length),
        build_up=_positive(read.slope, slip / length),
        length=length,
        stroke=float(np.ptp(trace.displacement)),
        speed=_positive(float(np.quantile(np.abs(trace.velocity), _FASTEST)), 1e-9),
        noise=_positive(noise, 1e-3 * slip),
        offset=offset,
    )


def middle(found: Iterable[Scales]) -> Scales:
    """Scales in the middle of several records: the median of each."""
    several = list(found)
    return Scales(
        **{f.name: float(np.median([getattr(s, f.name) for s in several])) for f in fields(Scales)}
    )


def _positive(value: float, other: float) -> float:
    return value if np.isfinite(value) and value > 0.0 else other


def _unloading(trace: Trace, force: Array, slip: float) -> float:
    """Median slope after the turns of full strokes, kip/in; NaN where it cannot be read."""
    x = trace.displacement
    slopes = []
    for first, last, sign in _strokes(trace):
        share = -sign * force[first : last + 1] / slip  # falls from 1 after the turn
        below = [int(np.argmax(share <= level)) for level in UNLOADING]
        travel = abs(x[first + below[1]] - x[first + below[0]])
        drop = share[below[0]] - share[below[1]]
        if share[0] > UNLOADING[0] and travel > 0.0 < drop:
            slopes.append(drop * slip / travel)
    return float(np.median(slopes)) if slopes else float("nan")
