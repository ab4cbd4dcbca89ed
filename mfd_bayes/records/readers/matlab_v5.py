"""Vectors out of MATLAB files of version 5, which `save` writes by default (``-v6``, ``-v7``).

The file is a row of elements, each a type, a size and that many bytes; a variable is an element
of elements, and may be deflated. Nothing is looked at but arrays of real numbers, and those in
structs; whatever else there is, is passed over by its size, and no object is made.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.bounds import UNPACKED, unpacks_to_too_much

Numbers = NDArray[np.generic]

_MB = 2**20
_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_TYPES = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
_STRUCT = 2
_NUMERIC = range(6, 16)
_COMPLEX = 0x08
_ORDERS = {b"IM": "<", b"MI": ">"}
_MOST_FIELDS = 10_000


class _BrokenError(Exception):
    """What is no element of a MATLAB file."""


class _TooMuchError(Exception):
    """A file that unpacks to more than is read."""


@dataclass(frozen=True)
class _Matrix:
    """A variable, or a field: what it is, and the elements that hold its content."""

    kind: int
    is_complex: bool
    shape: tuple[int, ...]
    name: str
    content: Iterator[tuple[int, memoryview]]

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    @property
    def is_vector(self) -> bool:
        return self.size > 1 and max(self.shape) == self.size


def open_columns(
    path: Path,
) -> tuple[tuple[str, ...], Callable[[Sequence[str]], dict[str, Numbers]]]:
    """Names of a file's vectors, and what gives their numbers.

    Raises
    ------
    RecordError
        When the file is no such file, or unpacks to more than `UNPACKED`.
    """
    if path.stat().st_size > UNPACKED * _MB:
        raise _too_much(path)
    data = memoryview(path.read_bytes())
    order = _ORDERS.get(bytes(data[126:_HEADER]))
    try:
        if order is None:
            raise _BrokenError
        columns = dict(_vectors(data[_HEADER:], order))
    except (_BrokenError, zlib.error) as error:
        raise RecordError(f"{path} is not a MATLAB file, v5 or v7.3, that can be read") from error
    except _TooMuchError:
        raise _too_much(path) from None
    return tuple(columns), lambda wanted: {name: columns[name] for name in wanted}


def _too_much(path: Path) -> RecordError:
    return unpacks_to_too_much(path, "save only the test's own columns")


def _vectors(data: memoryview, order: str) -> Iterator[tuple[str, Numbers]]:
    """Names and numbers of all vectors, those of a struct's fields as ``struct.field``."""
    left = UNPACKED * _MB
    for kind, content in _elements(data, order):
        if kind == _COMPRESSED:
            unpacked = zlib.decompressobj().decompress(content, left + 1)
            left -= len(unpacked)
            if left < 0:
                raise _TooMuchError
            kind, content = next(_elements(memoryview(unpacked), order), (0, content))
        if kind == _MATRIX:
            yield from _columns(content, order)


def _columns(data: memoryview, order: str) -> Iterator[tuple[str, Numbers]]:
    matrix = _matrix(data, order)
    if matrix is None:
        return
    if matrix.kind == _STRUCT and matrix.size == 1:
        for field, content in _fields(matrix, order):
            inner = _matrix(content, order)
            if inner is not None and inner.is_vector and inner.kind in _NUMERIC:
                yield from _numbers(inner, order, f"{matrix.name}.{field}")
    elif matrix.kind in _NUMERIC and matrix.is_vector:
        yield from _numbers(matrix, order, matrix.name)


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Types and contents, one after the other; each begins at a multiple of eight bytes."""
    at = 0
    while at + 8 <= len(data):
        kind, size = (int(n) for n in np.frombuffer(data[at : at + 8], f"{order}u4"))
        begin = at + 8
        if kind >> 16:  # four bytes or fewer, packed into the second half
            kind, size, begin = kind & 0xFFFF, kind >> 16, at + 4
            if size > 4:
                raise _BrokenError
        if begin + size > len(data):
            raise _BrokenError
        yield kind, data[begin : begin + size]
        # What is deflated is followed by the next element without padding.
        at = max(at + 8, begin + size if kind == _COMPRESSED else -(-(begin + size) // 8) * 8)


def _matrix(data: memoryview, order: str) -> _Matrix | None:
    """Variable of an element's content, or None where it is no array, as an object."""
    parts = _elements(data, order)
    flags = _integers(next(parts, None), order, "u4")
    if len(flags) != 2:
        raise _BrokenError
    kind, is_complex = flags[0] & 0xFF, bool(flags[0] >> 8 & _COMPLEX)
    if kind not in _NUMERIC and kind != _STRUCT:
        return None
    shape = tuple(_integers(next(parts, None), order, "i4"))
    if not shape or min(shape) < 0:
        raise _BrokenError
    _, name = next(parts, (0, data[:0]))
    return _Matrix(kind, is_complex, shape, _text(name), parts)


def _fields(matrix: _Matrix, order: str) -> Iterator[tuple[str, memoryview]]:
    """Names and contents of a struct's fields."""
    (length,) = _integers(next(matrix.content, None), order, "i4")[:1] or [0]
    _, names = next(matrix.content, (0, memoryview(b"")))
    if length <= 0 or len(names) // length > _MOST_FIELDS:
        raise _BrokenError
    for at in range(0, len(names) - length + 1, length):
        kind, content = next(matrix.content, (0, names[:0]))
        if kind != _MATRIX:
            raise _BrokenError
        if len(content):  # an empty field may have no content at all
            yield _text(names[at : at + length]), content


def _numbers(matrix: _Matrix, order: str, name: str) -> Iterator[tuple[str, Numbers]]:
    """Name and numbers of a real vector; numbers of complex ones are no column."""
    if matrix.is_complex:
        return
    kind, content = next(matrix.content, (0, memoryview(b"")))
    code = _TYPES.get(kind)
    if code is None or len(content) != matrix.size * np.dtype(code).itemsize:
        raise _BrokenError
    yield name, np.frombuffer(content, f"{order}{code}")


def _integers(element: tuple[int, memoryview] | None, order: str, code: str) -> list[int]:
    if element is None or len(element[1]) % 4 or len(element[1]) > 4 * 32:
        raise _BrokenError
    return [int(n) for n in np.frombuffer(element[1], f"{order}{code}")]


def _text(content: memoryview) -> str:
    return bytes(content).split(b"\0")[0].decode("utf-8", "replace")
