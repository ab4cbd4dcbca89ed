"""Columns out of JSON: an object of lists, a list of objects or of rows, or a form of pandas."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mfd_bayes.errors import RecordError
from mfd_bayes.records.motion import Array
from mfd_bayes.records.numbers import why_invalid
from mfd_bayes.records.readers.bounds import CELLS, check_columns, read_json_text
from mfd_bayes.records.readers.cells import bad_cell, bare_unit, is_number, sample
from mfd_bayes.records.readers.labels import label
from mfd_bayes.records.readers.table import Table

_UNITS = ("units", "unit")


def read_json(path: Path) -> Table:
    """Table of a .json file."""
    try:
        content = json.loads(read_json_text(path))
    except UnicodeDecodeError as error:
        raise RecordError(f"{path} is not UTF-8 text, as a .json file must be") from error
    except (ValueError, RecursionError) as error:
        raise RecordError(f"{path} is not valid JSON: {why_invalid(error)}") from error
    columns = _columns(path, content)
    units = _units(content, list(columns))
    columns = {name: cells for name, cells in columns.items() if not (units and name in _UNITS)}
    if not columns:
        raise RecordError(f"{path} holds no columns; expected an object of lists")

    rows = _labels(content)

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        if len({rows[name] for name in wanted if name in rows}) > 1:
            raise RecordError(f"columns of {path} have different lengths or row labels")
        return {name: _numbers(path, name, columns[name]) for name in wanted}

    return Table(path, tuple(columns), load, sample, units, headed=not _is_bare(content))


def _units(content: object, names: list[str]) -> dict[str, str]:
    """Name to unit of an object that has "units": an object, or a list in the columns' order."""
    given = (
        next((content[k] for k in _UNITS if k in content), None)
        if isinstance(content, dict)
        else None
    )
    if isinstance(given, list):
        given = dict(zip((name for name in names if name not in _UNITS), given, strict=False))
    if not isinstance(given, dict) or not all(isinstance(u, str) for u in given.values()):
        return {}
    return {name: unit for name, text in given.items() if (unit := bare_unit(text))}


def _is_bare(content: object) -> bool:
    """Whether it is a list of rows without names."""
    return isinstance(content, list) and bool(content) and isinstance(content[0], list)


def _columns(path: Path, content: object) -> dict[str, list[Any]]:
    """Columns of an object of lists, a list of rows, or pandas' "columns" and "split" forms."""
    if _is_bare(content) and isinstance(content, list):
        check_columns(path, len(content[0]))
        names = [label(at + 1) for at in range(len(content[0]))]
        return _from_rows(path, [_row(names, row) for row in content])
    match content:
        case {"columns": [*names], "data": [*rows]}:
            return _from_rows(path, [_row(names, row) for row in rows])
        case [*rows]:
            return _from_rows(path, rows)
        case {}:
            return {k: _in_order(v) for k, v in content.items() if isinstance(v, dict | list)}
    raise RecordError(f"{path} must hold an object of lists or a list of objects")


def _labels(content: object) -> dict[str, tuple[str, ...]]:
    """Labels of the rows of each column that has them."""
    columns = content.items() if isinstance(content, dict) else ()
    return {name: tuple(sorted(column)) for name, column in columns if isinstance(column, dict)}


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
    check_columns(path, len(names))
    if len(names) * len(rows) > CELLS:
        raise RecordError(
            f"{path} has {len(rows):,} rows of {len(names):,} columns; at most {CELLS:,} cells "
            "are read"
        )
    return {name: [row.get(name) for row in rows] for name in names}


def _in_order(column: dict[str, Any] | list[Any]) -> list[Any]:
    """Cells in row order: by label where the labels are 0, 1, 2 …, else as they stand."""
    if isinstance(column, list):
        return column
    labels = [str(i) for i in range(len(column))]
    return [column[k] for k in (labels if set(labels) == set(column) else column)]


def _numbers(path: Path, name: str, cells: list[Any]) -> Array:
    for i, cell in enumerate(cells):
        if type(cell) not in (int, float) or not is_number(cell, finite=True):
            raise bad_cell(sample(i), path, name, "null" if cell is None else cell)
    return np.array(cells, dtype=np.float64)
