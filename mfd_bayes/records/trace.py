"""The input of a friction model: a sampled motion, its turns, its actuation and its force.

From arrays, or a harmonic motion from a text.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import MfdError, RecordError, UnitError, real_number, real_numbers
from mfd_bayes.units import DAMPER, Axes, parse_quantity, split_quantity

Array = NDArray[np.float64]

HYSTERESIS = 1e-3  # smaller reversals, by their share of the peak-to-peak, are sensor noise
NOISY = 6.0  # and so are those smaller than so many standard deviations of the sensor's noise,
MOST_NOISE = 1e-2  # but no larger ones, by their share of the peak-to-peak
CYCLE = 0.2  # a cycle's turn goes back by this share of the stroke near it,
SMALLEST_CYCLE = 0.05  # and by this share of the peak-to-peak
SMOOTH = 0.1  # share of a step by which a smooth turn may differ from constant acceleration


@dataclass(frozen=True, eq=False)
class MotionPath:
    """The motion of a trace with a sample added at the vertex of every turn, (P,) samples.

    The true extreme lies between two samples. Without it, the distance since the turn would be
    too short by up to a (ω Δt)²/8, which shows in a stiff unloading. `step` and `rate` are the
    motion since the sample before and its mean velocity. The last of the `turning_points` counts
    however small it is, because the motion after it is not known. Each sample of the path is at or
    beside the `nearest` one of the trace; `samples` (T,) of the path are the trace's, and
    `stretch` (T,) counts the turning points before each of them.
    """

    time: Array
    displacement: Array
    velocity: Array
    step: Array
    rate: Array
    turning_points: NDArray[np.intp]
    direction: int
    nearest: NDArray[np.intp]
    samples: NDArray[np.intp]
    stretch: NDArray[np.intp]

    def __post_init__(self) -> None:
        for values in vars(self).values():
            if isinstance(values, np.ndarray):
                values.flags.writeable = False


def motion_path(t: Array, x: Array, v: Array, hysteresis: float) -> MotionPath:
    """Path of a motion in s, in and in/s, (T,) each, with its turns above `hysteresis`, in."""
    index, share, vertex = vertices(t, x, v)
    turning = turning_points(np.insert(x, index + 1, vertex), hysteresis, keep_last=True)
    mask = np.isin(index + 1 + np.arange(index.size), turning)
    index, share, vertex = index[mask], share[mask], vertex[mask]
    position = index + 1
    displacement = np.insert(x, position, vertex)
    samples = np.arange(t.size) + np.searchsorted(position, np.arange(t.size), side="right")
    turning = turning_points(displacement, hysteresis, keep_last=True)
    time = np.insert(t, position, t[index] + share * (t[index + 1] - t[index]))
    step = np.diff(displacement, prepend=displacement[0])
    duration = np.diff(time, prepend=time[0] - 1.0)
    return MotionPath(
        time=time,
        displacement=displacement,
        velocity=np.insert(v, position, 0.0),
        step=step,
        rate=step / duration,
        turning_points=turning,
        direction=first_direction(displacement, turning),
        nearest=np.insert(np.arange(t.size), position, np.where(share < 0.5, index, position)),
        samples=samples,
        stretch=np.searchsorted(turning, samples),
    )


def vertices(t: Array, x: Array, v: Array) -> tuple[NDArray[np.intp], Array, Array]:
    """Vertices of turns between samples: sample before, share of the step, displacement in in.

    Where the velocity changes its sign, the acceleration is taken as constant over the step, so
    the velocity is linear in time. Steps that do not fit such a motion (corners, noise) have no
    vertex. Only the two samples of a step are used, so a model that steps in time finds the same
    vertices.
    """
    index = np.flatnonzero(v[:-1] * v[1:] < 0)
    ends = (t[index + 1] - t[index], x[index], x[index + 1], v[index], v[index + 1])
    share, vertex, regular = vertex_of_turn(*ends)
    return index[regular], share[regular], vertex[regular]


def vertex_of_turn(
    dt: float | Array, x: Array, x_next: Array, v: Array, v_next: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Share of the step, vertex, in, and whether there is one, of steps that turn, (n,) each.

    See `vertices`: dt in s, displacements in in and velocities in in/s at both samples of each.
    """
    speed, next_speed = np.abs(v), np.abs(v_next)
    share = speed / (speed + next_speed)
    moved, sign = x_next - x, np.sign(v)
    from_left = sign * moved <= 0  # the extreme sample is the one before
    overshoot = 0.5 * dt * np.where(from_left, speed * share, next_speed * (1.0 - share))
    vertex = np.where(from_left, x, x_next) + sign * overshoot
    misfit = np.abs(moved - 0.5 * dt * (v + v_next))
    regular = misfit <= SMOOTH * dt * (speed + next_speed)
    regular &= np.abs(share - 0.5) < 0.499
    return share, vertex, regular


def turning_points(
    displacement: Array, hysteresis: float | Array, *, keep_last: bool = False
) -> NDArray[np.intp]:
    """Samples, (K,), at which the motion turns by more than `hysteresis`, in, without the ends.

    Alternating maxima and minima, from which the motion goes back by more than the hysteresis
    there; of equal extremes the last. With `keep_last`, the last turn counts however small it is.
    """
    steps = np.diff(displacement)
    moving = np.flatnonzero(steps)
    signs = np.sign(steps[moving])
    changes = moving[1:][signs[1:] != signs[:-1]]
    corners = np.concatenate([[0], changes, [displacement.size - 1]])
    values = displacement[corners]
    threshold = np.broadcast_to(hysteresis, displacement.shape)[corners]
    turns: list[int] = []
    low = high = 0
    direction = 0
    for i in range(1, len(values)):
        value = values[i]
        if value >= values[high]:
            high = i
        if value <= values[low]:
            low = i
        if direction >= 0 and values[high] - value > threshold[high]:
            if direction > 0:
                turns.append(int(corners[high]))
            direction, low, high = -1, i, i
        elif direction <= 0 and value - values[low] > threshold[low]:
            if direction < 0:
                turns.append(int(corners[low]))
            direction, low, high = 1, i, i
    extreme = high if direction > 0 else low
    if keep_last and direction != 0 and values[extreme] != values[-1]:
        turns.append(int(corners[extreme]))
    return np.array(turns, dtype=np.intp)


def cycle_turns(displacement: Array) -> NDArray[np.intp]:
    """Turning points of the whole motion, (K,): cycles run from one to the second after it.

    A tremble at the end of a stroke turns the motion, but begins no cycle; a small cycle among
    small ones is a cycle. So a turn counts where the motion goes back by more than the share
    `CYCLE` of the stroke near it: the range of the motion within half a cycle on both sides.
    """
    extent = float(np.ptp(displacement))
    noise = min(2.0 * NOISY * sensor_noise(displacement), 0.5 * extent)
    for share in (CYCLE, 0.5 * CYCLE, SMALLEST_CYCLE):  # a slow drift may be most of the range
        turns = turning_points(displacement, max(share * extent, noise))
        if turns.size >= 4:
            break
    if turns.size < 2:
        return turns
    strokes = np.abs(np.diff(displacement[turns]))
    half = float(np.median(np.diff(turns)[strokes >= 0.5 * strokes.max()]))
    width = 2 * int(np.ceil(1.2 * half)) + 1  # samples
    stroke = scipy.ndimage.maximum_filter1d(displacement, width)
    stroke -= scipy.ndimage.minimum_filter1d(displacement, width)
    smallest = max(SMALLEST_CYCLE * extent, noise)
    return turning_points(displacement, np.maximum(smallest, CYCLE * stroke))


def smallest_turn(displacement: Array) -> float:
    """Reversal of a displacement, (T,), in, that is no more than the noise of its sensor, in."""
    stroke = float(np.ptp(displacement))
    return min(max(HYSTERESIS * stroke, NOISY * sensor_noise(displacement)), MOST_NOISE * stroke)


def sensor_noise(displacement: Array) -> float:
    """Standard deviation, in, of the white noise of a displacement, (T,), in; 0 of a smooth one.

    Noise is told from motion by fourth differences: of noise they alternate, with a correlation
    of -0.8 from one to the next; of a smooth motion they hardly differ.
    """
    differences = np.diff(displacement, 4)
    leading, trailing = differences[:-1], differences[1:]
    if not leading @ trailing < -0.5 * float(differences @ differences):
        return 0.0
    return float(np.median(np.abs(differences)) / 0.6745 / np.sqrt(70.0))


def first_direction(displacement: Array, turns: NDArray[np.intp]) -> int:
    """+1 or -1, the direction of the first stretch of motion."""
    end = displacement[turns[0]] if turns.size else displacement[-1]
    return 1 if end >= displacement[0] else -1


SMALLEST = 1e-20  # the largest force of a record is above it, kip, or the record has none
LARGEST = 1e10  # largest number of a trace, in internal units; times since 1970 in s are below it


@dataclass(frozen=True, eq=False)
class Trace:
    """A sampled motion in internal units, made and checked by `Trace.from_arrays`.

    Attributes
    ----------
    time : (T,), s
        Strictly increasing.
    displacement : (T,), in
    velocity : (T,), in/s
    actuation : float or (T,), ksi (pressure) or kip (tension)
        NaN where it is not known.
    force : (T,), kip, or None
    turning_points : (K,), int
        Samples at which the motion turns, in order and without the ends.
    direction : int
        +1 or -1, the direction of the first stretch of motion.
    hysteresis : float, in
        Smallest reversal that counts as a turning point.
    timed : bool
        Whether the time is known; if not, samples are numbered.
    """

    time: Array
    displacement: Array
    velocity: Array
    actuation: float | Array
    force: Array | None
    turning_points: NDArray[np.intp]
    direction: int
    hysteresis: float
    timed: bool = True

    def __repr__(self) -> str:
        force = "without force" if self.force is None else "with force"
        return (
            f"Trace({self.samples} samples over {np.ptp(self.time):.4g} s, {force}; displacement "
            f"{self.displacement.min():.4g} to {self.displacement.max():.4g} in)"
        )

    @classmethod
    def from_arrays(
        cls,
        time: ArrayLike | None,
        displacement: ArrayLike,
        actuation: ArrayLike | None = None,
        force: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        *,
        hysteresis: float | None = None,
    ) -> Trace:
        """Trace of arrays, which are checked.

        Parameters
        ----------
        time : (T,), s, or None
            None where it is not known: samples are then numbered, which is for models that are
            rate-independent.
        displacement : (T,), in
        actuation : scalar or (T,), ksi or kip, optional
        force : (T,), kip, optional
        velocity : (T,), in/s, optional
            By default central differences of the displacement.
        hysteresis : float, in, optional
            Smallest reversal that counts as a turning point; by default a thousandth of the
            peak-to-peak displacement or what its noise needs.

        Raises
        ------
        RecordError
            When shapes do not fit, a value is not finite, or time does not increase.
        """
        timed = time is not None
        t = _column("time", np.arange(np.size(displacement)) if time is None else time)
        x = _column("displacement", displacement, t.size)
        if t.size < 3:
            raise RecordError(f"a trace needs at least 3 samples, got {t.size}")
        if not np.all(np.diff(t) > 0):
            index = int(np.argmax(~(np.diff(t) > 0))) + 1
            raise RecordError(
                f"time must increase; it does not at sample {index} (t = {t[index]:g} s)"
            )
        if velocity is not None:
            v = _column("velocity", velocity, t.size)
        else:
            with np.errstate(over="ignore", invalid="ignore"):  # what is infinite is refused
                v = np.gradient(x, t)
            check_magnitude("velocity", v, LARGEST**2)
            v.flags.writeable = False
        if hysteresis is None:
            span = smallest_turn(x)
        else:
            span = real_number("hysteresis, in inches,", hysteresis, RecordError, (0.0, LARGEST))
        turns = turning_points(x, span)
        turns.flags.writeable = False
        return cls(
            time=t,
            displacement=x,
            velocity=v,
            actuation=_actuation(actuation, t.size),
            force=None if force is None else _column("force", force, t.size),
            turning_points=turns,
            direction=first_direction(x, turns),
            hysteresis=span,
            timed=timed,
        )

    @property
    def samples(self) -> int:
        """Number of samples T."""
        return self.time.size

    @cached_property
    def path(self) -> MotionPath:
        """The motion with the vertices of its turns; forces are computed on it."""
        return motion_path(self.time, self.displacement, self.velocity, self.hysteresis)

    @cached_property
    def cycle_turns(self) -> NDArray[np.intp]:
        """Turning points between which cycles are counted, (K,): `cycle_turns`."""
        turns = cycle_turns(self.displacement)
        turns.flags.writeable = False
        return turns

    @property
    def varying(self) -> bool:
        """Whether the actuation changes with time."""
        return isinstance(self.actuation, np.ndarray)

    @property
    def reference_actuation(self) -> float:
        """The constant actuation, or the mean of a varying one: the level that theta belongs to."""
        return float(np.mean(self.actuation))


def check_trace(value: Any, error: type[MfdError]) -> Trace:
    """A trace, unchanged."""
    if not isinstance(value, Trace):
        kind = type(value).__name__
        raise error(f"trace must be a Trace, such as Trace.from_arrays(...) makes, got {kind}")
    return value


def _column(name: str, values: ArrayLike, size: int | None = None) -> Array:
    column = np.array(real_numbers(name, values))
    if column.ndim != 1:
        raise RecordError(f"{name} must be one-dimensional (T,), got shape {column.shape}")
    if size is not None and column.size != size:
        raise RecordError(f"{name} must have {size} samples as time has, got {column.size}")
    if not np.all(np.isfinite(column)):
        index = int(np.argmax(~np.isfinite(column)))
        fill = "; fill it with 0 where it is not known, as after a given part"
        hint = fill if name == "force" else ""
        raise RecordError(f"{name} must be finite; sample {index} is {column[index]}{hint}")
    check_magnitude(name, column)
    column.flags.writeable = False
    return column


def check_magnitude(name: str, values: Array, limit: float = LARGEST) -> None:
    """Refuse numbers so large that their fourth power could overflow."""
    large = np.flatnonzero(~(np.abs(values) <= limit))
    if large.size:
        raise RecordError(
            f"{name} holds numbers too large to use, beyond {limit:g} in s, in, kip or ksi: the "
            f"first at sample {large[0]}; where the logger overflowed, take such rows out"
        )


def check_size(name: str, role: str, values: Array) -> None:
    """Refuse numbers that are too large, and a force that is too small but not zero."""
    check_magnitude(name, values)
    largest = float(np.max(np.abs(values), initial=0.0))
    if role == "force" and 0.0 < largest < SMALLEST:
        raise RecordError(
            f"{name} holds numbers too small to use: the largest is {largest:.3g} kip, and at "
            f"least {SMALLEST:g} kip is expected; check its unit"
        )


def _actuation(values: ArrayLike | None, size: int) -> float | Array:
    if values is None:
        return float("nan")
    levels = real_numbers("actuation", values)
    history = _column("actuation", np.atleast_1d(levels), size if levels.ndim else None)
    if np.any(history < 0):
        index = int(np.argmax(history < 0))
        raise RecordError(f"actuation must not be negative; sample {index} is {history[index]:g}")
    return history if levels.ndim else float(history[0])


Samples = NDArray[np.intp]

SPIKE = 0.10  # an isolated sample that stands out by this share of the signal's range is a spike


OVERFLOW, LONGEST, MARKED = 10.0, 5, 0.05
"""Further from the median than so many times the range of the middle half, a value that does not
change, or that lasts for at most so many samples, is no measurement; nor is one that less than the
last share of the samples have, so far from all others."""


def run_lengths(flags: NDArray[np.bool_]) -> tuple[Samples, Samples]:
    """Sample before each run of flags, and the length of the run."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return (edges[::2] - 1).astype(np.intp), (edges[1::2] - edges[::2]).astype(np.intp)


def without_spikes(trace: Trace) -> Trace:
    """The trace with its spikes replaced by lines between their neighbours."""
    x, force = spikes_of(trace.displacement), trace.force
    samples = force_spikes(trace)
    if x.size:
        neighbours = np.unique(np.clip(x[:, None] + np.arange(-1, 2), 0, trace.samples - 1))
        motion = (
            interpolated(trace.displacement, x),
            None,
            force,
            interpolated(trace.velocity, neighbours),
        )
        trace = replace(
            Trace.from_arrays(trace.time, *motion), actuation=trace.actuation, timed=trace.timed
        )
    return replace(trace, force=interpolated(np.asarray(force), samples)) if samples.size else trace


def despiked(values: Array) -> Array:
    """A signal with lines in place of its spikes."""
    samples = spikes_of(values)
    return interpolated(values, samples) if samples.size else values


def interpolated(values: Array, samples: Samples) -> Array:
    """A signal with lines in place of some samples."""
    sound = np.delete(np.arange(values.size), samples)
    return np.asarray(np.interp(np.arange(values.size), sound, values[sound]))


def spikes_of(values: Array) -> Samples:
    """Spikes of one or a few samples, and overflow values."""
    spikes = [*(_isolated(values, n) for n in (1, 2, 3)), _over(values)]
    return np.asarray(np.unique(np.concatenate(spikes)), dtype=np.intp)


def force_spikes(trace: Trace) -> Samples:
    """Spikes of the force, if any; where the motion turns, a force within its range is none."""
    if trace.force is None:
        return np.empty(0, dtype=np.intp)
    samples, steps = spikes_of(trace.force), np.diff(trace.displacement)
    turns = np.concatenate([[False], steps[1:] * steps[:-1] < 0.0, [False]])
    low, high = np.quantile(np.delete(trace.force, samples), [0.005, 0.995])
    explained = turns & (trace.force >= low) & (trace.force <= high)
    return np.asarray(samples[~explained[samples]], dtype=np.intp)


def _isolated(values: Array, width: int) -> Samples:
    """Samples that differ from both neighbours, while the neighbours agree."""
    windows = np.lib.stride_tricks.sliding_window_view(values[1:-1], width)
    if not windows.size:
        return np.empty(0, dtype=np.intp)
    ends = np.stack([values[: -width - 1], values[width + 1 :]])
    distance = windows - ends[:, :, None]
    height = np.maximum(distance.min(axis=(0, 2)), -distance.max(axis=(0, 2)))
    height = np.maximum(height, 0.0)
    agree = np.abs(ends[1] - ends[0]) < 0.25 * height
    tail = min(max(0.005, LONGEST / values.size), 0.25)  # in which spikes of a short record lie
    reach = float(np.subtract(*np.quantile(values, [1.0 - tail, tail])))
    typical = float(np.quantile(height, 0.99))
    share = SPIKE if width == 1 else 1.0  # a peak of the signal itself is wider
    starts = np.flatnonzero(agree & (height > share * reach) & (height > 4 * typical)) + 1
    return np.unique(starts[:, None] + np.arange(width)).astype(np.intp)


def _over(values: Array) -> Samples:
    """Values of an overflow or a missing reading: far from all others, and reached in one step."""
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    distance = np.abs(values - middle)
    spikes = [np.empty(0, dtype=np.intp)]
    if high > low:
        for start, length in zip(*run_lengths(distance > OVERFLOW * (high - low)), strict=True):
            samples = np.arange(start + 1, start + 1 + length)
            ends = [n for n in (start, start + 1 + length) if 0 <= n < values.size]
            sudden = all(distance[n] < 0.5 * distance[samples].min() for n in ends)
            if sudden and (length <= LONGEST or np.ptp(values[samples]) == 0.0):
                spikes.append(samples)
    for side in (values, -values):  # as far from all others as these from each other: 9999
        top = side == side.max()
        reach = np.ptp(side[~top]) if not top.all() else 0.0
        if 0.0 < reach < side.max() - side[~top].max() and top.mean() < MARKED:
            spikes.append(np.flatnonzero(top))
    return np.concatenate(spikes)


CYCLE_SAMPLES = 400
"""Samples of a cycle."""

MOST_CYCLES = 100


@dataclass(frozen=True)
class Harmonic:
    """Full cycles from turn to turn, with half a cycle from rest to the first turn and back.

    A sine that begins at full speed would be a jump out of rest, and its viscous force a peak
    that no machine makes.

    Attributes
    ----------
    amplitude : float, in
        Half the stroke.
    frequency : float, Hz
    cycles : float
        Of full stroke.
    """

    amplitude: float
    frequency: float
    cycles: float
    timed: bool = True

    def trace(self, actuation: ArrayLike) -> Trace:
        """The sampled motion at an actuation, ksi or kip; back at rest after whole half cycles."""
        step = 2.0 * np.pi / CYCLE_SAMPLES
        angle, half = step * np.arange(round(CYCLE_SAMPLES * self.cycles) + 1), CYCLE_SAMPLES // 2
        ramp_up = step * np.arange(half)
        x = np.concatenate([0.5 * (1.0 - np.cos(ramp_up)), np.cos(angle)])
        v = np.concatenate([0.5 * np.sin(ramp_up), -np.sin(angle)])
        if (2.0 * self.cycles).is_integer():  # it ends at a turn
            ramp_down = step * np.arange(1, half + 1)
            level = 0.5 * round(np.cos(angle[-1]))
            x = np.concatenate([x, level * (1.0 + np.cos(ramp_down))])
            v = np.concatenate([v, -level * np.sin(ramp_down)])
        if not self.timed:
            return Trace.from_arrays(None, self.amplitude * x, actuation)
        return Trace.from_arrays(
            np.arange(x.size) / (CYCLE_SAMPLES * self.frequency),
            self.amplitude * x,
            actuation,
            velocity=2.0 * np.pi * self.frequency * self.amplitude * v,
        )


def parse_sine(text: str, axes: Axes = DAMPER) -> Harmonic:
    """Harmonic motion of ``"1 in, 0.5 Hz, 3 cycles"``: amplitude, frequency, number of cycles.

    Without a frequency where time does not matter; the amplitude is one of the model's motion,
    ``"2 %, 3 cycles"``.

    Raises
    ------
    UnitError
        When it has not these three parts, or one is not above zero or too large.
    """
    terms, form = [term.strip() for term in text.split(",")], _form(axes)
    if len(terms) != (3 if axes.timed else 2):
        raise UnitError(f"{form}, got {text!r}")
    if axes.motion == DAMPER.motion:
        amplitude = parse_quantity(terms[0], "displacement", of="the amplitude")
    else:
        value, unit = split_quantity(terms[0], of="the amplitude", example=f"1 {axes.motion.unit}")
        amplitude = value * axes.factor(unit, "displacement", of="the amplitude")
    frequency = parse_quantity(terms[1], "rate", of="the frequency") if axes.timed else 1.0
    number, _, word = terms[-1].partition(" ")
    try:
        cycles = float(number)
    except ValueError:
        cycles = math.nan
    if word.strip() not in ("cycle", "cycles") or not math.isfinite(cycles):
        raise UnitError(f"{form}, got {text!r}")
    if not 1.0 <= cycles <= MOST_CYCLES:
        raise UnitError(f"a harmonic motion has 1 to {MOST_CYCLES} cycles, got {text!r}")
    if not (amplitude > 0.0 and frequency > 0.0):
        raise UnitError(f"amplitude and frequency must be above zero, got {text!r}")
    return Harmonic(amplitude, frequency, cycles, axes.timed)


def _form(axes: Axes) -> str:
    unit = axes.motion.unit
    amplitude = f"1 {unit}" if unit != "1" else "2 %"
    if axes == DAMPER:
        return "a harmonic motion reads '1 in, 0.5 Hz, 3 cycles'"
    terms = (amplitude, "0.5 Hz", "3 cycles") if axes.timed else (amplitude, "3 cycles")
    return f"a harmonic motion of {axes.motion.name} reads '{', '.join(terms)}'"
