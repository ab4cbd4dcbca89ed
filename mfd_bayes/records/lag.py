"""The lag of the force behind the displacement of a record."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.motion import Array
from mfd_bayes.records.trace import Trace

NEAR = 0.05  # the fit uses this share of the peak-to-peak displacement around a reversal
STROKES = 0.4  # shorter strokes, by their share of the longest, have no clear reversal
REVERSALS = 40  # most reversals that are used
REACH = 0.06  # largest lag, s; eight samples or 3 % of a cycle where that is more
LIKELY = 0.85  # a lag counts up to this share of the squared misfit without a lag
_SAMPLES = 120  # of one reversal, at any rate
_LENGTHS = np.geomspace(0.02, 1.5, 10)  # of the release, over the distance that is used


def estimate_lag(trace: Trace) -> tuple[float, NDArray[np.intp]] | None:
    """Lag of the force behind the displacement, s, and the reversals that it was found at.

    After a turn of the motion the friction force falls, fastest at the turn itself: by
    A (1 − exp(−s/λ)) at the distance s from it. A and a line in time, for the level before the
    turn and viscous friction, are fitted to each reversal, λ and the lag to all reversals
    together. A late force begins to fall after the turn, an early one before it.

    Returns
    -------
    (lag, (K,) int) or None
        None without a force or reversals, or where no lag fits clearly better.
    """
    x, turns = trace.displacement, trace.cycle_turns
    ends = np.concatenate([[0], turns, [x.size - 1]])
    strokes = np.array([abs(x[b] - x[a]) for a, b in pairwise(ends)])
    long = strokes >= STROKES * np.ptp(x)
    turns = turns[long[:-1] & long[1:]]  # away from the ends, between long strokes
    turns = turns[:: max(1, -(-turns.size // REVERSALS))]
    if trace.force is None or np.ptp(trace.force) == 0.0 or turns.size < 2:
        return None
    step = float(np.median(np.diff(trace.time)))
    cycle = 2 * float(np.median(np.diff(trace.time[trace.cycle_turns])))
    reach = max(REACH, 8 * step, 0.03 * cycle)
    coarse = np.linspace(-reach, reach, 49)
    lag, misfit, at_rest = _best(trace, turns, coarse)
    if abs(lag) >= reach * 0.999 or misfit > LIKELY * at_rest:
        return None
    spacing = coarse[1] - coarse[0]
    lag, _, _ = _best(trace, turns, lag + np.linspace(-spacing, spacing, 9))
    return lag, turns


def _best(trace: Trace, turns: NDArray[np.intp], lags: Array) -> tuple[float, float, float]:
    """Lag with the smallest misfit, that misfit, and the misfit at the lag nearest to 0."""
    misfit = np.zeros((_LENGTHS.size, lags.size))
    for turn in turns.tolist():
        misfit += _misfit(trace, turn, lags)
    least = misfit.min(axis=0)
    at = int(np.argmin(least))
    return float(lags[at]), float(least[at]), float(least[int(np.argmin(np.abs(lags)))])


def _misfit(trace: Trace, turn: int, lags: Array) -> Array:
    """Squared misfit of the release to the force around one turn, (lengths, lags)."""
    near = NEAR * float(np.ptp(trace.displacement))
    away = np.abs(trace.displacement - trace.displacement[turn])
    before, behind = np.flatnonzero(away[:turn] > near), np.flatnonzero(away[turn:] > near)
    first = int(before[-1]) + 1 if before.size else 0
    last = turn + int(behind[0]) - 1 if behind.size else away.size - 1
    if last - first < 4:
        return np.zeros((_LENGTHS.size, lags.size))
    count = min(_SAMPLES, last - first + 1)
    time = np.linspace(trace.time[first], trace.time[last], count)
    force = np.interp(time, trace.time[first : last + 1], np.asarray(trace.force)[first : last + 1])
    released = np.where(np.arange(away.size) > turn, away, 0.0)
    begin = max(0, first - (last - first))
    distance = np.interp(
        time[None, :] - lags[:, None], trace.time[begin : last + 1], released[begin : last + 1]
    )
    shape = -np.expm1(-distance[None] / (near * _LENGTHS[:, None, None]))
    # Parts that are linear in time, as a viscous force is at a turn, are removed from both.
    line = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, count), 1)
    basis = np.linalg.qr(line)[0]
    shape -= (shape @ basis) @ basis.T
    force = force - basis @ (basis.T @ force)
    square = np.sum(shape**2, axis=2)
    along = shape @ force
    gain = np.divide(along**2, square, out=np.zeros_like(along), where=square > 1e-12)
    return np.asarray(np.sum(force**2) - gain)
