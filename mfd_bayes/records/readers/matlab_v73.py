"""Vectors out of MATLAB files of version 7.3, which are HDF5."""

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

if TYPE_CHECKING:
    import h5py

Numbers = NDArray[np.generic]


def open_columns(
    path: Path,
) -> tuple[tuple[str, ...], Callable[[Sequence[str]], dict[str, Numbers]]]:
    """Names of a file's vectors, and a function that reads their numbers."""
    with _opened(path) as file:
        places = dict(_vectors(file))

    def read(wanted: Sequence[str]) -> dict[str, Numbers]:
        with _opened(path) as file:
            for name in wanted:
                check_pieces(file[places[name]])
            return {name: np.asarray(file[places[name]][()]) for name in wanted}

    return tuple(places), read


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


def _vectors(file: h5py.File) -> Iterator[tuple[str, str]]:
    """Names and places of all vectors, those of a struct's fields as ``struct.field``."""
    import h5py

    for name, item in file.items():
        if name.startswith("#"):  # the contents of cells and objects
            continue
        if isinstance(item, h5py.Group) and "MATLAB_sparse" not in item.attrs:
            fields = ((f"{name}.{field}", inner) for field, inner in item.items())
            yield from ((full, inner.name) for full, inner in fields if _is_column(inner))
        elif _is_column(item):
            yield name, item.name


def _is_column(item: object) -> bool:
    import h5py

    if not isinstance(item, h5py.Dataset) or item.dtype.kind not in "fiub":
        return False
    if "MATLAB_empty" in item.attrs or _class_of(item) in ("char", "cell"):
        return False
    shape = item.shape or ()
    return bool(shape) and item.size > 1 and max(shape) == item.size


def _class_of(item: h5py.Dataset) -> str:
    """MATLAB's class of the array, "double", "char", …; empty where the file has none."""
    found = item.attrs.get("MATLAB_class", b"")
    return found.decode("ascii", "replace") if isinstance(found, bytes) else str(found)
