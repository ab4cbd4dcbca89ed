"""The first part of a record that is given, thinned to the rate of the calibrated tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import FitError
from mfd_bayes.population.strokes import strokes_of
from mfd_bayes.records.clock import checked_window
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

LEAST = 3
"""Fewest samples of a given part, at the rate of the calibrated tests."""


@dataclass(frozen=True, eq=False)
class GivenPart:
    """The motion to the end of a given part or further, thinned, and the force where it counts.

    Attributes
    ----------
    trace : Trace
        With a force at every sample; only that inside the window is used.
    counted : (T,) bool
        The samples inside the window.
    strokes : (T,) int
        Number of the stroke in the whole record: thinned, a short one may be lost.
    window : (float, float), s
    """

    trace: Trace
    counted: NDArray[np.bool_]
    strokes: NDArray[np.intp]
    window: tuple[float, float]


def given_part(trace: Trace, window: tuple[float, float], step: float) -> GivenPart:
    """The given part of a record, as means over blocks of samples.

    Parameters
    ----------
    trace : Trace
        With its force; what it is outside the window does not matter.
    window : (float, float), s
        Both ends belong to it.
    step : float, s
        Time between samples at which the noise is known; see `Pace.step`.

    Raises
    ------
    FitError
        When the window is none, not within the record or too short, or has no force.
    """
    begin, end = _checked(trace, window, step)
    inside = (trace.time >= begin) & (trace.time <= end)
    size = block_size(float(np.median(np.diff(trace.time))), step)
    if not np.any(inside):
        raise _too_short((begin, end), 0, size)
    first, last = np.flatnonzero(inside)[[0, -1]]
    end_of_motion = max(int(last), _second_turn(trace))
    edges = np.arange(first % size, end_of_motion + 1, size)
    if edges[0] > 0:
        edges = np.insert(edges, 0, 0)
    edges = edges[edges + size <= end_of_motion + 1]
    counted = (edges >= first) & (edges + size <= last + 1)
    if np.count_nonzero(counted) < LEAST:
        raise _too_short((begin, end), int(np.count_nonzero(inside)), size)
    force = np.asarray(trace.force)[inside]
    if not np.any(force):
        raise FitError(
            f"the force is zero in the whole given part {_words(window)}: expected a measured force"
        )
    stop = int(edges[-1]) + size
    strokes = strokes_of(trace)[edges + size // 2]
    return GivenPart(block_means(trace, edges, stop), counted, strokes, (begin, end))


def _second_turn(trace: Trace) -> int:
    """Sample until which the motion must be known, so that its first direction is.

    The motion is known beyond the given part: only the force is not.
    """
    turns = trace.turning_points
    return int(turns[1]) if turns.size > 1 else trace.samples - 1


def _too_short(window: tuple[float, float], samples: int, size: int) -> FitError:
    return FitError(
        f"the given part {_words(window)} holds {samples} samples, too few: at least "
        f"{LEAST * size} are expected"
    )


def _words(window: tuple[float, float]) -> str:
    return f"from {window[0]:g} s to {window[1]:g} s"


def _checked(trace: Trace, window: tuple[float, float], step: float) -> tuple[float, float]:
    """Begin and end of a window that lies within a record with a force."""
    begin, end = checked_window(window, "given", FitError)
    if trace.force is None:
        raise FitError(
            f"the trace has no force: given {_words((begin, end))} needs the force measured there"
        )
    first, last = float(trace.time[0]), float(trace.time[-1])
    if begin < first - step or end > last + step:
        raise FitError(
            f"the given part {_words((begin, end))} must lie within the record, which goes "
            f"{_words((first, last))}"
        )
    return max(begin, first), min(end, last)


def block_size(own: float, step: float) -> int:
    """Samples `own` s apart that are averaged, so that means are at most about `step` s apart."""
    return max(1, int(step / own + 0.25))


def block_means(trace: Trace, edges: NDArray[np.intp], stop: int) -> Trace:
    """Means of a trace over the samples from each edge to the next, up to sample `stop`."""
    sizes = np.diff([*edges.tolist(), stop])

    def mean(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values[:stop], edges) / sizes)

    actuation = mean(np.asarray(trace.actuation)) if trace.varying else trace.actuation
    return Trace.from_arrays(
        mean(trace.time),
        mean(trace.displacement),
        None if np.any(np.isnan(actuation)) else actuation,
        mean(np.asarray(trace.force)),
        mean(trace.velocity),
        hysteresis=trace.hysteresis,
    )
