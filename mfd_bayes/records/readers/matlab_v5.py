"""Vectors and matrices out of MATLAB files of version 5, which `save` writes by default.

A file is a sequence of elements: each a type, a size and that many bytes. A variable is an
element that holds elements, and may be deflated. Arrays of real numbers are read, and those in
structs; all else is skipped by its size. scipy's `loadmat` would build all else too: it needs
1.6 GB for a file of 264 bytes that declares a large cell array, and cells nested 100,000 deep
end its process.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.bounds import UNPACKED, unpacks_to_too_much
from mfd_bayes.records.readers.matrices import SIGNALS, signals_of

Numbers = NDArray[np.generic]

_MB = 2**20
_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_CODE = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_STRUCT, _CHAR = 2, 4
_DEEPEST = 2  # structs in structs: as in Simulink's structure with time
_LABEL = 200  # bytes of a label
_CODES = {
    **{kind: {"<": "utf-8", ">": "utf-8"} for kind in (1, 2, 16)},
    **{kind: {"<": "utf-16-le", ">": "utf-16-be"} for kind in (4, 17)},
}
_NUMERIC = range(6, 16)
_COMPLEX = 0x08
_ORDERS = {b"IM": "<", b"MI": ">"}
_MOST_FIELDS = 10_000
_NOTHING = memoryview(b"")
_WAY_OUT = "save only the test's own columns"


class _BrokenError(Exception):
    """An element that no MATLAB file holds."""


class _Matrix(NamedTuple):
    """A variable or a field: its class, and the elements that hold its content."""

    kind: int
    shape: tuple[int, ...]
    name: str
    content: Iterator[tuple[int, memoryview]]


def open_columns(
    path: Path,
) -> tuple[tuple[str, ...], Callable[[Sequence[str]], dict[str, Numbers]]]:
    """Names of a file's vectors, and a function that gives their numbers."""
    if path.stat().st_size > UNPACKED * _MB:
        raise unpacks_to_too_much(path, _WAY_OUT)
    data = memoryview(path.read_bytes())
    order = _ORDERS.get(bytes(data[126:_HEADER]))
    try:
        if order is None:
            raise _BrokenError
        columns = dict(_vectors(path, data[_HEADER:], order))
    except (_BrokenError, zlib.error) as error:
        raise RecordError(f"{path} is not a MATLAB file, v5 or v7.3, that can be read") from error
    return tuple(columns), lambda wanted: {name: columns[name] for name in wanted}


def _vectors(path: Path, data: memoryview, order: str) -> Iterator[tuple[str, Numbers]]:
    """Names and numbers of all vectors, those of a struct's fields as ``struct.field``."""
    left = UNPACKED * _MB
    for kind, content in _elements(data, order):
        if kind == _COMPRESSED:
            unpacked = zlib.decompressobj().decompress(content, left + 1)
            left -= len(unpacked)
            if left < 0:
                raise unpacks_to_too_much(path, _WAY_OUT)
            kind, content = next(_elements(memoryview(unpacked), order), (0, content))
        if kind == _MATRIX:
            yield from _columns(content, order)


def _columns(data: memoryview, order: str, field: str = "") -> Iterator[tuple[str, Numbers]]:
    """Name and numbers of a variable's signals, or of those of its fields."""
    matrix = _matrix(data, order)
    if matrix is None:
        return
    size = math.prod(matrix.shape)
    if matrix.kind == _STRUCT and 0 < size <= SIGNALS and field.count(".") < _DEEPEST:
        for number, element in enumerate(_structs(matrix, size, order), start=1):
            if field and "values" not in dict(element):  # no signal of Simulink's
                continue
            place = (field or matrix.name) + (f"({number})" if size > 1 else "")
            label = next(
                (_label(content, order) for name, content in element if name == "label"), ""
            )
            for name, content in element:
                full = f"{place}.{name}"
                for own, numbers in _columns(content, order, full):
                    yield (f"{own} {label}" if label and own == full else own), numbers
    elif matrix.kind in _NUMERIC and size > 1 and max(matrix.shape) * SIGNALS >= size:
        kind, content = next(matrix.content, (0, _NOTHING))
        code = _CODE.get(kind)
        if code is None or len(content) != size * np.dtype(code).itemsize:
            raise _BrokenError
        numbers = np.frombuffer(content, f"{order}{code}").reshape(matrix.shape, order="F")
        yield from signals_of(field or matrix.name, numbers)


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Type and content of each element; each begins at a multiple of eight bytes."""
    at = 0
    while at + 8 <= len(data):
        kind, size = (int(n) for n in np.frombuffer(data[at : at + 8], f"{order}u4"))
        begin = at + 8
        if kind >> 16:  # four bytes or fewer stand in the second half
            kind, size, begin = kind & 0xFFFF, kind >> 16, at + 4
            if size > 4:
                raise _BrokenError
        if begin + size > len(data):
            raise _BrokenError
        yield kind, data[begin : begin + size]
        # A deflated element is followed by the next one without padding.
        at = max(at + 8, begin + size if kind == _COMPRESSED else -(-(begin + size) // 8) * 8)


def _matrix(data: memoryview, order: str) -> _Matrix | None:
    """Real array or struct of an element's content; None for complex numbers and objects."""
    parts = _elements(data, order)
    flags = _integers(next(parts, None), order, "u4")
    if len(flags) != 2:
        raise _BrokenError
    kind, is_complex = flags[0] & 0xFF, bool(flags[0] >> 8 & _COMPLEX)
    if kind != _STRUCT and (kind not in _NUMERIC or is_complex):
        return None
    shape = tuple(_integers(next(parts, None), order, "i4"))
    if not shape or min(shape) < 0:
        raise _BrokenError
    _, name = next(parts, (0, _NOTHING))
    return _Matrix(kind, shape, _text(name), parts)


def _structs(matrix: _Matrix, size: int, order: str) -> Iterator[list[tuple[str, memoryview]]]:
    """Names and contents of the fields of each struct of an array."""
    (length,) = _integers(next(matrix.content, None), order, "i4")[:1] or [0]
    _, names = next(matrix.content, (0, _NOTHING))
    if length <= 0 or len(names) // length > _MOST_FIELDS:
        raise _BrokenError
    fields = [_text(names[at : at + length]) for at in range(0, len(names) - length + 1, length)]
    for _ in range(size):
        found = []
        for name in fields:
            kind, content = next(matrix.content, (0, _NOTHING))
            if kind != _MATRIX:
                raise _BrokenError
            if len(content):  # an empty field may have no content at all
                found.append((name, content))
        yield found


def _label(data: memoryview, order: str) -> str:
    """Text of a field, as Simulink labels a signal; empty where it holds none."""
    parts = _elements(data, order)
    flags = _integers(next(parts, None), order, "u4")
    shape = _integers(next(parts, None), order, "i4")
    _, (kind, content) = next(parts, None), next(parts, (0, _NOTHING))
    if not flags or flags[0] & 0xFF != _CHAR or min(shape, default=0) != 1 or kind not in _CODES:
        return ""
    return bytes(content)[:_LABEL].decode(_CODES[kind][order], "replace").replace("\0", "").strip()


def _integers(element: tuple[int, memoryview] | None, order: str, code: str) -> list[int]:
    if element is None or len(element[1]) % 4 or len(element[1]) > 4 * 32:
        raise _BrokenError
    return [int(n) for n in np.frombuffer(element[1], f"{order}{code}")]


def _text(content: memoryview) -> str:
    return bytes(content).split(b"\0")[0].decode("utf-8", "replace")
