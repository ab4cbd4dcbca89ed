"""Summaries of a loop that carry what a calibration would learn from it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.planning.loop import Loop

Array = NDArray[np.float64]

FAST = (0.4, 0.8)
SLOW = (0.92, 1.0)
"""Shares of a stroke: slip near the peak speed, and slip just before the turn."""

IN_GAP = 0.4
"""Share of the typical gap at which the force in the gap is read."""

RISES = (0.3, 0.5, 0.8)
"""Shares of the slip force that the force reaches after a turn, as in reading a loop by eye."""


def summarise(loop: Loop, force: Array, gap: float) -> Array:
    """Summaries of loops (n, T), kip, of a damper with a gap of about this width, in, (n, k)."""
    return np.stack(list(summaries_by_name(loop, force, gap).values()), axis=1)


def summaries_by_name(loop: Loop, force: Array, gap: float) -> Mapping[str, Array]:
    """Summaries by name, (n,) each.

    Energy of the loop, kip·in; of each direction the peak, the slip force near the peak speed and
    just before the turn, and the force in the gap, kip; the width of the gap, where half of the
    slip force is reached, and the travel of the build-up, in.
    """
    found = {"energy": loop.energy(force)}
    for side, half in zip(("bwd", "fwd"), loop.halves(force), strict=True):
        found |= {f"{name}_{side}": value for name, value in _of_stroke(loop, half, gap).items()}
    return found


def _of_stroke(loop: Loop, force: Array, gap: float) -> dict[str, Array]:
    share = loop.travel / loop.stroke
    fast = force[:, (share >= FAST[0]) & (share <= FAST[1])].mean(axis=1)
    slow = force[:, (share >= SLOW[0]) & (share < SLOW[1])].mean(axis=1)
    place = min(IN_GAP * gap, 0.5 * loop.stroke)
    right = int(np.clip(np.searchsorted(loop.travel, place), 1, loop.travel.size - 1))
    left = loop.travel[right - 1]
    part = (place - left) / (loop.travel[right] - left)
    inside = (1.0 - part) * force[:, right - 1] + part * force[:, right]
    low, half, high = (_reached(loop.travel, force, level * fast) for level in RISES)
    return {
        "peak": force.max(axis=1),
        "slip_fast": fast,
        "slip_slow": slow,
        "in_gap": inside,
        "gap": half,
        "rise": high - low,
    }


def _reached(travel: Array, force: Array, level: Array) -> Array:
    """Travel at which the force of each loop first reaches a level (n,), in."""
    above = force >= level[:, None]
    above[:, -1] = True
    right = np.maximum(np.argmax(above, axis=1), 1)
    row = np.arange(len(force))
    before, after = force[row, right - 1], force[row, right]
    step = after - before
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.where(step > 0.0, (level - before) / step, 0.0)
    part = np.clip(part, 0.0, 1.0)
    return np.asarray(travel[right - 1] + part * (travel[right] - travel[right - 1]))
