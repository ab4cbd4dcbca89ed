"""Which rows of a grid of cells are names, units and numbers: the one finder of all formats."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.table import (
    NUMBER,
    Cell,
    Column,
    Table,
    bare_unit,
    is_stamp,
    labels,
    parse,
)
from mfd_bayes.units import DIMENSIONS, UNREAD, measure

Row = Sequence[Cell]

ENOUGH = 40  # numbers of a table that is surely more than a few settings
TABLE = 20  # so many rows of numbers are a table by themselves
STEPS = 5  # steps of a column that show that it is a time
SEARCHED = 200  # filled rows, from the first, in which the names are looked for
_MISSING = frozenset(("nan", "na", "n/a", "n.a.", "null", "none", "inf", "infinity"))
# Ratios, rates and masses do not show that a row holds units: "1", "cycles" or "t" may be text.
_TELLING = {dimension.measure for dimension in DIMENSIONS.values()} - {"ratio", "rate", "mass"}
_TELLING |= {"acceleration", "length / time ** 2"}
_ACCELERATION = re.compile(r"%?\s*g|gals?|(?:[cm]?m|in|ft)/s(?:ec)?\^?2", re.IGNORECASE)  # no gram


@dataclass(frozen=True)
class Layout:
    """Rows of a table, from 0: its names and units, if it has any, and its first numbers."""

    names: int | None
    units: int | None  # right below the names
    data: int
    share: float  # numbers over filled cells
    count: int  # numbers, up to the next row without any

    @property
    def weight(self) -> float:
        """Share of numbers, times how many there are where these are few."""
        return self.share * min(self.count, ENOUGH)


def kinds(row: Row) -> str:
    """Of each cell, whether it is a number, "n", a text, "t", or empty, "-"."""
    return "".join(
        "-" if c in (None, "") else "t" if isinstance(c, str) and not NUMBER.fullmatch(c) else "n"
        for c in row
    )


def find_table(rows: Sequence[Row], *, exact: bool = False) -> Layout | None:
    """Layout of the table that weighs most, or else of the longest block of rows of numbers.

    A table is a row of at least two names, perhaps a row of units, and a row with a number; the
    fewer numbers it has, the less it counts, so that titles and settings above it ("Rate 1024") do
    not win. With `exact`, a row beyond whose end the numbers go on is a title too. Of tables with
    the same names the first is taken: a heading may stand above every block.
    """
    rows = rows[:SEARCHED]
    kind = [kinds(row) for row in rows]
    numbers = [k.count("n") for k in kind]
    filled = [len(k) - k.count("-") for k in kind]
    tables: list[Layout] = []
    for at in range(len(rows) - 1):
        if numbers[at] or filled[at] < 2:
            continue
        has_units = not numbers[at + 1] and gives_units(rows[at + 1], rows[at])
        data = at + 1 + has_units
        end = numbers.index(0, data) if 0 in numbers[data:] else len(rows)
        if end > data and (not exact or len(_cells(rows[at])) >= len(_cells(rows[data]))):
            count = sum(numbers[data:end])
            share = count / sum(filled[data:end])
            tables.append(Layout(at, at + 1 if has_units else None, data, share, count))
    if tables:
        best = max(tables, key=lambda table: (table.weight, table.count))
        return next(t for t in tables if rows[t.names or 0] == rows[best.names or 0])
    blocks: list[Layout] = []
    for (width, bare), group in groupby(range(len(rows)), lambda i: (filled[i], numbers[i] >= 2)):
        block = list(group)
        if bare:
            count = sum(numbers[i] for i in block)
            blocks.append(Layout(None, None, block[0], count / (width * len(block)), count))
    return max(blocks, key=lambda block: block.count, default=None)


def gives_units(row: Row, names: Row) -> bool:
    """Whether a row holds two units or more below names, and at least as many units as words."""
    under = [at for at, cell in enumerate(row) if cell not in (None, "")]
    if any(at >= len(names) or names[at] in (None, "") for at in under):
        return False
    units = [unit for cell in row if isinstance(cell, str) and (unit := bare_unit(cell))]
    unread = sum(len(unit) > 1 and unit.lower() in UNREAD for unit in units)
    measures = ["acceleration" if _ACCELERATION.fullmatch(u) else measure(u) for u in units]
    telling = sum(of in _TELLING for of in measures) + unread
    return telling >= 2 and 2 * (measures.count(None) - unread) <= len(under)


@dataclass(frozen=True)
class Grid:
    """Cells of a file or a sheet: its rows, perhaps only the first ones, and their numbers."""

    path: Path
    rows: Sequence[Row]
    numbers: Sequence[int]
    word: str = "line"
    sheet: str = ""

    def place(self, row: int) -> str:
        """Name of a row: "line 17"."""
        return f"{self.word} {self.numbers[row]}"

    def refusal(self, what: str) -> RecordError:
        """Error for a grid that may hold more than one table."""
        of = f"{self.sheet} of {self.path}" if self.sheet else self.path
        return RecordError(f"{of} holds more than one table: {what}: keep one table in a file")

    def table(
        self,
        layout: Layout,
        heading: tuple[Sequence[str], Row] | None = None,
        columns: Sequence[Column] | None = None,
        **more: Any,
    ) -> Table:
        """Table of a layout; `more` goes to the table.

        `heading` are names and units that do not stand in the layout's rows; `columns` are all
        numbers, where nothing stands between them.
        """
        rows, data = self.rows, layout.data
        first = rows[data] if data < len(rows) else ()
        if heading is not None:
            names, units = heading
            at = list(range(len(names)))
        else:
            title: Row = () if layout.names is None else _cells(rows[layout.names])
            units = () if layout.units is None else rows[layout.units]
            kind = kinds(first)
            at = [
                k
                for k in range(max(len(title), len(kind)))
                if (k < len(title) and title[k] is not None)
                or kind[k : k + 1] == "n"
                or (not title and kind[k : k + 1] == "t")
            ]
            texts = [" ".join(str(title[k] or "").split()) if k < len(title) else "" for k in at]
            names = labels(texts, [k + 1 for k in at])
        headed = heading is not None or layout.names is not None
        notes = self._above(data, names, headed=headed)
        body: Sequence[int] = range(data, len(self.numbers))
        blocks: dict[int, str] = {}
        if columns is None:
            body, blocks, footer = self._body(layout, len(names))
            notes += footer
        blank = "" if self.word == "line" else None  # of a short row
        cells: dict[str, Column] = {}
        given = {}
        first = rows[body[0]] if len(body) else ()
        for name, k in zip(names, at, strict=True):
            if columns is None:
                cells[name] = [rows[i][k] if k < len(rows[i]) else blank for i in body]
            else:
                cells[name] = columns[k]
            if k < len(first) and is_stamp(first[k]):
                given[name] = "s"
            elif k < len(units) and (unit := bare_unit(str(units[k] or ""))):
                given[name] = unit
        head = tuple(
            " ".join(f"{c:g}" if isinstance(c, float) else str(c) for c in row if c is not None)
            for row in rows[:data]
        )
        return Table(
            self.path,
            cells,
            [self.numbers[row] for row in body],
            (f"{self.word} ", f" of {self.sheet}" if self.sheet else ""),
            given,
            [k + 1 for k in at],
            headed,
            blocks,
            notes=tuple(notes),
            **{**more, "head": more.get("head") or head},
        )

    def _body(self, layout: Layout, width: int) -> tuple[list[int], dict[int, str], list[str]]:
        """Rows of numbers; the first below a repeated heading, to its place; a note on a footer.

        Rows that hold words where the first has its first number, and that stand together, are a
        heading where they hold the row of names, with no other than the same row of units below
        it. Others are kept, and refused once a column of them is read.
        """
        rows, data = self.rows, layout.data
        names = None if layout.names is None else _cells(rows[layout.names])
        units = None if layout.units is None else _cells(rows[layout.units])
        first = rows[data] if data < len(rows) else ()
        numbers = (k for k, cell in enumerate(first) if kinds([cell]) == "n" or is_stamp(cell))
        column = next(numbers, 0)
        words = [at for at in range(data, len(rows)) if _is_text(rows[at], column)]
        dropped: set[int] = set()
        below: dict[int, str] = {}
        notes = []
        for _, pairs in groupby(enumerate(words), lambda pair: pair[1] - pair[0]):
            group = [at for _, at in pairs]
            if _goes_on(rows, group[0], data):
                continue
            texts, end = [_cells(rows[at]) for at in group], group[-1] + 1
            again = names in texts and texts[texts.index(names) + 1 :] in ([], [units])
            if end == len(rows) or again:
                dropped.update(group)
                below[end] = self.place(group[0])
            elif any(_shared(text, names) >= 2 for text in texts):
                what = "has other units, or the names in another order"
                raise self.refusal(f"the heading at {self.place(group[0])} {what}")
            if end == len(rows) and names not in texts and "n" in "".join(map(kinds, texts)):
                if len(group) >= TABLE:
                    raise self.refusal(f"from {self.place(group[0])}, rows begin with words")
                notes = [f"{self.place(group[0])} and below: numbers below the table, not used"]
        kept = [at for at in range(data, len(rows)) if at not in dropped]
        while kept and len(rows[kept[-1]]) != width and "n" not in kinds(rows[kept[-1]]):
            kept.pop()  # other text below the numbers
        return kept, {n: below[at] for n, at in enumerate(kept) if at in below}, notes

    def _above(self, data: int, names: Row, *, headed: bool) -> list[str]:
        """Sentences on rows of numbers above a table, which are not used.

        Refused where they are so many, or so like the table's, that they may be a table too.
        """
        notes = []
        kind = [kinds(row) for row in self.rows[:data]]
        for has_numbers, group in groupby(range(data), lambda at: kind[at].count("n") >= 2):
            if not has_numbers:
                continue
            members = list(group)
            first, last = members[0], members[-1]
            where = self.place(first)
            if last > first:
                where = f"{self.word}s {self.numbers[first]} to {self.numbers[last]}"
            above = range(max(first - 2, 0), first)
            titles = [self.rows[at] for at in above if len(kind[at].strip("-")) > 1]
            bare = "t" not in "".join(kind[first : last + 1])
            alike = len(members) > 2 and len(kind[first].rstrip("-")) == len(names)
            if (
                len(members) >= TABLE
                or (bare and not titles and (alike or not headed))
                or any(_shared(row, names) >= 2 for row in titles)
            ):
                raise self.refusal(f"{where} hold numbers, and others begin at {self.place(data)}")
            if bare or len(members) > 2:
                notes.append(f"{where}: numbers above the table, not used")
        return notes


def _is_text(row: Row, column: int) -> bool:
    """Whether a row holds words where the first row has its first number."""
    cell = row[column] if column < len(row) else None
    if cell in (None, ""):
        return any(map(_is_word, row[: column + 1]))
    return _is_word(cell) or (kinds([cell]) == "t" and any(map(_is_word, row[:column])))


def _is_word(cell: Cell) -> bool:
    """Whether a cell holds words, and no mark of a number that is missing, nor a time stamp."""
    text = cell.strip().lower() if isinstance(cell, str) else ""
    return bool(re.match(r"[^\W\d_]|[*%]", text)) and text not in _MISSING and not is_stamp(text)


def _goes_on(rows: Sequence[Row], at: int, start: int) -> bool:
    """Whether a column counts on into a row by the step of those above: it is a measurement."""
    if at < start + STEPS:
        return False
    for column in zip(*rows[at - STEPS : at + 1], strict=False):
        steps = np.diff(parse([str(cell).replace(",", ".") for cell in column]))
        if np.all(np.isfinite(steps)) and 0.0 < steps.max() < 2.0 * steps.min():
            return True
    return False


def _shared(row: Row, names: Row | None) -> int:
    """How many names of the table a row holds too, as a heading in another order does."""
    return sum(cell not in (None, "") and cell in names for cell in row) if names else 0


def _cells(row: Row) -> list[Cell]:
    """Cells of a row, without empty ones at its end."""
    return list(row[: len(kinds(row).rstrip("-"))])
