"""Linear recurrences in time, for many vectors at once in few numpy calls."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SHORT = 24
"""Up to this many steps are taken one after the other, without blocks."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """N steps in blocks of consecutive steps, stored with the j-th steps of all blocks together.

    In this order one numpy call takes a step in all blocks at once, on contiguous memory.

    Attributes
    ----------
    length, count : int
        Steps of a block, and number of blocks.
    order : (rows,), int
        Step in each row. Rows that fill up the last block repeat the last step.
    place : (N,), int
        Row of each step.
    """

    length: int
    count: int
    order: NDArray[np.intp]
    place: NDArray[np.intp]

    @staticmethod
    @lru_cache(maxsize=64)
    def of(steps: int) -> Blocks:
        """Blocks of N steps: about N^(1/3) in each, since their ends are solved in blocks too."""
        length = 1 if steps <= SHORT else round(steps ** (1 / 3))
        count = -(-steps // length)
        order = np.arange(length * count).reshape(count, length).T.ravel()
        place = np.empty(order.size, dtype=np.intp)
        place[order] = np.arange(order.size)
        return Blocks(length, count, np.minimum(order, steps - 1), place[:steps])

    @property
    def rows(self) -> int:
        """Number of rows of the arrays given to `relax` and `solve`, at least N."""
        return self.order.size

    def relax(self, decay: Array, state: Array, first: Array) -> None:
        """Overwrite s in `state` with z_k = s_k + decay_k (z_{k−1} − s_k), which tends to s.

        Parameters
        ----------
        decay, state : (rows, n)
            In the order of the blocks; both are overwritten.
        first : (n,)
            z before the first step.
        """
        a, z, work = self._views(decay, state)
        z[0] -= np.multiply(a[0], z[0], out=work)
        for j in range(1, self.length):
            np.subtract(z[j - 1], z[j], out=work)
            work *= a[j]
            z[j] += work
            a[j] *= a[j - 1]
        self._join(a, z, first, work)

    def solve(self, decay: Array, state: Array, first: Array) -> None:
        """Overwrite the drive in `state` with z_k = decay_k z_{k−1} + drive_k; see `relax`."""
        a, z, work = self._views(decay, state)
        for j in range(1, self.length):
            z[j] += np.multiply(a[j], z[j - 1], out=work)
            a[j] *= a[j - 1]
        self._join(a, z, first, work)

    def _views(self, decay: Array, state: Array) -> tuple[Array, Array, Array]:
        shape = (self.length, self.count, state.shape[1])
        return decay.reshape(shape), state.reshape(shape), np.empty(shape[1:])

    def _join(self, decay: Array, state: Array, first: Array, work: Array) -> None:
        """Add to each block, solved from 0, the decayed state from the end of the block before."""
        work[0] = first
        work[1:] = solve(decay[-1, :-1], state[-1, :-1], first)
        decay *= work
        state += decay


def solve(decay: Array, drive: Array, first: Array) -> Array:
    """States after each of N steps, (N, n).

    Parameters
    ----------
    decay, drive : (N, n)
    first : (n,)
        z before the first step.
    """
    if len(decay) > SHORT:
        blocks = Blocks.of(len(decay))
        states = drive[blocks.order]
        blocks.solve(decay[blocks.order], states, first)
        return states[blocks.place]
    states = np.empty_like(drive)
    for k in range(len(decay)):
        np.multiply(decay[k], states[k - 1] if k else first, out=states[k])
        states[k] += drive[k]
    return states
