"""Tables I and II as an Excel workbook."""

from __future__ import annotations

import io
import math
from typing import Any

from mfd_bayes.evaluation.views import CampaignView, Row
from mfd_bayes.reporting.noises import others_text
from mfd_bayes.reporting.paper_tables import Line, PaperTable, paper_tables
from mfd_bayes.reporting.symbols import printable

NARROW, WIDEST = 11.0, 60.0
"""Widths of a column of numbers, and the most of one of texts, in letters."""

HEAD = 48.0
"""Height of the row of heads, which are written in several lines, pt."""

DIGITS = 4
"""Digits of a number that a cell shows; the cell holds all of them."""


def excel_tables(view: CampaignView) -> bytes:
    """A workbook (.xlsx) with a sheet for each of Tables I and II, in the units of the view.

    Median and bounds of each value stand in columns of their own, as numbers.
    """
    from openpyxl import Workbook

    book = Workbook()
    book.remove(book.active)
    book.properties.creator = "mfd_bayes"
    for name, table in zip(("Table I", "Table II"), paper_tables(view), strict=True):
        _fill(book.create_sheet(name), table)
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def _fill(sheet: Any, table: PaperTable) -> None:
    """Fill a sheet: a row of heads, then a row for each quantity."""
    heads = [f"{head}: {what}" for head in table.heads for what in ("median", "2.5 %", "97.5 %")]
    _put(sheet, ["quantity", "meaning", "unit", *heads, "note"])
    for line in table.lines:
        numbers = [value for row in line.values for value in _numbers(row)]
        text = _note(line)
        _put(sheet, [line.symbol.text, line.meaning, line.unit, *numbers, text])
    _lay_out(sheet)


def _note(line: Line) -> str:
    """Notes of a quantity's values, each with its tests, and the values under other noises."""
    rows = [row for row in line.values if row is not None]
    tests: dict[str, list[str]] = {}
    for row in rows:
        if row.note:
            tests.setdefault(row.note, []).append(row.subject)
    notes = (
        note if len(found) == len(line.values) else f"{note} ({', '.join(found)})"
        for note, found in tests.items()
    )
    return "; ".join((*notes, *(f"{r.subject} with {others_text(r)}" for r in rows if r.others)))


def _lay_out(sheet: Any) -> None:
    """Make heads and notes readable, on the screen and on paper."""
    from openpyxl.styles import Alignment, Font
    from openpyxl.utils import get_column_letter

    texts = (1, 2, 3, sheet.max_column)
    for column in range(1, sheet.max_column + 1):
        letter = get_column_letter(column)
        longest = max(len(str(cell.value or "")) for cell in sheet[letter][1:])
        width = min(longest + 2.0, WIDEST) if column in texts else NARROW
        sheet.column_dimensions[letter].width = max(width, NARROW)
        head = sheet.cell(1, column)
        head.font = Font(bold=True)
        head.alignment = Alignment(vertical="top", wrap_text=True)
    sheet.row_dimensions[1].height = HEAD
    sheet.freeze_panes = "D2"
    sheet.page_setup.orientation = "landscape"
    sheet.print_title_rows, sheet.print_title_cols = "1:1", "A:A"


def _put(sheet: Any, values: list[str | float | None]) -> None:
    """Append a row; a text stays a text, also one that looks like a formula."""
    at = sheet.max_row + 1 if sheet.cell(1, 1).value is not None else 1
    for column, value in enumerate(values, start=1):
        cell = sheet.cell(at, column)
        if isinstance(value, str):
            cell.value = printable(value)
            cell.data_type = "s"
        elif value is not None:
            cell.value = value
            cell.number_format = _format(value)


def _format(value: float) -> str:
    """Format of a cell that shows some digits of a number: "0.00" of 12.3456."""
    if not 1e-4 <= abs(value) < 1e6:
        return "General" if value == 0.0 else f"0.{'0' * (DIGITS - 1)}E+00"
    places = max(DIGITS - 1 - math.floor(math.log10(abs(value))), 0)
    return f"0.{'0' * places}" if places else "0"


def _numbers(row: Row | None) -> list[float | None]:
    values = (math.nan,) * 3 if row is None else (row.median, row.lower, row.upper)
    return [value if math.isfinite(value) else None for value in values]
