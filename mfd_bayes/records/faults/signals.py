"""Faults of the sensors: force and displacement as they were measured."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mfd_bayes.records.faults.clock import CROSSING
from mfd_bayes.records.faults.fault import Fault, Samples, count, runs, spread
from mfd_bayes.records.faults.lag import estimate_lag
from mfd_bayes.records.loops import FEWEST, find_loops
from mfd_bayes.records.motion import Array, sensor_noise
from mfd_bayes.records.readings import read_off
from mfd_bayes.records.trace import Trace

CLIPPED = 5  # fewest samples in a row at the extreme of the force that show a load cell's limit
LAG, LAG_SAMPLES, LAG_CYCLE = 0.010, 2.0, 0.0075
"""A lag is reported above all three: s, samples, and share of a cycle."""

ALIKE, SCALE = 0.9, 1.25
"""Least correlation, and largest factor, between a displacement and its velocity's integral."""

LEVELS = 200  # fewest steps of the sensor in the peak-to-peak displacement
SPIKE = 0.10  # an isolated sample that stands out by this share of the signal's range is a spike
NOISE = 0.05  # most noise of a displacement, by its share of the travel of the build-up
DRIFT = 0.25  # a force that drifts by this share of its half range has lost its zero


def no_force(trace: Trace) -> Iterator[Fault]:
    """A force that never changes."""
    if trace.force is not None and np.ptp(trace.force) == 0.0:
        yield Fault(
            "no force",
            f"the force is {trace.force[0]:g} kip throughout: was the load cell connected, and "
            "is it the right column?",
        )


def force_sign(trace: Trace) -> Iterator[Fault]:
    """Loops in which the force does negative work."""
    energy = find_loops(trace).energy
    if energy is not None and energy.size and energy.sum() < 0.0:
        yield Fault(
            "force sign",
            f"the force does negative work in the loops ({np.median(energy):.3g} kip·in a loop): "
            "the sign of the force or of the displacement is swapped",
        )


def velocity(trace: Trace) -> Iterator[Fault]:
    """A velocity that is not that of the displacement.

    Both are compared as displacements, without their lines in time: the integral of a velocity is
    smooth, where the derivative of a displacement is noise.
    """
    steps = np.diff(trace.time) * 0.5 * (trace.velocity[1:] + trace.velocity[:-1])
    line = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, trace.samples), 1)
    basis = np.linalg.qr(line)[0]
    both = np.column_stack([trace.displacement, np.concatenate([[0.0], np.cumsum(steps)])])
    moved, integral = (both - basis @ (basis.T @ both)).T
    share = float(integral @ moved / max(moved @ moved, 1e-300))
    size = float(np.sqrt((integral @ integral) * (moved @ moved)))
    alike = float(integral @ moved) / size if size > 0.0 else 0.0
    if alike < ALIKE or abs(np.log(share)) > np.log(SCALE):
        yield Fault(
            "velocity",
            f"the velocity is not that of the displacement: its integral moves {share:.3g} times "
            f"as far (correlation {alike:.2f}); check its column, unit and sign, or leave it out",
        )


def clipping(trace: Trace) -> Iterator[Fault]:
    """Force constant at its extreme, for longer than anywhere else, while the actuator moves."""
    if trace.force is None or np.ptp(trace.force) == 0.0:
        return
    force = trace.force
    moving = np.abs(trace.velocity) > 0.05 * np.max(np.abs(trace.velocity))
    starts, lengths = runs(np.diff(force, prepend=np.nan) == 0.0)
    fine = np.unique(force).size > LEVELS  # else the steps of the sensor make it flat
    limits = (force[starts] == force.max()) | (force[starts] == force.min())
    for extreme, name in ((force.max(), "largest"), (force.min(), "smallest")):
        at = force[starts] == extreme
        others = ~limits if fine else ~at
        elsewhere = max(lengths[others & moving[starts]], default=0)
        flat = at & moving[starts] & (lengths + 1 >= max(CLIPPED, 3 * (elsewhere + 1)))
        if np.any(flat):
            longest = int(lengths[flat].max()) + 1
            yield Fault(
                "clipping",
                f"the force stays at its {name} value, {extreme:.4g} kip, for up to {longest} "
                "samples in motion: the load cell or its amplifier is at its limit",
                spread(starts[flat], lengths[flat]),
            )


def lag(trace: Trace) -> Iterator[Fault]:
    """A force that comes too late or too early."""
    # the sample of a reversal must be known
    coarse = any(resolution(trace, None)) or any(noise(trace))
    found = None if coarse else estimate_lag(trace)
    if found is None:
        return
    delay, turns = found
    step = float(np.median(np.diff(trace.time)))
    cycle = 2 * float(np.median(np.diff(trace.time[trace.cycle_turns])))
    if abs(delay) > max(LAG, LAG_SAMPLES * step, LAG_CYCLE * cycle):
        way = "behind" if delay > 0 else "before"
        yield Fault(
            "lag",
            f"the force comes about {1000 * abs(delay):.3g} ms ({abs(delay) / step:.2g} samples) "
            f"{way} the displacement at reversals: filters or channels are out of step",
            turns,
        )


def spikes(trace: Trace) -> Iterator[Fault]:
    """Isolated samples that differ much from both neighbours."""
    measured = {"displacement": (trace.displacement, "in")}
    if trace.force is not None:
        measured["force"] = (trace.force, "kip")
    for name, (values, unit) in measured.items():
        at = _isolated(values)
        if at.size:
            height = float(np.max(np.abs(values[at] - 0.5 * (values[at - 1] + values[at + 1]))))
            yield Fault(
                "spikes",
                f"{count(at.size, 'isolated sample')} of the {name} "
                f"{'stands' if at.size == 1 else 'stand'} out by up to {height:.3g} {unit}, "
                f"the first at {trace.time[at[0]]:.4g} s",
                at,
            )


def _isolated(values: Array) -> Samples:
    """Samples that differ from both neighbours, while the neighbours agree."""
    before, behind = values[1:-1] - values[:-2], values[1:-1] - values[2:]
    height = np.minimum(np.abs(before), np.abs(behind))
    height[before * behind <= 0.0] = 0.0
    agree = np.abs(values[2:] - values[:-2]) < 0.25 * height
    reach = float(np.subtract(*np.quantile(values, [0.995, 0.005])))
    usual = float(np.quantile(height, 0.99)) if height.size else 0.0
    return np.flatnonzero(agree & (height > SPIKE * reach) & (height > 4 * usual)) + 1


def resolution(trace: Trace, gap: float | None) -> Iterator[Fault]:
    """A displacement in steps that are too large for the stroke or the gap."""
    quantum = _quantum(trace.displacement)
    if quantum is None:
        return
    stroke = float(np.ptp(trace.displacement))
    across = "" if gap is None else f", {gap / quantum:.2g} in the gap"
    if quantum > stroke / LEVELS or (gap is not None and quantum > gap / CROSSING):
        yield Fault(
            "resolution",
            f"the displacement moves in steps of {quantum:.3g} in, {stroke / quantum:.0f} in the "
            f"stroke{across}: the sensor or the file is too coarse",
        )


def noise(trace: Trace) -> Iterator[Fault]:
    """A displacement whose noise is no longer small beside the travel of the build-up.

    Errors in what a force follows weaken the relation: a fit takes the force for smaller and
    softer than it is (regression dilution).
    """
    coarse = any(resolution(trace, None))  # which says it better
    size = 0.0 if coarse else sensor_noise(trace.displacement)
    read = read_off(trace)
    rise = read.plateau / read.slope  # NaN where it cannot be read
    if size > NOISE * rise > 0.0:
        yield Fault(
            "noise",
            f"the displacement has noise of about {size:.2g} in, {size / rise:.0%} of the travel "
            f"over which the force builds up, {rise:.2g} in: stiffness and slip force would come "
            "out too small; take a smoother channel, or filter it before",
        )


def _quantum(values: Array) -> float | None:
    """Step of a quantised signal; None where the signal is not quantised."""
    levels = np.unique(values)
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * np.ptp(values)]
    if steps.size < 3 or levels.size > 0.5 * values.size:
        return None
    quantum = float(steps.min())
    whole = np.abs(steps / quantum - np.round(steps / quantum)) < 0.1
    return quantum if np.mean(whole) > 0.95 else None


def drift(trace: Trace) -> Iterator[Fault]:
    """A mean force that moves from the first strong loops to the last."""
    known = (find_loops(trace).offset_drift, _drift_of_few(trace))
    change = max((c for c in known if c is not None), key=abs, default=None)
    if change is None or trace.force is None:
        return
    half = 0.5 * float(np.subtract(*np.quantile(trace.force, [0.99, 0.01])))
    if abs(change) > DRIFT * half > 0.0:
        yield Fault(
            "drift",
            f"the force drifts by {change:+.3g} kip from its begin to its end, "
            f"{abs(change) / half:.0%} of its half range: the load cell's zero, or a device that "
            "changes",
        )


def _drift_of_few(trace: Trace) -> float | None:
    """Drift over a whole record with ramps, kip; None where it cannot be told.

    The mean force of ramps differs from that of strong loops without any drift. So the trend of
    the strong loops, continued over the record, and the change of the force at its quiet ends must
    agree in sign; the smaller of both counts.
    """
    loops = find_loops(trace)
    if loops.offset is None or trace.force is None or np.count_nonzero(loops.strong) < FEWEST:
        return None
    middle = 0.5 * (trace.time[loops.bounds[1:]] + trace.time[loops.bounds[:-1]])
    trend = np.polynomial.polynomial.polyfit(middle[loops.strong], loops.offset[loops.strong], 1)[1]
    few = max(trace.samples // 50, 1)
    ends = float(trace.force[-few:].mean() - trace.force[:few].mean())
    along = float(trend) * float(trace.time[-1] - trace.time[0])
    return min(along, ends, key=abs) if along * ends > 0.0 else None
