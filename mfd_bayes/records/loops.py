"""Loops of a record: size and energy, what is read off them, and the values of the standards.

With D+ and D- the largest and the smallest displacement of a cycle and F+ and F- the forces there,

    K_eff = (F+ - F-) / (D+ - D-),    beta_eff = (2/pi) E / (K_eff (D+ - D-)^2),    E = ∮ F dx

(ASCE/SEI 7, Eqs. 17.8-1 and 17.8-2; EN 15129 has the same damping as E / (2 pi K_eff d^2), with d
half of the stroke).

The slip force of a stroke is the mean of the force over the `WINDOW` about zero displacement, by
displacement: wide enough for chatter, and inside the plateau. Zero displacement is the record's;
where it lies further from mid-stroke than `OFF_CENTRE` it is only that of a sensor, and mid-stroke
is taken. Measured and computed forces are read alike, over the same window of the same motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.trace import Array, Trace, turning_points

STRONG = 0.95  # a loop is strong from this share of the largest amplitude; others ramp in or out
TURN = 0.1  # for shapes a motion turns when it goes back by this share of its range
FEWEST = 3  # fewest strong loops for which a drift is computed


@dataclass(frozen=True, eq=False)
class Loops:
    """Full loops, each from one of `Trace.cycle_turns` to the second after it.

    `bounds` (L + 1,) are the samples at which loops begin, and at which the last one ends. The
    `offset` (L,) is the mean of both half cycles' mean forces ∫ F dx / ∫ dx: from the load cell's
    zero, dead weight, and the difference between the two directions of the device.
    """

    bounds: NDArray[np.intp]
    period: Array  # s
    amplitude: Array  # in; half the peak-to-peak displacement
    middle: Array  # in; between the largest and the smallest displacement
    energy: Array | None  # kip·in, ∮ F dx; None without a force
    offset: Array | None  # kip

    @property
    def strong(self) -> NDArray[np.bool_]:
        """Whether each loop has at least `STRONG` of the largest amplitude, (L,)."""
        return np.asarray(self.amplitude >= STRONG * self.amplitude.max(initial=0.0))

    @property
    def energy_drift(self) -> float | None:
        """Relative change of the energy from the first third of the strong loops to the last.

        None without a force, with fewer than `FEWEST` strong loops, or fewer than weak ones.
        """
        start, end = self._ends(self.energy)
        return end / start - 1.0 if start else None

    @property
    def offset_drift(self) -> float | None:
        """Change of the offset, kip, from the first third of the strong loops to the last."""
        start, end = self._ends(self.offset)
        return None if start is None else end - start

    def _ends(self, values: Array | None) -> tuple[float | None, float]:
        """Median of the first third and of the last third of the strong loops."""
        strong = int(np.count_nonzero(self.strong))
        if values is None or strong < max(FEWEST, self.amplitude.size - strong):
            return None, 0.0
        selected, third = values[self.strong], strong // 3
        return float(np.median(selected[:third])), float(np.median(selected[-third:]))


def find_loops(trace: Trace) -> Loops:
    """Full loops of a trace."""
    bounds = trace.cycle_turns[::2]
    if bounds.size < 2:
        empty = np.empty(0)
        force = None if trace.force is None else empty
        return Loops(np.empty(0, dtype=np.intp), empty, empty, empty, force, force)
    begins, span = bounds[:-1] - bounds[0], slice(bounds[0], bounds[-1] + 1)
    x = trace.displacement[span]
    high, low = np.maximum.reduceat(x, begins), np.minimum.reduceat(x, begins)
    energy = offset = None
    if trace.force is not None:
        force = trace.force[span]
        work = 0.5 * (force[1:] + force[:-1]) * np.diff(x)
        energy = np.add.reduceat(work, begins)
        halves = trace.cycle_turns[: bounds.size * 2 - 1] - bounds[0]
        means = np.add.reduceat(work, halves[:-1]) / np.diff(x[halves])
        offset = 0.5 * (means[::2] + means[1::2])
    period, amplitude, middle = np.diff(trace.time[bounds]), 0.5 * (high - low), 0.5 * (high + low)
    return Loops(bounds, period, amplitude, middle, energy, offset)


def cycles_made(trace: Trace) -> float:
    """Number of cycles at full stroke that a motion made, with the parts at its ends.

    Ten cycles from zero to zero have nine full loops from turn to turn: their first and last
    quarters, beside full strokes, count too.
    """
    turns, x = trace.cycle_turns, trace.displacement
    strokes = np.abs(np.diff(x[turns]))
    if not strokes.size:
        return 0.0
    longest = float(strokes.max())
    full = strokes >= STRONG * longest
    ends = (full[0], abs(x[turns[0]] - x[0])), (full[-1], abs(x[-1] - x[turns[-1]]))
    partial = sum(min(way / longest, 1.0) for is_full, way in ends if is_full)
    return 0.5 * float(np.count_nonzero(full) + partial)


def channels_swapped(trace: Trace) -> bool:
    """Whether displacement and force of loops of negative work seem to be each other.

    A friction force follows the direction of the motion and is rougher than the motion; with the
    channels exchanged it is the displacement that does.
    """
    energy, x, force = find_loops(trace).energy, trace.displacement, trace.force
    if energy is None or force is None or not energy.sum() < 0.0:
        return False
    rougher = np.log10(roughness(force) / roughness(x))
    return bool(follows(x, force) - follows(force, x) + rougher < 0.0)


def explained_by_motion(trace: Trace) -> float:
    """Share of the variance of the force about its line in time that the motion explains.

    By least squares of displacement, velocity, and the direction of the motion with the distance
    from the middle: of the order of 0.8 for friction, at any lag, and 0 for what is not of this
    motion.
    """
    values = np.asarray(trace.force)
    x, samples = trace.displacement - np.mean(trace.displacement), np.arange(trace.samples)
    way = np.searchsorted(trace.cycle_turns, samples, side="right") % 2 * 2.0 - 1.0
    line = np.column_stack([np.ones(x.size), trace.time - trace.time[0]])
    motion = np.column_stack([line, x, trace.velocity, way, way * np.abs(x)])
    squares = []
    for columns in (line, motion):
        columns = columns / (np.linalg.norm(columns, axis=0) + 1e-300)
        residual = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
        squares.append(float(residual @ residual))
    return 1.0 - squares[1] / squares[0] if squares[0] > 0.0 else 0.0


def roughness(values: Array) -> float:
    """Squared second differences over squared first ones: small where a signal is smooth."""
    return float(np.sum(np.diff(values, 2) ** 2) / np.sum(np.diff(values) ** 2)) or 1e-300


def follows(motion: Array, force: Array) -> float:
    """Size of the correlation of a force with the direction of a motion, (T,) each."""
    turns = turning_points(motion, TURN * float(np.ptp(motion)))
    if turns.size < 2:
        return 0.0
    samples = np.arange(turns[0], turns[-1])
    way = np.searchsorted(turns, samples, side="right") % 2
    if not np.ptp(way) or not np.ptp(force[samples]) > 0.0:
        return 0.0
    return abs(float(np.corrcoef(way, force[samples])[0, 1]))


WINDOW = 0.15  # slip force: over this share of the stroke on both sides of zero displacement,
OFF_CENTRE = 0.1  # which lies at most this share of it from mid-stroke, else it is mid-stroke
RISE = (0.2, 0.8)  # shares of the slip force between which the force builds up after the gap
UNLOADING = (0.8, 0.2)  # shares of the slip force between which the slope after a turn is read


@dataclass(frozen=True, eq=False)
class Strokes:
    """The S strokes of a motion, and what each shows of forces (n, T), (n, S).

    A stroke is the way from one of `Trace.cycle_turns` to the next. `ends` (S, 2) are the first and
    the last sample of each, `sign` (S,) is its direction, `full` (S,) whether it has at least
    `STRONG` of the longest. NaN where nothing is seen.
    """

    ends: NDArray[np.intp]
    sign: Array
    full: NDArray[np.bool_]
    slip: Array  # kip, positive along the stroke
    slope: Array  # kip/in, of the build-up, between the shares `RISE` of the slip force
    gap: Array  # in; travel after a turn at which the line of the build-up meets the slip force


def stroke_estimates(trace: Trace, force: Array, *, mid_stroke: bool = False) -> Strokes:
    """What is read off each stroke of a motion under forces (n, T), kip.

    The slip force is that at zero displacement, or at mid-stroke.
    """
    x = trace.displacement
    ends = np.column_stack([trace.cycle_turns[:-1], trace.cycle_turns[1:]])
    way = np.diff(x[ends])[:, 0]
    full = np.abs(way) >= STRONG * np.max(np.abs(way), initial=0.0)
    slip, slope, gap = np.full((3, len(force), way.size), np.nan)
    strokes = Strokes(ends, np.sign(way), full, slip, slope, gap)
    centre = x[ends].mean(axis=1)
    if not mid_stroke and zero_is_central(trace):
        centre[:] = 0.0
    for k, (a, b) in enumerate(ends):
        weights = _window(x[a : b + 1], centre[k], WINDOW * abs(way[k]))
        slip[:, k] = strokes.sign[k] * (force[:, a : b + 1] @ weights)
    for sign in (1.0, -1.0):
        level = mean_of(slip, full & (strokes.sign == sign))
        for k in np.flatnonzero(strokes.sign == sign).tolist():
            a, b = ends[k]
            travel = np.abs(x[a : b + 1] - x[a])
            slope[:, k], gap[:, k] = _rise(sign * force[:, a : b + 1], travel, level)
    return strokes


def zero_is_central(trace: Trace) -> bool:
    """Whether the zero of the displacement lies near the middle of the strong loops."""
    loops = find_loops(trace)
    stroke, middle = 2.0 * loops.amplitude[loops.strong], loops.middle[loops.strong]
    return not stroke.size or bool(abs(np.median(middle)) <= OFF_CENTRE * np.median(stroke))


def _window(x: Array, centre: float, half: float) -> Array:
    """Weights, (m,), of samples in their mean over a window of a stroke x, (m,), by displacement.

    The force is taken as linear between samples. NaN where the window leaves the stroke.
    """
    low, high = centre - half, centre + half
    if not min(x[0], x[-1]) <= low < high <= max(x[0], x[-1]):
        return np.full(x.size, np.nan)
    clipped, step = np.clip(x, low, high), np.diff(x)
    share = (
        0.5 * (clipped[1:] + clipped[:-1]) - x[:-1]
    )  # of a step, to the middle of what is inside
    share = np.divide(share, step, out=np.full(step.size, 0.5), where=step != 0.0)
    weight = np.diff(clipped) / (clipped[-1] - clipped[0])
    return np.asarray(np.append(weight * (1.0 - share), 0.0) + np.insert(weight * share, 0, 0.0))


def asymmetry(trace: Trace) -> Array:
    """How far the loop is from the same in both directions, along a stroke, (P,), kip.

    The mean of the forward force and of the backward force, less its own mean: a record with both
    signs swapped has the opposite. NaN without full strokes in both directions.
    """
    grid = np.linspace(0.02, 0.98, 60)
    strokes, force = stroke_estimates(trace, np.empty((0, trace.samples))), np.asarray(trace.force)
    sides = []
    for sign in (1.0, -1.0):
        curves = [np.full(grid.size, np.nan)]
        for a, b in strokes.ends[strokes.full & (strokes.sign == sign)]:
            x = trace.displacement[a : b + 1]
            travel = np.maximum.accumulate((x - x[0]) / (x[-1] - x[0]))
            curves.append(np.interp(grid, travel, force[a : b + 1]))
        sides.append(np.median(curves[1:] or curves, axis=0))
    mean = 0.5 * (sides[0] + sides[1])
    return np.asarray(mean - mean.mean())


def _rise(force: Array, travel: Array, slip: Array) -> tuple[Array, Array]:
    """Slope of the build-up, kip/in, and travel at which it meets the slip force, in, (n,) each."""
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(slip[:, None] > 0.0, force / slip[:, None], np.nan)
        top = np.argmax(share >= RISE[1], axis=1)
        before_rise = (share <= RISE[0]) & (np.arange(travel.size) < top[:, None])
        bottom = travel.size - 1 - np.argmax(before_rise[:, ::-1], axis=1)
        bottom[~before_rise.any(axis=1)] = 0
        low, high = (
            _crossing(share, travel, index, level)
            for index, level in ((bottom, RISE[0]), (np.maximum(top - 1, 0), RISE[1]))
        )
        valid = before_rise.any(axis=1) & (high > low)
        slope = np.where(valid, (RISE[1] - RISE[0]) * slip / (high - low), np.nan)
        return slope, np.asarray(high + (1.0 - RISE[1]) * slip / slope)


def _crossing(share: Array, travel: Array, i: NDArray[np.intp], level: float) -> Array:
    """Travel, (n,), at which shares (n, m) cross a level between samples `i` and `i` + 1."""
    rows, next_i = np.arange(len(share)), np.minimum(i + 1, travel.size - 1)
    lower, upper = share[rows, i], share[rows, next_i]
    fraction = np.where(upper > lower, (level - lower) / (upper - lower), 0.0)
    return np.asarray(travel[i] + fraction * (travel[next_i] - travel[i]))


def mean_of(values: Array, mask: NDArray[np.bool_] | None = None) -> Array:
    """Mean of values (…, L) that are known, of some cycles or of all, (…); NaN where none is."""
    valid = np.isfinite(values) if mask is None else np.isfinite(values) & mask
    means = np.ma.array(values, mask=~valid).mean(axis=-1)
    return np.asarray(np.ma.filled(means, np.nan))
