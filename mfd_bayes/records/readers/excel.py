"""The sheets of Excel workbooks (.xlsx) as grids of cells."""

from __future__ import annotations

import datetime
import warnings
from pathlib import Path
from typing import Any

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.child import Content, UnreadableError, read_in_child
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
    with path.open("rb") as file:
        if file.read(len(_OLE)) == _OLE:
            raise RecordError(
                f"{path} is an old .xls workbook or has a password; save it as .xlsx without one"
            )
    kind = "an Excel workbook (.xlsx)"
    facts, _ = read_in_child(_sheets, path, kind, library="openpyxl", extra="excel")
    layouts = {}
    for sheet, (_, rows) in enumerate(facts["sheets"]):
        if (layout := find_table([cells for _, cells in rows])) is not None:
            layouts[sheet] = layout
    if not layouts:
        held = "; ".join(
            f"sheet {title!r} begins with "
            + ", ".join([repr(cell) for cell in rows[0][1] if cell is not None][:4])
            if rows
            else f"sheet {title!r} is empty"
            for title, rows in facts["sheets"][:5]
        )
        raise RecordError(f"{path} holds no row of two names or more above numbers: {held}")
    best = max(layouts, key=lambda sheet: (layouts[sheet].names is not None, layouts[sheet].weight))

    def names_of(sheet: int) -> Any:
        at = layouts[sheet].names
        return None if at is None else facts["sheets"][sheet][1][at][1]

    names = names_of(best)
    alike = [k for k in layouts if k != best and names is not None and names_of(k) == names]
    title, rows = facts["sheets"][best]
    doubts: tuple[str, ...] = ()
    if alike:
        others = ", ".join(repr(facts["sheets"][k][0]) for k in alike[:4])
        have, are = ("has", "is") if len(alike) == 1 else ("have", "are")
        doubts = (f"sheet {title!r} is read; {others} {have} the same columns, and {are} not",)
    cells, places = [row for _, row in rows], [f"row {number}" for number, _ in rows]
    return table_of(path, cells, places, layouts[best], sheet=f"sheet {title!r}", doubts=doubts)[0]


def _sheets(path: Path) -> Content:
    """Title of each sheet, and number and cells of its rows that are not blank."""
    from openpyxl import load_workbook

    warnings.simplefilter("ignore")  # about styles and extensions
    workbook = load_workbook(path, read_only=True, keep_links=False, data_only=True)
    sheets: list[tuple[str, list[tuple[int, list[Any]]]]] = []
    count = 0
    for sheet in workbook.worksheets:
        sheet.reset_dimensions()  # those that the sheet declares may be false
        rows = []
        for number, row in enumerate(sheet.iter_rows(values_only=True), start=1):
            count += max(len(row), 1)
            if count > CELLS:
                raise UnreadableError(
                    f"has more than {CELLS:,} cells, the most that is read; save the sheet as .csv"
                )
            cells = [_plain(cell) for cell in row]
            if any(cell is not None for cell in cells):
                rows.append((number, cells))
        sheets.append((sheet.title, rows))
    if any(None in cells for _, rows in sheets for _, cells in rows):
        formulas = load_workbook(path, read_only=True, keep_links=False)
        for (_, rows), sheet in zip(sheets, formulas.worksheets, strict=True):
            sheet.reset_dimensions()
            given = dict(enumerate(sheet.iter_rows(values_only=True), start=1))
            for number, cells in rows:
                for at, formula in enumerate(given.get(number, ())[: len(cells)]):
                    if cells[at] is None and str(formula or "")[:1] == "=":
                        cells[at] = _FORMULA
    return {"sheets": sheets}, {}


def _plain(cell: Any) -> Cell:
    """A cell as a number or a text: time stamps as texts."""
    match cell:
        case str():
            return cell.strip() or None
        case datetime.timedelta():
            seconds, micros = divmod(round(cell.total_seconds() * 1e6), 10**6)
            return f"{seconds // 3600}:{seconds // 60 % 60:02}:{seconds % 60:02}.{micros:06}"
        case bool():
            return str(cell).upper()
        case int() | float():
            return float(cell)
    return None if cell is None else str(cell)
