"""Faults of a record that would spoil its fit: of the sensors, the clock and the units."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.messages import Message, Quantity
from mfd_bayes.records.loops import FEWEST, channels_swapped, find_loops, loop_estimate
from mfd_bayes.records.motion import Array, sensor_noise
from mfd_bayes.records.spikes import force_spikes, interpolated, runs, spikes_of, without_spikes
from mfd_bayes.records.time_axis import crossing_times
from mfd_bayes.records.trace import Trace

Samples = NDArray[np.intp]

FASTEST = 400.0  # in/s, a speed that no damper reaches
CROSSING = 10  # fewest samples, and steps of the sensor, across the gap
DROPPED = 1.5  # median steps; after a longer one samples are missing
REPEATED = 0.01  # share of samples equal to the one before, above which it is not by chance
AT_REST = 10  # in a longer run of equal samples the actuator is at rest
SAMPLES, LOOPS = 100, 2  # fewest samples and cycles of a record
CLIPPED = 5  # fewest equal samples at the extreme of the force that show a load cell's limit
LAG, LAG_SAMPLES, LAG_CYCLE = 0.010, 2.0, 0.0075  # s, samples, cycles: a lag is above all three
CORRELATION, SCALE = 0.9, 1.25  # least, and most, of the integral of a velocity
LEVELS = 200  # fewest steps of the sensor in the peak-to-peak displacement
NOISE = 0.05  # most noise of a displacement, as a share of the travel of the build-up
DRIFT = 0.25  # drift of the force, as a share of its half range, that shows a lost zero
STEADY_DRIFT, P_VALUE, STEADY = 0.07, 0.01, 5
"""A trend is a drift from this share of the slip force on, with so small a probability by chance,
in a record of at least so many loops at full stroke."""
JUMP = 0.03  # share of the stroke that a sample of the displacement may be off its neighbours' line
ZERO = 0.04  # share of the stroke by which both ends of the strokes may move
HELD, LONGER = 5, 4.0  # equal samples of a frozen channel: the fewest, and times longer than usual
TRAVEL, SWING, FEW = 0.05, 0.6, 0.05
"""A frozen force holds while the motion goes on by this share of the stroke, a frozen displacement
while the force goes through this share of its range (or it jumps when it comes back). Where the
noise of a force stops, fewer samples than the last share equal the one before elsewhere."""


_NONE: Samples = np.empty(0, dtype=np.intp)


@dataclass(frozen=True, eq=False)
class Fault:
    """A fault of a record that would spoil its fit.

    Of a kind such as "force sign", with its figures and its possible cause, and the samples at
    which it was seen; none for the whole record.
    """

    name: str
    message: Message
    samples: Samples

    @classmethod
    def of(
        cls,
        name: str,
        template: str,
        samples: Samples | None = None,
        /,
        **values: str | tuple[float, str],
    ) -> Fault:
        """Fault whose message has these texts, and quantities as (value, internal unit)."""
        quantities = {
            key: v if isinstance(v, str) else Quantity.of(v[0], unit=v[1])
            for key, v in values.items()
        }
        return cls(name, Message(template, quantities), _NONE if samples is None else samples)


def time_unit(trace: Trace) -> Iterator[Fault]:
    """A speed that no test of a damper has."""
    speed = float(np.max(np.abs(np.diff(trace.displacement) / np.diff(trace.time))))
    if np.quantile(np.abs(trace.velocity), 0.9) > FASTEST:
        yield Fault.of(
            "time unit",
            "a speed of {speed} is implausible: check the units of time and displacement",
            speed=(speed, "in/s"),
        )


def short_record(trace: Trace) -> Iterator[Fault]:
    """Too few samples or cycles."""
    turns = trace.cycle_turns.size
    if trace.samples < SAMPLES or turns < 2 * LOOPS:
        yield Fault.of(
            "short record",
            f"the record is very short, {trace.samples} samples and {turns} turning points; "
            f"{SAMPLES} samples and {LOOPS} cycles are little already",
        )


def stroke(trace: Trace, gap: float | None) -> Iterator[Fault]:
    """A motion that stays within the gap."""
    travel = float(np.ptp(trace.displacement))
    if gap is not None and travel <= gap:
        yield Fault.of(
            "stroke",
            "the stroke of {travel} is within the gap of about {gap} that the priors expect: the "
            "device may never slip",
            travel=(travel, "in"),
            gap=(gap, "in"),
        )


def rate(trace: Trace, gap: float | None) -> Iterator[Fault]:
    """Too few samples across the gap."""
    if gap is None:
        return
    times = crossing_times(trace.time, trace.displacement, trace.turning_points, gap)
    hertz = (trace.samples - 1) / float(trace.time[-1] - trace.time[0])
    if times and (crossing := float(np.median(times)) * hertz) < CROSSING:
        yield Fault.of(
            "rate",
            f"{hertz:.4g} Hz leave {crossing:.2g} samples in the first {{gap}} after a reversal, "
            f"where the force builds up; {CROSSING} are needed to resolve it",
            gap=(gap, "in"),
        )


def dropped(trace: Trace) -> Iterator[Fault]:
    """Steps of time that are too long: samples are missing."""
    steps = np.diff(trace.time)
    median = float(np.median(steps))
    at = np.flatnonzero(steps > DROPPED * median)
    if at.size:
        yield Fault.of(
            "dropped samples",
            f"{_count(at.size, 'step')} of time longer than {DROPPED:g} median ones (up to "
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
    inside = (starts > 0) & (starts + lengths < steps.size) & (lengths <= AT_REST)
    starts, lengths = starts[inside], lengths[inside]
    smallest = float(np.min(steps[steps > 0.0], initial=np.inf))
    moving = np.minimum(steps[starts - 1], steps[starts + lengths]) > 2 * smallest
    at = _spread(starts[moving] + 1, lengths[moving] - 1)
    if at.size > REPEATED * trace.samples:
        yield Fault.of(
            "repeated samples",
            f"{at.size} samples ({at.size / trace.samples:.1%}) repeat the one before while the "
            f"displacement moves, the first at {trace.time[at[0]]:.4g} s: the logger was slower "
            "than its clock",
            at,
        )


def no_force(trace: Trace) -> Iterator[Fault]:
    """A force that never changes."""
    if trace.force is not None and np.ptp(trace.force) == 0.0:
        yield Fault.of(
            "no force",
            "the force is {force} throughout: was the load cell connected, and is it the right "
            "column?",
            force=(float(trace.force[0]), "kip"),
        )


def force_sign(trace: Trace) -> Iterator[Fault]:
    """Loops in which the force does negative work."""
    energy = find_loops(trace).energy
    if channels_swapped(trace):
        yield Fault.of(
            "channels",
            "displacement and force seem swapped: the loops have negative work, and the "
            "displacement follows the direction of the force instead of the force that of the "
            "motion; exchange the two columns in [columns]",
        )
    elif energy is not None and energy.size and energy.sum() < 0.0:
        yield Fault.of(
            "force sign",
            "the force does negative work in the loops ({work} a loop): the sign of the force or "
            "of the displacement is swapped; write sign = -1 for one of them in [columns]",
            work=(float(np.median(energy)), "kip·in"),
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
    correlation = float(integral @ moved) / size if size > 0.0 else 0.0
    if correlation < CORRELATION or abs(np.log(share)) > np.log(SCALE):
        yield Fault.of(
            "velocity",
            f"the velocity is not that of the displacement: its integral moves {share:.3g} times "
            f"as far (correlation {correlation:.2f}); check its column, unit and sign, or leave it "
            "out",
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
            yield Fault.of(
                "clipping",
                f"the force stays at its {name} value, {{extreme}}, for up to "
                f"{lengths[flat].max() + 1} samples in motion: the load cell or its amplifier is "
                "at its limit",
                _spread(starts[flat], lengths[flat]),
                extreme=(float(extreme), "kip"),
            )


def lag(trace: Trace) -> Iterator[Fault]:
    """A force that comes too late or too early."""
    if any(resolution(trace, None)) or any(noise(trace)):
        return  # the sample of a reversal must be known
    estimate = estimate_lag(trace)
    if estimate is None:
        return
    delay, turns = estimate
    step = float(np.median(np.diff(trace.time)))
    cycle = 2 * float(np.median(np.diff(trace.time[trace.cycle_turns])))
    if abs(delay) > max(LAG, LAG_SAMPLES * step, LAG_CYCLE * cycle):
        way = "behind" if delay > 0 else "before"
        yield Fault.of(
            "lag",
            f"the force comes about {1000 * abs(delay):.3g} ms ({abs(delay) / step:.2g} samples) "
            f"{way} the displacement at reversals: filters or channels are out of step, or this is "
            "a fluid damper (viscous or magneto-rheological), which no friction model describes: "
            "that needs a model of your own",
            turns,
        )


def spikes(trace: Trace) -> Iterator[Fault]:
    """Single samples, or a few, that differ much from both neighbours; and overflow values."""
    measured = [("displacement", trace.displacement, spikes_of(trace.displacement), "in")]
    if trace.force is not None:
        measured.append(("force", trace.force, force_spikes(trace), "kip"))
    for name, values, at, unit in measured:
        if at.size:
            yield Fault.of(
                "spikes",
                f"{_count(at.size, 'isolated sample')} of the {name} "
                f"{'stands' if at.size == 1 else 'stand'} out by up to {{height}}, the first at "
                f"{trace.time[at[0]]:.4g} s: correct or delete these rows of the file before a "
                "fit; all else is told without them",
                at,
                height=(float(np.max(np.abs(values - interpolated(values, at)))), unit),
            )


def jumps(trace: Trace) -> Iterator[Fault]:
    """Steps of the displacement that the motion before and after does not have."""
    at = _jumps(trace, trace.displacement)
    at = at[~np.isin(at - 1, _held_displacement(trace))]
    if at.size:
        x, step = trace.displacement, np.diff(trace.time)
        worst = at[np.argmax(np.abs(x[at] - x[at - 1]) / step[at - 1])]
        moved = float(x[worst] - x[worst - 1])
        several = f", the largest of {at.size} jumps" if at.size > 1 else ""
        yield Fault.of(
            "jump",
            f"the displacement jumps by {_plus(moved)}{{moved}} within a step of time at "
            f"{trace.time[worst]:.4g} s ({{speed}}, where the motion beside it is slower)"
            f"{several}: samples were lost and the time numbered anew, or the zero of the sensor "
            "has slipped",
            at,
            moved=(moved, "in"),
            speed=(float(abs(moved) / step[worst - 1]), "in/s"),
        )


def _jumps(trace: Trace, values: Array) -> Samples:
    """Samples to which a signal jumps."""
    steps = np.diff(values) / np.diff(trace.time)
    if steps.size < 9:
        return _NONE
    padded = np.pad(steps, 2, mode="edge")
    neighbours = np.array([padded[k : k + steps.size] for k in (0, 1, 3, 4)])
    off = np.abs(steps - np.median(neighbours, axis=0))
    usual = float(np.quantile(np.abs(steps), 0.98, method="lower"))
    large = off * np.diff(trace.time) > JUMP * np.ptp(values)
    sudden = off > 2.0 * np.abs(neighbours).max(axis=0)
    return np.flatnonzero(large & sudden & (off > 1.5 * usual)) + 1


def held(trace: Trace) -> Iterator[Fault]:
    """One channel that does not change while the other goes on."""
    frozen = {"displacement": _held_displacement(trace), "force": _held_force(trace)}
    for name, at in frozen.items():
        if at.size:
            last = int(at[np.argmax(np.append(np.diff(at), 2) > 1)])
            yield Fault.of(
                "held",
                f"the {name} holds one value from {trace.time[at[0]]:.4g} s to "
                f"{trace.time[last]:.4g} s{' and later once more' if last < at[-1] else ''}, while "
                "the test goes on: the sensor or its channel was frozen",
                at,
            )


def _held_displacement(trace: Trace) -> Samples:
    """Samples in which the displacement is frozen."""
    if trace.force is None:
        return _NONE
    starts, lengths = _equal(trace.displacement)
    swing = SWING * float(np.subtract(*np.quantile(trace.force, [0.99, 0.01])))
    long = (lengths >= HELD) & (lengths > LONGER * _usual(trace, starts, lengths))
    back = np.isin(starts + lengths + 1, _jumps(trace, trace.displacement))
    for k in np.flatnonzero(long & ~back):
        long[k] = np.ptp(trace.force[starts[k] : starts[k] + lengths[k] + 1]) > swing > 0.0
    return _spread(starts[long], lengths[long])


def _held_force(trace: Trace) -> Samples:
    """Samples in which the force is frozen, and does not just slip at one value.

    It jumps when it comes back, or has held over more than a stroke, or its noise has stopped.
    """
    if trace.force is None or np.ptp(trace.force) == 0.0:
        return _NONE
    starts, lengths = _equal(trace.force)
    path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(trace.displacement)))])
    travel = path[starts + lengths] - path[starts]
    stroke = np.ptp(trace.displacement)
    long = (lengths >= HELD) & (travel > TRAVEL * stroke)
    limits = (trace.force[starts] == trace.force.max()) | (trace.force[starts] == trace.force.min())
    noisy = lengths.sum() - lengths[long].sum() < FEW * trace.samples
    back = np.isin(starts + lengths + 1, _jumps(trace, trace.force))
    long &= (travel > 0.5 * stroke) | ((starts > 0) & (starts + lengths + 1 < trace.samples))
    long &= (travel > 1.5 * stroke) | (~limits & (noisy | back))
    long &= travel > LONGER * _usual(trace, starts, travel)
    return _spread(starts[long], lengths[long])


def _equal(values: Array) -> tuple[Samples, Samples]:
    """First sample of each run of equal values, and how many follow it."""
    starts, lengths = runs(np.concatenate([np.diff(values) == 0.0, [False]]))
    return starts + 1, lengths


def _usual(trace: Trace, starts: Samples, sizes: Array | Samples) -> float:
    """Size that the longest run of four strokes of five has not exceeded."""
    turns = trace.cycle_turns
    longest = np.zeros(turns.size + 1)
    np.maximum.at(longest, np.searchsorted(turns, starts, side="right"), sizes)
    return float(np.quantile(longest, 0.8, method="lower"))


def _spread(starts: Samples, lengths: Samples) -> Samples:
    """All samples of runs, with the one before each."""
    pieces = [np.arange(a, a + n + 1) for a, n in zip(starts, lengths, strict=True)]
    return np.concatenate([_NONE, *pieces]).astype(np.intp)


def zero_moves(trace: Trace) -> Iterator[Fault]:
    """Both ends of the strokes that move together: the zero of the displacement."""
    loops = find_loops(trace)
    full = loops.amplitude > 0.8 * loops.amplitude.max(initial=0.0)
    count = int(np.count_nonzero(full))
    if count < max(2 * FEWEST, loops.amplitude.size / 2):
        return
    ends = np.array([loops.middle + s * loops.amplitude for s in (1.0, -1.0)])[:, full]
    moves = np.array(
        [np.median(ends[:, k:], 1) - np.median(ends[:, :k], 1) for k in range(2, count - 1)]
    )
    k = int(np.argmax(np.abs(moves).min(axis=1)))
    high, low = moves[k].tolist()
    full_stroke = 2.0 * float(np.median(loops.amplitude[full]))
    if high * low > 0.0 and min(abs(high), abs(low)) > ZERO * full_stroke:
        moved = 0.5 * (high + low)
        since = float(trace.time[loops.bounds[:-1][full][k + 2]])
        yield Fault.of(
            "displacement zero",
            f"both ends of the strokes move by {_plus(moved)}{{moved}} at about {since:.4g} s, "
            f"{abs(moved) / full_stroke:.0%} of the stroke: the zero of the sensor slips or "
            "drifts, or the middle of the motion was moved",
            moved=(moved, "in"),
        )


def resolution(trace: Trace, gap: float | None) -> Iterator[Fault]:
    """A displacement in steps that are too large for the stroke or the gap."""
    stroke = float(np.ptp(trace.displacement))
    levels = np.unique(trace.displacement)
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * stroke]
    if steps.size < 3 or levels.size > 0.5 * trace.samples:
        return
    quantum = float(steps.min())
    if np.mean(np.abs(steps / quantum - np.round(steps / quantum)) < 0.1) <= 0.95:
        return  # the signal is not quantised
    across = "" if gap is None else f", {gap / quantum:.2g} in the gap"
    if quantum > stroke / LEVELS or (gap is not None and quantum > gap / CROSSING):
        yield Fault.of(
            "resolution",
            f"the displacement moves in steps of {{quantum}}, {stroke / quantum:.0f} in the "
            f"stroke{across}: the sensor or the file is too coarse",
            quantum=(quantum, "in"),
        )


def noise(trace: Trace) -> Iterator[Fault]:
    """A displacement whose noise is not small compared with the travel of the build-up.

    Errors in what a force follows weaken the relation: a fit takes the force for smaller and
    softer than it is (regression dilution).
    """
    if any(resolution(trace, None)):  # which says it better
        return
    size, loop = sensor_noise(trace.displacement), loop_estimate(trace)
    rise = loop.plateau / loop.slope  # NaN where it cannot be read
    if size > NOISE * rise > 0.0:
        yield Fault.of(
            "noise",
            f"the displacement has noise of about {{size}}, {size / rise:.0%} of the travel over "
            "which the force builds up, {rise}: stiffness and slip force would come out too small; "
            "take a smoother channel, or filter it before",
            size=(size, "in"),
            rise=(rise, "in"),
        )


def drift(trace: Trace) -> Iterator[Fault]:
    """A mean force that moves from the first strong loops to the last."""
    if trace.force is None:
        return
    estimates = (find_loops(trace).offset_drift, _drift_of_few(trace))
    change = max((c for c in estimates if c is not None), key=abs, default=0.0)
    half = 0.5 * float(np.subtract(*np.quantile(trace.force, [0.99, 0.01])))
    if not abs(change) > DRIFT * half > 0.0:
        change, half = _steady_drift(trace)
    if abs(change) > STEADY_DRIFT * half > 0.0:
        yield Fault.of(
            "drift",
            f"the force drifts by {_plus(change)}{{change}} from its begin to its end, "
            f"{abs(change) / half:.0%} of the force in slip: the load cell's zero, or a device "
            "that changes",
            change=(change, "kip"),
        )


def _steady_drift(trace: Trace) -> tuple[float, float]:
    """Trend of the mean force of many steady loops over the record, and the slip force, kip.

    Zeros where there are too few such loops, or they scatter as much as the trend.
    """
    from scipy.stats import linregress  # which takes long to import

    loops, slip = find_loops(trace), loop_estimate(trace).plateau
    strong = loops.strong
    many = np.count_nonzero(strong) >= max(STEADY, 0.5 * strong.size)
    if loops.offset is None or not many or not slip > 0.0 or trace.varying:
        return 0.0, 0.0
    middle = 0.5 * (trace.time[loops.bounds[1:]] + trace.time[loops.bounds[:-1]])
    line = linregress(middle[strong], loops.offset[strong])
    change = float(line.slope) * float(trace.time[-1] - trace.time[0])
    return (change, slip) if line.pvalue < P_VALUE else (0.0, 0.0)


def _drift_of_few(trace: Trace) -> float | None:
    """Drift over a whole record with ramps, kip; None where it cannot be seen.

    The mean force of ramps differs from that of strong loops without any drift. So the trend of
    the strong loops and the change of the force at its quiet ends must agree in sign; the smaller
    counts.
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


def _count(number: int, thing: str) -> str:
    """Number and noun: "3 steps"."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _plus(value: float) -> str:
    return "+" if value > 0.0 else ""


_CONSEQUENCES = {
    "channels": {"clipping", "lag", "noise", "drift", "held"},
    "held": {"clipping", "lag", "drift", "repeated samples"},
}
"""Faults that need not be told where another is."""


def find_faults(trace: Trace, gap: float | None = None) -> tuple[Fault, ...]:
    """Faults of a record, the most serious first, of a trace with every sample.

    `gap` is the median width of the device's gap, in; without it, rate and stroke are not checked.
    """
    clean = without_spikes(trace)
    faults = [
        *no_force(clean),
        *force_sign(clean),
        *velocity(clean),
        *time_unit(clean),
        *short_record(clean),
        *stroke(clean, gap),
        *clipping(clean),
        *lag(clean),
        *jumps(clean),
        *held(clean),
        *zero_moves(clean),
        *spikes(trace),
        *dropped(clean),
        *repeated(clean),
        *resolution(clean, gap),
        *noise(clean),
        *rate(clean, gap),
        *drift(clean),
    ]
    hidden = {name for fault in faults for name in _CONSEQUENCES.get(fault.name, ())}
    return tuple(fault for fault in faults if fault.name not in hidden)


NEAR_TURN = 0.05  # the fit uses this share of the peak-to-peak displacement around a reversal
STROKES = 0.4  # shorter strokes, by their share of the longest, have no clear reversal
REVERSALS = 40  # most reversals that are used
REACH = 0.06  # largest lag, s; eight samples or 3 % of a cycle where that is more
LIKELY = 0.85  # a lag counts up to this share of the squared misfit without a lag
_TURN_SAMPLES = 120  # of one reversal, at any rate
_LENGTHS = np.geomspace(0.02, 1.5, 10)  # of the release, over the distance that is used


def estimate_lag(trace: Trace) -> tuple[float, NDArray[np.intp]] | None:
    """Lag of the force behind the displacement, s, and the reversals that it was found at.

    After a turn of the motion the friction force falls, fastest at the turn itself: by
    A (1 − exp(−s/λ)) at the distance s from it. A and a line in time, for the level before the
    turn and viscous friction, are fitted to each reversal, λ and the lag to all reversals
    together. A late force begins to fall after the turn, an early one before it. None without a
    force or reversals, or where no lag fits clearly better.
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
    lag, misfit, at_rest = _best_lag(trace, turns, coarse)
    if abs(lag) >= reach * 0.999 or misfit > LIKELY * at_rest:
        return None
    spacing = coarse[1] - coarse[0]
    lag, _, _ = _best_lag(trace, turns, lag + np.linspace(-spacing, spacing, 9))
    return lag, turns


def _best_lag(trace: Trace, turns: NDArray[np.intp], lags: Array) -> tuple[float, float, float]:
    """Lag with the smallest misfit, that misfit, and the misfit at the lag nearest to 0."""
    misfit = np.zeros((_LENGTHS.size, lags.size))
    for turn in turns.tolist():
        misfit += _lag_misfit(trace, turn, lags)
    least = misfit.min(axis=0)
    at = int(np.argmin(least))
    return float(lags[at]), float(least[at]), float(least[int(np.argmin(np.abs(lags)))])


def _lag_misfit(trace: Trace, turn: int, lags: Array) -> Array:
    """Squared misfit of the release to the force around one turn, (lengths, lags)."""
    near = NEAR_TURN * float(np.ptp(trace.displacement))
    away = np.abs(trace.displacement - trace.displacement[turn])
    before, behind = np.flatnonzero(away[:turn] > near), np.flatnonzero(away[turn:] > near)
    first = int(before[-1]) + 1 if before.size else 0
    last = turn + int(behind[0]) - 1 if behind.size else away.size - 1
    if last - first < 4:
        return np.zeros((_LENGTHS.size, lags.size))
    count = min(_TURN_SAMPLES, last - first + 1)
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
