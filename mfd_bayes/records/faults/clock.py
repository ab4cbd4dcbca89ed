"""Faults of the clock and of the motion: units, rate, lost and repeated samples, length."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mfd_bayes.records.faults.fault import Fault, count, rate_of, runs, spread
from mfd_bayes.records.resampling import crossing_times
from mfd_bayes.records.trace import Trace

FAST = 400.0  # a speed, in/s, that no damper reaches
CROSSING = 10  # fewest samples, and steps of the sensor, across the gap
DROPPED = 1.5  # after a step of time longer than this many median steps, samples are missing
REPEATED = 0.01  # share of samples equal to the one before, above which it is not by chance
HELD = 10  # in a longer run of equal samples the actuator is at rest
SAMPLES, LOOPS = 100, 2  # fewest samples and cycles of a record


def time_unit(trace: Trace) -> Iterator[Fault]:
    """A speed that no test of a damper has."""
    speed = float(np.max(np.abs(np.diff(trace.displacement) / np.diff(trace.time))))
    if np.quantile(np.abs(trace.velocity), 0.9) > FAST:
        yield Fault(
            "time unit",
            f"a speed of {speed:.3g} in/s is implausible: check the units of time and displacement",
        )


def short_record(trace: Trace) -> Iterator[Fault]:
    """Too few samples or cycles."""
    turns = trace.cycle_turns.size
    if trace.samples < SAMPLES or turns < 2 * LOOPS:
        yield Fault(
            "short record",
            f"the record is very short, {trace.samples} samples and {turns} turning points; "
            f"{SAMPLES} samples and {LOOPS} cycles are little already",
        )


def stroke(trace: Trace, gap: float) -> Iterator[Fault]:
    """A motion that stays within the gap."""
    travel = float(np.ptp(trace.displacement))
    if travel <= gap:
        yield Fault(
            "stroke",
            f"the stroke of {travel:.3g} in is within the gap of about {gap:.2g} in that the "
            "priors expect: the device may never slip",
        )


def rate(trace: Trace, gap: float) -> Iterator[Fault]:
    """Too few samples across the gap."""
    times = crossing_times(trace.time, trace.displacement, trace.turning_points, gap)
    if not times:
        return
    crossing = float(np.median(times)) * rate_of(trace)
    if crossing < CROSSING:
        yield Fault(
            "rate",
            f"{rate_of(trace):.4g} Hz leave {crossing:.2g} samples in the first {gap:.2g} in after "
            f"a reversal, where the force builds up; {CROSSING} are needed to resolve it",
        )


def dropped(trace: Trace) -> Iterator[Fault]:
    """Steps of time that are too long: samples are missing."""
    steps = np.diff(trace.time)
    median = float(np.median(steps))
    at = np.flatnonzero(steps > DROPPED * median)
    if at.size:
        yield Fault(
            "dropped samples",
            f"{count(at.size, 'step')} of time longer than {DROPPED:g} median ones (up to "
            f"{steps[at].max():.3g} s, median {median:.3g} s), the first at "
            f"{trace.time[at[0]]:.4g} s: samples were dropped",
            at + 1,
        )


def repeated(trace: Trace) -> Iterator[Fault]:
    """Samples equal to the one before while the actuator moves."""
    if trace.force is None or np.ptp(trace.force) == 0.0:
        return  # a slow displacement alone may repeat its last digit
    steps = np.abs(np.diff(trace.displacement))
    same = (steps == 0.0) & (np.diff(trace.force) == 0.0)
    starts, lengths = runs(np.concatenate([[False], same]))
    inside = (starts > 0) & (starts + lengths < steps.size) & (lengths <= HELD)
    starts, lengths = starts[inside], lengths[inside]
    smallest = float(np.min(steps[steps > 0.0], initial=np.inf))
    beside = np.minimum(steps[starts - 1], steps[starts + lengths])
    moving = beside > 2 * smallest
    at = spread(starts[moving] + 1, lengths[moving] - 1)
    if at.size > REPEATED * trace.samples:
        yield Fault(
            "repeated samples",
            f"{at.size} samples ({at.size / trace.samples:.1%}) repeat the one before while the "
            f"displacement moves, the first at {trace.time[at[0]]:.4g} s: the logger was slower "
            "than its clock",
            at,
        )
