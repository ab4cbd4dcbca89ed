"""Decimation without delay, and the sampling rate that is enough."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.motion import Array

MOST_SAMPLES = 6000  # most samples of a trace at the default rate


def decimate(values: Array, share: Fraction, first: int, last: int) -> Array:
    """Signal, (N,), from sample `first` to `last` at a lower rate, without delay.

    A symmetric low-pass filter, flat to 0.7 of the new Nyquist frequency and at least 40 dB
    down above it. The filter also uses the samples before `first` and after `last`; beyond the
    ends of the signal it uses its point reflection, which keeps value and slope there.

    Parameters
    ----------
    values : (T,)
    share : Fraction
        New rate over old, at most 1.
    first, last : int
        `first` is the first sample of the result; no sample of the result is after `last`.
    """
    from scipy.signal import firwin, resample_poly

    up, down = share.numerator, share.denominator
    # The filter reaches over ten new samples; the padding is a whole number of new samples.
    blocks = -(-10 // up)
    pad = blocks * down
    padded = np.pad(values, pad, mode="reflect", reflect_type="odd")
    taps = firwin(20 * down + 1, 0.84 / down, window=("kaiser", 5.0))
    window: Any = taps  # scipy's documentation allows taps here, its type stubs do not
    piece = padded[first : last + 2 * pad + 1]
    fine = resample_poly(piece, up, down, window=window, padtype="line")
    count = (last - first) * up // down + 1
    return np.asarray(fine[blocks * up :][:count], dtype=np.float64)


def default_rate(
    time: Array,
    displacement: Array,
    turns: NDArray[np.intp],
    gap: float,
    *,
    rate: float | None = None,
) -> float:
    """Lowest sampling rate, Hz, that resolves the crossing of a gap and the half-cycles.

    At least 20 samples per crossing of the gap after a turning point, by the lower quartile of
    the crossing times, and 40 per median half-cycle, if the record has them; then the next
    higher rate that is the record's over a whole number. At most `MOST_SAMPLES` samples, which
    comes before all else: a long record gets fewer samples per crossing.

    Parameters
    ----------
    time : (T,), s
    displacement : (T,), in
    turns : (K,), int
        Samples at which the motion turns.
    gap : float, in
    rate : float, Hz, optional
        The record's; by default from `time`.
    """
    record_rate = (time.size - 1) / float(time[-1] - time[0]) if rate is None else rate
    crossings = crossing_times(time, displacement, turns, gap)
    needs = [20 / float(np.quantile(crossings, 0.25))] if crossings else []
    if turns.size > 1:
        needs.append(40 / float(np.median(np.diff(time[turns]))))
    needed = max(needs, default=record_rate)
    divisor = max(1, int(record_rate / needed * (1 + 1e-9)))
    return record_rate / max(divisor, math.ceil(time.size / MOST_SAMPLES))


def crossing_times(
    time: Array, displacement: Array, turns: NDArray[np.intp], gap: float
) -> list[float]:
    """Times, s, from each turning point to a distance `gap` from it, if reached before the next."""
    times = []
    for start, end in zip(turns, [*turns[1:], time.size - 1], strict=False):  # there may be none
        away = np.abs(displacement[start : end + 1] - displacement[start])
        reached = int(np.argmax(away >= gap))
        if away[reached] >= gap and reached > 0:
            part = (gap - away[reached - 1]) / (away[reached] - away[reached - 1])
            at = start + reached
            times.append(float(time[at - 1] + part * (time[at] - time[at - 1]) - time[start]))
    return times
