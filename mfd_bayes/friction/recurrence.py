"""Linear recurrences in time, for many vectors at once in few numpy calls."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.arrays import aligned, rows_of

Array = NDArray[np.float64]

SHORT = 24
"""Up to this many steps are one block."""


@lru_cache(maxsize=4096)
def _layout(steps: int) -> tuple[int, int]:
    """Rows of N steps in blocks of blocks, as few as can be, and steps of the largest blocks."""
    if steps <= SHORT:
        return steps, steps
    usual = 2.0 * steps ** (1 / 3) if steps > SHORT**2 else steps ** (1 / 2)
    lengths = range(round(0.8 * usual), round(1.2 * usual) + 1)
    return min((length * _layout(-(-steps // length))[0], length) for length in lengths)


@dataclass(frozen=True, eq=False)
class Blocks:
    """N steps in blocks of consecutive steps, stored with the j-th steps of all blocks together.

    In this order one numpy call takes a step in all blocks at once, on contiguous memory. The
    blocks themselves stand in the order of `ends`, so that their ends are solved where they are.

    Attributes
    ----------
    length, count : int
        Steps of a block, and number of blocks.
    order : (rows,), int
        Step in each row. Rows that fill up the blocks repeat the last step.
    place : (N,), int
        Row of each step.
    ends : Blocks, optional
        The ends of the blocks, in blocks of their own; None of a single block.
    before : (count,), int
        Place of the block before each block; the first has none, and any will do.
    """

    length: int
    count: int
    order: NDArray[np.intp]
    place: NDArray[np.intp]
    ends: Blocks | None
    before: NDArray[np.intp]

    @staticmethod
    @lru_cache(maxsize=64)
    def of(steps: int) -> Blocks:
        """Blocks of N steps, about 2 N^(1/3) in each."""
        if steps <= SHORT:
            every = np.arange(steps)
            return Blocks(steps, 1, every, every, None, every[:1])
        _, length = _layout(steps)
        ends = Blocks.of(-(-steps // length))
        order = np.add.outer(np.arange(length), ends.order * length).ravel()
        step = np.arange(steps)
        place = step % length * ends.rows + ends.place[step // length]
        before = ends.place[np.maximum(ends.order - 1, 0)]
        return Blocks(length, ends.rows, np.minimum(order, steps - 1), place, ends, before)

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
        if self.ends is None:
            state -= decay * state
            self.solve(decay, state, first)
            return
        a, z, work = self._views(decay, state)
        last_a, last_z = a[0], z[0]
        last_z -= np.multiply(last_a, last_z, out=work)
        for next_a, next_z in zip(a[1:], z[1:], strict=True):
            np.subtract(last_z, next_z, work)
            np.multiply(work, next_a, work)
            np.add(next_z, work, next_z)
            np.multiply(next_a, last_a, next_a)
            last_a, last_z = next_a, next_z
        self._join(a, z, first, work)

    def solve(self, decay: Array, state: Array, first: Array) -> None:
        """Overwrite the drive in `state` with z_k = decay_k z_{k−1} + drive_k; see `relax`."""
        if self.ends is None:
            z, work = first, np.empty(first.shape)
            for a, drive in zip(decay, state, strict=True):
                z = np.add(drive, np.multiply(a, z, work), drive)
            return
        a, z, work = self._views(decay, state)
        last_a, last_z = a[0], z[0]
        for next_a, next_z in zip(a[1:], z[1:], strict=True):
            np.add(next_z, np.multiply(next_a, last_z, work), next_z)
            np.multiply(next_a, last_a, next_a)
            last_a, last_z = next_a, next_z
        self._join(a, z, first, work)

    def _views(self, decay: Array, state: Array) -> tuple[Array, Array, Array]:
        shape = (self.length, self.count, state.shape[1])
        return decay.reshape(shape), state.reshape(shape), aligned(*shape[1:])

    def _join(self, decay: Array, state: Array, first: Array, work: Array) -> None:
        """Add to each block, solved from 0, the decayed state from the end of the block before."""
        if self.ends is not None:
            faded, last = aligned(*work.shape), aligned(*work.shape)
            faded[:], last[:] = decay[-1], state[-1]
            self.ends.solve(faded, last, first)
            rows_of(last, self.before, out=work)
        work[0] = first
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
    blocks = Blocks.of(len(decay))
    if blocks.ends is None:
        states = drive.copy()
        blocks.solve(decay, states, first)
        return states
    states = drive[blocks.order]
    blocks.solve(decay[blocks.order], states, first)
    return states[blocks.place]
