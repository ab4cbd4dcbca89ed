"""Columns out of Excel workbooks (.xlsx)."""

from __future__ import annotations

import datetime
import warnings
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from mfd_bayes.errors import RecordError
from mfd_bayes.records.motion import Array
from mfd_bayes.records.readers.archive import CELLS, check_archive, too_many_cells
from mfd_bayes.records.readers.cells import (
    as_number,
    is_number,
    missing_library,
    not_a_number,
    unreadable,
)
from mfd_bayes.records.readers.labels import labels
from mfd_bayes.records.readers.layout import (
    SEARCHED,
    Layout,
    body_of,
    find_layout,
    find_numbers,
    first_of,
    is_word,
    left_out,
    units_of,
)
from mfd_bayes.records.readers.table import Table

Cells = tuple[Any, ...]

_OLE = bytes.fromhex("D0CF11E0")  # first bytes of old .xls workbooks and of encrypted ones


@dataclass(frozen=True, eq=False)
class _Sheet:
    """Table of a sheet."""

    path: Path
    number: int  # of the sheet, from 0
    title: str
    columns: dict[str, int]  # name to number, from 1
    rows: list[tuple[int, Cells]]  # row number in the sheet, from 1, and cells; no blank rows

    def place(self, row: int) -> str:
        return f"row {self.rows[row][0]} of sheet {self.title!r}"

    def load(self, wanted: Sequence[str]) -> dict[str, Array]:
        """Numbers of columns that exist, down to the last row where one of them is filled."""
        columns = {name: self._cells(self.columns[name]) for name in wanted}
        size = max(map(_filled_to, columns.values()), default=0)
        return {name: self._numbers(name, cells[:size]) for name, cells in columns.items()}

    def patchy(self, wanted: Sequence[str]) -> dict[str, Array]:
        """As `load`, with NaN for cells that hold no finite number."""
        columns = {name: self._cells(self.columns[name]) for name in wanted}
        size = max(map(_filled_to, columns.values()), default=0)
        return {
            name: np.array([as_number(c) if _holds_number(c) else np.nan for c in cells[:size]])
            for name, cells in columns.items()
        }

    def _cells(self, column: int) -> list[Any]:
        return [cells[column - 1] if column <= len(cells) else None for _, cells in self.rows]

    def _numbers(self, name: str, cells: list[Any]) -> Array:
        for row, cell in enumerate(cells):
            if not _holds_number(cell) or not is_number(cell, finite=True):
                raise self._fault(name, row, cell)
        return np.array(cells, dtype=np.float64)

    def _fault(self, name: str, row: int, cell: object) -> RecordError:
        from openpyxl.utils import get_column_letter

        number, column = self.rows[row][0], self.columns[name]
        shown = _shown(cell)
        if cell is None and self._has_formula(number, column):
            shown = "a formula without a stored value; open the file in Excel and save it"
        place = f"cell {get_column_letter(column)}{number} of sheet {self.title!r}"
        return not_a_number(place, self.path, name, shown)

    def _has_formula(self, number: int, column: int) -> bool:
        """Whether a cell has a formula."""
        with _workbook(self.path, formulas=True) as workbook:
            rows = _filled_rows(self.path, workbook.worksheets[self.number])
            cells = next((cells for at, cells in rows if at == number), ())
        return column <= len(cells) and cells[column - 1] is not None


def read_excel(path: Path) -> Table:
    """Table of an .xlsx file: of the first sheet whose table holds numbers alone.

    Where there is no such sheet, of the one with the largest share of numbers; where no sheet has
    names above numbers, of the one with most rows of numbers. Columns without a name are called by
    their number, from A = 1. Formulas count with the values that Excel stored.
    """
    with _workbook(path) as workbook:
        number, layout, doubts = _find(path, workbook)
        sheet = workbook.worksheets[number]
        rows = list(_filled_rows(path, sheet))
    cells = [cells for _, cells in rows]
    layout = first_of(cells[:SEARCHED], layout, _holds_number)
    numbers = _columns(rows, layout)
    below = range(layout.data, len(rows))
    column = next((k for k, c in enumerate(cells[layout.data]) if _holds_number(c)), 0)
    words = [at for at in below if column < len(cells[at]) and _has_word(cells[at][: column + 1])]
    body = body_of(words, below, cells.__getitem__, cells[: layout.data], layout, _holds_number)
    places, headed = [f"row {at}" for at, _ in rows], layout.names is not None
    of = f"sheet {sheet.title!r} of {path}"
    names = cells[layout.data if layout.names is None else layout.names]
    notes = left_out(of, cells[: layout.data], body, places, names, headed, _holds_number)
    held = _Sheet(path, number, sheet.title, numbers, [rows[at] for at in body.rows])
    units_row = () if layout.units is None else rows[layout.units][1]
    units = units_of(
        list(numbers),
        [units_row[at - 1] if at <= len(units_row) else None for at in numbers.values()],
    )
    return Table(
        *(path, tuple(numbers), held.load, held.place, units),
        numbers=tuple(numbers.values()),
        headed=headed,
        blocks={row: places[at] for row, at in body.blocks.items()},
        notes=notes,
        doubts=doubts,
        patchy=held.patchy,
    )


def _has_word(cells: Cells) -> bool:
    """Whether the last cell is a word, or one before is and the last is empty."""
    return is_word(cells[-1]) or (cells[-1] is None and any(map(is_word, cells)))


def _columns(rows: Sequence[tuple[int, Cells]], layout: Layout) -> dict[str, int]:
    """Name to number, from 1, of the columns that have a name or a number below it."""
    heading = () if layout.names is None else rows[layout.names][1]
    first = rows[layout.data][1]
    found = {
        at + 1: "" if at >= len(heading) or heading[at] is None else " ".join(heading[at].split())
        for at in range(max(len(heading), len(first)))
        if (at < len(heading) and heading[at] is not None)
        or (at < len(first) and _holds_number(first[at]))
    }
    numbers = list(found)
    return dict(zip(labels(list(found.values()), numbers), numbers, strict=True))


@contextmanager
def _workbook(path: Path, *, formulas: bool = False) -> Iterator[Any]:
    """Workbook whose size was checked, open to be read row by row."""
    try:
        from openpyxl import load_workbook
    except ImportError as error:
        raise missing_library(path, "openpyxl", "excel") from error
    try:
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about styles and extensions
            check_archive(path, file)
            options = {"read_only": True, "keep_links": False}
            with closing(load_workbook(file, data_only=not formulas, **options)) as workbook:
                yield workbook
    except RecordError:
        raise
    except OSError as error:
        raise unreadable(path, error) from error
    except Exception as error:  # zipfile, the XML parser and openpyxl raise a dozen kinds
        raise RecordError(_not_a_workbook(path)) from error


def _not_a_workbook(path: Path) -> str:
    with path.open("rb") as file:
        if file.read(len(_OLE)) == _OLE:
            return f"{path} is an old .xls workbook or has a password; save it as .xlsx without one"
    return f"{path} is not an Excel workbook (.xlsx) that can be read"


def _find(path: Path, workbook: Any) -> tuple[int, Layout, tuple[str, ...]]:
    """Number of the first sheet whose table weighs most, the layout of that table, and doubts.

    Other sheets with the same names may hold the rest of the test.
    """
    heads = [
        [cells for _, cells in islice(_filled_rows(path, sheet), SEARCHED)]
        for sheet in workbook.worksheets
    ]
    named = [
        (number, layout)
        for number, head in enumerate(heads)
        if (layout := find_layout(head, _holds_number)) is not None
    ]
    bare = [(n, b) for n, h in enumerate(heads) if (b := find_numbers(h, _holds_number))]
    if not (named or bare):
        held = "; ".join(
            f"sheet {sheet.title!r} {_described(head)}"
            for sheet, head in zip(workbook.worksheets[:5], heads, strict=False)
        )
        raise RecordError(f"{path} holds no row of two names or more above numbers: {held}")
    if not named:
        return *max(bare, key=lambda table: table[1].count), ()
    number, layout = max(named, key=lambda table: table[1].weight)
    names = heads[number][layout.names or 0]
    alike = [
        repr(workbook.worksheets[n].title)
        for n, other in named
        if n != number and heads[n][other.names or 0] == names
    ]
    have, are = ("has", "is") if len(alike) == 1 else ("have", "are")
    doubt = (
        f"sheet {workbook.worksheets[number].title!r} is read; {', '.join(alike[:4])} "
        f"{have} the same columns, and {are} not"
    )
    return number, layout, (doubt,) if alike else ()


def _described(head: list[Cells]) -> str:
    if not head:
        return "is empty"
    first = ", ".join(_shown(cell) for cell in head[0][:4] if cell is not None)
    return f"begins with {first}"


def _filled_rows(path: Path, sheet: Any) -> Iterator[tuple[int, Cells]]:
    """Number, from 1, and cells of the rows of a sheet that are not blank."""
    sheet.reset_dimensions()  # those that the sheet declares may be false
    count = 0
    for number, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        count += max(len(row), 1)
        if count > CELLS:
            raise too_many_cells(path)
        cells = tuple((c.strip() or None) if isinstance(c, str) else c for c in row)
        if any(cell is not None for cell in cells):
            yield number, cells


def _filled_to(cells: list[Any]) -> int:
    """Number of cells down to the last that is not blank."""
    return next((row + 1 for row in reversed(range(len(cells))) if cells[row] is not None), 0)


def _holds_number(cell: object) -> bool:
    return type(cell) in (int, float)


def _shown(cell: object) -> str:
    match cell:
        case None:
            return "an empty cell"
        case bool():
            return str(cell).upper()
        case str():
            return f"the text {cell[:40]!r}"
        case datetime.date() | datetime.time() | datetime.timedelta():
            return f"the date or time {cell}; format the column as numbers"
    return repr(cell)[:40]
