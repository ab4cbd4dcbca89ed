"""Figures read off the loops of a record by a plain rule, without a model."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mfd_bayes.records.loops import STRONG, find_loops
from mfd_bayes.records.motion import Array
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
