"""Turns of a motion, and the motion with the vertices of its turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

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
    left, share, vertex = vertices(t, x, v)
    turning = turning_points(np.insert(x, left + 1, vertex), hysteresis, last=True)
    kept = np.isin(left + 1 + np.arange(left.size), turning)
    left, share, vertex = left[kept], share[kept], vertex[kept]
    at = left + 1
    displacement = np.insert(x, at, vertex)
    samples = np.arange(t.size) + np.searchsorted(at, np.arange(t.size), side="right")
    turning = turning_points(displacement, hysteresis, last=True)
    time = np.insert(t, at, t[left] + share * (t[left + 1] - t[left]))
    step = np.diff(displacement, prepend=displacement[0])
    duration = np.diff(time, prepend=time[0] - 1.0)
    return MotionPath(
        time=time,
        displacement=displacement,
        velocity=np.insert(v, at, 0.0),
        step=step,
        rate=step / duration,
        turning_points=turning,
        direction=first_direction(displacement, turning),
        nearest=np.insert(np.arange(t.size), at, np.where(share < 0.5, left, at)),
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
    left = np.flatnonzero(v[:-1] * v[1:] < 0)
    ends = (t[left + 1] - t[left], x[left], x[left + 1], v[left], v[left + 1])
    share, vertex, regular = vertex_of_turn(*ends)
    return left[regular], share[regular], vertex[regular]


def vertex_of_turn(
    dt: float | Array, x: Array, x_next: Array, v: Array, v_next: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Share of the step, vertex, in, and whether there is one, of steps that turn, (n,) each.

    See `vertices`: dt in s, displacements in in and velocities in in/s at both samples of each.
    """
    before, after = np.abs(v), np.abs(v_next)
    share = before / (before + after)
    moved, sign = x_next - x, np.sign(v)
    from_left = sign * moved <= 0  # the extreme sample is the one before
    beyond = 0.5 * dt * np.where(from_left, before * share, after * (1.0 - share))
    vertex = np.where(from_left, x, x_next) + sign * beyond
    misfit = np.abs(moved - 0.5 * dt * (v + v_next))
    regular = misfit <= SMOOTH * dt * (before + after)
    regular &= np.abs(share - 0.5) < 0.499
    return share, vertex, regular


def turning_points(
    displacement: Array, hysteresis: float | Array, *, last: bool = False
) -> NDArray[np.intp]:
    """Samples, (K,), at which the motion turns by more than `hysteresis`, in, without the ends.

    Alternating maxima and minima, from which the motion goes back by more than the hysteresis
    there; of equal extremes the last. With `last`, the last turn counts however small it is.
    """
    steps = np.diff(displacement)
    moving = np.flatnonzero(steps)
    signs = np.sign(steps[moving])
    changes = moving[1:][signs[1:] != signs[:-1]]
    corners = np.concatenate([[0], changes, [displacement.size - 1]])
    values = displacement[corners]
    least = np.broadcast_to(hysteresis, displacement.shape)[corners]
    turns: list[int] = []
    low = high = 0
    direction = 0
    for i in range(1, len(values)):
        value = values[i]
        if value >= values[high]:
            high = i
        if value <= values[low]:
            low = i
        if direction >= 0 and values[high] - value > least[high]:
            if direction > 0:
                turns.append(int(corners[high]))
            direction, low, high = -1, i, i
        elif direction <= 0 and value - values[low] > least[low]:
            if direction < 0:
                turns.append(int(corners[low]))
            direction, low, high = 1, i, i
    extreme = high if direction > 0 else low
    if last and direction != 0 and values[extreme] != values[-1]:
        turns.append(int(corners[extreme]))
    return np.array(turns, dtype=np.intp)


def cycle_turns(displacement: Array) -> NDArray[np.intp]:
    """Turning points of the whole motion, (K,): cycles run from one to the second after it.

    A tremble at the end of a stroke turns the motion, but begins no cycle; a small cycle among
    small ones is a cycle. So a turn counts where the motion goes back by more than the share
    `CYCLE` of the stroke near it: the range of the motion within half a cycle on both sides.
    """
    whole = float(np.ptp(displacement))
    noise = min(2.0 * NOISY * sensor_noise(displacement), 0.5 * whole)
    for share in (CYCLE, 0.5 * CYCLE, SMALLEST_CYCLE):  # a slow drift may be most of the range
        turns = turning_points(displacement, max(share * whole, noise))
        if turns.size >= 4:
            break
    if turns.size < 2:
        return turns
    strokes = np.abs(np.diff(displacement[turns]))
    half = float(np.median(np.diff(turns)[strokes >= 0.5 * strokes.max()]))
    near = 2 * int(np.ceil(1.2 * half)) + 1  # samples
    stroke = ndimage.maximum_filter1d(displacement, near)
    stroke -= ndimage.minimum_filter1d(displacement, near)
    smallest = max(SMALLEST_CYCLE * whole, noise)
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
    before, after = differences[:-1], differences[1:]
    if not before @ after < -0.5 * float(differences @ differences):
        return 0.0
    return float(np.median(np.abs(differences)) / 0.6745 / np.sqrt(70.0))


def first_direction(displacement: Array, turns: NDArray[np.intp]) -> int:
    """+1 or -1, the direction of the first stretch of motion."""
    end = displacement[turns[0]] if turns.size else displacement[-1]
    return 1 if end >= displacement[0] else -1
