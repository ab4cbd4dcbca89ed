"""The full loops of a record: how large, how fast, how much energy, and how these drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

STRONG = 0.95
"""A loop of at least this share of the largest amplitude is no ramp, and counts in a drift."""

FEWEST = 3
"""Fewest strong loops of which a drift is told."""


@dataclass(frozen=True, eq=False)
class Loops:
    """Full loops, each from one turning point to the second after it.

    Attributes
    ----------
    bounds : (L + 1,), int
        Samples at which the loops begin, and at which the last ends; empty without a loop.
    period : (L,), s
    amplitude : (L,), in
        Half the peak-to-peak displacement.
    energy : (L,), kip·in, or None
        Dissipated, ∮ F dx, by the trapezoidal rule; None without a force.
    offset : (L,), kip, or None
        Mean force along the way, ∮ F |dx| / ∮ |dx|: zero of the load cell, dead weight, and
        what the device differs by between its directions.
    """

    bounds: NDArray[np.intp]
    period: Array
    amplitude: Array
    energy: Array | None
    offset: Array | None

    @property
    def strong(self) -> NDArray[np.bool_]:
        """Which loops are no ramps, (L,)."""
        return np.asarray(self.amplitude >= STRONG * self.amplitude.max(initial=0.0))

    @property
    def _steady(self) -> bool:
        """Whether enough loops are strong, and no fewer than the others, for a drift to be told."""
        strong = int(np.count_nonzero(self.strong))
        return strong >= max(FEWEST, self.amplitude.size - strong)

    @property
    def energy_drift(self) -> float | None:
        """Energy of the last third of the strong loops over that of the first, less one.

        None where there are fewer than `FEWEST`, or than weak ones, or no force.
        """
        if self.energy is None or not self._steady:
            return None
        first, last = _ends(self.energy[self.strong])
        return last / first - 1.0 if first != 0.0 else None

    @property
    def offset_drift(self) -> float | None:
        """Offset of the last third of the strong loops less that of the first, kip, or None."""
        if self.offset is None or not self._steady:
            return None
        first, last = _ends(self.offset[self.strong])
        return last - first


def find_loops(trace: Trace) -> Loops:
    """Full loops of a trace, at its own rate."""
    bounds = trace.turning_points[::2]
    if bounds.size < 2:
        empty = np.empty(0)
        force = None if trace.force is None else empty
        return Loops(np.empty(0, dtype=np.intp), empty, empty, force, force)
    begins = bounds[:-1] - bounds[0]
    kept = slice(bounds[0], bounds[-1] + 1)
    x = trace.displacement[kept]
    high, low = np.maximum.reduceat(x, begins), np.minimum.reduceat(x, begins)
    energy = offset = None
    if trace.force is not None:
        steps, force = np.diff(x), trace.force[kept]
        mean = 0.5 * (force[1:] + force[:-1])
        energy = np.add.reduceat(mean * steps, begins)
        way = np.add.reduceat(np.abs(steps), begins)
        offset = np.add.reduceat(mean * np.abs(steps), begins) / way
    return Loops(bounds, np.diff(trace.time[bounds]), 0.5 * (high - low), energy, offset)


def _ends(values: Array) -> tuple[float, float]:
    """Median of the first third, and of the last."""
    third = max(1, values.size // 3)
    return float(np.median(values[:third])), float(np.median(values[-third:]))
