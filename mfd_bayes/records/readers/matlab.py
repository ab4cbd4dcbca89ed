"""Columns out of MATLAB files, v5 and v7.3. scipy.io and h5py read .mat files here alone."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.cells import bad_cell, sample
from mfd_bayes.records.readers.table import Array, Table


def read_matlab(path: Path) -> Table:
    """Table of a .mat file: its vectors, and the fields of structs as ``struct.field``.

    Raises
    ------
    RecordError
        When the file is not MATLAB's, or holds no vector of numbers.
    """
    from pymatreader import read_mat

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about objects that are no columns anyway
            content = read_mat(path)
    except Exception as error:  # scipy and h5py raise a dozen kinds on a broken file
        raise RecordError(f"{path} is not a MATLAB file, v5 or v7.3, that can be read") from error
    columns = _columns(content)
    if not columns:
        raise RecordError(f"{path} holds no numeric column")

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        return {name: _numbers(path, name, columns[name]) for name in wanted}

    return Table(path, tuple(columns), load, sample)


def _columns(content: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Vectors, with the fields of a struct as ``struct.field``; anything else is left out."""
    flat: dict[str, Any] = {}
    for name, value in content.items():
        if isinstance(value, dict):
            flat |= {f"{name}.{field}": inner for field, inner in value.items()}
        else:
            flat[name] = value
    return {
        name: np.squeeze(value)
        for name, value in flat.items()
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and _is_vector(value)
    }


def _is_vector(value: NDArray[Any]) -> bool:
    return value.size > 0 and np.squeeze(value).ndim == 1


def _numbers(path: Path, name: str, values: NDArray[Any]) -> Array:
    column = values.astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(column))
    if bad.size:
        raise bad_cell(sample(int(bad[0])), path, name, column[bad[0]])
    return column
