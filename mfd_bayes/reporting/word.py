"""Tables I and II as a Word document."""

from __future__ import annotations

import io
from typing import Any

from mfd_bayes.assessment.views import CampaignView, Row
from mfd_bayes.reporting.noises import others_text
from mfd_bayes.reporting.paper_tables import Line, PaperTable, Symbol, paper_tables
from mfd_bayes.reporting.symbols import number, printable

COLUMNS = 3
"""Most columns of values in one table, so that it fits the width of a page."""


def word_tables(view: CampaignView) -> bytes:
    """A Word document (.docx) with Tables I and II, in the units of the view."""
    from docx import Document

    document = Document()
    document.core_properties.author = "mfd_bayes"
    document.add_heading(printable(view.title), level=1)
    for table in paper_tables(view):
        for begin in range(0, len(table.heads), COLUMNS):
            _add(document, table, slice(begin, begin + COLUMNS))
        for note in table.notes:
            document.add_paragraph(f"{note[:1].upper()}{note[1:]}.")
    stream = io.BytesIO()
    document.save(stream)
    return stream.getvalue()


def _add(document: Any, table: PaperTable, columns: slice) -> None:
    """Add some columns of a table, with its title."""
    document.add_paragraph(table.title, style="Caption")
    heads = ("Quantity", "Unit", *table.heads[columns])
    grid = document.add_table(rows=1, cols=len(heads), style="Light List")
    for cell, head in zip(grid.rows[0].cells, heads, strict=True):
        cell.text = head
    for line in table.lines:
        _fill(grid.add_row().cells, line, columns)


def _fill(cells: Any, line: Line, columns: slice) -> None:
    """Fill a row: symbol and meaning, unit, and the values."""
    first, unit, *others = cells
    _write(first.paragraphs[0], line.symbol)
    if line.meaning:
        first.add_paragraph(line.meaning)
    unit.text = line.unit
    for cell, row in zip(others, line.values[columns], strict=True):
        cell.text = _value(row)


def _write(paragraph: Any, symbol: Symbol) -> None:
    """Write a symbol with its subscripts."""
    for text, low in symbol.parts:
        run = paragraph.add_run(text)
        run.font.subscript = low


def _value(row: Row | None) -> str:
    """Median and interval, such as "1.23 [1.10, 1.38]", and those under other noises."""
    if row is None:
        return "–"
    own = f"{number(row.median, 3)} [{number(row.lower, 3)}, {number(row.upper, 3)}]"
    return "; ".join(filter(None, (own, others_text(row))))
