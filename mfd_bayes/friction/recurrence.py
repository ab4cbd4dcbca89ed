"""Linear recurrences in time, for many vectors at once in few numpy calls, and memory for them."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SHORT = 24
"""Up to this many steps are taken one after the other."""


class _Memory(threading.local):
    def __init__(self) -> None:
        self.room = np.empty(0)


_memory = _Memory()


def scratch(count: int, rows: int, n: int) -> list[Array]:
    """Uninitialised arrays (rows, n), valid until this thread's next call of `scratch`.

    Every call returns the same memory: to be given new pages by the system takes as long as the
    computation. Each array begins with a line of the cache.
    """
    size = -(-rows * n // 8) * 8
    if _memory.room.size < count * size + 8:
        _memory.room = np.empty(count * size + 8)
    begin = -(_memory.room.ctypes.data // 8) % 8
    return [
        _memory.room[begin + i * size : begin + i * size + rows * n].reshape(rows, n)
        for i in range(count)
    ]


@dataclass(frozen=True, eq=False)
class Blocks:
    """N steps in blocks of consecutive steps, stored with the j-th steps of all blocks together.

    In this order one numpy call takes a step in all blocks at once, on contiguous memory.

    Attributes
    ----------
    length, count : int
        Steps of a block, and number of blocks.
    order : (length count,), int
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
        """Blocks of N steps, of a length that needs few calls."""
        step = np.arange(steps)
        if steps <= SHORT:
            return Blocks(steps, 1, step, step)
        length = round(1.3 * steps ** (1 / 3) if steps > SHORT**2 else steps**0.5)
        count = -(-steps // length)
        order = np.add.outer(np.arange(length), np.arange(count) * length).ravel()
        return Blocks(
            length, count, np.minimum(order, steps - 1), step % length * count + step // length
        )

    def solve(self, decay: Array, state: Array, first: Array) -> None:
        """Overwrite the drive in `state` with z_k = decay_k z_{k−1} + drive_k.

        Parameters
        ----------
        decay, state : (length count, n)
            In the order of the blocks; both are overwritten.
        first : (n,)
            z before the first step.
        """
        if self.count == 1:
            work = np.empty(first.shape)
            for a, z in zip(decay, state, strict=True):
                first = np.add(z, np.multiply(a, first, work), z)
            return
        shape = (self.length, self.count, first.size)
        a, z, work = decay.reshape(shape), state.reshape(shape), np.empty(shape[1:])
        last_a, last_z = a[0], z[0]
        for next_a, next_z in zip(a[1:], z[1:], strict=True):
            np.add(next_z, np.multiply(next_a, last_z, work), next_z)
            np.multiply(next_a, last_a, next_a)
            last_a, last_z = next_a, next_z
        work[0], work[1:] = first, solve(last_a, last_z, first)[:-1]
        a *= work
        z += a


def solve(decay: Array, drive: Array, first: Array) -> Array:
    """States z_k = decay_k z_{k−1} + drive_k after each of N steps, (N, n).

    Parameters
    ----------
    decay, drive : (N, n)
    first : (n,)
        z before the first step.
    """
    blocks = Blocks.of(len(decay))
    states = drive.take(blocks.order, axis=0)
    blocks.solve(decay.take(blocks.order, axis=0), states, first)
    return states if blocks.count == 1 else states.take(blocks.place, axis=0)
