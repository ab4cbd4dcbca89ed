"""Columns of numbers out of CSV, JSON and MATLAB files."""

from __future__ import annotations

import csv
import json
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Table:
    """What a file holds, read on demand so that unused columns may hold anything.

    Attributes
    ----------
    path : Path
    names : tuple of str
        Columns, in the file's order.
    load : callable
        Takes names that exist; gives their numbers, checked cell by cell.
    place : callable
        Takes a row, from 0; says where that is in the file: ``"line 17"``.
    """

    path: Path
    names: tuple[str, ...]
    load: Callable[[Sequence[str]], dict[str, Array]]
    place: Callable[[int], str]

    def columns(self, names: Sequence[str]) -> dict[str, Array]:
        """Columns by name, each (T,), in the file's units.

        Raises
        ------
        RecordError
            When a column is missing, named twice, empty, of another length,
            or holds text or a value that is not finite.
        """
        for name in names:
            if self.names.count(name) != 1:
                fault = "missing column" if name not in self.names else "more than one column"
                raise RecordError(f"{fault} {name!r} in {self.path}; it has {_listed(self.names)}")
        columns = self.load(names)
        sizes = {name: column.size for name, column in columns.items()}
        if len(set(sizes.values())) > 1:
            lengths = ", ".join(f"{name} {size}" for name, size in sizes.items())
            raise RecordError(f"columns of {self.path} have different lengths: {lengths}")
        if 0 in sizes.values():
            raise RecordError(f"{self.path} has columns but no data")
        return columns


def read_table(path: Path) -> Table:
    """Table of a .csv, .txt, .json or .mat file.

    Raises
    ------
    RecordError
        When the file cannot be read, is empty, or is not what its suffix says.
    """
    suffix = path.suffix.lower()
    if suffix not in _FORMATS:
        raise RecordError(
            f"{path} has the unknown suffix {suffix!r}; expected {', '.join(_FORMATS)}"
        )
    try:
        if path.stat().st_size == 0:
            raise RecordError(f"{path} is empty")
        return _FORMATS[suffix](path)
    except (OSError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise RecordError(f"cannot read {path}: {reason}") from error


def column_names(path: Path) -> tuple[str, ...]:
    """Names of the columns that a file holds; raises as `read_table` does."""
    return read_table(path).names


def read_columns(path: Path, names: Sequence[str]) -> dict[str, Array]:
    """Named columns of a file, each (T,); raises as `read_table` and `Table.columns` do."""
    return read_table(path).columns(names)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordError(f"{path} is not UTF-8 text, as a {path.suffix} file must be") from error


def _csv_table(path: Path) -> Table:
    lines = _text(path).split("\n")
    kept = [i for i, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")]
    if not kept:
        raise RecordError(f"{path} is empty")
    header = lines[kept[0]]
    comma = next((sign for sign in (",", "\t", ";") if sign in header), ",")
    names = tuple(_cells(header, comma))
    if all(_is_number(name) for name in names):
        raise RecordError(f"{path} has no header: line {kept[0] + 1} holds numbers, not names")
    for i in kept[1:]:
        if lines[i].count(comma) >= len(names) and len(_cells(lines[i], comma)) > len(names):
            raise RecordError(
                f"line {i + 1} of {path} has more cells than the header's {len(names)} columns"
            )
    text = "\n".join(lines[i] for i in kept[1:])

    def place(row: int) -> str:
        return f"line {kept[row + 1] + 1}"

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        return _csv_columns(path, text, names, wanted, comma, place)

    return Table(path, names, load, place)


def _cells(line: str, comma: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=comma))]


def _csv_columns(
    path: Path,
    text: str,
    names: tuple[str, ...],
    wanted: Sequence[str],
    comma: str,
    place: Callable[[int], str],
) -> dict[str, Array]:
    import pandas as pd

    if not text:
        return {name: np.empty(0) for name in wanted}
    positions = [names.index(name) for name in wanted]
    options: dict[str, Any] = {
        "sep": comma,
        "header": None,
        "names": list(range(len(names))),
        "usecols": sorted(set(positions)),
        "index_col": False,
        "skipinitialspace": True,
    }
    try:
        frame = pd.read_csv(StringIO(text), dtype=np.float64, **options)
        columns = {name: frame[at].to_numpy() for name, at in zip(wanted, positions, strict=True)}
        if all(np.all(np.isfinite(column)) for column in columns.values()):
            return columns
    except (ValueError, OverflowError, pd.errors.ParserError):
        pass  # the slow way below says where and what
    try:
        cells = pd.read_csv(StringIO(text), dtype=str, keep_default_na=False, **options)
    except (ValueError, pd.errors.ParserError) as error:
        reason = str(error).splitlines()[0]
        raise RecordError(f"{path} is not a table of separated columns: {reason}") from error
    row, name = min(
        (_first_bad(cells[at]), name) for name, at in zip(wanted, positions, strict=True)
    )
    if row == len(cells):
        raise RecordError(f"{path} holds numbers that cannot be read")
    raise RecordError(_bad_cell(path, place(row), name, cells[names.index(name)].iloc[row]))


def _first_bad(cells: Any) -> int:
    """First row whose text is not a finite number, or the number of rows."""
    bad = (row for row, cell in enumerate(cells) if not _is_number(cell, finite=True))
    return next(bad, len(cells))


def _is_number(text: object, *, finite: bool = False) -> bool:
    try:
        value = float(text)  # type: ignore[arg-type]  # what is no number is caught
    except (TypeError, ValueError):
        return False
    # Python's float accepts 1_000; a table's number has no underscore.
    return "_" not in str(text) and (not finite or math.isfinite(value))


def _json_table(path: Path) -> Table:
    try:
        content = json.loads(_text(path))
    except (ValueError, RecursionError) as error:
        raise RecordError(f"{path} is not valid JSON: {error}") from error
    columns = _json_columns(path, content)
    if not columns:
        raise RecordError(f"{path} holds no columns; expected an object of lists")

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        return {name: _json_numbers(path, name, columns[name]) for name in wanted}

    return Table(path, tuple(columns), load, _sample)


def _json_columns(path: Path, content: object) -> dict[str, list[Any]]:
    """Columns of name → list, of a list of rows, or of pandas' "columns" and "split" forms."""
    match content:
        case {"columns": [*names], "data": [*rows]}:
            return _from_rows(path, [_row(names, row) for row in rows])
        case [*rows]:
            return _from_rows(path, rows)
        case {}:
            columns = {k: _in_order(v) for k, v in content.items() if isinstance(v, dict | list)}
            indices = {tuple(sorted(v)) for v in content.values() if isinstance(v, dict)}
            if len(indices) > 1:
                raise RecordError(f"columns of {path} have different lengths or row labels")
            return columns
    raise RecordError(f"{path} must hold an object of lists or a list of objects")


def _row(names: list[Any], row: object) -> object:
    if isinstance(row, list) and len(row) == len(names):
        return {str(name): cell for name, cell in zip(names, row, strict=True)}
    return row


def _from_rows(path: Path, rows: list[Any]) -> dict[str, list[Any]]:
    names: dict[str, None] = {}
    for i, row in enumerate(rows):
        if not isinstance(row, dict):
            raise RecordError(f"row {i + 1} of {path} must be an object with one value per column")
        names.update(dict.fromkeys(row))
    return {name: [row.get(name) for row in rows] for name in names}


def _in_order(column: dict[str, Any] | list[Any]) -> list[Any]:
    """Cells in row order; sorted by label where the labels count 0, 1, 2 … in some order."""
    if isinstance(column, list):
        return column
    labels = [str(i) for i in range(len(column))]
    return [column[k] for k in (labels if set(labels) == set(column) else column)]


def _json_numbers(path: Path, name: str, cells: list[Any]) -> Array:
    for i, cell in enumerate(cells):
        if type(cell) not in (int, float) or not math.isfinite(cell):
            raise RecordError(_bad_cell(path, _sample(i), name, "null" if cell is None else cell))
    return np.array(cells, dtype=np.float64)


def _mat_table(path: Path) -> Table:
    from pymatreader import read_mat

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about objects that are no columns anyway
            content = read_mat(path)
    except Exception as error:  # scipy and h5py raise a dozen kinds on a broken file
        raise RecordError(f"{path} is not a MATLAB file, v5 or v7.3, that can be read") from error
    columns = _mat_columns(content)
    if not columns:
        raise RecordError(f"{path} holds no numeric column")

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        return {name: _mat_numbers(path, name, columns[name]) for name in wanted}

    return Table(path, tuple(columns), load, _sample)


def _mat_columns(content: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
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


def _mat_numbers(path: Path, name: str, values: NDArray[Any]) -> Array:
    column = values.astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(column))
    if bad.size:
        raise RecordError(_bad_cell(path, _sample(int(bad[0])), name, column[bad[0]]))
    return column


def _sample(row: int) -> str:
    return f"sample {row + 1}"


def _bad_cell(path: Path, place: str, name: str, found: object) -> str:
    text = str(found).strip()
    shown = repr(text[:40]) if text else "an empty cell"
    return f"{place} of {path}, column {name!r}: expected a finite number, found {shown}"


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(islice(names, 20))
    return shown if len(names) <= 20 else f"{shown} and {len(names) - 20} more"


_FORMATS: dict[str, Callable[[Path], Table]] = {
    ".csv": _csv_table,
    ".txt": _csv_table,
    ".json": _json_table,
    ".mat": _mat_table,
}
