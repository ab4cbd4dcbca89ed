"""The state of the chains that sample a population, and the thinned states that are kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Choice = NDArray[np.intp]
Index = NDArray[np.intp]

Accepted = list[tuple[str, NDArray[np.bool_]]]
"""What a move accepted: by name, which chains."""

ROOM = 1 << 25
"""Most numbers of test coordinates that are kept, in single precision: 128 MiB."""

FEWEST = 16
"""Sweeps that are kept, however many tests there are."""


@dataclass
class Chains:
    """Current state of n chains.

    Attributes
    ----------
    h : (n, dim)
        Hyperparameters, as in `Layout`.
    latent : (n, 1 + cells, d)
        Levels, then the effects' independent parts.
    x : list of (n, D)
        Coordinates of each test in prior units: the d shared ones first, then its own.
    log_density : list of (n,)
        Of each test at its coordinates: its likelihood and the prior of those of its own.
    choice : (n, L) int
        Law of each quantity that follows the actuation.
    weight : (n, J, d)
        Of each test in the scatter of each quantity: its variance is scatter² / weight.
    ensemble : (n,) int
        Differential evolution takes partners from a chain's own ensemble alone.
    """

    h: Array
    latent: Array
    x: list[Array]
    log_density: list[Array]
    choice: Choice
    weight: Array
    ensemble: Index

    def values(self, k: int) -> Array:
        """Coordinate k of every test, (n, J)."""
        return np.stack([x[:, k] for x in self.x], axis=1)

    def take(self, others: Chains, log_density: Sequence[Array], picks: Index) -> None:
        """Give each chain the state of one of the others, by number, (n,); its law stays.

        `log_density` is that of each test at the others' coordinates, (n,) each.
        """
        self.h, self.latent = others.h[picks], others.latent[picks]
        self.weight, self.x = others.weight[picks], [x[picks] for x in others.x]
        self.log_density = [density[picks] for density in log_density]

    def move_tests(
        self, yes: NDArray[np.bool_], x: Sequence[Array], density: Sequence[Array]
    ) -> None:
        """Move every test to new coordinates, (n, D), of this log density, (n,), where accepted."""
        for j, (new, found) in enumerate(zip(x, density, strict=True)):
            self.x[j][yes] = new[yes]
            self.log_density[j][yes] = found[yes]

    def partners(self, rng: np.random.Generator) -> list[tuple[Index, Index, Index]]:
        """Halves of the chains, each with two different partners from its ensemble's other half."""
        found = []
        for own, other in self.halves(rng):
            first = rng.integers(other.shape[1], size=own.shape)
            second = (first + rng.integers(1, other.shape[1], size=own.shape)) % other.shape[1]
            rows = np.arange(len(other))[:, None]
            found.append((own.ravel(), other[rows, first].ravel(), other[rows, second].ravel()))
        return found

    def halves(self, rng: np.random.Generator) -> list[tuple[Index, Index]]:
        """Random halves of the ensembles, each with the other half, (ensembles, …) each."""
        order = rng.permutation(len(self.h))
        order = order[np.argsort(self.ensemble[order], kind="stable")]
        by_ensemble = order.reshape(self.ensemble[-1] + 1, -1)
        middle = by_ensemble.shape[1] // 2
        halves = by_ensemble[:, :middle], by_ensemble[:, middle:]
        return [halves, halves[::-1]]


@dataclass(frozen=True, eq=False)
class Snapshot:
    """What is kept of the chains after a sweep, for the tests.

    Attributes
    ----------
    latent : (n, 1 + cells, d)
    products : (n, d, d)
        Products of the tests' standardised deviations, summed over tests.
    x : (n, sum of D) float32
        Coordinates of all tests, one test after the other.
    """

    latent: Array
    products: Array
    x: NDArray[np.float32]


class ThinnedChains:
    """Snapshots of every `step`-th sweep; the step doubles when there is no more room.

    Parameters
    ----------
    wanted : int
        Snapshots that are wanted at the end, after half of them may be dropped as warm-up. There
        are fewer where those of many tests would take more than `ROOM`.
    chains : int
    size : int
        Coordinates of all tests together.
    """

    def __init__(self, wanted: int, chains: int, size: int) -> None:
        room = max(FEWEST, ROOM // (chains * size))
        self.most = min(4 * wanted + 2, room)
        self.wanted, self.step = wanted, 1
        self.snapshots: dict[int, Snapshot] = {}
        # allocated once: many small allocations would leave gaps in the memory
        self._room = np.empty((self.most, chains, size), dtype=np.float32)
        self._free = list(range(self.most))
        self._taken: dict[int, int] = {}

    def wants(self, sweep: int) -> bool:
        """Whether the chains after this sweep are to be added."""
        return (sweep + 1) % self.step == 0

    def add(self, sweep: int, latent: Array, products: Array, x: Sequence[Array]) -> None:
        """Keep a snapshot; where there is no room, every other one is dropped first.

        `latent` and `products` are those of `Snapshot`, x holds each test's coordinates, (n, D).
        """
        if not self._free:
            self.step *= 2
            for dropped in [i for i in self.snapshots if not self.wants(i)]:
                del self.snapshots[dropped]
                self._free.append(self._taken.pop(dropped))
        if self.wants(sweep):
            slot = self._taken[sweep] = self._free.pop()
            np.concatenate(x, axis=1, out=self._room[slot], casting="same_kind")
            self.snapshots[sweep] = Snapshot(latent, products, self._room[slot])

    def since(self, sweep: int) -> dict[int, Snapshot]:
        """Snapshots of a sweep and later ones by sweep, thinned evenly if more than wanted."""
        late = [i for i in self.snapshots if i >= sweep]
        apart = max(1, len(late) // self.wanted)
        return {i: self.snapshots[i] for i in late[::-1][::apart][::-1]}


class TestDraws(Sequence[Array]):
    """Draws of each test, (chain, draw, D); they are large, so each is put together on request.

    Parameters
    ----------
    snapshots : sequence of Snapshot
    sizes : sequence of int
        D of each test.
    ensembles : int
    """

    __test__ = False  # pytest is not to collect it

    def __init__(self, snapshots: Sequence[Snapshot], sizes: Sequence[int], ensembles: int) -> None:
        self._snapshots, self._ensembles = snapshots, ensembles
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
        draws = by_walker([snapshot.x[:, own] for snapshot in self._snapshots], self._ensembles)
        return np.asarray(draws, dtype=np.float64)


def by_walker(steps: Sequence[NDArray[Any]], ensembles: int) -> NDArray[Any]:
    """Steps of (n, …) as (chain, draw, …), the draws of a chain by walker, then by step."""
    array = np.stack(steps, axis=1)  # (n, step, …)
    return array.reshape(ensembles, -1, *array.shape[2:])
