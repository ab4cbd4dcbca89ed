"""Steps halved until the peaks of every draw settle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.response.building import Building
from mfd_bayes.response.devices import Dampers
from mfd_bayes.response.ground import Ground
from mfd_bayes.response.integration import History, integrate
from mfd_bayes.response.pace import spare_halvings
from mfd_bayes.response.tally import Energies, Peaks

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Accuracy:
    """How exactly histories are computed.

    Attributes
    ----------
    tolerance : float
        Peaks have settled when none changes by more than this share of the largest of its kind
        when the step is halved.
    longest : float, s
        Longest first step where the dampers' forces bend most. Where they bend little it may be up
        to four times as long, but no longer than the ground motion's own; see `pace`.
    halvings : int
        Most times that all steps are halved.
    kept : int
        Draws of each block whose dampers' histories are kept.
    """

    tolerance: float = 0.01
    longest: float = 0.01
    halvings: int = 4
    kept: int = 8


@dataclass(frozen=True, eq=False)
class Settled:
    """Histories of n draws with the step at which each has settled; see `History`.

    Attributes
    ----------
    change : (n,)
        Change of the peaks at the last halving.
    steps : (n,), s
        Shortest step of each at the last halving.
    """

    peaks: Peaks
    residual: Array
    energies: Energies
    imbalance: Array
    unstable: NDArray[np.bool_]
    open: Array
    change: Array
    steps: Array
    drifts: Array
    travels: Array
    forces: Array


def settle(
    building: Building,
    ground: Ground,
    dampers: Dampers,
    accuracy: Accuracy,
    tick: Callable[[float], object] = lambda share: None,
) -> Settled:
    """Histories of every draw, each with a step at which its peaks have settled."""
    n, kept = dampers.draws, min(accuracy.kept, dampers.draws)
    parts = max(1, int(np.ceil(ground.step / accuracy.longest - 1e-9)))
    spare = spare_halvings(building, ground, dampers)
    first = integrate(building, ground, dampers, np.maximum(parts >> spare, 1), kept=kept)
    found = _settled(first, np.full(n, np.inf))
    rows = np.arange(n)
    for number in range(accuracy.halvings):
        parts *= 2
        old = found.peaks.chosen(rows)
        keep = int(np.searchsorted(rows, kept))
        grid = np.maximum(parts >> spare, 1)
        fine = integrate(building, ground, dampers.chosen(rows), grid, kept=keep)
        change = np.where(fine.unstable, np.inf, fine.peaks.change_from(old))
        _replace(found, rows, _settled(fine, change), keep)
        rows = rows[(change > accuracy.tolerance) & ~fine.unstable]
        tick((number + 1) / accuracy.halvings if rows.size else 1.0)
        if not rows.size:
            break
    return found


def _settled(history: History, change: Array) -> Settled:
    return Settled(
        history.peaks,
        history.residual,
        history.energies,
        history.imbalance,
        history.unstable,
        history.open,
        change,
        np.full(change.size, history.step),
        history.drifts,
        history.travels,
        history.forces,
    )


def _replace(found: Settled, rows: NDArray[np.intp], fine: Settled, kept: int) -> None:
    """Put finer histories of some draws in place; those of the first `kept` have loops."""
    for field in fields(found):
        old, new = getattr(found, field.name), getattr(fine, field.name)
        if isinstance(old, np.ndarray):
            if field.name in ("travels", "forces"):
                old[rows[:kept]] = new
            else:
                old[rows] = new
        else:
            for inner in fields(old):
                getattr(old, inner.name)[rows] = getattr(new, inner.name)
