"""The input of a friction model, motion and actuation, and the measured force where known."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import RecordError

Array = NDArray[np.float64]

HYSTERESIS = 1e-3
"""Reversals smaller than this share of the peak-to-peak displacement are sensor noise."""

LARGEST = 1e10
"""Largest number of a trace, in internal units; times since 1970 in s are below it."""

SMOOTH = 0.1
"""Share of a step by which a smooth turn may differ from a turn of constant acceleration."""


@dataclass(frozen=True, eq=False)
class MotionPath:
    """The motion of a trace with a sample added at the vertex of every turn.

    The true extreme lies between two samples. Without it, the distance since the turn would be
    too short by up to a (ω Δt)²/8, which shows in a stiff unloading.

    Attributes
    ----------
    time, displacement, velocity : (P,), s, in, in/s
    step, rate : (P,), in, in/s
        Motion since the sample before, and its mean velocity; 0 at the first sample.
    turning_points : (K,), int
        Samples of the path at which the motion turns. The last turn counts however small it
        is, because the motion after it is not known.
    direction : int
        +1 or -1, the direction of the first stretch of motion.
    nearest : (P,), int
        For each sample of the path, the sample of the trace at or beside it.
    samples : (T,), int
        Samples of the path that are the trace's.
    stretch : (T,), int
        Number of turning points before each of `samples`.
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
    """

    time: Array
    displacement: Array
    velocity: Array
    actuation: float | Array
    force: Array | None
    turning_points: NDArray[np.intp]
    direction: int
    hysteresis: float

    @classmethod
    def from_arrays(
        cls,
        time: ArrayLike,
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
        time : (T,), s
        displacement : (T,), in
        actuation : scalar or (T,), ksi or kip, optional
        force : (T,), kip, optional
        velocity : (T,), in/s, optional
            By default central differences of the displacement.
        hysteresis : float, in, optional
            Smallest reversal that counts as a turning point; by default `HYSTERESIS` times the
            peak-to-peak displacement.

        Raises
        ------
        RecordError
            When shapes do not fit, a value is not finite, or time does not increase.
        """
        t = _column("time", time)
        x = _column("displacement", displacement, t.size)
        if t.size < 3:
            raise RecordError(f"a trace needs at least 3 samples, got {t.size}")
        _check_increasing(t)
        v = _differences(t, x) if velocity is None else _column("velocity", velocity, t.size)
        span = HYSTERESIS * float(np.ptp(x)) if hysteresis is None else hysteresis
        turns = turning_points(x, span)
        return cls(
            time=t,
            displacement=x,
            velocity=v,
            actuation=_actuation(actuation, t.size),
            force=None if force is None else _column("force", force, t.size),
            turning_points=turns,
            direction=_first_direction(x, turns),
            hysteresis=span,
        )

    @property
    def samples(self) -> int:
        """Number of samples T."""
        return self.time.size

    @cached_property
    def path(self) -> MotionPath:
        """The motion with the vertices of its turns; forces are computed on it."""
        return _path(self)

    @property
    def varying(self) -> bool:
        """Whether the actuation changes with time."""
        return isinstance(self.actuation, np.ndarray)

    @property
    def reference_actuation(self) -> float:
        """The constant actuation, or the mean of a varying one: the level that theta belongs to."""
        return float(np.mean(self.actuation))


def _path(trace: Trace) -> MotionPath:
    """Path of a trace: every vertex that is a turning point, between its two samples."""
    t = trace.time
    left, share, vertex = _turns_between_samples(trace)
    at = left + 1
    displacement = np.insert(trace.displacement, at, vertex)
    samples = np.arange(t.size) + np.searchsorted(at, np.arange(t.size), side="right")
    turning = turning_points(displacement, trace.hysteresis, last=True)
    time = np.insert(t, at, t[left] + share * (t[left + 1] - t[left]))
    step = np.diff(displacement, prepend=displacement[0])
    duration = np.diff(time, prepend=time[0] - 1.0)
    return MotionPath(
        time=time,
        displacement=displacement,
        velocity=np.insert(trace.velocity, at, 0.0),
        step=step,
        rate=step / duration,
        turning_points=turning,
        direction=_first_direction(displacement, turning),
        nearest=np.insert(np.arange(t.size), at, np.where(share < 0.5, left, at)),
        samples=samples,
        stretch=np.searchsorted(turning, samples),
    )


def _turns_between_samples(trace: Trace) -> tuple[NDArray[np.intp], Array, Array]:
    """The `vertices` of a trace that are turning points."""
    left, share, vertex = vertices(trace.time, trace.displacement, trace.velocity)
    at = left + 1 + np.arange(left.size)
    displacement = np.insert(trace.displacement, left + 1, vertex)
    kept = np.isin(at, turning_points(displacement, trace.hysteresis, last=True))
    return left[kept], share[kept], vertex[kept]


def vertices(t: Array, x: Array, v: Array) -> tuple[NDArray[np.intp], Array, Array]:
    """Vertices of turns between samples: sample before, share of the step, displacement in in.

    Where the velocity changes its sign, the acceleration is taken as constant over the step, so
    the velocity is linear in time. Steps that do not fit such a motion (corners, noise) have no
    vertex. Only the two samples of a step are used, so a model that steps in time finds the same
    vertices.
    """
    left = np.flatnonzero(v[:-1] * v[1:] < 0)
    before, behind, step = np.abs(v[left]), np.abs(v[left + 1]), t[left + 1] - t[left]
    share = before / (before + behind)
    way, sign = x[left + 1] - x[left], np.sign(v[left])
    from_left = sign * way <= 0  # the extreme sample is the one before
    beyond = 0.5 * step * np.where(from_left, before * share, behind * (1.0 - share))
    vertex = np.where(from_left, x[left], x[left + 1]) + sign * beyond
    regular = np.abs(way - 0.5 * step * (v[left] + v[left + 1])) <= SMOOTH * step * (
        before + behind
    )
    regular &= np.abs(share - 0.5) < 0.499
    return left[regular], share[regular], vertex[regular]


def turning_points(
    displacement: Array, hysteresis: float, *, last: bool = False
) -> NDArray[np.intp]:
    """Samples at which the motion turns by more than `hysteresis`, without the ends.

    Parameters
    ----------
    displacement : (T,), in
    hysteresis : float, in
        A turn counts when the motion goes back from its extreme by more than this.
    last : bool
        Whether the last turn counts however small it is.

    Returns
    -------
    (K,) int
        Alternating maxima and minima. Of equal extremes the last counts.
    """
    corners = _corners(displacement)
    values = displacement[corners]
    turns: list[int] = []
    low = high = 0
    direction = 0
    for i in range(1, len(values)):
        value = values[i]
        if value >= values[high]:
            high = i
        if value <= values[low]:
            low = i
        if direction >= 0 and values[high] - value > hysteresis:
            if direction > 0:
                turns.append(int(corners[high]))
            direction, low, high = -1, i, i
        elif direction <= 0 and value - values[low] > hysteresis:
            if direction < 0:
                turns.append(int(corners[low]))
            direction, low, high = 1, i, i
    extreme = high if direction > 0 else low
    if last and direction != 0 and values[extreme] != values[-1]:
        turns.append(int(corners[extreme]))
    return np.array(turns, dtype=np.intp)


def _corners(displacement: Array) -> NDArray[np.intp]:
    """Samples at which the sign of the motion changes, and both ends."""
    steps = np.diff(displacement)
    moving = np.flatnonzero(steps)
    signs = np.sign(steps[moving])
    changes = moving[1:][signs[1:] != signs[:-1]]
    return np.concatenate([[0], changes, [displacement.size - 1]]).astype(np.intp)


def _first_direction(displacement: Array, turns: NDArray[np.intp]) -> int:
    end = displacement[turns[0]] if turns.size else displacement[-1]
    return 1 if end >= displacement[0] else -1


def _check_increasing(time: Array) -> None:
    steps = np.diff(time)
    if not np.all(steps > 0):
        at = int(np.argmax(~(steps > 0))) + 1
        raise RecordError(f"time must increase; it does not at sample {at} (t = {time[at]:g} s)")


def _differences(time: Array, displacement: Array) -> Array:
    """Velocity by central differences."""
    with np.errstate(over="ignore", invalid="ignore"):  # check_magnitude refuses what is infinite
        velocity = np.gradient(displacement, time)
    check_magnitude("velocity", velocity, LARGEST**2)
    return velocity


def _column(name: str, values: ArrayLike, size: int | None = None) -> Array:
    column = np.array(values, dtype=np.float64)
    if column.ndim != 1:
        raise RecordError(f"{name} must be one-dimensional (T,), got shape {column.shape}")
    if size is not None and column.size != size:
        raise RecordError(f"{name} must have {size} samples as time has, got {column.size}")
    if not np.all(np.isfinite(column)):
        at = int(np.argmax(~np.isfinite(column)))
        raise RecordError(f"{name} must be finite; sample {at} is {column[at]}")
    check_magnitude(name, column)
    column.flags.writeable = False
    return column


def check_magnitude(name: str, values: Array, most: float = LARGEST) -> None:
    """Refuse numbers so large that their fourth power could overflow.

    Raises
    ------
    RecordError
        When the size of one is above `most`, or it is not finite.
    """
    if not np.all(np.abs(values) <= most):
        raise RecordError(
            f"{name} holds numbers too large to use, beyond {most:g} in s, in, kip or ksi"
        )


def _actuation(values: ArrayLike | None, size: int) -> float | Array:
    if values is None:
        return float("nan")
    if np.ndim(values) == 0:
        level = float(np.asarray(values, dtype=np.float64))
        if not np.isfinite(level) or level < 0:
            raise RecordError(f"actuation must be finite and not negative, got {level}")
        check_magnitude("actuation", np.array([level]))
        return level
    history = _column("actuation", values, size)
    if np.any(history < 0):
        at = int(np.argmax(history < 0))
        raise RecordError(f"actuation must not be negative; sample {at} is {history[at]:g}")
    return history
