"""The input of a friction model, motion and actuation, and the measured force where known."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import MfdError, RecordError
from mfd_bayes.records.motion import (
    Array,
    MotionPath,
    cycle_turns,
    first_direction,
    motion_path,
    smallest_turn,
    turning_points,
)
from mfd_bayes.records.numbers import real_number, real_numbers

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
            at = int(np.argmax(~(np.diff(t) > 0))) + 1
            raise RecordError(f"time must increase; it does not at sample {at} (t = {t[at]:g} s)")
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
        """Turning points between which cycles are counted, (K,): `motion.cycle_turns`."""
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


def check_trace(name: str, value: Any, error: type[MfdError]) -> Trace:
    """A trace, unchanged."""
    if not isinstance(value, Trace):
        kind = type(value).__name__
        raise error(f"{name} must be a Trace, such as Trace.from_arrays(...) makes, got {kind}")
    return value


def _column(name: str, values: ArrayLike, size: int | None = None) -> Array:
    column = np.array(real_numbers(name, values))
    if column.ndim != 1:
        raise RecordError(f"{name} must be one-dimensional (T,), got shape {column.shape}")
    if size is not None and column.size != size:
        raise RecordError(f"{name} must have {size} samples as time has, got {column.size}")
    if not np.all(np.isfinite(column)):
        at = int(np.argmax(~np.isfinite(column)))
        fill = "; fill it with 0 where it is not known, as after a given part"
        hint = fill if name == "force" else ""
        raise RecordError(f"{name} must be finite; sample {at} is {column[at]}{hint}")
    check_magnitude(name, column)
    column.flags.writeable = False
    return column


def check_magnitude(name: str, values: Array, most: float = LARGEST) -> None:
    """Refuse numbers so large that their fourth power could overflow."""
    if not np.all(np.abs(values) <= most):
        raise RecordError(
            f"{name} holds numbers too large to use, beyond {most:g} in s, in, kip or ksi"
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
    values = real_numbers("actuation", values)
    if values.ndim == 0:
        level = float(values)
        if not np.isfinite(level) or level < 0:
            raise RecordError(f"actuation must be finite and not negative, got {level}")
        check_magnitude("actuation", np.array([level]))
        return level
    history = _column("actuation", values, size)
    if np.any(history < 0):
        at = int(np.argmax(history < 0))
        raise RecordError(f"actuation must not be negative; sample {at} is {history[at]:g}")
    return history
