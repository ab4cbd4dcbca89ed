"""Turns of many motions between two samples, each motion with its own."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.motion import SMOOTH

Array = NDArray[np.float64]


class Turns(NamedTuple):
    """Motions that turn within a step: their numbers, share of the step, and vertex, in."""

    rows: NDArray[np.intp]
    share: Array
    vertex: Array


def turns_within(x: Array, v: Array, x_next: Array, v_next: Array, dt: float) -> Turns:
    """Turns of motions between two samples, (n,) each, in and in/s.

    As `records.motion.vertices`: where the velocity changes its sign it is taken as linear in time;
    steps that do not fit such a motion have no vertex.
    """
    (rows,) = (v * v_next < 0).nonzero()
    if not rows.size:
        return Turns(rows, np.empty(0), np.empty(0))
    x, v, x_next, v_next = x[rows], v[rows], x_next[rows], v_next[rows]
    before, after = np.abs(v), np.abs(v_next)
    share = before / (before + after)
    moved, sign = x_next - x, np.sign(v)
    from_left = sign * moved <= 0
    beyond = 0.5 * dt * np.where(from_left, before * share, after * (1.0 - share))
    vertex = np.where(from_left, x, x_next) + sign * beyond
    misfit = np.abs(moved - 0.5 * dt * (v + v_next))
    regular = misfit <= SMOOTH * dt * (before + after)
    regular &= np.abs(share - 0.5) < 0.499
    return Turns(rows[regular], share[regular], vertex[regular])
