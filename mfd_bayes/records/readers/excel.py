"""The sheets of Excel workbooks (.xlsx) as grids of cells."""

from __future__ import annotations

import datetime
import warnings
from pathlib import Path
from typing import Any

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.child import (
    Content,
    UnreadableError,
    import_library,
    read_in_child,
)
from mfd_bayes.records.readers.grid import find_table, table_of
from mfd_bayes.records.readers.table import Cell, Table

CELLS = 2_000_000  # most cells of a workbook: eight minutes of four columns at 1024 Hz
_OLE = bytes.fromhex("D0CF11E0")  # first bytes of old .xls workbooks and of encrypted ones
_FORMULA = "(a formula without a stored value: save it in Excel)"


def read_excel(path: Path) -> Table:
    """Table of an .xlsx file: of the sheet whose table weighs most, of several alike the first.

    Columns without a name are called by their number, from A = 1. Formulas count with the values
    that Excel stored.
    """
    import_library(path, "openpyxl", "openpyxl", "excel")
    with path.open("rb") as file:
        if file.read(len(_OLE)) == _OLE:
            raise RecordError(
                f"{path} is an old .xls workbook or has a password; save it as .xlsx without one"
            )
    sheets = read_in_child(_sheets, path, "an Excel workbook (.xlsx)")[0]["sheets"]
    found = [
        (one, title, cells, [f"row {number}" for number, _ in rows])
        for title, rows in sheets
        if (one := find_table(cells := [row for _, row in rows])) is not None
    ]
    if not found:
        held = "; ".join(
            f"sheet {title!r} begins with "
            + ", ".join([repr(cell) for cell in rows[0][1] if cell is not None][:4])
            if rows
            else f"sheet {title!r} is empty"
            for title, rows in sheets[:5]
        )
        raise RecordError(f"{path} holds no row of two names or more above numbers: {held}")
    best = max(found, key=lambda one: (one[0].names is not None, one[0].weight))
    layout, title, rows, places = best
    alike = [
        repr(other)
        for one, other, cells, _ in found
        if other != title
        and layout.names is not None
        and one.names is not None
        and cells[one.names] == rows[layout.names]
    ]
    have, are = ("has", "is") if len(alike) == 1 else ("have", "are")
    doubt = (
        f"sheet {title!r} is read; {', '.join(alike[:4])} {have} the same columns, and {are} not"
    )
    return table_of(
        path,
        f"sheet {title!r} of {path}",
        rows,
        places,
        layout,
        place=lambda at: f"{places[at]} of sheet {title!r}",
        doubts=(doubt,) if alike else (),
    )[0]


def _sheets(path: Path) -> Content:
    """Title of each sheet, and number and cells of its rows that are not blank."""
    from openpyxl import load_workbook

    warnings.simplefilter("ignore")  # about styles and extensions
    values = load_workbook(path, read_only=True, keep_links=False, data_only=True)
    sheets: list[tuple[str, list[tuple[int, list[Any]]]]] = []
    count, lacking = 0, False
    for sheet in values.worksheets:
        sheet.reset_dimensions()  # those that the sheet declares may be false
        rows: list[tuple[int, list[Any]]] = []
        for number, row in enumerate(sheet.iter_rows(values_only=True), start=1):
            count += max(len(row), 1)
            if count > CELLS:
                raise UnreadableError(
                    f"has more than {CELLS:,} cells, the most that is read; save the sheet as .csv"
                )
            cells = [_plain(cell) for cell in row]
            if any(cell is not None for cell in cells):
                lacking = lacking or None in cells
                rows.append((number, cells))
        sheets.append((sheet.title, rows))
    if lacking:
        formulas = load_workbook(path, read_only=True, keep_links=False)
        for (_, rows), sheet in zip(sheets, formulas.worksheets, strict=True):
            sheet.reset_dimensions()
            given = dict(enumerate(sheet.iter_rows(values_only=True), start=1))
            for number, cells in rows:
                for at, formula in enumerate(given.get(number, ())):
                    if at < len(cells) and cells[at] is None and str(formula or "")[:1] == "=":
                        cells[at] = _FORMULA
    return {"sheets": sheets}, []


def _plain(cell: Any) -> Cell:
    """A cell as a number or a text: time stamps as texts."""
    match cell:
        case str():
            return cell.strip() or None
        case datetime.datetime():
            return str(cell)
        case datetime.timedelta():
            seconds, micros = divmod(round(cell.total_seconds() * 1e6), 10**6)
            return f"{seconds // 3600}:{seconds // 60 % 60:02}:{seconds % 60:02}.{micros:06}"
        case bool() | datetime.time() | datetime.date():
            return str(cell).upper()
        case int() | float():
            return float(cell)
    return None if cell is None else str(cell)
