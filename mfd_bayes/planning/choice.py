"""Tests that are best together: greedy choice, then exchange of one test for another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from mfd_bayes.planning.gain import Goals

Array = NDArray[np.float64]

PASSES = 5
"""Most rounds of exchange."""

_PENALTY = 1e-3  # over the number of draws, of columns with unit sd

Set = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Pool:
    """Simulated tests to choose from, each as a few columns that carry what it tells of the goals.

    Attributes
    ----------
    goals : Goals
    blocks : sequence of (n, q)
        Columns of each test, mean 0.
    """

    goals: Goals
    blocks: Sequence[Array]

    @cached_property
    def _columns(self) -> list[NDArray[np.intp]]:
        ends = np.cumsum([0, *(block.shape[1] for block in self.blocks)])
        return [np.arange(a, b) for a, b in pairwise(ends)]

    @cached_property
    def _products(self) -> tuple[Array, Array, Array]:
        """Products of columns with columns, of columns with goals, and of goals."""
        goals = self.goals.values - self.goals.values.mean(axis=0)
        every = np.concatenate(self.blocks, axis=1)
        return every.T @ every, every.T @ goals, np.sum(goals**2, axis=0)

    @cached_property
    def _widths(self) -> Array:
        return self.goals.widths

    def reduction(self, chosen: Set) -> float:
        """Expected reduction of the mean width by tests together, corrected for their columns."""
        columns = np.concatenate([self._columns[k] for k in chosen])
        gram, told, whole = self._products
        n, q = len(self.goals.values), columns.size
        if not q or n <= q + 2:
            return 0.0
        matrix = gram[np.ix_(columns, columns)]
        matrix[range(q), range(q)] += _PENALTY * n
        right = told[columns]
        explained = np.einsum("qm,qm->m", right, linalg.solve(matrix, right, assume_a="pos"))
        share = (whole - explained) / (n - 1.0 - q) * (n - 1.0) / np.maximum(whole, 1e-300)
        after = float(np.sqrt(np.clip(share, 0.0, None)) @ self._widths)
        return max(1.0 - after / max(float(self._widths.sum()), 1e-300), 0.0)


def choose(count: int, value: Callable[[Set], float], size: int) -> list[Set]:
    """The best sets of 1, 2, … up to `size` of `count` tests, by greedy choice and exchange.

    Parameters
    ----------
    count : int
    value : callable
        Worth of a set of tests.
    size : int
        Largest set.
    """
    found: list[Set] = []
    chosen: Set = ()
    for _ in range(min(size, count)):
        free = [k for k in range(count) if k not in chosen]
        chosen = max(((*chosen, k) for k in free), key=value)
        chosen = exchange(chosen, count, value)
        found.append(chosen)
    return found


def exchange(chosen: Set, count: int, value: Callable[[Set], float]) -> Set:
    """The set after each of its tests was offered for any other, until none is worth more."""
    worth = value(chosen)
    for _ in range(PASSES if len(chosen) > 1 else 0):
        before = worth
        for place in range(len(chosen)):
            for k in (k for k in range(count) if k not in chosen):
                other = (*chosen[:place], k, *chosen[place + 1 :])
                if (now := value(other)) > worth + 1e-12:
                    chosen, worth = other, now
        if worth <= before + 1e-12:
            break
    return chosen


def greedy(chosen: Set, count: int, value: Callable[[Set], float], size: int) -> list[Set]:
    """The set with one more test after another, up to `size`, each the best to add."""
    found = []
    while len(chosen) < min(size, count):
        free = [k for k in range(count) if k not in chosen]
        chosen = max(((*chosen, k) for k in free), key=value)
        found.append(chosen)
    return found
