"""What the friction models are driven by: a motion, an actuation and, when known, a force."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.errors import RecordError

Array = NDArray[np.float64]

HYSTERESIS = 1e-3
"""Reversals smaller than this share of the peak-to-peak displacement are sensor noise."""


@dataclass(frozen=True, eq=False)
class Path:
    """A trace's motion with the vertex of every turn as a sample of its own.

    The true extreme lies between two samples. Left out, the way since the turn would be
    short by up to a (ω Δt)²/8, which a stiff unloading shows.

    Attributes
    ----------
    time, displacement, velocity : (P,), s, in, in/s
    turning_points : (K,), int
        Samples of the path at which the motion turns.
    direction : int
        +1 or -1, the direction of the first stretch of motion.
    nearest : (P,), int
        The trace's sample at, or beside, each of the path's.
    samples : (T,), int
        The path's samples that are the trace's.
    """

    time: Array
    displacement: Array
    velocity: Array
    turning_points: NDArray[np.intp]
    direction: int
    nearest: NDArray[np.intp]
    samples: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Trace:
    """A motion sampled in time, in internal units.

    Made by `Trace.from_arrays`, which checks it.

    Attributes
    ----------
    time : (T,), s
        Strictly increasing.
    displacement : (T,), in
    velocity : (T,), in/s
    actuation : float or (T,), ksi (pressure) or kip (tension)
        NaN when it was not given.
    force : (T,), kip, or None
    turning_points : (K,), int
        Samples, in order and without the ends, at which the motion turns.
    direction : int
        +1 or -1, the direction of the first stretch of motion.
    """

    time: Array
    displacement: Array
    velocity: Array
    actuation: float | Array
    force: Array | None
    turning_points: NDArray[np.intp]
    direction: int

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
        """Trace of arrays that are checked first.

        Parameters
        ----------
        time : (T,), s
        displacement : (T,), in
        actuation : scalar or (T,), ksi or kip, optional
        force : (T,), kip, optional
        velocity : (T,), in/s, optional
            Central differences of the displacement when left out.
        hysteresis : float, in, optional
            Smallest reversal that counts as a turning point; by default
            `HYSTERESIS` times the peak-to-peak displacement.

        Raises
        ------
        RecordError
            When shapes do not fit, a value is not finite, or time does not increase.
        """
        t = _column("time", time)
        x = _column("displacement", displacement, t.size)
        if t.size < 3:
            raise RecordError(f"a trace needs at least 3 samples, got {t.size}")
        steps = np.diff(t)
        if not np.all(steps > 0):
            at = int(np.argmax(~(steps > 0))) + 1
            raise RecordError(f"time must increase; it does not at sample {at} (t = {t[at]:g} s)")
        v = np.gradient(x, t) if velocity is None else _column("velocity", velocity, t.size)
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
        )

    @property
    def samples(self) -> int:
        """Number of samples T."""
        return self.time.size

    @cached_property
    def path(self) -> Path:
        """The motion with the vertices of its turns, on which forces are computed."""
        return _path(self)

    @property
    def varying(self) -> bool:
        """Whether the actuation is a history."""
        return isinstance(self.actuation, np.ndarray)

    @property
    def reference_actuation(self) -> float:
        """The constant actuation, or a history's mean: the level that theta belongs to."""
        return float(np.mean(self.actuation))


def _path(trace: Trace) -> Path:
    """Path of a trace: beside the sample of every smooth turn, its vertex.

    Between the samples where the velocity changes sign the acceleration is taken constant,
    so that the velocity is linear in time.
    """
    t, x, v, turns = trace.time, trace.displacement, trace.velocity, trace.turning_points
    after = v[turns] * (x[turns] - x[turns - 1]) > 0  # the sample is still on its old way
    left = np.where(after, turns, turns - 1)
    before, behind = np.abs(v[left]), np.abs(v[left + 1])
    share = before / np.maximum(before + behind, 1e-300)
    step = t[left + 1] - t[left]
    beyond = 0.5 * v[turns] * step * np.where(after, share, share - 1.0)
    inside = (v[left] * v[left + 1] < 0) & (np.abs(share - 0.5) < 0.499)
    inside &= _smooth(x, turns) & (np.abs(beyond) < 0.5 * np.abs(x[left + 1] - x[left - 1]))
    kept = np.flatnonzero(inside)
    at = left[kept] + 1
    samples = np.arange(t.size) + np.searchsorted(at, np.arange(t.size), side="right")
    turning = samples[turns]
    turning[kept] = at + np.arange(at.size)
    return Path(
        time=np.insert(t, at, (t[left] + share * step)[kept]),
        displacement=np.insert(x, at, (x[turns] + beyond)[kept]),
        velocity=np.insert(v, at, 0.0),
        turning_points=turning,
        direction=trace.direction,
        nearest=np.insert(np.arange(t.size), at, turns[kept]),
        samples=samples,
    )


def _smooth(displacement: Array, turns: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Whether the motion bends beside each turn about as it does at it: no corner, no noise."""
    bend = np.zeros(displacement.size)
    bend[1:-1] = np.diff(displacement, 2)
    beside = np.minimum(bend[turns - 1] / bend[turns], bend[turns + 1] / bend[turns])
    smooth: NDArray[np.bool_] = beside > 0.5
    return smooth


def turning_points(displacement: Array, hysteresis: float) -> NDArray[np.intp]:
    """Where the motion turns by more than `hysteresis`, ends left out.

    Parameters
    ----------
    displacement : (T,), in
    hysteresis : float, in
        A turn counts when the motion retreats from its extreme by more than this.

    Returns
    -------
    (K,) int
        Samples: alternating maxima and minima. Of equal extremes the last counts.
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
    return np.array(turns, dtype=np.intp)


def _corners(displacement: Array) -> NDArray[np.intp]:
    """Where the sign of the motion changes, with both ends."""
    moving = np.flatnonzero(np.diff(displacement))
    signs = np.sign(np.diff(displacement)[moving])
    changes = moving[1:][signs[1:] != signs[:-1]]
    return np.concatenate([[0], changes, [displacement.size - 1]]).astype(np.intp)


def _first_direction(displacement: Array, turns: NDArray[np.intp]) -> int:
    end = displacement[turns[0]] if turns.size else displacement[-1]
    return 1 if end >= displacement[0] else -1


def _column(name: str, values: ArrayLike, size: int | None = None) -> Array:
    column = np.array(values, dtype=np.float64)
    if column.ndim != 1:
        raise RecordError(f"{name} must be one-dimensional (T,), got shape {column.shape}")
    if size is not None and column.size != size:
        raise RecordError(f"{name} must have {size} samples as time has, got {column.size}")
    if not np.all(np.isfinite(column)):
        at = int(np.argmax(~np.isfinite(column)))
        raise RecordError(f"{name} must be finite; sample {at} is {column[at]}")
    column.flags.writeable = False
    return column


def _actuation(values: ArrayLike | None, size: int) -> float | Array:
    if values is None:
        return float("nan")
    if np.ndim(values) == 0:
        level = float(np.asarray(values, dtype=np.float64))
        if not np.isfinite(level) or level < 0:
            raise RecordError(f"actuation must be finite and not negative, got {level}")
        return level
    history = _column("actuation", values, size)
    if np.any(history < 0):
        at = int(np.argmax(history < 0))
        raise RecordError(f"actuation must not be negative; sample {at} is {history[at]:g}")
    return history
