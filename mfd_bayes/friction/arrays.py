"""Array operations of the force kernels, (rows, n), faster than plain numpy expressions."""

from __future__ import annotations

import threading

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dger

Array = NDArray[np.float64]


class _Memory(threading.local):
    def __init__(self) -> None:
        self.room = np.empty(0)


_memory = _Memory()


def scratch(count: int, rows: int, n: int) -> list[Array]:
    """Uninitialised arrays (rows, n), valid until this thread's next call of `scratch`.

    Every call returns the same memory: allocating it would cost more than the computation. Each
    begins with a line of the cache, which a vector of 512 bits fills: else writing it takes longer.
    """
    size = -(-rows * n // 8) * 8
    if _memory.room.size < count * size:
        room = np.empty(count * size + 8)
        _memory.room = room[-(room.ctypes.data // 8) % 8 :]
    return [_memory.room[i * size : i * size + rows * n].reshape(rows, n) for i in range(count)]


def outer(column: Array, row: Array, out: Array) -> Array:
    """Product of a column (rows,) and a row (n,)."""
    out.fill(0.0)
    return add_outer(column, row, out)


def add_row(row: Array, out: Array) -> Array:
    """Add a row (n,) to every row."""
    return add_outer(np.ones(len(out)), row, out)


def add_outer(column: Array, row: Array, out: Array) -> Array:
    """Add the product of a column (rows,) and a row (n,): BLAS does it in one pass."""
    total: Array = dger(1.0, row, column, a=out.T, overwrite_a=True).T
    return total


def rows_of(table: Array, index: NDArray[np.intp], out: Array) -> Array:
    """Rows of a table (k, n) by index, (rows, n), written to `out`."""
    return np.take(table, index, axis=0, out=out, mode="clip")
