"""Stages 2 and 3: the gap, a play operator that remembers on which side it last slipped."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from mfd_bayes.friction.arrays import rows_of
from mfd_bayes.friction.recurrence import solve
from mfd_bayes.friction.transitions import SATURATED, Crossing, Gap, blend
from mfd_bayes.records.motion import MotionPath

Array = NDArray[np.float64]
Rows = NDArray[np.intp]


def follow(gap: Gap, path: MotionPath, start: Array, slip: Array) -> Crossing:
    """State of the gap in every stretch between turning points.

    At a turning point after slip (u ≥ D or u ≤ 0) the travel restarts at 0 in the new
    direction, and the force before minus the force after that restart is kept as `carry`.
    Inside the gap nothing is reset, so that the force retraces its path.

    Parameters
    ----------
    start : (n,), 1
        u/D at the first sample.
    slip : (K, n), kip
        F1 at the turning points.
    """
    first = begin(gap, float(path.displacement[0]), path.direction, start)
    return turn(gap, first, path.displacement[path.turning_points], path.direction, slip)


def travel(gap: Gap, path: MotionPath, start: Array) -> Array:
    """Travel u since the last slip at every sample, (T, n), in; see `follow`.

    Between 0 and D the gap is crossed; beyond D the device slips.
    """
    first = begin(gap, float(path.displacement[0]), path.direction, start)
    x = path.displacement[path.turning_points][:, None]
    directions = np.where(np.arange(len(x) + 1) % 2, -1.0, 1.0) * path.direction
    edge, slipped = _dragged(gap, first.edge, x, directions)
    side = _side(first, slipped, directions)[0]
    crossing = Crossing(side, edge, np.zeros(edge.shape))
    along = np.empty((path.samples.size, start.size))
    rows_of(side, path.stretch, out=along)
    along *= path.displacement[path.samples, None]
    along -= rows_of(side * crossing.origin(gap), path.stretch, out=np.empty(along.shape))
    return along


def place_at_end(gap: Gap, path: MotionPath, start: Array) -> Array:
    """Place in the gap at the last sample, (n,), 1: 0 at its backward end, 1 at its forward end.

    The play operator alone: motion beyond either end drags the gap along.
    """
    edge = begin(gap, float(path.displacement[0]), path.direction, start).edge[0]
    last = float(path.displacement[-1])
    for x in (*path.displacement[path.turning_points].tolist(), last):
        edge = np.minimum(np.maximum(edge, x - gap.width), x)
    width = gap.width
    place = np.divide(last - edge, width, out=np.full(edge.shape, 0.5), where=width > 0)
    return np.asarray(np.clip(place, 0.0, 1.0))


def _side(
    before: Crossing, slipped: NDArray[np.bool_], directions: Array
) -> tuple[Array, NDArray[np.intp]]:
    """Direction of the crossing in each stretch, (K + 1, n), and the stretch that set it."""
    latest = np.zeros((len(slipped) + 1, slipped.shape[1]), dtype=np.intp)
    np.multiply(slipped, np.arange(1, len(latest))[:, None], out=latest[1:])
    np.maximum.accumulate(latest, axis=0, out=latest)
    return np.where(latest > 0, directions[latest], before.side), latest


def begin(gap: Gap, displacement: float, direction: int, start: Array) -> Crossing:
    """State in the one stretch before the first turning point; see `follow`."""
    behind = start if direction > 0 else 1.0 - start
    shape = (1, start.size)
    return Crossing(
        np.full(shape, float(direction)),
        (displacement - behind * gap.width).reshape(shape),
        np.zeros(shape),
    )


def turn(gap: Gap, before: Crossing, at: Array, direction: int, slip: Array) -> Crossing:
    """State of a stretch and of the K stretches that follow it, each after a turning point.

    Parameters
    ----------
    before : Crossing
        State of one stretch.
    at : (K,), in
        Turning points.
    direction : int
        +1 or -1, direction of motion before the first of them.
    slip : (K, n), kip
        F1 at the turning points.
    """
    x = at[:, None]
    directions = np.where(np.arange(len(x) + 1) % 2, -1.0, 1.0) * direction
    edge, slipped = _dragged(gap, before.edge, x, directions)
    side, latest = _side(before, slipped, directions)
    carry = np.zeros(edge.shape)
    left, faded = _left_over(gap, Crossing(side, edge, carry), x, slipped, slip)
    carry[0], carry[1:] = before.carry[0], left
    if faded is not None:
        # after slip carry_k = faded carry_{k−1} + jump; inside the gap carry_k = carry_{k−1}
        carry[1:] = solve(np.where(slipped, faded, 1.0), left * slipped, before.carry[0])
    elif not slipped.all():
        carry = np.take_along_axis(carry, latest, axis=0)
    return Crossing(side, edge, carry)


def _dragged(
    gap: Gap, first: Array, x: Array, directions: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Edge of the gap in each stretch, (K + 1, n), and whether each turning point ends a slip.

    Motion beyond either end of the gap drags the gap along.
    """
    # first as if every stretch crossed the whole gap; short stretches are corrected below
    beyond = x - gap.width
    edge = np.concatenate([first, np.where(directions[:-1, None] > 0, beyond, x)])
    slipped = np.ones(x.shape[:1] + first.shape[1:], dtype=bool)
    short = np.abs(x[1:, 0] - x[:-1, 0]) <= gap.width.max()
    for k in [0, *(np.flatnonzero(short) + 1).tolist()][: len(x)]:
        np.maximum(edge[k], beyond[k], out=edge[k + 1])
        np.minimum(edge[k + 1], x[k], out=edge[k + 1])
        slipped[k] = (edge[k + 1] == x[k]) | (edge[k + 1] == beyond[k])
    return edge, slipped


def _left_over(
    gap: Gap, crossing: Crossing, x: Array, slipped: NDArray[np.bool_], slip: Array
) -> tuple[Array, Array | None]:
    """Blended force before minus after each turning point that follows slip, (K, n), kip.

    Also the share of the previous `carry` that is left there, (K, n), or None if none is.
    """
    # after the turn, at u = 0
    build_up = expit(gap.width / gap.transition) * expit(-gap.d2 / gap.transition)
    left = build_up * (slip - crossing.side[1:] * ((gap.k2 - gap.k3) * gap.d2))
    u = crossing.side[:-1] * (x - crossing.origin(gap)[:-1])
    early = slipped & (u < gap.width + SATURATED * gap.transition)
    if not early.any():
        return left, None
    partly = np.flatnonzero(early.any(axis=1))
    before = slip[partly]
    blend(gap, crossing, partly, x[partly, 0], before)
    left[partly] += before - slip[partly]
    return left, 1.0 - np.tanh(np.abs(u) * (0.5 / gap.transition))
