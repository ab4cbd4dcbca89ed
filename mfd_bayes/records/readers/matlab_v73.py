"""Vectors and matrices out of MATLAB files of version 7.3, which are HDF5."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.bounds import UNPACKED
from mfd_bayes.records.readers.hdf5 import UnsafeError, check_objects, check_pieces
from mfd_bayes.records.readers.matrices import names_of

if TYPE_CHECKING:
    import h5py

Numbers = NDArray[np.generic]


def open_columns(
    path: Path,
) -> tuple[tuple[str, ...], Callable[[Sequence[str]], dict[str, Numbers]]]:
    """Names of a file's vectors, and a function that reads their numbers."""
    with _opened(path) as file:
        places = {name: at for one in _vectors(file) for name, at in _places(*one)}

    def read(wanted: Sequence[str]) -> dict[str, Numbers]:
        with _opened(path) as file:
            for name in wanted:
                check_pieces(file[places[name][0]])
            return {name: _numbers(file, *places[name]) for name in wanted}

    return tuple(places), read


def _places(name: str, item: h5py.Dataset) -> Iterator[tuple[str, tuple[str, int]]]:
    """Name, place and number in its matrix, from 1, of each signal; of a vector the number is 0."""
    is_vector = max(item.shape) == item.size
    for number, signal in enumerate(names_of(name, item.shape[::-1]), start=1):  # MATLAB's order
        yield signal, (item.name, 0 if is_vector else number)


def _numbers(file: h5py.File, place: str, number: int) -> Numbers:
    """Numbers of a vector, or of a signal of a matrix, from 1."""
    item = file[place]
    if not number:
        return np.asarray(item[()])
    rows, columns = item.shape
    return np.asarray(item[number - 1] if columns >= rows else item[:, number - 1])


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """File, checked; its data are not read yet."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            check_objects(file, UNPACKED * 2**20)
            yield file
    except UnsafeError as error:
        raise RecordError(f"{path} {error}") from None
    except Exception as error:  # h5py raises a dozen kinds on a broken file
        raise RecordError(f"{path} is not a MATLAB file, v5 or v7.3, that can be read") from error


def _vectors(file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
    """Names and data sets of vectors and matrices, of a struct's fields as ``struct.field``."""
    import h5py

    for name, item in file.items():
        if name.startswith("#"):  # the contents of cells and objects
            continue
        if isinstance(item, h5py.Group) and "MATLAB_sparse" not in item.attrs:
            fields = ((f"{name}.{field}", inner) for field, inner in item.items())
            yield from ((full, inner) for full, inner in fields if _is_column(inner))
        elif _is_column(item):
            yield name, item


def _is_column(item: object) -> bool:
    import h5py

    if not isinstance(item, h5py.Dataset) or item.dtype.kind not in "fiub":
        return False
    if "MATLAB_empty" in item.attrs or _class_of(item) in ("char", "cell"):
        return False
    shape = item.shape or ()
    return bool(shape) and item.size > 1 and bool(names_of("", shape))


def _class_of(item: h5py.Dataset) -> str:
    """MATLAB's class of the array, "double", "char", …; empty where the file has none."""
    found = item.attrs.get("MATLAB_class", b"")
    return found.decode("ascii", "replace") if isinstance(found, bytes) else str(found)
