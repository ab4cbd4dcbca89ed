"""The full loops of a record: amplitude, period, energy, mean force, and their drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.motion import Array, turning_points
from mfd_bayes.records.trace import Trace

STRONG = 0.95  # a loop is strong from this share of the largest amplitude on; others ramp in or out
TURN = 0.1  # for shapes a motion turns when it goes back by this share of its range
FEWEST = 3  # fewest strong loops for which a drift is computed


@dataclass(frozen=True, eq=False)
class Loops:
    """Full loops, each from one of `Trace.cycle_turns` to the second after it.

    Attributes
    ----------
    bounds : (L + 1,), int
        Samples at which the loops begin, and at which the last one ends; empty without a loop.
    period : (L,), s
    amplitude : (L,), in
        Half the peak-to-peak displacement.
    middle : (L,), in
        Middle between the largest and the smallest displacement.
    energy : (L,), kip·in, or None
        Dissipated energy, ∮ F dx, by the trapezoidal rule; None without a force.
    offset : (L,), kip, or None
        Mean of both half cycles' mean forces ∫ F dx / ∫ dx: from the load cell's zero, dead weight,
        and the difference between the two directions of the device.
    """

    bounds: NDArray[np.intp]
    period: Array
    amplitude: Array
    middle: Array
    energy: Array | None
    offset: Array | None

    @property
    def strong(self) -> NDArray[np.bool_]:
        """Whether each loop has at least `STRONG` of the largest amplitude, (L,)."""
        return np.asarray(self.amplitude >= STRONG * self.amplitude.max(initial=0.0))

    @property
    def energy_drift(self) -> float | None:
        """Relative change of the energy from the first third of the strong loops to the last.

        None without a force, with fewer than `FEWEST` strong loops, or fewer than weak ones.
        """
        ends = self._ends(self.energy)
        return None if ends is None or ends[0] == 0.0 else ends[1] / ends[0] - 1.0

    @property
    def offset_drift(self) -> float | None:
        """Change of the offset, kip, from the first third of the strong loops to the last."""
        ends = self._ends(self.offset)
        return None if ends is None else ends[1] - ends[0]

    def _ends(self, values: Array | None) -> tuple[float, float] | None:
        """Median of the first third and of the last third of the strong loops."""
        strong = int(np.count_nonzero(self.strong))
        if values is None or strong < max(FEWEST, self.amplitude.size - strong):
            return None
        kept, third = values[self.strong], strong // 3
        return float(np.median(kept[:third])), float(np.median(kept[-third:]))


def find_loops(trace: Trace) -> Loops:
    """Full loops of a trace."""
    bounds = trace.cycle_turns[::2]
    if bounds.size < 2:
        empty = np.empty(0)
        force = None if trace.force is None else empty
        return Loops(np.empty(0, dtype=np.intp), empty, empty, empty, force, force)
    begins = bounds[:-1] - bounds[0]
    kept = slice(bounds[0], bounds[-1] + 1)
    x = trace.displacement[kept]
    high, low = np.maximum.reduceat(x, begins), np.minimum.reduceat(x, begins)
    energy = offset = None
    if trace.force is not None:
        steps, force = np.diff(x), trace.force[kept]
        mean = 0.5 * (force[1:] + force[:-1])
        energy = np.add.reduceat(mean * steps, begins)
        halves = trace.cycle_turns[: 2 * begins.size + 1] - bounds[0]
        along = np.add.reduceat(mean * steps, halves[:-1]) / np.diff(x[halves])
        offset = 0.5 * (along[::2] + along[1::2])
    period, amplitude, middle = np.diff(trace.time[bounds]), 0.5 * (high - low), 0.5 * (high + low)
    return Loops(bounds, period, amplitude, middle, energy, offset)


def channels_swapped(trace: Trace) -> bool:
    """Whether displacement and force of loops of negative work seem to be each other.

    A friction force follows the direction of the motion and is rougher than the motion; with the
    channels exchanged it is the displacement that does.
    """
    energy = find_loops(trace).energy
    if energy is None or not energy.sum() < 0.0:
        return False
    x, force = trace.displacement, np.asarray(trace.force)
    rougher = np.log10(roughness(force) / roughness(x))
    return bool(follows(x, force) - follows(force, x) + rougher < 0.0)


def roughness(values: Array) -> float:
    """Squared second differences over squared first ones: small where a signal is smooth."""
    return float(np.sum(np.diff(values, 2) ** 2) / np.sum(np.diff(values) ** 2)) or 1e-300


def follows(motion: Array, force: Array) -> float:
    """Size of the correlation of a force with the direction of a motion, (T,) each."""
    turns = turning_points(motion, TURN * float(np.ptp(motion)))
    if turns.size < 2 or not np.ptp(force) > 0.0:
        return 0.0
    inside = slice(int(turns[0]), int(turns[-1]))
    way = np.where(np.searchsorted(turns, np.arange(motion.size), side="right") % 2, 1.0, -1.0)
    if not np.ptp(way[inside]) > 0.0 or not np.ptp(force[inside]) > 0.0:
        return 0.0
    return abs(float(np.corrcoef(way[inside], force[inside])[0, 1]))
