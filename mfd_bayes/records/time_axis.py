"""The time of a record: its rate, how even it is, and its longest piece without a gap."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from math import ceil, inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import MfdError, RecordError, UnitError
from mfd_bayes.records.numbers import real_number
from mfd_bayes.records.readers import Table
from mfd_bayes.records.trace import Array
from mfd_bayes.units import parse_quantity

SAMPLES = 20  # fewest samples that a record, or a window of it, may have
GAP = 10.0  # a step longer than this many median steps is a gap in time
PAUSE = 1.9  # a step longer than this many median steps is a pause
SHORTEST = 1e-9  # shortest step in time that is accepted, s
JITTER = 0.01  # above this jitter, in steps, samples are interpolated onto a uniform grid


@dataclass(frozen=True)
class Clock:
    """When samples were taken."""

    rate: float  # Hz; (T - 1) over the duration without pauses
    jitter: float  # largest distance of a sample from a uniform grid between the ends, in steps
    pauses: int  # number of steps longer than `PAUSE` median steps
    longest: float  # s; longest step

    def words(self) -> str:
        """Rate, and how even it is, in words."""
        rate = f"{self.rate:.6g} Hz"
        if self.jitter <= JITTER:
            return f"{rate}, jitter {self.jitter:.2%} of a step"
        away = f"{self.jitter:.3g} steps" if self.jitter >= 1.0 else f"{self.jitter:.2%} of a step"
        text = f"{rate}, jitter: time stamps are up to {away} off an even clock"
        if self.pauses:
            times = "once" if self.pauses == 1 else f"{self.pauses} times"
            text += f"; the logger pauses {times}, for up to {self.longest:.3g} s"
        return text


def after_gaps(time: Array) -> NDArray[np.intp]:
    """Samples of an increasing time, (T,), s, before which there is a gap."""
    steps = np.diff(time)
    return np.flatnonzero(steps > GAP * np.median(steps)) + 1


def longest_piece(
    time: Array, place: Callable[[int], str], window: tuple[float, float] | None
) -> tuple[slice, str]:
    """Samples of the longest piece of a time without a gap, and a sentence where there is one.

    `place` names a row, from 0; only the part of a piece inside the window counts.
    """
    steps, after = np.diff(time), after_gaps(time)
    if not after.size:
        return slice(0, time.size), ""
    bounds = [0, *(int(at) for at in after), time.size]
    start, end = (-np.inf, np.inf) if window is None else window
    spans = [min(time[b - 1], end) - max(time[a], start) for a, b in pairwise(bounds)]
    best = int(np.argmax(spans))
    first, last = bounds[best], bounds[best + 1]
    missing = float(steps[after - 1].max())
    gaps = "a gap" if after.size == 1 else f"{after.size} gaps, the longest"
    at = int(after[np.argmax(steps[after - 1])])
    share = (time[last - 1] - time[first]) / (time[-1] - time[0])
    return slice(first, last), (
        f"time has {gaps} of {missing:.4g} s before {place(at)}, after {time[at - 1]:g} s; the "
        f"longest unbroken piece is used, {time[first]:g} s to {time[last - 1]:g} s, "
        f"{share:.0%} of the record"
    )


def check_increasing(table: Table, time: Array) -> None:
    """Refuse a time of a table, (T,), s, that is too short, stands still or goes back."""
    path, place = table.path, table.place
    if time.size < SAMPLES:
        raise RecordError(f"{path} has {time.size} samples; at least {SAMPLES} are needed")
    steps = np.diff(time)
    if not np.all(steps > 0):
        row = int(np.argmax(steps <= 0)) + 1
        if row in table.blocks:
            raise RecordError(
                f"{path} holds {len(table.blocks) + 1} blocks: the heading is repeated from "
                f"{table.blocks[row]}, and time starts again below it, {time[row]:g} s after "
                f"{time[row - 1]:g} s: keep one block in a file"
            )
        coarse = table.stamped and steps[row - 1] == 0.0
        raise RecordError(
            f"time in {path} does not increase at {place(row)}: "
            f"{time[row]:g} s after {time[row - 1]:g} s"
            + ('; where time stamps are too coarse, write rate = "100 Hz"' if coarse else "")
        )
    shortest = int(np.argmin(steps))
    if steps[shortest] < SHORTEST:
        raise RecordError(
            f"time in {path} increases by {steps[shortest]:.2g} s at "
            f"{place(shortest + 1)}; expected {SHORTEST:g} s or more"
        )


def clock_of(time: Array) -> Clock:
    """Rate and evenness of an increasing time, (T,), s."""
    steps = np.diff(time)
    median = float(np.median(steps))
    step = float(time[-1] - time[0]) / (time.size - 1)
    jitter = float(np.max(np.abs(time - np.linspace(time[0], time[-1], time.size)))) / step
    late = steps > PAUSE * median
    pauses = int(np.count_nonzero(late))
    rate = 1.0 / float(np.mean(steps[~late]))
    return Clock(rate if pauses else 1.0 / step, jitter, pauses, float(steps.max()))


def checked_window(
    window: object, name: str = "a window", error: type[MfdError] = RecordError
) -> tuple[float, float]:
    """Two times, s, the first before the second; either may be infinite."""
    expected = f"{name} must be two times in s, the earlier one first, got {window!r}"
    if isinstance(window, str | bytes) or not isinstance(window, Sequence | np.ndarray):
        raise error(expected)
    try:
        start, end = (t if t in (-inf, inf) else real_number(name, t, error) for t in window)
    except (TypeError, ValueError, error) as fault:
        raise error(expected) from fault
    if not start < end:
        raise error(expected)
    return float(start), float(end)


def parse_window(text: str, *, of: str = "", timed: bool = True) -> tuple[float, float]:
    """Start and end, in s, of ``"0 s to 60 s"``; `of` is what it is of, for messages.

    Where samples are numbered, those of ``"0 to 300"``.
    """
    parts, of = text.split(" to "), of or "a window"
    numbered = re.fullmatch(r"\s*(\d{1,9}) to (\d{1,9})\s*", text)
    if not timed and numbered is None:
        raise UnitError(f"{of} must be two numbers of samples such as '0 to 300', got {text!r}")
    if len(parts) != 2:
        raise UnitError(f"{of} must be two times such as '0 s to 60 s', got {text!r}")
    if numbered and not timed:
        start, end = float(numbered[1]), float(numbered[2])
    else:
        start, end = (parse_quantity(part, "time", of=of) for part in parts)
    if not start < end:
        raise UnitError(f"{of} must end after it starts, got {text!r}")
    return start, end


MOST_SAMPLES = 6000  # most samples of a trace at the default rate


def decimate(values: Array, share: Fraction, first: int, last: int) -> Array:
    """Signal, (N,), from sample `first` to `last` at a lower rate, without delay.

    `share` is the new rate over the old. A symmetric low-pass filter, flat to 0.7 of the new
    Nyquist frequency and at least 40 dB down above it. It also uses the samples before `first` and
    after `last`, and beyond the ends of the signal its point reflection, which keeps value and
    slope there.
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
    record_rate: float,
) -> float:
    """Lowest sampling rate, Hz, that resolves the crossing of a gap and the half-cycles.

    At least 20 samples per crossing of the gap after a turning point, by the lower quartile of
    the crossing times, and 40 per median half-cycle, if the record has them; then the next
    higher rate that is the record's over a whole number. At most `MOST_SAMPLES` samples, which
    comes before all else: a long record gets fewer samples per crossing.
    """
    crossings = crossing_times(time, displacement, turns, gap)
    needs = [20 / float(np.quantile(crossings, 0.25))] if crossings else []
    if turns.size > 1:
        needs.append(40 / float(np.median(np.diff(time[turns]))))
    needed = max(needs, default=record_rate)
    divisor = max(1, int(record_rate / needed * (1 + 1e-9)))
    return record_rate / max(divisor, ceil(time.size / MOST_SAMPLES))


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
