"""A motion cut into steps that are short where slip sets in, and long in slip."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

FAR = 2.0
"""In slip a step may be longer than near a turn by this factor."""

MOST_FAR = 8
"""Most steps into which a sample's way is cut in slip: in slip more of them change nothing."""

MOST = 128
"""A sample's way that would be cut into more steps is not cut: slip then sets in at once, within a
small part of it.
"""


@dataclass(frozen=True)
class Plan:
    """How short the steps must be.

    Attributes
    ----------
    step : float, in
        Longest step within `window` of a turn.
    window : float, in
        Way after a turn beyond which the device surely slips.
    """

    step: float
    window: float


@dataclass(frozen=True, eq=False)
class Place:
    """Where in its motion a device stands: its direction, 0 before it moved, and way since."""

    sign: float = 0.0
    travelled: float = 0.0


@dataclass(frozen=True, eq=False)
class Course:
    """Steps of a motion.

    Attributes
    ----------
    way : (R, 1) or (R, n), in
        Length of each step, 0 or more.
    sign : (R,)
        +1 or −1, its direction.
    origin : (R,), int
        The step of the uncut motion that it is part of.
    share : (R, 1) or (R, n)
        Where in that its middle lies, from 0 to 1.
    ends : (M,), int
        Number of steps up to the end of each step of the uncut motion.
    place : Place
        At the end.
    """

    way: Array
    sign: Array
    origin: Index
    share: Array
    ends: Index
    place: Place


def cut(moves: Array, plan: Plan, place: Place) -> Course:
    """Course of a motion's steps, (M,), in, signed, from a place in it."""
    length = np.abs(moves)
    sign = _directions(moves, place.sign)
    since = _travelled(length, sign, place)
    near = np.clip(plan.window - since, 0.0, length)
    far = length - near
    wanted, later = near / plan.step, far / (FAR * plan.step)
    close = np.ceil(np.where(wanted > MOST, 1.0, wanted)).astype(np.intp)
    loose = np.ceil(np.where(later > MOST, 1.0, np.minimum(later, MOST_FAR))).astype(np.intp)
    close[(close == 0) & (loose == 0)] = 1
    count = close + loose
    ends = np.cumsum(count)
    origin = np.repeat(np.arange(moves.size), count)
    turn = np.arange(origin.size) - (ends - count)[origin]
    a, b = near / np.maximum(close, 1), far / np.maximum(loose, 1)
    inside = turn < close[origin]
    way = np.where(inside, a[origin], b[origin])
    middle = (turn + 0.5) * way + np.where(inside, 0.0, (near - close * b)[origin])
    share = middle / np.maximum(length, 1e-300)[origin]
    last = Place(float(sign[-1]), float(since[-1] + length[-1])) if moves.size else place
    return Course(way[:, None], sign[origin], origin, share[:, None], ends, last)


def _directions(moves: Array, before: float) -> Array:
    """Direction of each step; one of length zero has that of the step before it."""
    sign = np.append(before, np.sign(moves))
    last = np.where(sign != 0, np.arange(sign.size), 0)
    sign = sign[np.maximum.accumulate(last)][1:]
    return np.where(sign == 0, 1.0, sign)


def _travelled(length: Array, sign: Array, place: Place) -> Array:
    """Way since the last turn at the start of each step, in."""
    total = np.append(0.0, np.cumsum(length))
    starts = np.append(0, 1 + np.flatnonzero(sign[1:] != sign[:-1]))
    begun = total[starts]
    if sign.size and sign[0] == place.sign:
        begun[0] -= place.travelled
    stretch = np.zeros(sign.size, dtype=np.intp)
    stretch[starts[1:]] = 1
    return np.asarray(total[:-1] - begun[np.cumsum(stretch)])


def side_by_side(courses: list[Course], which: Index) -> Course:
    """Course of vectors that follow several courses of one motion, (n,): each has its own lengths.

    Where a vector has fewer steps than another, it has some of length zero.
    """
    if len(courses) == 1:
        return courses[0]
    counts = np.diff(np.stack([course.ends for course in courses]), axis=1, prepend=0)
    most = counts.max(axis=0)
    ends = np.cumsum(most)
    way, share = np.zeros((2, ends[-1], len(courses)))
    for i, course in enumerate(courses):
        late = (ends - most) - (course.ends - counts[i])
        at = np.arange(course.sign.size) + late[course.origin]
        way[at, i], share[at, i] = course.way[:, 0], course.share[:, 0]
    origin = np.repeat(np.arange(most.size), most)
    first = courses[0]
    sign = first.sign[first.ends - 1]
    return Course(way[:, which], sign[origin], origin, share[:, which], ends, first.place)


def cut_few(moves: list[float], plans: list[Plan], which: Index, place: Place) -> Course:
    """As `cut` for a few steps of vectors with several plans, (n,): each has its own lengths.

    A vector with fewer steps than another has some of length zero.
    """
    ways: list[list[list[float]]] = []
    middles: list[list[list[float]]] = []
    signs, origin, ends = [], [], []
    for i, move in enumerate(moves):
        sign = float((move > 0) - (move < 0)) or place.sign or 1.0
        since = place.travelled if sign == place.sign else 0.0
        lengths = [_lengths(abs(move), since, plan) for plan in plans]
        count = max(map(len, lengths))
        ways.append([way + [0.0] * (count - len(way)) for way in lengths])
        middles.append([_middles(way, abs(move), count) for way in lengths])
        signs += [sign] * count
        origin += [i] * count
        ends.append(len(signs))
        place = Place(sign, since + abs(move))
    way, middle = (np.hstack(rows).T[:, which] for rows in (ways, middles))
    return Course(way, np.array(signs), np.array(origin), middle, np.array(ends), place)


def _lengths(length: float, since: float, plan: Plan) -> list[float]:
    near = min(max(plan.window - since, 0.0), length)
    far = length - near
    wanted, later = near / plan.step, far / (FAR * plan.step)
    close = math.ceil(1.0 if wanted > MOST else wanted)
    loose = math.ceil(1.0 if later > MOST else min(later, MOST_FAR))
    if close + loose == 0:
        return [near]
    return [near / max(close, 1)] * close + [far / max(loose, 1)] * loose


def _middles(ways: list[float], length: float, count: int) -> list[float]:
    ends = list(accumulate(ways))
    found = [(end - 0.5 * way) / max(length, 1e-300) for end, way in zip(ends, ways, strict=True)]
    return found + [1.0] * (count - len(found))
