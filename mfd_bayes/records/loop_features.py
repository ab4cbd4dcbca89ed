"""Slip force, stiffness, gap and scales read off the loops of a record, without a model."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np

from mfd_bayes.records.loops import STRONG, find_loops
from mfd_bayes.records.motion import Array
from mfd_bayes.records.spikes import without_spikes
from mfd_bayes.records.trace import Trace

SLIP = (0.5, 0.95)
"""Shares of a stroke between which the damper slips: the plateau is the median force there."""

RISE = (0.2, 0.8)
"""Shares of the plateau between which the force builds up after the gap."""


@dataclass(frozen=True)
class Readings:
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


def read_off(trace: Trace, offset: float = 0.0) -> Readings:
    """Readings of a record less the offset of its load cell, kip.

    A motion without a full stroke, or without a force, has none: all are NaN.
    """
    nan = float("nan")
    strokes = _strokes(trace) if trace.force is not None else []
    if not strokes:
        return Readings(nan, nan, nan, nan, nan)
    force = np.asarray(trace.force) - offset
    plateaus = {
        way: _median([_plateau(trace, force, a, b) for a, b, s in strokes if s == way])
        for way in (1, -1)
    }
    rises = [_rise(trace, force, stroke, plateaus) for stroke in strokes]
    loops = find_loops(trace)
    has = loops.energy is not None and bool(loops.strong.any())
    energy = float(np.mean(np.asarray(loops.energy)[loops.strong])) if has else nan
    slope, gap = (_median([rise[k] for rise in rises]) for k in (0, 1))
    return Readings(plateaus[1], plateaus[-1], slope, gap, energy)


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


def _plateau(trace: Trace, force: Array, first: int, last: int) -> float:
    """Median force in the direction of the motion over the slip of one stroke, kip."""
    x = trace.displacement[first : last + 1]
    way = (x - x[0]) / (x[-1] - x[0])
    inside = (way >= SLIP[0]) & (way <= SLIP[1])
    sign = 1.0 if x[-1] > x[0] else -1.0
    return sign * float(np.median(force[first : last + 1][inside])) if inside.any() else np.nan


def _rise(
    trace: Trace, force: Array, stroke: tuple[int, int, int], plateaus: dict[int, float]
) -> tuple[float, float]:
    """Slope of the build-up of one stroke, kip/in, and travel at which it meets the plateau, in."""
    first, last, sign = stroke
    level = plateaus[sign]
    if not level > 0.0:
        return np.nan, np.nan
    share = sign * force[first : last + 1] / level
    travel = np.abs(trace.displacement[first : last + 1] - trace.displacement[first])
    top = int(np.argmax(share >= RISE[1]))
    below = np.flatnonzero(share[:top] <= RISE[0])
    if not below.size:
        return np.nan, np.nan
    ends = ((int(below[-1]), RISE[0]), (top - 1, RISE[1]))
    low, high = (_crossing(share, travel, k, level) for k, level in ends)
    if not high > low:
        return np.nan, np.nan
    steepness = (RISE[1] - RISE[0]) * plateaus[sign] / (high - low)
    return steepness, high + (1.0 - RISE[1]) * plateaus[sign] / steepness


def _crossing(share: Array, travel: Array, k: int, level: float) -> float:
    """Travel at which the share crosses a level between samples k and k + 1."""
    step = share[k + 1] - share[k]
    part = (level - share[k]) / step if step > 0 else 0.0
    return float(travel[k] + part * (travel[k + 1] - travel[k]))


def _median(values: list[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else float("nan")


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
    read = read_off(trace, offset)
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
