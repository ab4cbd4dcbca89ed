"""Columns out of MATLAB files, v5 and v7.3: vectors and matrices, in structs too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError
from mfd_bayes.records.motion import Array
from mfd_bayes.records.readers import matlab_v5, matlab_v73
from mfd_bayes.records.readers.bounds import COLUMNS
from mfd_bayes.records.readers.cells import bad_cell, sample
from mfd_bayes.records.readers.table import Table

_HDF5 = b"\x89HDF\r\n\x1a\n"
_USER_BLOCK = 512  # bytes of text before the HDF5 part of a v7.3 file


def read_matlab(path: Path) -> Table:
    """Table of a .mat file: vectors, columns of matrices, fields of structs as ``struct.field``."""
    with path.open("rb") as file:
        head = file.read(_USER_BLOCK + len(_HDF5))
    is_v73 = head.startswith(_HDF5) or head.endswith(_HDF5)
    names, read = (matlab_v73 if is_v73 else matlab_v5).open_columns(path)
    if len(names) > COLUMNS:
        names = tuple(name for name in names if not name.endswith(")"))  # vectors alone
    if not names:
        raise RecordError(f"{path} holds no numeric column")

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        return _checked(path, read(wanted))

    return Table(path, names, load, sample)


def _checked(path: Path, columns: Mapping[str, NDArray[np.generic]]) -> dict[str, Array]:
    """Columns as floats, all of them finite."""
    found = {}
    for name, values in columns.items():
        found[name] = values.reshape(-1).astype(np.float64)
        bad = np.flatnonzero(~np.isfinite(found[name]))
        if bad.size:
            raise bad_cell(sample(int(bad[0])), path, name, found[name][bad[0]])
    return found
