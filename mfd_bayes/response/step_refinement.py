"""Shorter steps for the draws whose estimated error is too large."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mfd_bayes.response.building import Building
from mfd_bayes.response.device_draws import Dampers
from mfd_bayes.response.ground import Ground
from mfd_bayes.response.result import Response
from mfd_bayes.response.time_integration import HALVINGS, integrate

BEND = 2.0  # largest bend of the forces at first (see `integrate`), over the tolerance
LARGEST_BEND = 0.1

SHARPER = 0.25  # share of this for the draws that are computed again


@dataclass(frozen=True)
class Accuracy:
    """How exactly a response is computed.

    Attributes
    ----------
    tolerance : float
        Largest estimated error of a draw's drift, relative.
    rounds : int
        Most times that a draw is computed again with shorter steps.
    halvings : int
        Most halvings of a step.
    kept : int
        Draws of each block whose dampers' histories are kept.
    """

    tolerance: float = 0.01
    rounds: int = 2
    halvings: int = HALVINGS
    kept: int = 8


def settle(
    building: Building,
    ground: Ground,
    dampers: Dampers,
    accuracy: Accuracy,
    tick: Callable[[float], object] = lambda share: None,
) -> Response:
    """Response of every draw to one ground motion, at steps that suit each."""
    bend = min(BEND * accuracy.tolerance, LARGEST_BEND)
    halvings, kept = accuracy.halvings, accuracy.kept
    found = integrate(building, ground, dampers, bend, halvings=halvings, kept=kept, tick=tick)
    for _ in range(accuracy.rounds):
        far = (found.change > accuracy.tolerance) & ~found.unstable
        rows = np.flatnonzero(far[:, 0])
        if not rows.size:
            break
        bend *= SHARPER
        keep = int(np.searchsorted(rows, kept))
        some = dampers.chosen(rows)
        fine = integrate(building, ground, some, bend, halvings=halvings, kept=keep, tick=tick)
        found.put(rows, fine)
    return found
