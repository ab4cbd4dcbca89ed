"""Which rows of a grid of cells are names, units and numbers: the one finder of all formats."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.table import NUMBER, Cell, Column, Table, bare_unit, labels, parse
from mfd_bayes.records.readers.time_stamps import is_stamp
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
    """Rows of a table, counted from 0, and how many of its cells hold numbers."""

    names: int | None  # None where no row of names stands above the numbers
    units: int | None  # right below the names
    data: int  # first row of numbers
    share: float  # numbers over filled cells
    count: int  # numbers, up to the next row without any

    @property
    def weight(self) -> float:
        """Share of numbers, times how many there are where these are few."""
        return self.share * min(self.count, ENOUGH)


def kinds(row: Row) -> str:
    """Of each cell, whether it is a number, "n", a text, "t", or empty, "-"."""
    match = NUMBER.fullmatch
    return "".join(
        [
            "-" if c is None or c == "" else "t" if isinstance(c, str) and not match(c) else "n"
            for c in row
        ]
    )


def find_table(rows: Sequence[Row], *, exact: bool = False) -> Layout | None:
    """Layout of the table that weighs most, or else of the longest block of rows of numbers.

    A table is a row of at least two names, perhaps a row of units, and a row with a number.
    Titles and settings above it ("Station", "Rate 1024") are no table, or a small one, which
    counts the less the fewer numbers it has. With `exact`, a row beyond whose end the numbers go on
    is a title too. Of tables with the same names the first is taken: a heading may stand above
    every block.
    """
    rows = rows[:SEARCHED]
    kind = [kinds(row) for row in rows]
    numbers = [k.count("n") for k in kind]
    filled = [len(k) - k.count("-") for k in kind]
    tables: list[Layout] = []
    for at in range(len(rows) - 1):
        if numbers[at] or filled[at] < 2:
            continue
        units = at + 1 if not numbers[at + 1] and gives_units(rows[at + 1], rows[at]) else None
        data = at + 1 if units is None else at + 2
        end = numbers.index(0, data) if 0 in numbers[data:] else len(rows)
        width = len(kind[data].rstrip("-")) if exact and data < len(rows) else 0
        if end > data and len(kind[at].rstrip("-")) >= width:
            count = sum(numbers[data:end])
            tables.append(Layout(at, units, data, count / sum(filled[data:end]), count))
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


def table_of(
    path: Path,
    rows: Sequence[Row],
    places: Sequence[str],
    layout: Layout,
    *,
    sheet: str = "",
    heading: tuple[Sequence[str], Row] | None = None,
    numbers: Sequence[Column] | None = None,
    blank: Cell = None,
    decimals: tuple[str, ...] = (".",),
    doubts: tuple[str, ...] = (),
    head: tuple[str, ...] = (),
) -> tuple[Table, Sequence[int]]:
    """Table of a grid whose layout is known, and its rows of numbers.

    Parameters
    ----------
    path : Path
    rows : sequence of rows
        With `numbers` perhaps only the first ones.
    places : sequence of str
        Name of each row in its file or sheet: "line 17".
    layout : Layout
    sheet : str
        Which sheet of the file it is.
    heading : (names, units), optional
        Of the columns, where they do not stand in the layout's rows.
    numbers : sequence of columns, optional
        All columns, where nothing stands between the numbers.
    blank : cell
        In place of a cell that a short row lacks.
    decimals, doubts, head
        As in `Table`.
    """
    of = f"{sheet} of {path}" if sheet else str(path)
    first = rows[layout.data] if layout.data < len(rows) else ()
    if heading is not None:
        names, units = heading
        at = list(range(len(names)))
    else:
        title: Row = () if layout.names is None else rows[layout.names]
        units = () if layout.units is None else rows[layout.units]
        filled, kind = len(kinds(title).rstrip("-")), kinds(first)
        at = [
            k
            for k in range(max(filled, len(kind)))
            if (k < filled and title[k] is not None)
            or kind[k : k + 1] == "n"
            or (not title and kind[k : k + 1] == "t")
        ]
        texts = [" ".join(str(title[k] or "").split()) if k < len(title) else "" for k in at]
        names = labels(texts, [k + 1 for k in at])
    headed = heading is not None or layout.names is not None
    body: Sequence[int] = range(layout.data, len(places))
    blocks: dict[int, str] = {}
    footer: list[int] = []
    if numbers is None:
        body, blocks, footer = _body(of, rows, places, layout, len(names))
    notes = _above(of, rows, places, layout.data, names, headed=headed)
    if len(footer) >= TABLE:
        raise RecordError(
            f"{of} holds more than one table: from {places[footer[0]]}, rows begin with words"
        )
    if footer:
        notes.append(f"{places[footer[0]]} and below: numbers below the table, not used")
    cells: dict[str, Column] = {}
    for name, k in zip(names, at, strict=True):
        if numbers is None:
            cells[name] = [rows[i][k] if k < len(rows[i]) else blank for i in body]
        else:
            cells[name] = numbers[k]
    first = rows[body[0]] if len(body) else ()
    stamped = [
        name for name, k in zip(names, at, strict=True) if k < len(first) and is_stamp(first[k])
    ]
    stated = {
        name: unit
        for name, k in zip(names, at, strict=True)
        if k < len(units) and (unit := bare_unit(str(units[k] or "")))
    }
    above = (
        " ".join(f"{c:g}" if isinstance(c, float) else str(c) for c in row if c is not None)
        for row in rows[: layout.data]
    )
    table = Table(
        path,
        cells,
        [f"{places[row]} of {sheet}" if sheet else places[row] for row in body],
        units=stated | dict.fromkeys(stamped, "s"),
        numbers=tuple(k + 1 for k in at),
        headed=headed,
        blocks=blocks,
        notes=tuple(notes),
        doubts=doubts,
        decimals=decimals,
        head=head or tuple(above),
    )
    return table, body


def _body(
    of: str, rows: Sequence[Row], places: Sequence[str], layout: Layout, width: int
) -> tuple[list[int], dict[int, str], list[int]]:
    """Rows of numbers; of these the first below a repeated heading, to its place; and the footer.

    Rows of text that stand together are a heading where they hold the row of names, or begin as
    the rows above the table do; below the names, only the same row of units may stand. All others
    are kept, and refused once a column of them is read.
    """
    names, units = (None if k is None else _filled(rows[k]) for k in (layout.names, layout.units))
    beginnings = {_beginning(row) for row in rows[: layout.names or 0]}
    first = rows[layout.data] if layout.data < len(rows) else ()
    column = next((k for k, cell in enumerate(first) if kinds([cell]) == "n" or is_stamp(cell)), 0)
    words = [at for at in range(layout.data, len(rows)) if _is_text(rows[at], column)]
    dropped: set[int] = set()
    below: dict[int, str] = {}  # row below a repeated heading, to the heading's place
    footer: list[int] = []
    for _, pairs in groupby(enumerate(words), lambda pair: pair[1] - pair[0]):
        group = [at for _, at in pairs]
        if _goes_on(rows, group[0], layout.data):
            continue
        texts, end = [_filled(rows[at]) for at in group], group[-1] + 1
        again = names in texts and texts[texts.index(names) + 1 :] in ([], [units])
        if end == len(rows):
            dropped.update(group)
            if names not in texts and any("n" in kinds(text) for text in texts):
                footer = group
        elif again or all(_beginning(t) in beginnings and _shared(t, names) == 0 for t in texts):
            dropped.update(group)
            below[end] = places[group[0]]
        elif any(_shared(text, names) >= 2 for text in texts):
            raise RecordError(
                f"{of} has another heading at {places[group[0]]}, with other units, or with its "
                "names in another order: keep one table in a file"
            )
    kept = [at for at in range(layout.data, len(rows)) if at not in dropped]
    while kept and len(rows[kept[-1]]) != width and "n" not in kinds(rows[kept[-1]]):
        kept.pop()  # other text below the numbers
    return kept, {n: below[at] for n, at in enumerate(kept) if at in below}, footer


def _above(
    of: str, rows: Sequence[Row], places: Sequence[str], data: int, names: Row, *, headed: bool
) -> list[str]:
    """Sentences on rows of numbers above a table, which are not used.

    Refused where there are so many that they are a table too, or such as it has, and it has no
    names to tell them apart.
    """
    notes = []
    kind = [kinds(row) for row in rows[:data]]
    for has_numbers, group in groupby(range(data), lambda at: kind[at].count("n") >= 2):
        members = list(group)
        if not has_numbers:
            continue
        first, last = members[0], members[-1]
        where = places[first]
        if last > first:
            where = f"{where.replace(' ', 's ', 1)} to {places[last].split(' ')[1]}"
        titles = [
            rows[at] for at in range(max(first - 2, 0), first) if len(kind[at].strip("-")) > 1
        ]
        plain = all("t" not in kind[at] for at in members)
        alone = plain and len(members) > 2 and not titles
        alone = alone and len(kind[first].rstrip("-")) == len(names)
        same = any(_shared(row, names) >= 2 for row in titles)
        if len(members) >= TABLE or alone or same or (plain and not (headed or titles)):
            raise RecordError(
                f"{of} holds more than one table: {where} hold numbers, and others begin at "
                f"{places[data]}: keep one table in a file"
            )
        if plain or len(members) > 2:
            notes.append(f"{where}: numbers above the table, not used")
    return notes


def _is_text(row: Row, column: int) -> bool:
    """Whether a row holds words where the first row has its first number."""
    cell = row[column] if column < len(row) else None
    if cell in (None, ""):
        return any(map(_is_word, row[: column + 1]))
    return _is_word(cell) or (kinds([cell]) == "t" and any(map(_is_word, row[:column])))


def _goes_on(rows: Sequence[Row], at: int, start: int) -> bool:
    """Whether a column counts on into a row by the step of those above: it is a measurement."""
    if at < start + STEPS:
        return False
    for column in zip(*rows[at - STEPS : at + 1], strict=False):
        values = parse([str(cell).replace(",", ".") for cell in column])
        if np.all(np.isfinite(values)):
            steps = [float(b - a) for a, b in pairwise(values)]
            if 0.0 < max(steps) < 2.0 * min(steps):
                return True
    return False


def _shared(row: Row, names: Row | None) -> int:
    """How many names of the table a row holds too, as a heading in another order does."""
    return sum(cell not in (None, "") and cell in names for cell in row) if names else 0


def _is_word(cell: Cell) -> bool:
    """Whether a cell holds words, and no mark of a number that is missing, nor a time stamp."""
    text = cell.strip().lower() if isinstance(cell, str) else ""
    return bool(re.match(r"[^\W\d_]|[*%]", text)) and text not in _MISSING and not is_stamp(text)


def _filled(row: Row) -> list[Cell]:
    """Cells of a row, without empty ones at its end."""
    return list(row[: len(kinds(row).rstrip("-"))])


def _beginning(row: Row) -> str:
    """First words of a row, without their numbers."""
    return re.sub(r"\d+", "", str(next((cell for cell in row if cell not in (None, "")), "")))
