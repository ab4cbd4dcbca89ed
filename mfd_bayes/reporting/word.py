"""Tables I and II as a Word document."""

from __future__ import annotations

import io
import string
from collections.abc import Iterator, Mapping
from itertools import count, product
from typing import Any

from mfd_bayes.evaluation.views import CampaignView, Row
from mfd_bayes.reporting.noises import others_text
from mfd_bayes.reporting.paper_tables import Line, PaperTable, Symbol, paper_tables
from mfd_bayes.reporting.symbols import number, printable

COLUMNS = 3
"""Most columns of values in one table, so that it fits the width of a page."""

MARGIN, UNIT, VALUE = 0.75, 0.8, 1.3
"""Margins of a page, and widths of the columns, in; the first column has the rest of the page."""

SIZE, SMALL = 9.0, 7.5
"""Sizes of the font of a table, and of meanings and intervals in it, pt."""


def word_tables(view: CampaignView) -> bytes:
    """A Word document (.docx) with Tables I and II, in the units of the view.

    Every part of a table begins a page of its own, and is as wide as the page.
    """
    from docx import Document

    document = Document()
    document.core_properties.author = "mfd_bayes"
    for section in document.sections:
        section.left_margin = section.right_margin = _inches(MARGIN)
        section.top_margin = section.bottom_margin = _inches(MARGIN)
    document.add_heading(printable(view.title), level=1)
    for first, table in zip((True, False), paper_tables(view), strict=True):
        _add_table(document, table, at_the_top=first)
    stream = io.BytesIO()
    document.save(stream)
    return stream.getvalue()


def _add_table(document: Any, table: PaperTable, *, at_the_top: bool) -> None:
    """Add a table in parts of some columns, each with its title and the notes."""
    marks = dict(zip(table.notes, _marks(), strict=False))
    begins = range(0, len(table.heads), COLUMNS)
    for part, begin in enumerate(begins, start=1):
        which = f" ({part} of {len(begins)})" if len(begins) > 1 else ""
        title = document.add_paragraph(f"{table.title}{which}", style="Caption")
        title.paragraph_format.page_break_before = not at_the_top or part > 1
        title.paragraph_format.keep_with_next = True
        _add_part(document, table, slice(begin, begin + COLUMNS), marks)
        for note, mark in marks.items():
            paragraph = document.add_paragraph()
            paragraph.paragraph_format.space_after = 0
            _raised(paragraph, mark)
            _small(paragraph.add_run(f" {note[:1].upper()}{note[1:]}."))


def _marks() -> Iterator[str]:
    """Letters for notes: a to z, then aa, ab, and so on."""
    for length in count(1):
        yield from map("".join, product(string.ascii_lowercase, repeat=length))


def _add_part(document: Any, table: PaperTable, columns: slice, marks: Mapping[str, str]) -> None:
    """Add some columns of a table."""
    heads = ("Quantity", "Unit", *table.heads[columns])
    grid = document.add_table(rows=1, cols=len(heads), style="Light List")
    grid.autofit = False
    for cell, head in zip(grid.rows[0].cells, heads, strict=True):
        cell.text = head
    _repeat(grid.rows[0])
    for line in table.lines:
        row = grid.add_row()
        _whole(row)
        _fill(row.cells, line, columns, marks)
    values = len(heads) - 2
    left = document.sections[0].page_width.inches - 2 * MARGIN - UNIT - values * VALUE
    for column, width in zip(grid.columns, (left, UNIT, *[VALUE] * values), strict=True):
        _set_width(column, _inches(width))


def _fill(cells: Any, line: Line, columns: slice, marks: Mapping[str, str]) -> None:
    """Fill a row: symbol and meaning, unit, and the values."""
    first, unit, *others = cells
    _write(first.paragraphs[0], line.symbol)
    if line.meaning:
        _small(first.add_paragraph().add_run(line.meaning))
    unit.text = line.unit
    for cell, row in zip(others, line.values[columns], strict=True):
        _put_value(cell, row, marks)


def _write(paragraph: Any, symbol: Symbol) -> None:
    """Write a symbol with its subscripts."""
    for text, low in symbol.parts:
        run = paragraph.add_run(text)
        run.font.subscript = low


def _put_value(cell: Any, row: Row | None, marks: Mapping[str, str]) -> None:
    """Median with the letter of its note, below it the interval and values of other noises."""
    first, *others = value_lines(row)
    paragraph = cell.paragraphs[0]
    paragraph.add_run(first)
    if row is not None and (mark := marks.get(printable(row.note))):
        _raised(paragraph, mark)
    for text in others:
        _small(cell.add_paragraph().add_run(text))


def value_lines(row: Row | None) -> tuple[str, ...]:
    """Median, interval and values under other noises: "1.23", "[1.10, 1.38]"."""
    if row is None:
        return ("–",)
    own = number(row.median, 3), f"[{number(row.lower, 3)}, {number(row.upper, 3)}]"
    return (*own, *filter(None, (others_text(row),)))


def _raised(paragraph: Any, text: str) -> None:
    paragraph.add_run(text).font.superscript = True


def _small(run: Any) -> None:
    from docx.shared import Pt

    run.font.size = Pt(SMALL)
    run.bold = False


def _inches(width: float) -> Any:
    from docx.shared import Inches

    return Inches(width)


def _set_width(column: Any, width: Any) -> None:
    """Set the width of each cell, as Word and LibreOffice read it, and the cells' font."""
    from docx.shared import Pt

    column.width = width
    for cell in column.cells:
        cell.width = width
        for run in (run for paragraph in cell.paragraphs for run in paragraph.runs):
            run.font.size = run.font.size or Pt(SIZE)


def _repeat(row: Any) -> None:
    """Repeat a row at the top of each page that its table goes on to."""
    _whole(row)
    _property(row, "w:tblHeader")


def _whole(row: Any) -> None:
    """Keep a row on one page."""
    _property(row, "w:cantSplit")


def _property(row: Any, name: str) -> None:
    from docx.oxml import OxmlElement

    row._tr.get_or_add_trPr().append(OxmlElement(name))
