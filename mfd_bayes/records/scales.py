"""Orders of magnitude of a device, read off its records: what priors from data are made of."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np

from mfd_bayes.records.faults import without_spikes
from mfd_bayes.records.loops import STRONG, find_loops
from mfd_bayes.records.motion import Array
from mfd_bayes.records.readings import read_off
from mfd_bayes.records.trace import Trace

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
    length = _positive(read.gap, _FALLBACK * float(np.ptp(trace.displacement)))
    return Scales(
        force=slip,
        unloading=_positive(_unloading(trace, np.asarray(force) - offset, slip), slip / length),
        build_up=_positive(read.slope, slip / length),
        length=length,
        stroke=float(np.ptp(trace.displacement)),
        speed=_positive(float(np.quantile(np.abs(trace.velocity), _FASTEST)), 1e-9),
        noise=_positive(_noise(np.asarray(force)), 1e-3 * slip),
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


def _noise(force: Array) -> float:
    """Standard deviation of white noise whose second differences have the size of these."""
    return float(np.median(np.abs(np.diff(force, 2))) / 0.6745 / np.sqrt(6.0))


def _unloading(trace: Trace, force: Array, slip: float) -> float:
    """Median slope after the turns of full strokes, kip/in; NaN where it cannot be read."""
    x = trace.displacement
    turns = list(pairwise(int(turn) for turn in trace.cycle_turns))
    longest = max((abs(x[b] - x[a]) for a, b in turns), default=0.0)
    slopes = []
    for first, last in turns:
        if abs(x[last] - x[first]) < STRONG * longest:
            continue
        sign = 1.0 if x[last] > x[first] else -1.0
        share = -sign * force[first : last + 1] / slip  # falls from 1 after the turn
        below = [int(np.argmax(share <= level)) for level in UNLOADING]
        travel = abs(x[first + below[1]] - x[first + below[0]])
        drop = share[below[0]] - share[below[1]]
        if share[0] > UNLOADING[0] and travel > 0.0 < drop:
            slopes.append(drop * slip / travel)
    return float(np.median(slopes)) if slopes else float("nan")
