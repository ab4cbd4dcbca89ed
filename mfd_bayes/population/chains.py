"""What the chains of a population said of its tests, sweep by sweep, in bounded memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROOM = 1 << 25
"""Numbers that are held of the tests, in single precision: 128 MiB."""

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


class ThinnedChains:
    """States of sweeps evenly apart: every `step`-th, which doubles when there is no more room.

    Parameters
    ----------
    wanted : int
        States that are wanted at the end, where half may be too early. Fewer are held where
        those of many tests would take more than `ROOM`.
    chains : int
    size : int
        Coordinates of all tests.
    """

    def __init__(self, wanted: int, chains: int, size: int) -> None:
        room = max(FEWEST, ROOM // (chains * size))
        self.most = min(4 * wanted + 2, room)
        self.wanted, self.step = wanted, 1
        self.states: dict[int, State] = {}
        # taken at once: what is taken and given back bit by bit leaves holes in the memory
        self._room = np.empty((self.most, chains, size), dtype=np.float32)
        self._free = list(range(self.most))
        self._taken: dict[int, int] = {}

    def wants(self, sweep: int) -> bool:
        """Whether the state after a sweep is to be added."""
        return (sweep + 1) % self.step == 0

    def add(self, sweep: int, latent: Array, products: Array, x: Sequence[Array]) -> None:
        """Take a state in; where there is no room, every other one goes first.

        Parameters
        ----------
        sweep : int
        latent, products
            As of `State`.
        x : sequence of (n, D)
            Of each test.
        """
        if not self._free:
            self.step *= 2
            for gone in [i for i in self.states if not self.wants(i)]:
                del self.states[gone]
                self._free.append(self._taken.pop(gone))
        if self.wants(sweep):
            slot = self._taken[sweep] = self._free.pop()
            np.concatenate(x, axis=1, out=self._room[slot], casting="same_kind")
            self.states[sweep] = State(latent, products, self._room[slot])

    def since(self, sweep: int) -> dict[int, State]:
        """States of a sweep and those after it, in their order; every so many, if too many."""
        late = [i for i in self.states if i >= sweep]
        apart = max(1, len(late) // self.wanted)
        return {i: self.states[i] for i in late[::-1][::apart][::-1]}


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
