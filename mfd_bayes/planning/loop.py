"""One full loop of a test that could be made, sampled where a damper's force changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.planning.candidate import Candidate
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

IN_GAP, IN_SLIP = 14, 8
"""Samples of a stroke after a turn, up to `REACH` times the gap, and in the rest of the stroke."""

REACH = 2.5

_LEAD = 4  # every so many samples of a stroke are enough before the loop


@dataclass(frozen=True, eq=False)
class Loop:
    """A full stroke forward, and then a full loop of backward and forward stroke.

    Attributes
    ----------
    trace : Trace
        With the actuation.
    first : int
        Sample at which the loop begins, at the forward end.
    travel : (S + 1,), in
        Travel since the turn at the samples of one stroke of the loop.
    steps : (T,), s
        Time that each sample stands for.
    """

    trace: Trace
    first: int
    travel: Array
    steps: Array

    @property
    def stroke(self) -> float:
        """From one end to the other, in."""
        return float(self.travel[-1])

    def halves(self, force: Array) -> tuple[Array, Array]:
        """Force along the backward and along the forward stroke of the loop, (n, S + 1) each.

        The backward one is given as a positive number where the force resists the motion.
        """
        strokes = self.travel.size - 1
        middle = self.first + strokes
        return -force[:, self.first : middle + 1], force[:, middle : middle + strokes + 1]

    def energy(self, force: Array) -> Array:
        """Energy dissipated in the loop, (n,), kip·in."""
        x = self.trace.displacement[self.first :]
        return np.asarray(np.trapezoid(force[:, self.first :], x, axis=1))


def loop_of(candidate: Candidate, gap: float) -> Loop:
    """Loop of a test of a damper with a gap of about this width, in.

    The stroke before the loop makes the place at which the test began without effect.
    """
    travel = _travel(candidate, gap)
    lead = np.unique(np.append(travel[::_LEAD], travel[-1]))
    strokes = [(lead, -1.0), (travel, 1.0), (travel, -1.0)]
    time, place, speed, clock = [], [], [], 0.0
    for k, (along, begin) in enumerate(strokes):
        since, fast = _clock(candidate, along)
        skip = 1 if k else 0
        time.append(clock + since[skip:])
        place.append(begin * candidate.amplitude - begin * along[skip:])
        speed.append(-begin * fast[skip:])
        clock += since[-1]
    times = np.concatenate(time)
    trace = Trace.from_arrays(
        times, np.concatenate(place), candidate.actuation, velocity=np.concatenate(speed)
    )
    return Loop(trace, lead.size - 1, travel, np.gradient(times))


def _travel(candidate: Candidate, gap: float) -> Array:
    """Travel since a turn at the samples of a stroke: dense in the gap, in."""
    stroke = candidate.stroke
    dense = min(REACH * gap, 0.5 * stroke)
    build = np.linspace(0.0, dense, IN_GAP + 1)
    # closer towards the end, where a sine is slow
    rest = 0.5 * (1.0 - np.cos(np.pi * np.linspace(0.0, 1.0, 2 * IN_SLIP + 1)[IN_SLIP + 1 :]))
    rest = dense + (stroke - dense) * (rest - 0.5) / 0.5
    return np.concatenate([build, rest])


def _clock(candidate: Candidate, travel: Array) -> tuple[Array, Array]:
    """Time since the turn, s, and speed, in/s, at travels of a stroke."""
    if candidate.waveform == "triangle":
        return travel / candidate.speed, np.full(travel.size, candidate.speed)
    angle = np.arccos(np.clip(1.0 - travel / candidate.amplitude, -1.0, 1.0))
    turning = 2.0 * np.pi * candidate.frequency
    return angle / turning, candidate.speed * np.sin(angle)
