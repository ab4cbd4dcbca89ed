"""Columns out of JSON: an object of lists, a list of objects or of rows, or a form of pandas."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mfd_bayes.errors import RecordError
from mfd_bayes.records.numbers import why_invalid
from mfd_bayes.records.readers.table import Column, Table, bare_unit, check_names, labels
from mfd_bayes.records.readers.time_stamps import is_stamp

SIZE, LISTS, CELLS = 64, 1_000_000, 20_000_000
"""Largest file, MB, most lists and objects of it, and most cells where its rows are objects."""


def read_json(path: Path) -> Table:
    """Table of a .json file; numbers and texts next to the columns are its settings."""
    size = path.stat().st_size / 2**20
    if size > SIZE:
        raise RecordError(f"{path} has {size:,.0f} MB; at most {SIZE} MB of a .json file are read")
    try:
        text = path.read_text(encoding="utf-8-sig")
        if text.count("[") + text.count("{") > LISTS:
            raise RecordError(
                f"{path} holds more than {LISTS:,} lists and objects, the most that are read; "
                "expected one list for each column"
            )
        content = json.loads(text)
    except UnicodeDecodeError as error:
        raise RecordError(f"{path} is not UTF-8 text, as a .json file must be") from error
    except (ValueError, RecursionError) as error:
        raise RecordError(f"{path} is not valid JSON: {why_invalid(error)}") from error
    bare = isinstance(content, list) and bool(content) and isinstance(content[0], list)
    whole: dict[str, Any] = content if isinstance(content, dict) else {}
    match content:
        case [[*cells], *_]:
            columns = _of_rows(path, content, labels([""] * len(cells)))
        case {"columns": [*names], "data": [*lines]}:
            columns = _of_rows(path, lines, [str(name) for name in names])
        case [*lines]:
            columns = _of_rows(path, lines)
        case {}:
            columns = {k: v for k, v in whole.items() if isinstance(v, dict | list)}
        case _:
            raise RecordError(f"{path} must hold an object of lists or a list of objects")
    rows: dict[str, frozenset[str]] = {}  # labels of the rows of columns that have them
    for name, column in columns.items():
        if isinstance(column, dict):
            numbers = [str(i) for i in range(len(column))]
            order = numbers if set(numbers) == set(column) else list(column)
            columns[name] = [column[k] for k in order]
            rows[name] = frozenset(column)
    named = next((key for key in ("units", "unit") if key in whole), "")
    given = whole.get(named)
    if isinstance(given, list):
        given = dict(zip([name for name in columns if name != named], given, strict=False))
    if isinstance(given, dict) and all(isinstance(unit, str) for unit in given.values()):
        columns = {name: column for name, column in columns.items() if name != named}
    else:
        given = {}
    if not columns:
        raise RecordError(f"{path} holds no columns; expected an object of lists")
    stamped = [name for name, cells in columns.items() if cells and is_stamp(cells[0])]
    units = {name: unit for name, text in given.items() if (unit := bare_unit(text))}

    def align(used: Mapping[str, Column]) -> Mapping[str, Column]:
        if len({rows[name] for name in used if name in rows}) > 1:
            raise RecordError(f"columns of {path} have different lengths or row labels")
        return used

    return Table(
        path,
        columns,
        units=units | dict.fromkeys(stamped, "s"),
        align=align,
        headed=not bare,
        head=tuple(f"{k}: {v}" for k, v in whole.items() if type(v) in (int, float, str)),
    )


def _of_rows(path: Path, rows: list[Any], names: Sequence[str] | None = None) -> dict[str, Any]:
    """Columns of rows that are objects, or lists with a cell for each name."""
    every: dict[str, None] = {}
    for i, row in enumerate(rows):
        if names is not None and isinstance(row, list) and len(row) == len(names):
            rows[i] = row = dict(zip(names, row, strict=True))
        if not isinstance(row, dict):
            raise RecordError(f"row {i + 1} of {path} must be an object with one value per column")
        every.update(dict.fromkeys(row))
    check_names(path, [""] * len(every))
    if len(every) * len(rows) > CELLS:
        raise RecordError(
            f"{path} has {len(rows):,} rows of {len(every):,} columns; at most {CELLS:,} cells "
            "are read"
        )
    return {name: [row.get(name) for row in rows] for name in every}
