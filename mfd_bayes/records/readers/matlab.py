"""Columns out of MATLAB files, v5 and v7.3: vectors and matrices, in structs too."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.child import Content, UnreadableError, read_in_child
from mfd_bayes.records.readers.table import COLUMNS, Table

SIGNALS, SAMPLES = 32, 20
"""Most signals of a matrix and fewest samples of each; another matrix is left out."""

_HDF5 = b"\x89HDF\r\n\x1a\n"
_USER_BLOCK = 512  # bytes of text before the HDF5 part of a v7.3 file
_DEEPEST = 4  # structs in structs

Arrays = Iterator[tuple[str, NDArray[np.generic]]]


def read_matlab(path: Path) -> Table:
    """Table of a .mat file: vectors, columns of matrices, fields of structs as ``struct.field``."""
    import scipy.io  # noqa: F401  # a copy of this process has it then

    kind = "a MATLAB file, v5 or v7.3,"
    facts, arrays = read_in_child(_arrays, path, kind, library="h5py")
    if not arrays:
        raise RecordError(f"{path} holds no numeric column")
    columns = {
        name: arrays[str(k)].astype(np.float64, copy=False) for k, name in enumerate(facts["names"])
    }
    return Table(path, columns, head=tuple(facts["settings"]))


def _arrays(path: Path) -> Content:
    """Signals of a file and their names, and its scalars as "name: value"."""
    with path.open("rb") as file:
        head = file.read(_USER_BLOCK + len(_HDF5))
    signals: dict[str, NDArray[np.generic]] = {}
    settings = []
    variables = _v73(path) if head.startswith(_HDF5) or head.endswith(_HDF5) else _v5(path)
    for name, array in variables:
        if array.size == 1:
            settings.append(f"{name}: {array.reshape(-1)[0]:.9g}")
        elif array.size and max(array.shape) == array.size:
            signals[name] = array.reshape(-1)
        elif array.ndim == 2 and max(array.shape) >= SAMPLES and min(array.shape) <= SIGNALS:
            upright = array.shape[0] >= array.shape[1]  # signals run along the longer side
            for k, signal in enumerate(array.T if upright else array, start=1):
                signals[f"{name}(:,{k})" if upright else f"{name}({k},:)"] = signal
    if len(signals) > COLUMNS:
        signals = {name: array for name, array in signals.items() if not name.endswith(")")}
    arrays = {str(k): array for k, array in enumerate(signals.values())}
    return {"names": list(signals), "settings": settings}, arrays


def _v5(path: Path) -> Arrays:
    """Name and numbers of each array of numbers in a file of version 5."""
    from scipy.io import loadmat

    for name, value in loadmat(path, struct_as_record=True).items():
        if not name.startswith("__"):
            yield from _inside(name, value, 0)


def _inside(name: str, value: Any, depth: int) -> Arrays:
    """A variable's numbers, or those of its fields; Simulink's label follows a signal's name."""
    if not isinstance(value, np.ndarray):
        return
    if value.dtype.names is None:
        if value.dtype.kind in "fiub":
            yield name, value
        return
    if depth >= _DEEPEST or value.size > SIGNALS:
        return
    for number, element in enumerate(value.reshape(-1), start=1):
        place = f"{name}({number})" if value.size > 1 else name
        fields = dict(zip(value.dtype.names, element, strict=True))
        label: Any = fields.get("label")
        words = ""
        if isinstance(label, np.ndarray) and label.dtype.kind == "U" and label.size == 1:
            words = f" {str(label.reshape(-1)[0]).strip()}".rstrip()
        for field, content in fields.items():
            own = words if field == "values" else ""
            yield from _inside(f"{place}.{field}{own}", content, depth + 1)


def _v73(path: Path) -> Arrays:
    """Name and numbers of each array of numbers in a file of version 7.3, which is HDF5."""
    os.environ["HDF5_PLUGIN_PRELOAD"] = "::"  # a plugin would be foreign code
    import h5py

    with h5py.File(path, "r") as file:
        yield from _group(h5py, file, "", 0)


def _group(h5py: Any, group: Any, above: str, depth: int) -> Arrays:
    """Arrays of a group of HDF5; one that leads to another file is refused."""
    for name in group:
        if name.startswith("#"):  # the contents of cells and objects
            continue
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise UnreadableError(f"has a link to elsewhere, {name[:60]!r}")
        item = group[name]
        if isinstance(item, h5py.Group):
            if depth < _DEEPEST and "MATLAB_sparse" not in item.attrs:
                yield from _group(h5py, item, f"{above}{name}.", depth + 1)
        elif isinstance(item, h5py.Dataset):
            if item.is_virtual or item.external:
                raise UnreadableError(f"takes {name[:60]!r} from another file")
            kind = item.attrs.get("MATLAB_class", b"")
            numeric = item.dtype.kind in "fiub" and bytes(kind) not in (b"char", b"cell")
            if numeric and item.shape and "MATLAB_empty" not in item.attrs:
                yield above + name, np.asarray(item[()]).T  # in MATLAB's order
