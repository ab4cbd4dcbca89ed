"""Which of two signals is the displacement of a loop and which its force, by their shape."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.motion import turning_points

Array = NDArray[np.float64]

TURN = 0.1
"""A motion turns when it goes back by this share of its range: noise on a plateau is less."""

SURE = 0.3
"""Correlation of a force with the direction of a motion from which two signals make a loop."""

_MOST = 8  # signals of which all pairs are compared


def by_loop(signals: Mapping[str, Array]) -> list[str]:
    """Names of signals, the displacement first, then the force, then the others in their order.

    A friction force follows the direction of the motion, and is rougher than the motion: that the
    motion follows the direction of the force is seldom. Where no two signals follow each other,
    the order stays as given.
    """
    names = list(signals)
    pairs = {(x, f): follows(signals[x], signals[f]) for x, f in permutations(names[:_MOST], 2)}
    best = max(pairs, key=lambda pair: pairs[pair], default=None)
    if best is None or pairs[best] < SURE:
        return names
    one, other = best
    rougher = np.log10(roughness(signals[other]) / roughness(signals[one]))
    if pairs[one, other] - pairs[other, one] + rougher < 0.0:
        one, other = other, one
    return [one, other, *(name for name in names if name not in best)]


def roughness(values: Array) -> float:
    """Squared second differences over squared first ones: small where a signal is smooth."""
    return float(np.sum(np.diff(values, 2) ** 2) / np.sum(np.diff(values) ** 2)) or 1e-300


def follows(motion: Array, force: Array) -> float:
    """Size of the correlation of a force with the direction of a motion, (T,) each."""
    if motion.size != force.size:
        return 0.0
    turns = turning_points(motion, TURN * float(np.ptp(motion)))
    if turns.size < 2 or not np.ptp(force) > 0.0:
        return 0.0
    inside = slice(int(turns[0]), int(turns[-1]))
    way = np.where(np.searchsorted(turns, np.arange(motion.size), side="right") % 2, 1.0, -1.0)
    if not np.ptp(way[inside]) > 0.0 or not np.ptp(force[inside]) > 0.0:
        return 0.0
    return abs(float(np.corrcoef(way[inside], force[inside])[0, 1]))
