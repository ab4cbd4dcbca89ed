"""Spikes of a signal, overflow values, and the signal without them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.motion import Array
from mfd_bayes.records.trace import Trace

Samples = NDArray[np.intp]

SPIKE = 0.10  # an isolated sample that stands out by this share of the signal's range is a spike


OVERFLOW, LONGEST = 10.0, 5
"""Further from the median than so many times the range of the middle half, a value that does not
change, or that lasts for at most so many samples, is no measurement."""


def runs(flags: NDArray[np.bool_]) -> tuple[Samples, Samples]:
    """Sample before each run of flags, and the length of the run."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return (edges[::2] - 1).astype(np.intp), (edges[1::2] - edges[::2]).astype(np.intp)


def without_spikes(trace: Trace) -> Trace:
    """The trace with its spikes replaced by lines between their neighbours."""
    x, force = spikes_of(trace.displacement), trace.force
    at = force_spikes(trace)
    if x.size:
        near = np.unique(np.clip(x[:, None] + np.arange(-1, 2), 0, trace.samples - 1))
        motion = (
            interpolated(trace.displacement, x),
            None,
            force,
            interpolated(trace.velocity, near),
        )
        trace = replace(
            Trace.from_arrays(trace.time, *motion), actuation=trace.actuation, timed=trace.timed
        )
    return replace(trace, force=interpolated(np.asarray(force), at)) if at.size else trace


def mended(values: Array) -> Array:
    """A signal with lines in place of its spikes."""
    at = spikes_of(values)
    return interpolated(values, at) if at.size else values


def interpolated(values: Array, at: Samples) -> Array:
    """A signal with lines in place of some samples."""
    sound = np.delete(np.arange(values.size), at)
    return np.asarray(np.interp(np.arange(values.size), sound, values[sound]))


def spikes_of(values: Array) -> Samples:
    """Spikes of one or a few samples, and overflow values."""
    spikes = [*(_isolated(values, n) for n in (1, 2, 3)), _over(values)]
    return np.asarray(np.unique(np.concatenate(spikes)), dtype=np.intp)


def force_spikes(trace: Trace) -> Samples:
    """Spikes of the force, if any; where the motion turns, a force within its range is none."""
    if trace.force is None:
        return np.empty(0, dtype=np.intp)
    at, steps = spikes_of(trace.force), np.diff(trace.displacement)
    turns = np.concatenate([[False], steps[1:] * steps[:-1] < 0.0, [False]])
    low, high = np.quantile(trace.force, [0.005, 0.995])
    explained = turns & (trace.force >= low) & (trace.force <= high)
    return np.asarray(at[~explained[at]], dtype=np.intp)


def _isolated(values: Array, width: int) -> Samples:
    """Samples that differ from both neighbours, while the neighbours agree."""
    inside = np.lib.stride_tricks.sliding_window_view(values[1:-1], width)
    if not inside.size:
        return np.empty(0, dtype=np.intp)
    left, right = values[: -width - 1], values[width + 1 :]
    before, behind = inside - left[:, None], inside - right[:, None]
    up = np.minimum(before.min(axis=1), behind.min(axis=1))
    down = np.minimum(-before.max(axis=1), -behind.max(axis=1))
    height = np.maximum(np.maximum(up, down), 0.0)
    agree = np.abs(right - left) < 0.25 * height
    reach = float(np.subtract(*np.quantile(values, [0.995, 0.005])))
    usual = float(np.quantile(height, 0.99))
    share = SPIKE if width == 1 else 1.0  # a peak of the signal itself is wider
    at = np.flatnonzero(agree & (height > share * reach) & (height > 4 * usual)) + 1
    return np.unique(at[:, None] + np.arange(width)).astype(np.intp)


def _over(values: Array) -> Samples:
    """Values of an overflow or a missing reading: far from all others, and reached in one step."""
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    away = np.abs(values - middle)
    spikes = [np.empty(0, dtype=np.intp)]
    if high > low:
        for start, length in zip(*runs(away > OVERFLOW * (high - low)), strict=True):
            at = np.arange(start + 1, start + 1 + length)
            ends = [n for n in (start, start + 1 + length) if 0 <= n < values.size]
            sudden = all(away[n] < 0.5 * away[at].min() for n in ends)
            if sudden and (length <= LONGEST or np.ptp(values[at]) == 0.0):
                spikes.append(at)
    return np.concatenate(spikes)
