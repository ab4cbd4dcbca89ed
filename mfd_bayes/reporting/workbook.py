"""Tables I and II as an Excel workbook."""

from __future__ import annotations

import io
import math
from typing import Any

from mfd_bayes.assessment.views import CampaignView, Row
from mfd_bayes.reporting.noises import others_text
from mfd_bayes.reporting.paper_tables import PaperTable, paper_tables
from mfd_bayes.reporting.symbols import printable

_WIDE = 30


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
        rows = [row for row in line.values if row is not None]
        notes = dict.fromkeys(row.note for row in rows if row.note)
        others = (f"{row.subject} with {others_text(row)}" for row in rows if row.others)
        text = "; ".join((*notes, *others))
        _put(sheet, [line.symbol.text, line.meaning, line.unit, *numbers, text])
    sheet.freeze_panes = "B2"
    for column in "AB":
        sheet.column_dimensions[column].width = _WIDE


def _put(sheet: Any, values: list[str | float | None]) -> None:
    """Append a row; a text stays a text, also one that looks like a formula."""
    at = sheet.max_row + 1 if sheet.cell(1, 1).value is not None else 1
    for column, value in enumerate(values, start=1):
        cell = sheet.cell(at, column)
        if isinstance(value, str):
            cell.value = printable(value)
            cell.data_type = "s"
        else:
            cell.value = value


def _numbers(row: Row | None) -> list[float | None]:
    values = (math.nan,) * 3 if row is None else (row.median, row.lower, row.upper)
    return [value if math.isfinite(value) else None for value in values]
