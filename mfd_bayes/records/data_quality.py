"""What a record shows before a fit, and its faults: of sensors, clock, units and file name."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, groupby, product

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.messages import Measure, Message, counted
from mfd_bayes.records.cycles import FULL, PROPERTIES, MeasuredCycles, features_of, measured_cycles
from mfd_bayes.records.loops import (
    FEWEST,
    Loops,
    channels_swapped,
    explained_by_motion,
    find_loops,
    mean_of,
    stroke_estimates,
    zero_is_central,
)
from mfd_bayes.records.record import NO_ACTUATION, ROLES, Record, crossing_times
from mfd_bayes.records.table import header_unit, stated_unit
from mfd_bayes.records.trace import (
    Array,
    Trace,
    despiked,
    force_spikes,
    interpolated,
    run_lengths,
    sensor_noise,
    spikes_of,
    without_spikes,
)
from mfd_bayes.units import (
    actuation_factor,
    by_spelling,
    factor,
    force_meant,
    may_mean,
    measure,
    parse_actuation,
    same_unit,
)

Samples = NDArray[np.intp]
Value = tuple[float, str]  # with its internal unit

FASTEST = 400.0  # in/s, a speed that no damper reaches
CROSSING = 10  # fewest samples, and steps of the sensor, across the gap
DROPPED = 1.5  # median steps; after a longer one samples are missing
SAMPLES, LOOPS = 100, 2  # fewest samples and cycles of a record
CLIPPED = 5  # fewest equal samples at the extreme of the force that show a load cell's limit
LAG, LAG_SAMPLES, LAG_CYCLE = 0.010, 2.0, 0.0075  # s, samples, cycles: a lag is above all three
CORRELATION, SCALE = 0.9, 1.25  # least, and most, of the integral of a velocity
NEAR = 0.01  # of the stroke: zero displacement is then that of mid-stroke
LEVELS, FORCE_LEVELS = 200, 50  # fewest steps of the sensor in the peak-to-peak of each
PEAKS_ONLY = 8.0  # samples of a cycle, below which no loop can be read
FOLLOWS, WHITE = 0.1, 0.8
"""Least share of a force's variance that the motion explains; where white noise is the second share
of its standard deviation, it is noise only."""
UNEVEN, OFF, SMOOTHER = 0.05, 0.5, 2.0
"""Time stamps are uneven where more than the first share of the steps is off the median by the
second share, and the displacement so many times smoother over the samples than over the time."""
FLAT, CORNER, TURNED = 0.002, 2.0, 0.2
"""A displacement is flat at a turn within the first share of the stroke. It is clipped there if the
motion is so many times as far off before and after as at a smooth turn, and the force changes by
the last share of its range meanwhile, which it does not where the machine rests."""
BLOCK, REPEATED, SAME_CYCLE = 32, 0.5, 0.05
"""Samples of a repeated block; share of a record from which on it has equal cycles; and distance
from a whole number of cycles at which it is only a cycle that is like another one."""
NOISE = 0.05  # most noise of a displacement, as a share of the travel of the build-up
DRIFT, STEADY_DRIFT, P_VALUE, STEADY = 0.25, 0.07, 0.01, 5
"""Of few full loops, a trend of the force is a drift from the first share of its half range on; of
so many, from the second share of the slip force on, if it has so small a probability by chance."""
JUMP = 0.03  # share of the stroke that a sample of the displacement may be off its neighbours' line
ZERO, SLOW_ZERO = 0.04, 0.03  # shares of the stroke by which both ends may move: once, or steadily
TURNS, BESIDE, CERTAIN = 6, 0.02, 5.0
"""Fewest turns from which a steady drift of the displacement is read; the largest sd of their
middles beside its line, as a share of the stroke, above which the motion is no harmonic one; and
the least drift, in its standard errors."""
HELD, LONGER = 5, 4.0  # equal samples of a frozen channel: the fewest, and times longer than usual
SWING, FAR, NEAR = 0.6, 1.5, 0.05
"""A displacement is frozen while the force goes through the first share of its range, a force
while the motion goes on by the second share of the stroke; or by the third and it then jumps."""

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
        cls, name: str, template: str, samples: Samples | None = None, /, **values: str | Value
    ) -> Fault:
        """Fault whose message has these texts, and quantities as (value, internal unit)."""
        quantities = {
            key: v if isinstance(v, str) else Measure.of(v[0], unit=v[1])
            for key, v in values.items()
        }
        return cls(name, Message(template, quantities), _NONE if samples is None else samples)


def time_unit(trace: Trace) -> Iterator[Fault]:
    """A speed that no test of a damper has."""
    speed = np.abs(trace.velocity)
    if np.quantile(speed, 0.9) > FASTEST:
        yield Fault.of(
            "time unit",
            "a speed of {speed} is implausible: check the units of time and displacement",
            speed=(float(speed.max()), "in/s"),
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


def of_gap(trace: Trace, gap: float) -> Iterator[Fault]:
    """A motion that stays within the gap, or has too few samples across it."""
    travel = float(np.ptp(trace.displacement))
    if travel <= gap:
        yield Fault.of(
            "stroke",
            "the stroke of {travel} is within the gap of about {gap} that the priors expect: the "
            "device may never slip",
            travel=(travel, "in"),
            gap=(gap, "in"),
        )
    times = crossing_times(trace.time, trace.displacement, trace.turning_points, gap)
    hertz = (trace.samples - 1) / float(trace.time[-1] - trace.time[0])
    if times and (crossing := float(np.median(times)) * hertz) < CROSSING:
        yield Fault.of(
            "rate",
            f"{hertz:.4g} Hz leave {crossing:.2g} samples in the first {{gap}} after a reversal, "
            f"where the force builds up; {CROSSING} are needed to resolve it",
            gap=(gap, "in"),
        )


def peaks_only(trace: Trace) -> Iterator[Fault]:
    """So few samples of a cycle that its loop is not seen."""
    strokes = np.diff(trace.cycle_turns)
    if strokes.size > 1 and (cycle := 2.0 * float(np.median(strokes))) < PEAKS_ONLY:
        yield Fault.of(
            "peaks and valleys",
            f"{cycle:.2g} samples a cycle: peaks and valleys, from which no loop can be read; "
            "record the whole cycle",
        )


def uneven(trace: Trace) -> Iterator[Fault]:
    """Time stamps that are rougher than the motion: samples were even, and their times are not."""
    steps, x = np.diff(trace.time), trace.displacement
    median = float(np.median(steps))
    share = steps[:-1] / (steps[:-1] + steps[1:])
    over_samples = np.abs(x[1:-1] - 0.5 * (x[:-2] + x[2:]))
    over_time = np.abs(x[1:-1] - x[:-2] - share * (x[2:] - x[:-2]))
    irregular = np.abs(steps - median) > OFF * median
    if np.mean(irregular) > UNEVEN and np.mean(over_time) > SMOOTHER * np.mean(over_samples):
        mean = float(np.mean(steps))
        yield Fault.of(
            "time stamps",
            f"the time stamps are uneven, with steps of {1e3 * steps.min():.3g} to "
            f"{1e3 * steps.max():.3g} ms about a mean of {1e3 * mean:.4g} ms, and the motion is "
            "not: write the rate in place of the column, time = {{ rate = {rate} }}",
            rate=f'"{1.0 / mean:.3g} Hz"',
        )


def dropped(trace: Trace) -> Iterator[Fault]:
    """Steps of time that are too long: samples are missing."""
    steps = np.diff(trace.time)
    median = float(np.median(steps))
    long_steps = np.flatnonzero(steps > DROPPED * median)
    if long_steps.size:
        yield Fault.of(
            "dropped samples",
            f"{counted(long_steps.size, 'step')} of time longer than {DROPPED:g} median ones (up "
            f"to {steps[long_steps].max():.3g} s, median {median:.3g} s), the first at "
            f"{trace.time[long_steps[0]]:.4g} s: samples were dropped",
            long_steps + 1,
        )


def no_force(trace: Trace) -> Iterator[Fault]:
    """A force that is constant, noise alone, or not of this motion."""
    if trace.force is None:
        return
    ask = "was the load cell connected, and is it the right column?"
    if not np.ptp(trace.force) > 0.0:
        text = f"the force is {{force}} throughout: {ask}"
        yield Fault.of("no force", text, force=(float(trace.force[0]), "kip"))
        return
    if explained_by_motion(trace) > FOLLOWS:
        return
    sd, energy = float(np.std(trace.force)), np.asarray(find_loops(trace).energy)
    if sensor_noise(trace.force) > WHITE * sd:
        yield Fault.of("no force", f"the force is noise only, of {{sd}}: {ask}", sd=(sd, "kip"))
    elif energy.size:
        yield Fault.of(
            "no force",
            "the force does not follow the motion, with loops from {least} to {most}: is it the "
            "right column, and have both channels one clock?",
            least=(float(energy.min()), "kip·in"),
            most=(float(energy.max()), "kip·in"),
        )
    else:
        yield Fault.of("no force", "the force does not follow the motion: is it the right column?")


def force_sign(trace: Trace) -> Iterator[Fault]:
    """Loops in which the force does negative work."""
    energy = find_loops(trace).energy
    if energy is None or not energy.sum() < 0.0 or out_of_step(trace):
        return
    if channels_swapped(trace):
        yield Fault.of(
            "channels",
            "displacement and force seem swapped: the loops have negative work, and the "
            "displacement follows the direction of the force instead of the force that of the "
            "motion; exchange the two columns in [columns]",
        )
    else:
        yield Fault.of(
            "force sign",
            "the force does negative work in the loops ({work} a loop): the sign of the force or "
            "of the displacement is swapped; write sign = -1 for one of them in [columns]",
            work=(float(np.median(energy)), "kip·in"),
        )


def runs_backward(trace: Trace) -> bool:
    """Whether the loops have negative work because the sign of one channel is swapped."""
    return any(fault.name == "force sign" for fault in force_sign(without_spikes(trace)))


def velocity(trace: Trace) -> Iterator[Fault]:
    """A velocity that is not that of the displacement.

    Both are compared as displacements, without their lines in time: the integral of a velocity is
    smooth, where the derivative of a displacement is noise.
    """
    from scipy.integrate import cumulative_trapezoid
    from scipy.signal import detrend

    integral = cumulative_trapezoid(trace.velocity, trace.time, initial=0)
    moved, integral = detrend(np.array([trace.displacement, integral]))
    sizes = [float(np.linalg.norm(v)) or 1e-300 for v in (moved, integral)]
    share = float(integral @ moved) / sizes[0] ** 2
    correlation = share * sizes[0] / sizes[1]
    if correlation < CORRELATION or abs(np.log(share)) > np.log(SCALE):
        yield Fault.of(
            "velocity",
            f"the velocity is not that of the displacement: its integral moves {share:.3g} times "
            f"as far (correlation {correlation:.2f}); check its column, unit and sign, or leave it "
            "out",
        )


def clipping(trace: Trace) -> Iterator[Fault]:
    """Force constant at its extreme, for longer than anywhere else, while the actuator moves."""
    if trace.force is None:
        return
    force, speed = trace.force, np.abs(trace.velocity)
    starts, lengths = _constant(force)
    moving = speed[starts] > 0.05 * speed.max()
    high, low = force[starts] == force.max(), force[starts] == force.min()
    fine = np.unique(force).size > LEVELS  # else the steps of the sensor make it flat
    for name, mask in (("largest", high), ("smallest", low)):
        elsewhere = np.max(lengths[moving & ~(high | low if fine else mask)], initial=0)
        flat = mask & moving & (lengths + 1 >= max(CLIPPED, 3 * (elsewhere + 1)))
        if np.any(flat):
            yield Fault.of(
                "clipping",
                f"the force stays at its {name} value, {{extreme}}, for up to "
                f"{lengths[flat].max() + 1} samples in motion: the load cell or its amplifier is "
                "at its limit",
                _spread(starts[flat], lengths[flat]),
                extreme=(float(force[starts[flat][0]]), "kip"),
            )


def clipped_motion(trace: Trace) -> Iterator[Fault]:
    """Displacement flat at its extreme, to which it comes at speed, while the force turns.

    A smooth turn, of which so many samples are within `band` of the extreme, is nine times as far
    from it as many samples before and after.
    """
    x, force = trace.displacement, trace.force
    if force is None:
        return
    band = max(FLAT * float(np.ptp(x)), 1.5 * _quantum(x))
    turned = TURNED * float(np.ptp(force))
    for name, sign in (("largest", 1.0), ("smallest", -1.0)):
        extreme = float(np.max(sign * x))
        previous, lengths = run_lengths(sign * x > extreme - band)
        starts, ends = previous - lengths, previous + 1 + 2 * lengths
        valid = (lengths >= CLIPPED) & (starts >= 0) & (ends < x.size)
        far = [
            extreme - np.max(sign * x[[a, b]]) > 9.0 * CORNER * band
            and np.ptp(force[a + n : b - n]) > turned
            for a, b, n in zip(starts[valid], ends[valid], lengths[valid], strict=True)
        ]
        if far and np.mean(far) > 0.5:
            yield Fault.of(
                "displacement clipping",
                f"the displacement stays at its {name} value, {{extreme}}, for up to "
                f"{lengths[valid].max()} samples at a turn, while the force goes on: the sensor or "
                "its amplifier is at its limit",
                _spread(previous[valid] + 1, lengths[valid] - 1),
                extreme=(sign * extreme, "in"),
            )


def lag(trace: Trace) -> Iterator[Fault]:
    """A force that comes too late or too early."""
    if (estimate := estimate_lag(trace)) is None:
        return
    delay, turns = estimate
    step = float(np.median(np.diff(trace.time)))
    cycle = _cycle(trace)
    if abs(delay) > max(LAG, LAG_SAMPLES * step, LAG_CYCLE * cycle):
        way, size, bound = "behind", abs(delay), "about"
        cause = "filters or channels are out of step"
        if delay < 0:
            way = "before"
            cause += (
                ", or this is a fluid damper (viscous or magneto-rheological), which no friction "
                "model describes: that needs a model of your own"
            )
        if size > REACH * cycle:
            size, bound = REACH * cycle, "at least"
        yield Fault.of(
            "lag",
            f"the force comes {bound} {1000 * size:.3g} ms ({size / step:.2g} samples) {way} the "
            f"displacement at reversals: {cause}",
            turns,
        )


def _cycle(trace: Trace) -> float:
    """Time of a cycle, s."""
    return 2.0 * float(np.median(np.diff(trace.time[trace.cycle_turns])))


def out_of_step(trace: Trace) -> bool:
    """Whether the force lags or leads so much that its work tells nothing of its sign."""
    estimate = estimate_lag(trace)
    return estimate is not None and abs(estimate[0]) > HALF_OFF * _cycle(trace)


def held_samples(trace: Trace) -> Iterator[Fault]:
    """A channel that is new only at every k-th sample, which the other one is not."""
    channels = {"displacement": trace.displacement}
    if trace.force is not None:
        channels["force"] = trace.force
    periods = {name: _hold(values) for name, values in channels.items()}
    step = float(np.median(np.diff(trace.time)))
    shortest = max(LAG, LAG_CYCLE * _cycle(trace)) if trace.cycle_turns.size > 1 else LAG
    for name, period in periods.items():
        if period * step > shortest and period == max(periods.values()) > min(periods.values()):
            yield Fault.of(
                "held samples",
                f"the {name} is new only at every {period}th sample, every "
                f"{1e3 * period * step:.3g} ms: the logger holds its values, which are old by "
                f"{0.5e3 * (period - 1) * step:.3g} ms on average; take a channel of the full rate",
            )


def _hold(values: Array) -> int:
    """Samples for which each value is held, 1 where it may change at every sample."""
    changes = np.flatnonzero(np.diff(values)) + 1
    if changes.size < BLOCK:
        return 1
    period = int(np.gcd.reduce(np.diff(changes)))
    return period if np.median(np.diff(changes)) == period else 1


def repeated_block(trace: Trace) -> Iterator[Fault]:
    """Samples of both channels that are there twice, number by number."""
    channels = [trace.displacement] if trace.force is None else [trace.displacement, trace.force]
    if trace.samples < 2 * BLOCK:
        return
    rng, count = np.random.default_rng(0), trace.samples - BLOCK + 1
    sums = np.zeros(count, dtype=np.uint64)  # of each block, equal where its numbers are
    changing = np.ones(count, dtype=bool)
    for values in channels:
        codes = np.unique(values, return_inverse=True)[1].astype(np.uint64)
        for k, weight in enumerate(rng.integers(1, 2**63, BLOCK).astype(np.uint64)):
            sums += weight * codes[k : k + count]
        changes = np.pad(np.cumsum(np.diff(values) != 0.0), (1, 0))
        changing &= changes[BLOCK - 1 :] - changes[:count] > BLOCK // 2
    _, indices, inverse = np.unique(sums, return_index=True, return_inverse=True)
    again = (indices[inverse] < np.arange(count)) & changing
    if not 0 < np.count_nonzero(again) < REPEATED * count:
        return
    previous, lengths = run_lengths(again)
    longest = int(np.argmax(lengths))
    start, rows = int(previous[longest]) + 1, int(lengths[longest]) + BLOCK - 1
    source, t = int(indices[inverse[start]]), trace.time
    if trace.cycle_turns.size > 1:
        cycles = float(t[start] - t[source]) / _cycle(trace)
        if abs(cycles - round(cycles)) < SAME_CYCLE:
            return  # a cycle that is like another one
    yield Fault.of(
        "repeated block",
        f"{rows} samples from {t[start]:.4g} s on are those from {t[source]:.4g} s on again, "
        "number by number: a block of the file was written twice",
        np.arange(start, start + rows),
    )


def spikes(trace: Trace) -> Iterator[Fault]:
    """Single samples, or a few, that differ much from both neighbours; and overflow values."""
    measured = [("displacement", trace.displacement, spikes_of(trace.displacement), "in")]
    if trace.force is not None:
        measured.append(("force", trace.force, force_spikes(trace), "kip"))
    for name, values, rows, unit in measured:
        if rows.size:
            yield Fault.of(
                "spikes",
                f"{counted(rows.size, 'isolated sample')} of the {name} "
                f"{'stands' if rows.size == 1 else 'stand'} out by up to {{height}}, the first at "
                f"{trace.time[rows[0]]:.4g} s: correct or delete these rows of the file before a "
                "fit; all else is told without them",
                rows,
                height=(float(np.max(np.abs(values - interpolated(values, rows)))), unit),
            )


def jumps(trace: Trace, frozen_samples: Samples) -> Iterator[Fault]:
    """Steps of the displacement that the motion before and after does not have."""
    samples = _jumps(trace, trace.displacement)
    samples = samples[~np.isin(samples - 1, frozen_samples)]
    if samples.size:
        moved, step = np.diff(trace.displacement)[samples - 1], np.diff(trace.time)[samples - 1]
        worst = int(np.argmax(np.abs(moved) / step))
        several = f", the largest of {samples.size} jumps" if samples.size > 1 else ""
        yield Fault.of(
            "jump",
            f"the displacement jumps by {_plus(moved[worst])}{{moved}} within a step of time at "
            f"{trace.time[samples[worst]]:.4g} s ({{speed}}, where the motion beside it is slower)"
            f"{several}: samples were lost and the time numbered anew, or the zero of the sensor "
            "has slipped",
            samples,
            moved=(float(moved[worst]), "in"),
            speed=(float(abs(moved[worst]) / step[worst]), "in/s"),
        )


def _jumps(trace: Trace, values: Array) -> Samples:
    """Samples to which a signal jumps."""
    steps = np.diff(values) / np.diff(trace.time)
    if steps.size < 9:
        return _NONE
    window = np.lib.stride_tricks.sliding_window_view(np.pad(steps, 2, mode="edge"), 5)
    neighbours = window[:, [0, 1, 3, 4]]
    deviation = np.abs(steps - np.median(neighbours, axis=1))
    typical = float(np.quantile(np.abs(steps), 0.98, method="lower"))
    large = deviation * np.diff(trace.time) > JUMP * np.ptp(values)
    sudden = deviation > np.maximum(2.0 * np.abs(neighbours).max(axis=1), 1.5 * typical)
    return np.flatnonzero(large & sudden) + 1


def held(trace: Trace, name: str, idx: Samples) -> Iterator[Fault]:
    """One channel that does not change, at these samples, while the other goes on."""
    if idx.size:
        end = int(idx[np.argmax(np.append(np.diff(idx), 2) > 1)])
        yield Fault.of(
            "held",
            f"the {name} holds one value from {trace.time[idx[0]]:.4g} s to {trace.time[end]:.4g} s"
            f"{' and later once more' if end < idx[-1] else ''}, while the test goes on: the "
            "sensor or its channel was frozen",
            idx,
        )


def frozen(trace: Trace) -> tuple[Samples, Samples]:
    """Samples in which the displacement, and the force, is frozen.

    A channel is frozen where it keeps a value for much longer than usual, and the other one goes
    far, or it jumps when it comes back. A force may slip at one value, and stay at a limit.
    """
    if trace.force is None:
        return _NONE, _NONE
    x, force = trace.displacement, trace.force
    path, stroke = np.pad(np.cumsum(np.abs(np.diff(x))), (1, 0)), float(np.ptp(x))
    swing = SWING * float(np.subtract(*np.quantile(force, [0.99, 0.01])))
    samples = []
    for values in (x, force):
        starts, lengths = _constant(values)
        ends = starts + lengths
        travel = path[ends] - path[starts]
        returns = np.isin(ends + 1, _jumps(trace, values))
        if values is x:
            sizes = lengths.astype(float)
            pairs = zip(starts, ends, strict=True)
            goes_on = np.array([np.ptp(force[a : b + 1]) > swing > 0.0 for a, b in pairs], bool)
        else:
            sizes, goes_on = travel, travel > FAR * stroke
            returns &= (travel > NEAR * stroke) & (np.abs(values[starts]) < np.abs(values).max())
        # The longest run of four strokes of five is not exceeded by what is usual.
        longest = np.zeros(trace.cycle_turns.size + 1)
        np.maximum.at(longest, np.searchsorted(trace.cycle_turns, starts, side="right"), sizes)
        typical = float(np.quantile(longest, 0.8, method="lower"))
        long = (lengths >= HELD) & (sizes > LONGER * typical) & (returns | goes_on)
        samples.append(_spread(starts[long], lengths[long]))
    return samples[0], samples[1]


def _constant(values: Array) -> tuple[Samples, Samples]:
    """First sample of each run of equal values, and how many follow it."""
    previous, lengths = run_lengths(np.diff(values) == 0.0)
    return previous + 1, lengths


def _spread(starts: Samples, lengths: Samples) -> Samples:
    """All samples of runs."""
    pieces = [np.arange(a, a + n + 1) for a, n in zip(starts, lengths, strict=True)]
    return np.concatenate([_NONE, *pieces]).astype(np.intp)


def zero_moves(trace: Trace) -> Iterator[Fault]:
    """Both ends of the strokes that move together: the zero of the displacement."""
    turns, stroke = trace.displacement[trace.cycle_turns], float(np.ptp(trace.displacement))
    if turns.size >= TURNS:
        # of three turns, so that strokes that grow or shrink evenly have no other middle; strokes
        # of which one end stays have one that follows their size
        aside = 0.5 * (turns[:-2] + turns[2:])
        middles, sizes = 0.5 * (turns[1:-1] + aside), np.abs(turns[1:-1] - aside)
        time = trace.time[trace.cycle_turns[1:-1]]
        columns = np.column_stack([np.ones(time.size), time - time.mean(), sizes - sizes.mean()])
        columns /= np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
        line, _, rank, _ = np.linalg.lstsq(columns, middles, rcond=1e-3)
        beside = middles - columns @ line
        error = np.sqrt(
            beside @ beside / (time.size - 3) * np.linalg.pinv(columns.T @ columns)[1, 1]
        )
        moved = float(line[1] / np.linalg.norm(time - time.mean()) * np.ptp(trace.time))
        steady = beside.std() < BESIDE * stroke and abs(line[1]) > CERTAIN * error
        steady &= rank == 3 or np.ptp(sizes) < 1e-3 * stroke
        if steady and abs(moved) > SLOW_ZERO * stroke:
            yield Fault.of(
                "displacement zero",
                f"the displacement drifts by {_plus(moved)}{{moved}} over the record at both ends "
                f"of its strokes, {abs(moved) / stroke:.0%} of the stroke: the zero of the sensor "
                "drifts, or the middle of the motion was moved",
                moved=(moved, "in"),
            )
            return
    loops = find_loops(trace)
    full = loops.amplitude > 0.8 * loops.amplitude.max(initial=0.0)
    middle, half = loops.middle[full], loops.amplitude[full]
    if half.size < max(2 * FEWEST, full.size / 2):
        return
    ends, stroke = np.array([middle + half, middle - half]), 2.0 * float(np.median(half))
    moves = np.array(
        [np.median(ends[:, k:], 1) - np.median(ends[:, :k], 1) for k in range(2, half.size - 1)]
    )
    k = int(np.argmax(np.abs(moves).min(axis=1)))
    moved = float(moves[k].mean())
    if np.prod(moves[k]) > 0.0 and np.abs(moves[k]).min() > ZERO * stroke:
        yield Fault.of(
            "displacement zero",
            f"both ends of the strokes move by {_plus(moved)}{{moved}} at about "
            f"{trace.time[loops.bounds[:-1][full][k + 2]]:.4g} s, {abs(moved) / stroke:.0%} of the "
            "stroke: the zero of the sensor slips or drifts, or the middle of the motion was moved",
            moved=(moved, "in"),
        )


def resolution(trace: Trace, gap: float | None) -> Iterator[Fault]:
    """A channel in steps that are too large for its range, or the displacement's for the gap."""
    for name, values, unit, fewest in (
        ("displacement", trace.displacement, "in", LEVELS),
        ("force", trace.force, "kip", FORCE_LEVELS),
    ):
        if values is None or not (quantum := _quantum(values)) > 0.0:
            continue
        steps, of, across = float(np.ptp(values)) / quantum, "its range", ""
        if name == "displacement":
            of, across = "the stroke", "" if gap is None else f", {gap / quantum:.2g} in the gap"
        if steps < fewest or (across and gap is not None and quantum > gap / CROSSING):
            yield Fault.of(
                "resolution" if name == "displacement" else "force resolution",
                f"the {name} moves in steps of {{quantum}}, {steps:.0f} in {of}{across}: the "
                "sensor or the file is too coarse",
                quantum=(quantum, unit),
            )


def _quantum(values: Array) -> float:
    """Step in which a signal moves; 0 where it is not quantised."""
    span, levels = float(np.ptp(values)), np.unique(values)
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * span]
    if steps.size < 3 or levels.size > 0.5 * values.size:
        return 0.0
    shares = steps / steps.min()
    return float(steps.min()) if np.mean(np.abs(shares - np.round(shares)) < 0.1) > 0.95 else 0.0


def noise(trace: Trace) -> Iterator[Fault]:
    """A displacement whose noise is not small compared with the travel of the build-up.

    Errors in what a force follows weaken the relation: a fit takes the force for smaller and
    softer than it is (regression dilution).
    """
    size, loop = sensor_noise(trace.displacement), features_of(trace)
    rise = loop["slip"] / loop["build_up_slope"]  # NaN where it cannot be read
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
    """A trend of the mean force of the loops at full stroke, over the record.

    Of few such loops, as far as the force at the quiet ends of the record has changed alike,
    because ramps differ in their mean force without any drift.
    """
    from scipy.stats import linregress  # which takes long to import

    loops = find_loops(trace)
    strong = loops.strong
    count = np.count_nonzero(strong)
    if trace.force is None or count < FEWEST:
        return
    middle = 0.5 * (trace.time[loops.bounds[1:]] + trace.time[loops.bounds[:-1]])
    line = linregress(middle[strong], np.asarray(loops.offset)[strong])
    change = float(line.slope) * float(trace.time[-1] - trace.time[0])
    if count >= max(STEADY, 0.5 * strong.size) and not trace.varying:
        change = change if line.pvalue < P_VALUE else 0.0
        size, threshold = features_of(trace)["slip"], STEADY_DRIFT
    else:
        size, threshold = 0.5 * float(np.subtract(*np.quantile(trace.force, [0.99, 0.01]))), DRIFT
        width = max(trace.samples // 50, 1)
        ends = float(trace.force[-width:].mean() - trace.force[:width].mean())
        change = min(change, ends, key=abs) if change * ends > 0.0 else 0.0
    if abs(change) > threshold * size > 0.0:
        yield Fault.of(
            "drift",
            f"the force drifts by {_plus(change)}{{change}} from its begin to its end, "
            f"{abs(change) / size:.0%} of the force in slip: the load cell's zero, or a device "
            "that changes",
            change=(change, "kip"),
        )


def _plus(value: float) -> str:
    return "+" if value > 0.0 else ""


_OF_FORCE = {"force sign", "channels", "clipping", "lag", "drift", "noise", "held", "held samples"}
_CONSEQUENCES = {
    "no force": {"rate", "stroke"},
    "peaks and valleys": {"short record", "rate", "stroke", "resolution", "force resolution"},
    "two clocks": _OF_FORCE | {"no force", "file name", "rate", "stroke"},
    "time stamps": {"velocity", "dropped samples", "lag", "jump", "held", "time unit", "noise"},
    "channels": {"clipping", "lag", "noise", "drift", "held"},
    "displacement clipping": {"lag", "noise", "velocity", "displacement zero"},
    "held": {"clipping", "lag", "drift"},
    "held samples": {"lag"},
    "repeated block": {"jump"},
    "resolution": {"noise", "lag"},  # the sample of a reversal must be known
    "noise": {"lag"},
}
"""Faults that need not be told where another is: they would be guessed from what it spoils."""

SPOILED = {*_CONSEQUENCES, "no force", "clipping", "lag", "force resolution"} - {"channels", "held"}
"""Faults of a record that spoil what its loops show: it is not compared with other tests."""


NO_LOOPS = {"peaks and valleys", "two clocks", "no force"}
"""Faults of a record of which no measured value of a cycle is told."""


def without_consequences(faults: Iterable[Fault]) -> tuple[Fault, ...]:
    """Faults but for those that are guessed from what another one spoils."""
    faults = tuple(faults)
    hidden = {name for fault in faults for name in _CONSEQUENCES.get(fault.name, ())}
    return tuple(fault for fault in faults if fault.name not in hidden)


def find_faults(trace: Trace, gap: float | None = None) -> tuple[Fault, ...]:
    """Faults of a record, the most serious first, of a trace with every sample.

    `gap` is the median width of the device's gap, in; without it, rate and stroke are not checked.
    """
    clean = without_spikes(trace)
    if faults := [*peaks_only(clean)]:
        return (*faults, *time_unit(clean))
    faults = [*no_force(clean)]
    if faults:
        clean = replace(clean, force=None)
    motion, force = frozen(clean)
    faults += force_sign(clean)
    if not np.array_equal(trace.velocity, np.gradient(trace.displacement, trace.time)):
        faults += velocity(clean)  # which was measured
    faults += [*uneven(clean), *time_unit(clean), *short_record(clean)]
    faults += [*clipping(clean), *clipped_motion(clean), *held_samples(clean), *lag(clean)]
    faults += [*repeated_block(trace), *jumps(clean, motion)]
    faults += [*held(clean, "displacement", motion), *held(clean, "force", force)]
    faults += [*zero_moves(clean), *spikes(trace), *dropped(clean)]
    faults += [*resolution(clean, gap), *noise(clean)]
    if gap is not None:
        faults += of_gap(clean, gap)
    faults += drift(clean)
    return without_consequences(faults)


NEAR_TURN = 0.05  # share of the peak-to-peak displacement before a reversal that the fit sees
STROKES, REVERSALS = 0.4, 40  # shortest strokes, by their share of the longest; most reversals
SEARCH, FALL = 0.25, 0.8
"""The fall of the force at a turn is looked for from the first share of the stroke before to as
far from the end of the one after, and fitted until it has gone the second share of the way to the
middle between both plateaus: what the gap does lies behind it."""
LIKELY, CLEAR, FITTED = 0.85, 0.01, 0.2
"""A lag counts if its squared misfit is at most the first share of that without a lag, and better
by the second share of the variance, and leaves at most the third share of it."""
REACH, HALF_OFF = 0.2, 0.12
"""Share of a cycle, of a longer lag than which it is only said that it is as long; and from which
negative work does not tell a swapped sign."""


def estimate_lag(trace: Trace) -> tuple[float, Samples] | None:
    """Lag of the force behind the displacement, s, and the reversals that it was seen at.

    After a turn of the motion the friction force falls, fastest at the turn itself: by
    A (1 − exp(−s/λ)) at the distance s from it, which is a spring's straight line where λ is long.
    A and a line in time, for the level before the turn and viscous friction, are fitted to each
    reversal, λ and the lag to all reversals together. A late force begins to fall after the turn,
    an early one before it. None without reversals, or where no lag fits clearly better.
    """
    from scipy.signal import detrend

    t, x = trace.time, trace.displacement
    falls = list(_falls(trace))
    if len(falls) < 2:
        return None
    lengths = NEAR_TURN * float(np.ptp(x)) * np.geomspace(0.003, 30.0, 12)[:, None, None]

    def misfits(lags: Array) -> tuple[Array, float]:
        """Squared misfit over all turns with the best λ, (lags,), and without any fall."""
        misfit, total = np.zeros((len(lengths), lags.size)), 0.0
        for begin, turn, end, stop, force in falls:
            time = t[begin : end + 1]
            if time.size > 120:
                time = np.linspace(time[0], time[-1], 120)
            segment = slice(begin, max(stop, end) + 1)
            distance = np.abs(x[segment] - x[turn])
            distance[: max(turn - begin, 0) + 1] = 0.0
            distance = np.maximum.accumulate(distance)
            shape = detrend(
                -np.expm1(-np.interp(time - lags[:, None], t[segment], distance) / lengths)
            )
            fall = detrend(-np.interp(time, t[segment], force[segment]))
            square, projection = np.sum(shape**2, axis=2), np.maximum(shape @ fall, 0.0)
            size = float(np.sum(fall**2))
            misfit += size - np.where(
                square > 1e-12, projection**2 / np.maximum(square, 1e-12), 0.0
            )
            total += size
        return misfit.min(axis=0), total

    earliest, latest = np.median(
        [(t[b] - t[turn], t[e] - t[turn]) for b, turn, e, *_ in falls], axis=0
    )
    coarse = np.linspace(earliest, latest, 49)
    misfit, total = misfits(np.append(coarse, 0.0))
    unlagged = misfit[-1]
    best = int(np.argmin(misfit[:-1]))
    if misfit[best] > min(LIKELY * unlagged, unlagged - CLEAR * total):
        return None
    fine = coarse[best] + np.linspace(-1.0, 1.0, 9) * (coarse[1] - coarse[0])
    refined = misfits(fine)[0]
    if refined.min() > FITTED * total:
        return None
    return float(fine[np.argmin(refined)]), np.array([turn for _, turn, *_ in falls])


def _falls(trace: Trace) -> Iterator[tuple[int, int, int, int, Array]]:
    """Falls of the force at the turns between long strokes, as samples.

    At which it is fitted from, of the turn, to which it is fitted, and of the next turn; and the
    force, (T,), positive before the turn.
    """
    x = trace.displacement
    if trace.force is None:
        return
    ends = np.concatenate([[0], trace.cycle_turns, [x.size - 1]])
    long = np.abs(np.diff(x[ends])) >= STROKES * np.ptp(x)
    turns = np.flatnonzero(long[:-1] & long[1:]) + 1  # between long strokes
    for k in turns[:: max(1, -(-turns.size // REVERSALS))]:
        start, turn, stop = ends[k - 1 : k + 2].tolist()
        force = np.sign(x[turn] - x[start]) * trace.force
        search_start, search_end = (
            a + int(np.argmax(np.abs(x[a : b + 1] - x[a]) >= share * abs(x[b] - x[a])))
            for a, b, share in ((start, turn, SEARCH), (turn, stop, 1.0 - SEARCH))
        )
        window = force[search_start : search_end + 1]
        low, high = np.quantile(window, [0.1, 0.8])
        search_start += int(np.argmax(window))
        fallen = force[search_start : search_end + 1] < high - 0.5 * FALL * (high - low)
        if high > low and fallen.any():
            end = search_start + int(np.argmax(fallen))
            far = np.abs(x[start:turn] - x[turn]) > NEAR_TURN * np.ptp(x)
            begin = start + int(np.max(np.flatnonzero(far), initial=-1)) + 1
            begin = max(start, min(begin, end - 2 * (turn - begin), end - 4))
            yield begin, turn, end, stop, force


TOLERANCE = 0.1  # most difference of a record from its name, as a share of the name's value
SLOW_RATE, SLOW_PERIOD = 5.0, 3600.0
"""Where no unit of time is stated, a slower rate (Hz) with longer cycles (s) is not of a time in s:
qualification tests take a sample each few seconds, and up to an hour."""

NUMBER = (
    r"(?<![\d.])(?<!\d[eE])(?<![A-Za-z]\d,)"  # no part of 1.5e3, nor of "seal3,5bar"
    r"(0,\d+(?![\d.,])|(?<![A-Za-z])\d{1,3},\d{1,2}(?![\d.,])"
    r"|(?!(?<=\d,)\d{3}(?!\d))"  # no part of 1,200
    r"(?:\d+[.px]\d+(?!\d)|\d+(?!\d|[.px]\d)))"  # whole: Python 3.11.2 misreads (\d++)?+
)
"""Number in a name: ``0.5``, ``0p5``, ``0x5``, ``0,5``. Of ``1,200`` it is not known which it is,
and commas may stand between words too, as in ``2022,36lb,0.25Hz``.
"""

_BEFORE = re.compile(r"(?<![\d.,])(0|[1-9]\d{0,2})([ _-])$")  # what a number may go on from

_ALONE = rf"(?<![A-Za-z]){NUMBER}"
_FREQUENCY = re.compile(rf"{NUMBER}[ _-]?hz(?![a-z])", re.IGNORECASE)
_LENGTH = re.compile(rf"{_ALONE}(in|inch|mm)(?![a-z])", re.IGNORECASE)
_ACTUATION = re.compile(
    rf"{_ALONE}[ _-]?(psi|ksi|kpa|mpa|bar|lbf|lbs|lb|kips|kip|kn)(?![a-z])", re.IGNORECASE
)
_SPELLED = by_spelling(
    {
        "kPa": "kpa",
        "MPa": "mpa",
        "kN": "kn",
        "N": "n",
        "lbf": "lb lbs",
        "kip": "kips",
        "N*m": "nm",
        "mV": "mv",
        "mA": "ma",
        "A": "a amp amps",
        "V": "v volt volts",
    }
)


def contradictions(
    record: Record, trace: Trace | None = None, *, roles: Collection[str] = ROLES
) -> tuple[Fault, ...]:
    """Gaps in time, and units in columns' names or figures in a file's that its record has not.

    Words are numbers with a unit, as ``36lb_0.25Hz_1.0in``. A length is the amplitude or the whole
    stroke, whichever agrees; a rate may also be that of the samples. Of several it is enough that
    one agrees. Only roles whose unit is known, `roles`, are compared.
    """
    trace = record.trace() if trace is None else trace
    faults = [Fault.of("rows not used", "{rows}", rows=doubt) for doubt in record.doubts]
    if "time" in roles and record.gap:
        faults.insert(0, Fault.of("gap in time", "{gap}", gap=record.gap))
    faults += _of_columns(record, roles)
    if "time" in roles:
        faults += _of_time(record, trace)
    faults += [*_of_name(record, trace, roles), *_of_other_columns(record, trace, roles)]
    return tuple(faults)


CLOCK = 0.01  # share of the duration by which times of two clocks differ
ELASTIC, GIVE = 0.8, 0.02
"""A displacement holds a spring where the force explains the first share of its difference from
another one, and that is the second share of its stroke."""
LIKE, FORCE_OF_MOTION = 0.8, 0.4
"""Least correlation of two displacements, and share of a force that its own motion explains."""


def _of_other_columns(record: Record, trace: Trace, roles: Collection[str]) -> Iterator[Fault]:
    """Columns that are not used, and from which the loops show that they should be."""
    in_trace = (record.time >= trace.time[0]) & (record.time <= trace.time[-1])
    candidates = {
        role: {n: values[in_trace] for n, (r, values) in record.rivals.items() if r == role}
        for role in ("time", "displacement", "force")
    }
    labels = {role: repr(name) for role, (name, _) in record.columns.items()}
    for name, clock in candidates["time"].items() if "time" in labels else ():
        difference = clock - clock[0] - (trace.time - trace.time[0])
        if np.max(np.abs(difference)) > CLOCK * np.ptp(trace.time):
            rates = [(trace.samples - 1) / float(np.ptp(t)) for t in (trace.time, clock)]
            yield Fault.of(
                "two clocks",
                "the time is read from {used}, and {name} is another clock: "
                f"{rates[0]:.4g} Hz and {rates[1]:.4g} Hz; where force and displacement have a "
                "time each, bring them onto one before, by interpolation",
                used=labels["time"],
                name=repr(name),
            )
    clean = without_spikes(trace)
    if clean.force is None or not {"displacement", "force"} <= set(roles):
        return
    if not explained_by_motion(clean) > FOLLOWS:
        for role, columns in (
            ("force", candidates["force"]),
            ("displacement", candidates["displacement"]),
        ):
            for name, values in columns.items():
                channel = {role: despiked(values)}
                motion = channel.get("displacement", clean.displacement)
                force = channel.get("force", clean.force)
                if not np.ptp(motion) > 0.0 < np.ptp(force):
                    continue
                pair = Trace.from_arrays(clean.time, motion, None, force)
                if explained_by_motion(pair) > FORCE_OF_MOTION:
                    yield Fault.of(
                        "other column",
                        "the force does not follow the motion, but makes loops with it where the "
                        "{role} is read from {name} and not from {used}: which is it?",
                        role=role,
                        name=repr(name),
                        used=labels[role],
                    )
        return
    for name, values in candidates["displacement"].items():
        rival = despiked(values)
        if not np.ptp(rival) > 0.0 or np.corrcoef(rival, clean.displacement)[0, 1] < LIKE:
            continue
        difference = clean.displacement - rival
        slope, _ = np.polyfit(clean.force, difference, 1)
        give = float(slope * np.ptp(clean.force))
        follows = np.corrcoef(clean.force, difference)[0, 1] if np.ptp(difference) > 0.0 else 0.0
        if follows > ELASTIC and give > GIVE * np.ptp(clean.displacement):
            yield Fault.of(
                "other column",
                "the displacement of {used} is that of {name} and {give} more, in proportion to "
                "the force: it holds what gives way beside the device; which is across the device?",
                used=labels["displacement"],
                name=repr(name),
                give=(give, "in"),
            )


def _of_columns(record: Record, roles: Collection[str]) -> Iterator[Fault]:
    """Columns that are read in another unit than the file says, or whose own is not known."""
    for role, (name, unit) in record.columns.items():
        if role in record.derived or (role not in roles and role != "actuation"):
            continue
        row = record.stated_units.get(role, "")
        stated, source = stated_unit(name, row), "the file" if row else "its name"
        if not stated or measure(stated) != measure(unit):  # "kN" of "load_kN"
            suffix = header_unit(name)
            if suffix and measure(suffix) == measure(unit):
                stated, source = suffix, "its name"
        if not stated or " " in stated or same_unit(stated, unit):
            continue
        question = ": which is it?"
        if measure(stated) != measure(unit):
            if may_mean(stated, unit):
                continue
            question = f", which is no known unit of {role}: which is it{force_meant(stated)}?"
        yield Fault.of(
            "column unit",
            f"column {{name}} is read in {{unit}}, and {source} says {{own}}{question}",
            name=repr(name),
            unit=repr(unit),
            own=repr(stated),
        )


def _of_time(record: Record, trace: Trace) -> Iterator[Fault]:
    """Times read as s, without the file's word for it, that are plausible as ms alone."""
    name = record.columns.get("time", ("", ""))[0]
    stated = (header_unit(name), stated_unit(name), record.stated_units.get("time"))
    duration = float(np.ptp(trace.time))
    cycle, rate = duration / max(trace.turning_points.size / 2, 1.0), trace.samples / duration
    is_stated = any(unit and measure(unit) == "time" for unit in stated)
    if rate <= SLOW_RATE and cycle > SLOW_PERIOD and not is_stated:
        yield Fault.of(
            "time unit",
            f"a rate of {rate:.3g} Hz with cycles of {cycle:.3g} s is implausible, and the file "
            "states no unit of time: is time in ms rather than in s?",
        )


def _of_name(record: Record, trace: Trace, roles: Collection[str]) -> Iterator[Fault]:
    """Amplitude, frequency and actuation that no figure in the file's name agrees with."""
    name, loops = record.path.stem, find_loops(trace)
    compared: list[
        tuple[dict[str, tuple[float, ...]], tuple[float, ...], str, dict[str, str | Value]]
    ] = []
    if loops.period.size and "displacement" in roles:
        size = float(np.median(loops.amplitude[loops.strong]))
        text = "the record has an amplitude of {amplitude} (a stroke of {stroke})"
        sizes: dict[str, str | Value] = {"amplitude": (size, "in"), "stroke": (2 * size, "in")}
        compared.append((_lengths(name), (size, 2 * size), text, sizes))
    if loops.period.size and "time" in roles:
        rate = float(1.0 / np.median(loops.period[loops.strong]))
        rates = dict(readings(name, m) for m in _FREQUENCY.finditer(name))
        compared.append((rates, (rate, record.rate), f"the record's motion has {rate:.3g} Hz", {}))
    if record.actuation is not None:
        declared, level = {}, float(np.mean(record.actuation))
        for match in _ACTUATION.finditer(name):
            words, numbers = readings(name, match)
            scale, internal = parse_actuation(level_text(1.0, match[2]))
            if internal == record.actuation_unit:
                declared[words] = tuple(scale * number for number in numbers)
        origin = "the campaign"
        words = record.given_actuation or f"{level:.4g} {record.actuation_unit}"
        if "actuation" in record.columns:
            unit = record.columns["actuation"][1]
            origin, words = "its column", f"{level / actuation_factor(unit)[0]:.4g} {unit}"
        text = f"{origin} has an actuation of {{level}}"
        compared.append((declared, (level,), text, {"level": words}))
    for figures, measured, text, values in compared:
        stated = chain.from_iterable(figures.values())
        if figures and not any(_near(s, f) for f, s in product(stated, measured)):
            sentence = f"the name of {{file}} says {{words}}, but {text}"
            words = " and ".join(figures)
            yield Fault.of("file name", sentence, file=record.path.name, words=words, **values)


def _lengths(name: str) -> dict[str, tuple[float, ...]]:
    """Lengths in a file's name, in, by their words: amplitudes or whole strokes."""
    read = [(readings(name, m), factor(m[2], "displacement")) for m in _LENGTH.finditer(name)]
    return {words: tuple(scale * number for number in numbers) for (words, numbers), scale in read}


def length_in_name(record: Record) -> tuple[str, str] | None:
    """The one unit with which a displacement, read as inches, is as long as its name says; why."""
    loops = find_loops(record.trace())
    if not loops.period.size:
        return None
    amplitude = float(np.median(loops.amplitude[loops.strong]))
    sizes = {u: amplitude * factor(u, "displacement") for u in ("mm", "cm", "m", "in")}
    agree = {
        unit: words
        for unit, size in sizes.items()
        for words, lengths in _lengths(record.path.stem).items()
        if any(_near(size, length) or _near(2.0 * size, length) for length in lengths)
    }
    if len(agree) != 1:
        return None
    unit, words = agree.popitem()
    reason = f"the file's name says {words}, and the numbers have an amplitude of {amplitude:.3g}"
    return unit, reason


def readings(name: str, match: re.Match[str]) -> tuple[str, tuple[float, ...]]:
    """Words of a quantity that `NUMBER` has found in a name, and the numbers that it may be.

    An x is a sign of decimals, or of times, as in ``2x500psi``. Behind digits and ``_``, ``-`` or
    a blank the last part comes first, then both as one number: ``1_5bar`` is the first test at
    5 bar, or 1.5 bar; ``1 500psi`` may be 1500 psi.
    """
    text, start = match[1].lower(), match.start(1)
    numbers = [float(re.sub("[px,]", ".", text))]
    head, times, tail = text.partition("x")
    if times and head != "0":
        numbers.insert(0 if len(tail) >= 3 else 1, float(tail))
    prefix = _BEFORE.search(name[:start])
    if prefix and text.isdigit() and len(text) <= 3:
        start = prefix.start()
        grouped = len(text) == 3 and prefix[1] != "0"
        if prefix[2] != " " or not grouped:
            numbers.append(float(f"{prefix[1]}.{text}"))
        if grouped:
            numbers.append(float(prefix[1] + text))
    return name[start : match.end()], tuple(dict.fromkeys(numbers))


def level_text(number: float, unit: str) -> str:
    """Quantity of a number and a unit in any case: "5 MPa"."""
    return f"{number:.9g} {_SPELLED.get(unit.lower(), unit.lower())}"


def _near(size: float, declared: float) -> bool:
    return abs(size - declared) <= TOLERANCE * declared + 1e-9


@dataclass(frozen=True, eq=False)
class Inspection:
    """Facts, loops and faults of a record."""

    name: str
    facts: dict[str, Message]  # by title: file, columns, rate, ranges, loops, measured values
    trace: Trace  # at the record's own rate
    loops: Loops
    faults: tuple[Fault, ...]

    def __repr__(self) -> str:
        facts = [f"  {key:21s}{fact}" for key, fact in self.facts.items()]
        faults = [f"  {'warning':21s}{fault.name}: {fault.message}" for fault in self.faults]
        return "\n".join([self.name, *facts, *faults])


def inspect_record(name: str, record: Record, gap: float | None = None) -> Inspection:
    """Columns, units, rate, loops, measured values, drifts and faults of a record.

    `gap` is the median width of the gap, in, under the priors, if there are any.
    """
    raw = record.trace()
    trace = without_spikes(raw)
    loops = find_loops(trace)
    faults = without_consequences((*contradictions(record, trace), *find_faults(raw, gap)))
    facts = _facts_of_file(record, trace) | _facts_of_motion(record, trace, loops)
    if trace.force is not None:
        shows_loops = not NO_LOOPS.intersection(fault.name for fault in faults)
        facts |= _facts_of_force(record, trace, loops if shows_loops else None)
    return Inspection(name, facts, raw, loops, faults)


def _facts_of_file(record: Record, trace: Trace) -> dict[str, Message]:
    name, columns = record.axes.name, record.columns.items()
    texts = {
        "file": record.path.name,
        "columns": ", ".join(f"{name(role)}: {n} [{unit}]" for role, (n, unit) in columns),
        **{f"{name(role)} is made of": text for role, text in record.derived.items()},
        "columns not used": ", ".join(record.other_columns),
        "rows not used": "; ".join(record.notes),
        "samples": f"{trace.samples}",
    }
    if trace.timed:
        texts["samples"] += f" over {trace.time[-1] - trace.time[0]:.6g} s"
        texts["rate"] = record.clock.words()
    return {title: Message("{text}", {"text": text}) for title, text in texts.items() if text}


def _facts_of_motion(record: Record, trace: Trace, loops: Loops) -> dict[str, Message]:
    turns, strong = trace.cycle_turns.size, loops.strong
    facts = {"displacement": _message("{}", (trace.displacement, "in"))}
    if trace.timed:
        facts["velocity"] = _message("{}", (trace.velocity, "in/s"))
    facts["turning points"] = Message(f"{turns} ({turns / 2:g} cycles)")
    if strong.size:
        suffix = "" if strong.all() else f", {np.count_nonzero(strong)} of them at full stroke"
        text, values = f"{strong.size}{suffix}: amplitude {{}}", [(loops.amplitude[strong], "in")]
        if trace.timed:
            text += ", frequency {}"
            values.append((1.0 / loops.period[strong], "Hz"))
        facts["full loops"] = _message(text, *values, digits=3)
    if record.actuation is not None and record.given_actuation != NO_ACTUATION:
        history = " (mean of a history)" if trace.varying else ""
        level = (float(np.mean(record.actuation)), str(record.actuation_unit))
        facts["actuation"] = _message(f"{{}}{history}", level, digits=3)
    return facts


def _facts_of_force(record: Record, trace: Trace, loops: Loops | None) -> dict[str, Message]:
    """Range of the force, measured values of the cycles, and drifts."""
    force = np.asarray(trace.force)
    at_peak = max(np.count_nonzero(force == end) for end in (force.min(), force.max()))
    facts = {"force": _message(f"{{}}, samples at a peak: {at_peak}", (force, "kip"))}
    cycles = measured_cycles(trace)
    if loops is None or cycles is None or not cycles.time.size:
        return facts
    values, span = cycles.of_test(), "from the first loops to the last"
    shown = [p for p in PROPERTIES.values() if p.of_cycle and p.applies(record.axes)]
    shown.sort(key=lambda p: (p.key == "energy", p.design == 0))
    for title, quantities in groupby(shown, key=lambda p: p.label):
        first, *others = quantities
        sizes = [(values[quantity.name], quantity.unit) for quantity in (first, *others)]
        if not np.isfinite([size for size, _ in sizes]).all():
            continue
        if title == "slip force":
            facts[title] = _slip_force(trace, cycles)
        elif first.key == "energy":
            full = first.extent == FULL
            energy = cycles.values["energy"][cycles.full_stroke == full]
            text = f"{{}} (mean of {energy.size} {'at full stroke' if full else 'smaller'}, {{}})"
            facts[title] = _message(text, *sizes, (energy, "kip*in"))
        else:
            facts[title] = _message("{} forward, {} backward" if others else "{}", *sizes)
    if loops.energy_drift is not None and PROPERTIES["energy_per_cycle"].applies(record.axes):
        facts["energy drift"] = Message(f"{loops.energy_drift:+.1%} {span}")
    offset = (float(np.median(cycles.offset)), "kip")
    facts["force offset"] = _message("{}, mean along a loop", offset, digits=3)
    if loops.offset_drift is not None:
        facts["force drift"] = _message(f"{{}} {span}", (loops.offset_drift, "kip"), digits=3)
    return facts


def _slip_force(trace: Trace, cycles: MeasuredCycles) -> Message:
    """Slip forces with their standard errors, and those at mid-stroke where it lies elsewhere."""
    names, values = ("slip_fwd", "slip_bwd"), cycles.of_test()
    errors = [cycles.standard_error(name) for name in names]
    text, quantities = "{} forward, {} backward", [(values[name], "kip") for name in names]
    if np.isfinite(errors).all():
        text += " (standard errors {} and {})"
        threshold = 1e-6 * max(cycles.largest_fwd, cycles.largest_bwd)  # below it is round-off
        quantities += [(float(f"{e:.2g}") if e > threshold else 0.0, "kip") for e in errors]
    if not zero_is_central(trace):
        return _message(f"{text}, at mid-stroke, where zero displacement is not", *quantities)
    middles = find_loops(trace).middle[cycles.full_stroke]
    if abs(np.median(middles)) <= NEAR * np.median(cycles.stroke[cycles.full_stroke]):
        return _message(f"{text}, at zero displacement", *quantities)
    strokes = stroke_estimates(trace, np.asarray(trace.force)[None], mid_stroke=True)
    for sign in (1.0, -1.0):
        middle = mean_of(strokes.slip[0], strokes.full & (strokes.sign == sign))
        quantities.append((float(middle), "kip"))
    return _message(f"{text}, at zero displacement; at mid-stroke {{}} and {{}}", *quantities)


def _message(text: str, *values: tuple[Array | float, str], digits: int = 4) -> Message:
    """A text with quantities, each a value or the ends of several, and its internal unit."""
    quantities = {}
    for number, (value, unit) in enumerate(values):
        ends = (np.min(value), np.max(value)) if np.ndim(value) else (value,)
        quantities[f"value{number}"] = Measure.of(*map(float, ends), unit=unit, digits=digits)
    return Message(text.format(*(f"{{{name}}}" for name in quantities)), quantities)
