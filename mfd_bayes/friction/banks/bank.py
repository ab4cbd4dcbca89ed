"""What every bank of dampers offers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Scales = Mapping[str, Array]
S = TypeVar("S", bound=Any)


class Bank(Protocol):
    """State of n dampers, each with its own motion; a step makes a new one."""

    @property
    def force(self) -> Array:
        """Force of each damper at its last sample, (n,), kip."""

    def step(
        self, displacement: Array, velocity: Array, dt: float, scales: Scales | None = None
    ) -> Self:
        """State at the next sample of each damper's motion.

        This one is not changed, and may be stepped again: that is what equilibrium iterations do.

        Parameters
        ----------
        displacement, velocity : (n,), in, in/s
        dt : float, s
        scales : mapping of (n,), optional
            Factors of the parameters that follow the actuation.
        """

    def chosen(self, rows: NDArray[np.intp]) -> Self:
        """The bank of some of its dampers."""

    def replaced(self, rows: NDArray[np.intp], part: Self) -> Self:
        """The bank with the state of some of its dampers replaced, after the same samples.

        That is how only those are stepped again that are not in equilibrium yet.
        """


def with_rows(whole: Array, rows: NDArray[np.intp], part: Array | float) -> Array:
    """A copy with some of its values replaced, (n,)."""
    whole = whole.copy()
    whole[rows] = part
    return whole


def with_scales(whole: Scales, rows: NDArray[np.intp], part: Scales) -> dict[str, Array]:
    """Factors with those of some dampers replaced; 1 where the others have none."""
    return {name: with_rows(share, rows, part.get(name, 1.0)) for name, share in whole.items()}


def with_state(whole: S, names: Iterable[str], rows: NDArray[np.intp], part: S) -> S:
    """A state with some rows of the named arrays replaced by those of another state."""
    new = {name: with_rows(getattr(whole, name), rows, getattr(part, name)) for name in names}
    changed: S = replace(whole, **new)
    return changed
