"""What the chains of a population said of its tests, sweep by sweep, in bounded memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROOM = 1 << 26
"""Numbers that are held of the tests, in single precision: 256 MiB."""

FEWEST = 16
"""Sweeps that are held, however many tests there are."""


@dataclass(frozen=True, eq=False)
class State:
    """What the chains say of the tests after a sweep.

    Attributes
    ----------
    latent : (n, 1 + cells, d)
    products : (n, d, d)
        Of the tests' places in the scatter, summed over the tests.
    x : (n, sum of D) float32
        Coordinates of one test after the other.
    """

    latent: Array
    products: Array
    x: NDArray[np.float32]


class History:
    """States of sweeps evenly apart: every `step`-th, which doubles when there are too many.

    Parameters
    ----------
    wanted : int
        States that are wanted at the end, of which a tenth is too early. Fewer are held where
        those of many tests would take more than `ROOM`.
    size : int
        Numbers in the x of a state.
    """

    def __init__(self, wanted: int, size: int) -> None:
        room = max(FEWEST, ROOM // size)
        self.most = min(2 * (wanted + wanted // 9 + 1), room)
        self.step = 1
        self.states: dict[int, State] = {}

    def wants(self, sweep: int) -> bool:
        """Whether the state after a sweep is to be added."""
        return (sweep + 1) % self.step == 0

    def add(self, sweep: int, state: State) -> None:
        """Take a state in, and let every other one go where there are too many."""
        self.states[sweep] = state
        if len(self.states) > self.most:
            self.step *= 2
            self.states = {i: s for i, s in self.states.items() if self.wants(i)}

    def since(self, sweep: int) -> dict[int, State]:
        """States of a sweep and those after it, in their order."""
        return {i: state for i, state in self.states.items() if i >= sweep}


class TestDraws(Sequence[Array]):
    """Draws of each test, (chain, draw, D), put together when asked for: they are many.

    Parameters
    ----------
    states : sequence of State
    sizes : sequence of int
        D of each test.
    ensembles : int
    """

    __test__ = False

    def __init__(self, states: Sequence[State], sizes: Sequence[int], ensembles: int) -> None:
        self._states, self._ensembles = states, ensembles
        self._edges = [0, *np.cumsum(sizes).tolist()]

    def __len__(self) -> int:
        return len(self._edges) - 1

    @overload
    def __getitem__(self, index: int) -> Array: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Array]: ...
    def __getitem__(self, index: int | slice) -> Array | Sequence[Array]:
        if isinstance(index, slice):
            return [self[j] for j in range(*index.indices(len(self)))]
        j = range(len(self))[index]
        own = slice(self._edges[j], self._edges[j + 1])
        draws = by_walker([state.x[:, own] for state in self._states], self._ensembles)
        return np.asarray(draws, dtype=np.float64)


def by_walker(steps: Sequence[NDArray[Any]], ensembles: int) -> NDArray[Any]:
    """Steps of (n, …) as (chain, draw, …), a chain's draws by walker and along it by step."""
    array = np.stack(steps, axis=1)  # (n, step, …)
    return array.reshape(ensembles, -1, *array.shape[2:])
