"""Which of two signals is the displacement of a loop and which its force, by their shape."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.loops import follows, roughness

Array = NDArray[np.float64]

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
