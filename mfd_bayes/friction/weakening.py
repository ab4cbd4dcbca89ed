"""Slip weakening: how friction falls with the travel since a turn of the motion."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.friction.quantity import Quantity
from mfd_bayes.records.motion import vertices
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

LENGTH = 0.5
"""Travel λ over which friction falls, in: most of the fall is over in the first inch."""

SIDES = ("fwd", "bwd")

ENDINGS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"weakening": SIDES, "weakening_fwd": ("fwd",), "weakening_bwd": ("bwd",)}
)
"""What follows the name of a model and a "+", and the directions whose friction then falls."""

QUANTITIES: Mapping[str, Quantity] = MappingProxyType(
    {
        side: Quantity(
            *(f"weakening_{side}", "dimensionless", rf"w_\mathrm{{{side}}}"),
            f"w<sub>{side}</sub>",
            f"fall of the slip force with the travel since a turn, {word}",
            least=-1.0,
            most=1.0,
        )
        for side, word in zip(SIDES, ("forward", "backward"), strict=True)
    }
)
"""The quantity that each direction adds."""


def weakened_name(name: str, sides: Iterable[str]) -> str:
    """Name of a model whose friction also falls in these directions; the name itself for none."""
    base, _, ending = name.partition("+")
    wanted = {*sides, *ENDINGS.get(ending, ())}
    chosen = tuple(side for side in SIDES if side in wanted)
    return next((f"{base}+{end}" for end, those in ENDINGS.items() if those == chosen), name)


def fall(travel: ArrayLike, direction: ArrayLike, side: str) -> Array:
    """What w is multiplied by, exp(−u/λ) − exp(−1), where the motion goes to that side.

    While it goes the other way, it is that of a motion that turns at once, 1 − exp(−1).

    Parameters
    ----------
    travel : in
        u, since the last turn.
    direction
        +1 or -1, of the same shape.
    side : "fwd" or "bwd"
    """
    there = np.asarray(direction) == (1 if side == "fwd" else -1)
    left = np.where(there, np.exp(-np.asarray(travel) / LENGTH), 1.0)
    return np.asarray(left - np.exp(-1.0))


def fall_along(trace: Trace, side: str) -> Array:
    """`fall` at each sample of a trace, (T,); before the first turn u is since its first sample."""
    path = trace.path
    turns = np.concatenate([path.displacement[:1], path.displacement[path.turning_points]])
    travel = np.abs(trace.displacement - turns[path.stretch])
    direction = np.where(path.stretch % 2, -1, 1) * path.direction
    return fall(travel, direction, side)


@dataclass(frozen=True)
class Sliding:
    """Where a motion that is stepped in time is, and where it turned.

    Attributes
    ----------
    direction : int
        +1 or -1; 0 before the first sample if it is not known.
    turn : float, in
        Displacement of the last turn, or of the first sample.
    displacement, velocity : float, in, in/s
        At the last sample; NaN before the first.
    """

    direction: int = 0
    turn: float = float("nan")
    displacement: float = float("nan")
    velocity: float = float("nan")

    @property
    def begun(self) -> bool:
        """Whether there was a sample."""
        return not np.isnan(self.displacement)

    def moved(self, displacement: float, velocity: float, dt: float) -> Sliding:
        """The motion at its next sample, through the vertex if it turns before that."""
        if not self.begun:
            direction = self.direction or (-1 if velocity < 0 else 1)
            return Sliding(direction, displacement, displacement, velocity)
        direction, turn, x = self.direction, self.turn, self.displacement
        ends = np.array([x, displacement]), np.array([self.velocity, velocity])
        _, _, vertex = vertices(np.array([0.0, dt]), *ends)
        for place in (*vertex.tolist(), displacement):
            if (place - x) * direction < 0:
                direction, turn = -direction, x
            x = place
        return Sliding(direction, turn, displacement, velocity)

    def fall(self, side: str) -> float:
        """`fall` at the last sample."""
        return float(fall(abs(self.displacement - self.turn), self.direction, side))
