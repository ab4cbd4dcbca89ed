"""Which rows of a grid of cells are names, units and numbers: the one finder of all formats."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.table import (
    NUMBER,
    Cell,
    Column,
    Table,
    bare_unit,
    labels,
    parse,
)
from mfd_bayes.records.readers.time_stamps import is_stamp
from mfd_bayes.units import DIMENSIONS, UNREAD, measure

Row = Sequence[Cell]

ENOUGH = 40  # numbers of a table that is surely more than a few settings
TABLE = 20  # so many rows of numbers are a table by themselves
STEPS = 5  # number of steps over which a time is told
SEARCHED = 200  # number of filled rows, from the first, in which the names are looked for
_MISSING = frozenset(("nan", "na", "n/a", "n.a.", "null", "none", "inf", "infinity"))
# Ratios, rates and masses do not show that a row holds units: "1", "cycles" or "t" may be text.
_TELLING = {dimension.measure for dimension in DIMENSIONS.values()} - {"ratio", "rate", "mass"}
_TELLING |= {"acceleration", "length / time ** 2"}
_ACCELERATION = re.compile(r"%?\s*g|gals?|(?:[cm]?m|in|ft)/s(?:ec)?\^?2", re.IGNORECASE)  # no gram


@dataclass(frozen=True, eq=False)
class Grid:
    """Rows of cells, those of a text file perhaps only its first ones.

    Attributes
    ----------
    path : Path
    of : str
        What holds the rows, for messages: the path, or a sheet of it.
    rows : sequence of rows
    places : sequence of str
        Name of each row: "line 17".
    """

    path: Path
    of: str
    rows: Sequence[Row]
    places: Sequence[str]


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


def find_table(grid: Grid, *, exact: bool = False) -> Layout | None:
    """Layout of the table that weighs most, or else of the longest block of rows of numbers.

    A table is a row of at least two names, perhaps a row of units, and a row with a number.
    Titles and settings above it ("Station", "Rate 1024") are no table, or a small one, which
    counts the less the fewer numbers it has. With `exact`, a row beyond whose end the numbers go on
    is a title too. Of tables with the same names the first is taken: a
    heading may stand above every block.
    """
    rows = grid.rows[:SEARCHED]
    known = [kinds(row) for row in rows]
    numbers = [kind.count("n") for kind in known]
    filled = [len(kind) - kind.count("-") for kind in known]
    found: list[Layout] = []
    for at, kind in enumerate(known):
        if numbers[at] or filled[at] < 2 or at + 1 == len(rows):
            continue
        below = rows[at + 1]
        units = at + 1 if not numbers[at + 1] and gives_units(below, rows[at]) else None
        data = at + 1 if units is None else units + 1
        end = numbers.index(0, data) if 0 in numbers[data:] else len(rows)
        narrow = exact and len(kind.rstrip("-")) < len(
            (known[data : data + 1] or [""])[0].rstrip("-")
        )
        if end == data or narrow:
            continue
        count = sum(numbers[data:end])
        found.append(Layout(at, units, data, count / sum(filled[data:end]), count))
    if found:
        best = max(found, key=lambda one: (one.weight, one.count))
        names = rows[best.names or 0]
        return next(one for one in found if rows[one.names or 0] == names)
    blocks: list[Layout] = []
    for (width, bare), group in groupby(range(len(rows)), lambda i: (filled[i], numbers[i] >= 2)):
        block = list(group)
        count = sum(numbers[i] for i in block)
        if bare:
            blocks.append(Layout(None, None, block[0], count / (width * len(block)), count))
    return max(blocks, key=lambda one: one.count, default=None)


def gives_units(row: Row, names: Row) -> bool:
    """Whether a row holds two units or more below names, and at least as many units as words."""
    texts = [bare_unit(c) if isinstance(c, str) else "" for c in row]
    under = [at for at, c in enumerate(row) if c not in (None, "")]
    if any(at >= len(names) or names[at] in (None, "") for at in under):
        return False
    units = [text for text in texts if text]
    unread = sum(len(unit) > 1 and unit.lower() in UNREAD for unit in units)
    found = ["acceleration" if _ACCELERATION.fullmatch(u) else measure(u) for u in units]
    told = sum(of in _TELLING for of in found) + unread
    words = sum(of is None for of in found) - unread
    return told >= 2 and 2 * words <= len(under)


def table_of(
    grid: Grid,
    layout: Layout,
    *,
    place: Callable[[int], str],
    names: Sequence[str] | None = None,
    units: Row = (),
    body: Sequence[int] | None = None,
    load: Callable[[Sequence[int], Sequence[int]], Sequence[Column]] | None = None,
    decimals: tuple[str, ...] = (".",),
    doubts: tuple[str, ...] = (),
    head: tuple[str, ...] = (),
    trim: bool = False,
) -> Table:
    """Table of a grid whose layout is known.

    Parameters
    ----------
    grid : Grid
    layout : Layout
    place : callable
        Name of a row of the grid.
    names : sequence of str, optional
        Of the columns, where they do not stand in the layout's row of names.
    units : row
        Of the columns, where they do not stand in the layout's row of units.
    body : sequence of int, optional
        Rows of numbers, where it is known that there are no others.
    load : callable, optional
        Cells of columns, from 0, in rows.
    decimals, doubts, head
        As in `Table`.
    trim : bool
        Whether columns end at the last row where one of those that are read is filled.

    Raises
    ------
    RecordError
        When the grid has rows of numbers that are not the table's and may be meant.
    """
    headed = layout.names is not None or names is not None
    heading = [] if layout.names is None else list(grid.rows[layout.names])
    first = grid.rows[layout.data] if layout.data < len(grid.rows) else ()
    at = list(range(len(names))) if names is not None else _columns(heading, first)
    if names is None:
        texts = [" ".join(str(heading[k] or "").split()) if k < len(heading) else "" for k in at]
        names = labels(texts, [k + 1 for k in at])
    if layout.units is not None:
        units = grid.rows[layout.units]
    found: Body | None = None
    if body is None:
        found = _body(grid, layout, names)
        body = found.rows
    notes = _left_out(grid, layout, found, names, headed)
    position = dict(zip(names, at, strict=True))

    def cells(wanted: Sequence[str]) -> Mapping[str, Column]:
        places = [position[name] for name in wanted]
        if load is not None:
            return dict(zip(wanted, load(body, places), strict=True))
        columns = [[r[k] if k < len(r) else None for r in picked] for k in places]
        while trim and columns and columns[0] and all(c[-1] is None for c in columns):
            for column in columns:
                column.pop()
        return dict(zip(wanted, columns, strict=True))

    picked = [grid.rows[i] for i in body] if load is None else []
    first = grid.rows[body[0]] if len(body) else ()
    stamped = frozenset(n for n, k in position.items() if k < len(first) and is_stamp(first[k]))
    stated = {
        name: unit
        for name, k in position.items()
        if k < len(units) and (unit := bare_unit(str(units[k] or "")))
    }
    return Table(
        grid.path,
        tuple(names),
        cells,
        lambda row: place(body[row]),
        stated | dict.fromkeys(stamped, "s"),
        numbers=tuple(k + 1 for k in at),
        headed=headed,
        blocks={} if found is None else {n: grid.places[i] for n, i in found.blocks.items()},
        notes=notes,
        doubts=doubts,
        decimals=decimals,
        head=head or tuple(_said(row) for row in grid.rows[: layout.data]),
        stamped=stamped,
    )


def _said(row: Row) -> str:
    """A row above the table as a text: "Sample rate 100"."""
    return " ".join(f"{c:g}" if isinstance(c, float) else str(c) for c in row if c is not None)


def _columns(heading: Row, first: Row) -> list[int]:
    """Columns, from 0, that have a name, or a number in the first row."""
    numbers = kinds(first)
    end = len(kinds(heading).rstrip("-")) if heading else len(first)
    return [
        k
        for k in range(max(end, len(numbers)))
        if (k < min(end, len(heading)) and heading[k] is not None)
        or numbers[k : k + 1] == "n"
        or (not heading and numbers[k : k + 1] == "t")
    ]


@dataclass(frozen=True)
class Body:
    """Rows of numbers of a table, and what stands between and below them."""

    rows: list[int]
    blocks: dict[int, int]  # number among `rows` of the first below a repeated heading, to its row
    footer: list[int]  # rows with a number in them below the table
    other: int | None  # first row of a heading that is not the table's


def _body(grid: Grid, layout: Layout, labelled: Sequence[str]) -> Body:
    """Rows of numbers, without headings that are repeated above each block, and without a footer.

    Rows of text that stand together are a heading where they hold the row of names, or begin as
    the rows above the table do; below the names, only the same row of units may stand. All others
    are kept, and refused once a column of them is read.
    """
    rows, size = grid.rows, len(grid.rows)
    names = None if layout.names is None else _plain(rows[layout.names])
    units = None if layout.units is None else _plain(rows[layout.units])
    own = {_beginning(row) for row in rows[: layout.names]} if layout.names is not None else set()
    first = rows[layout.data] if layout.data < size else ()
    column = next(
        (k for k, kind in enumerate(kinds(first)) if kind == "n" or is_stamp(first[k])), 0
    )
    words = [at for at in range(layout.data, size) if _is_text(rows[at], column)]
    dropped: set[int] = set()
    starts: dict[int, int] = {}  # row below a repeated heading, to the heading's first row
    footer: list[int] = []
    other: int | None = None
    for _, pairs in groupby(enumerate(words), lambda pair: pair[1] - pair[0]):
        group = [at for _, at in pairs]
        if _goes_on(rows, group[0], layout.data):
            continue
        texts, below = [_plain(rows[at]) for at in group], group[-1] + 1
        if below == size:
            if names not in texts and any("n" in kinds(text) for text in texts):
                footer = group
            dropped.update(group)
            continue
        behind = texts[texts.index(names) + 1 :] if names in texts else []
        again = names in texts and behind in ([], [units])
        if again or all(_beginning(t) in own and _shared(t, names) == 0 for t in texts):
            dropped.update(group)
            starts[below] = group[0]
        elif other is None and any(_shared(text, names) >= 2 for text in texts):
            other = group[0]
    kept = [at for at in range(layout.data, size) if at not in dropped]
    while kept and len(rows[kept[-1]]) != len(labelled) and "n" not in kinds(rows[kept[-1]]):
        kept.pop()  # other text below the numbers
    return Body(kept, {n: starts[at] for n, at in enumerate(kept) if at in starts}, footer, other)


def _is_text(row: Row, column: int) -> bool:
    """Whether a row holds words where the first row has its first number."""
    cell = row[column] if column < len(row) else None
    if cell not in (None, ""):
        return is_word(cell) or (
            isinstance(cell, str) and not NUMBER.fullmatch(cell) and any(map(is_word, row[:column]))
        )
    return any(map(is_word, row[: column + 1]))


def _left_out(
    grid: Grid, layout: Layout, body: Body | None, names: Sequence[str], headed: bool
) -> tuple[str, ...]:
    """Sentences on rows of numbers above and below a table, which are not used.

    Raises
    ------
    RecordError
        When there are so many above it that they are a table too, or such as it has, and it has no
        names to tell them apart.
    """
    of, places, above = grid.of, grid.places, grid.rows[: layout.data]
    if body is not None and body.other is not None:
        raise RecordError(
            f"{of} has another heading at {places[body.other]}, with other units, or with its "
            "names in another order: keep one table in a file"
        )
    notes = []
    known = [kinds(row) for row in above]
    for has_numbers, group in groupby(range(len(above)), lambda at: known[at].count("n") >= 2):
        members = list(group)
        if not has_numbers:
            continue
        first, last = members[0], members[-1]
        where = places[first]
        if last > first:
            where = f"{where.replace(' ', 's ', 1)} to {places[last].split(' ')[1]}"
        titles = [
            above[at]
            for at in range(max(first - 2, 0), first)
            if len(known[at].replace("-", "")) > 1
        ]
        plain = all("t" not in known[at] for at in members)
        width = len(known[first].rstrip("-"))
        alone = plain and len(members) > 2 and not titles and width == len(names)
        same = any(_shared(row, names) >= 2 for row in titles)
        if len(members) >= TABLE or alone or same or (plain and not (headed or titles)):
            raise RecordError(
                f"{of} holds more than one table: {where} hold numbers, and others begin at "
                f"{places[layout.data]}: keep one table in a file"
            )
        if plain or len(members) > 2:
            notes.append(f"{where}: numbers above the table, not used")
    footer = [] if body is None else body.footer
    if len(footer) >= TABLE:
        raise RecordError(
            f"{of} holds more than one table: from {places[footer[0]]}, rows begin with words"
        )
    if footer:
        notes.append(f"{places[footer[0]]} and below: numbers below the table, not used")
    return tuple(notes)


def _goes_on(rows: Sequence[Row], at: int, start: int) -> bool:
    """Whether a column counts on into a row by the step of those above: it is a measurement."""
    if at < start + STEPS:
        return False
    for column in zip(*rows[at - STEPS : at + 1], strict=False):
        values = parse([str(c).replace(",", ".") for c in column])
        if np.all(np.isfinite(values)):
            steps = [float(b - a) for a, b in pairwise(values)]
            if 0.0 < max(steps) < 2.0 * min(steps):
                return True
    return False


def _shared(row: Row, names: Row | None) -> int:
    """How many names of the table a row holds too, as a heading in another order does."""
    return sum(cell not in (None, "") and cell in names for cell in row) if names else 0


def is_word(cell: Cell) -> bool:
    """Whether a cell holds words, and no mark of a number that is missing, nor a time stamp."""
    text = cell.strip().lower() if isinstance(cell, str) else ""
    return bool(re.match(r"[^\W\d_]|[*%]", text)) and text not in _MISSING and not is_stamp(text)


def _plain(row: Row) -> list[Cell]:
    """Cells of a row, without empty ones at its end."""
    return list(row[: len(kinds(row).rstrip("-"))])


def _beginning(row: Row) -> str:
    """First words of a row, without their numbers."""
    first = next((cell for cell in row if cell not in (None, "")), "")
    return re.sub(r"\d+", "", str(first))
