"""Array operations of the force kernels, (rows, n), faster than plain numpy expressions."""

from __future__ import annotations

import threading
from dataclasses import dataclass

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
        _memory.room = _aligned(count * size)
    return [_memory.room[i * size : i * size + rows * n].reshape(rows, n) for i in range(count)]


def aligned(rows: int, n: int) -> Array:
    """Uninitialised array (rows, n) that begins with a line of the cache."""
    return _aligned(rows * n).reshape(rows, n)


def _aligned(size: int) -> Array:
    room = np.empty(size + 8)
    begin = -(room.__array_interface__["data"][0] // 8) % 8
    return room[begin : begin + size]


def outer(column: Array, row: Array, out: Array) -> Array:
    """Product of a column (rows,) and a row (n,)."""
    columns, rows = np.zeros((2, column.size)), np.zeros((2, row.size))
    columns[0], rows[0] = column, row
    # of one column and one row numpy takes many times as long
    return np.matmul(columns.T, rows, out=out)


def add_row(row: Array, out: Array) -> Array:
    """Add a row (n,) to every row."""
    return add_outer(np.ones(len(out)), row, out)


def add_outer(column: Array, row: Array, out: Array) -> Array:
    """Add the product of a column (rows,) and a row (n,): BLAS does it in one pass."""
    total: Array = dger(1.0, row, column, a=out.T, overwrite_a=True).T
    return total


def rows_of(table: Array, index: NDArray[np.intp], out: Array) -> Array:
    """Rows of a table (k, n) by index, (rows, n), written to `out`."""
    return table.take(index, 0, out, "clip")


FEW = 8
"""Up to so many lines a product of matrices is the fastest way to many points on them."""


@dataclass(frozen=True)
class Along:
    """Points on straight lines: number of each one's line, and its place there, (rows,) each.

    `columns` is the matrix that takes the lines `some` to the points, where these are few.
    """

    index: NDArray[np.intp]
    place: Array
    some: NDArray[np.intp]
    columns: Array | None

    @classmethod
    def of(cls, index: NDArray[np.intp], place: Array) -> Along:
        """Points, (rows,) each."""
        some = np.flatnonzero(np.bincount(index))
        if some.size > FEW:
            return cls(index, place, some, None)
        columns = np.empty((some.size, 2, index.size))
        columns[:, 1] = index == some[:, None]
        np.multiply(columns[:, 1], place, out=columns[:, 0])
        return cls(index, place, some, columns.reshape(2 * some.size, index.size).T)

    def part(self, rows: slice) -> Along:
        """Some of the points."""
        if self.columns is None:
            return Along.of(self.index[rows], self.place[rows])
        return Along(self.index[rows], self.place[rows], self.some, self.columns[rows])

    def lines(self, table: Array, out: Array, work: Array) -> Array:
        """Values at the points, (rows, n), of lines (k, 2, n) with their slopes and constants."""
        if self.columns is not None:
            some = table if self.some.size == len(table) else table[self.some]
            return np.matmul(self.columns, some.reshape(-1, table.shape[2]), out)
        rows_of(table[:, 0], self.index, out=out)
        out *= self.place[:, None]
        out += rows_of(table[:, 1], self.index, out=work)
        return out
