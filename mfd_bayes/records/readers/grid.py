"""Which rows of a grid of cells are names, units and numbers: the one finder of all formats."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
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
STEPS = 5  # number of steps over which a time is told
SEARCHED = 200  # number of filled rows, from the first, in which the names are looked for
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
    known = [kinds(row) for row in rows]
    numbers = [kind.count("n") for kind in known]
    filled = [len(kind) - kind.count("-") for kind in known]
    found: list[Layout] = []
    for at in range(len(rows) - 1):
        if numbers[at] or filled[at] < 2:
            continue
        units = at + 1 if not numbers[at + 1] and gives_units(rows[at + 1], rows[at]) else None
        data = at + 1 if units is None else at + 2
        end = numbers.index(0, data) if 0 in numbers[data:] else len(rows)
        width = len(known[data].rstrip("-")) if exact and data < len(rows) else 0
        if end > data and len(known[at].rstrip("-")) >= width:
            count = sum(numbers[data:end])
            found.append(Layout(at, units, data, count / sum(filled[data:end]), count))
    if found:
        best = max(found, key=lambda one: (one.weight, one.count))
        return next(one for one in found if rows[one.names or 0] == rows[best.names or 0])
    blocks: list[Layout] = []
    for (width, bare), group in groupby(range(len(rows)), lambda i: (filled[i], numbers[i] >= 2)):
        block = list(group)
        count = sum(numbers[i] for i in block)
        if bare:
            blocks.append(Layout(None, None, block[0], count / (width * len(block)), count))
    return max(blocks, key=lambda one: one.count, default=None)


def gives_units(row: Row, names: Row) -> bool:
    """Whether a row holds two units or more below names, and at least as many units as words."""
    under = [at for at, c in enumerate(row) if c not in (None, "")]
    if any(at >= len(names) or names[at] in (None, "") for at in under):
        return False
    units = [unit for c in row if isinstance(c, str) and (unit := bare_unit(c))]
    unread = sum(len(unit) > 1 and unit.lower() in UNREAD for unit in units)
    found = ["acceleration" if _ACCELERATION.fullmatch(u) else measure(u) for u in units]
    words = found.count(None) - unread
    return sum(of in _TELLING for of in found) + unread >= 2 and 2 * words <= len(under)


def table_of(
    path: Path,
    of: str,
    rows: Sequence[Row],
    places: Sequence[str],
    layout: Layout,
    *,
    place: Callable[[int], str],
    names: Sequence[str] | None = None,
    units: Row = (),
    load: Callable[[Sequence[int]], Sequence[Column]] | None = None,
    decimals: tuple[str, ...] = (".",),
    doubts: tuple[str, ...] = (),
    head: tuple[str, ...] = (),
    blank: Cell = None,
) -> tuple[Table, Sequence[int]]:
    """Table of a grid whose layout is known, and its rows of numbers.

    Parameters
    ----------
    path : Path
    of : str
        What holds the rows, for messages: the path, or a sheet of it.
    rows : sequence of rows
        With `load` perhaps only the first ones.
    places : sequence of str
        Name of each row in its file or sheet: "line 17".
    layout : Layout
    place : callable
        Name of a row for the messages of the table.
    names, units : row, optional
        Of the columns, where they do not stand in the layout's rows.
    load : callable, optional
        Cells of columns, from 0, where it is known that nothing stands between the numbers.
    decimals, doubts, head
        As in `Table`.
    blank : cell
        In place of a cell that a short row lacks. Columns end at the last row in which one of
        those that are read is not None.
    """
    headed = layout.names is not None or names is not None
    first = rows[layout.data] if layout.data < len(rows) else ()
    if names is not None:
        at = list(range(len(names)))
    else:
        heading = () if layout.names is None else rows[layout.names]
        own, kind = kinds(heading).rstrip("-"), kinds(first)
        at = [
            k
            for k in range(max(len(own), len(kind)))
            if (k < len(own) and heading[k] is not None)
            or kind[k : k + 1] == "n"
            or (not heading and kind[k : k + 1] == "t")
        ]
        texts = [" ".join(str(heading[k] or "").split()) if k < len(heading) else "" for k in at]
        names = labels(texts, [k + 1 for k in at])
    if layout.units is not None:
        units = rows[layout.units]
    body: Sequence[int] = range(layout.data, len(places))
    blocks: dict[int, int] = {}
    footer: list[int] = []
    if load is None:
        body, blocks, footer = _body(of, rows, places, layout, len(names))
    notes = _above(of, rows, places, layout.data, names, headed)
    if len(footer) >= TABLE:
        raise RecordError(
            f"{of} holds more than one table: from {places[footer[0]]}, rows begin with words"
        )
    if footer:
        notes.append(f"{places[footer[0]]} and below: numbers below the table, not used")
    position = dict(zip(names, at, strict=True))
    picked = [rows[i] for i in body] if load is None else []

    def cells(wanted: Sequence[str]) -> Mapping[str, Column]:
        where = [position[name] for name in wanted]
        if load is not None:
            return dict(zip(wanted, load(where), strict=True))
        columns = [[r[k] if k < len(r) else blank for r in picked] for k in where]
        while columns and columns[0] and all(c[-1] is None for c in columns):
            for column in columns:
                column.pop()
        return dict(zip(wanted, columns, strict=True))

    first = rows[body[0]] if len(body) else ()
    stamped = frozenset(n for n, k in position.items() if k < len(first) and is_stamp(first[k]))
    stated = {
        name: unit
        for name, k in position.items()
        if k < len(units) and (unit := bare_unit(str(units[k] or "")))
    }
    above = (
        " ".join(f"{c:g}" if isinstance(c, float) else str(c) for c in row if c is not None)
        for row in rows[: layout.data]
    )
    table = Table(
        path,
        tuple(names),
        cells,
        lambda row: place(body[row]),
        stated | dict.fromkeys(stamped, "s"),
        numbers=tuple(k + 1 for k in at),
        headed=headed,
        blocks={n: places[i] for n, i in blocks.items()},
        notes=tuple(notes),
        doubts=doubts,
        decimals=decimals,
        head=head or tuple(above),
        stamped=stamped,
    )
    return table, body


def _body(
    of: str, rows: Sequence[Row], places: Sequence[str], layout: Layout, width: int
) -> tuple[list[int], dict[int, int], list[int]]:
    """Rows of numbers; of these the first below a repeated heading, to its row; and the footer.

    Rows of text that stand together are a heading where they hold the row of names, or begin as
    the rows above the table do; below the names, only the same row of units may stand. All others
    are kept, and refused once a column of them is read.
    """
    size = len(rows)
    names = None if layout.names is None else _filled(rows[layout.names])
    units = None if layout.units is None else _filled(rows[layout.units])
    own = set() if layout.names is None else {_beginning(row) for row in rows[: layout.names]}
    first = rows[layout.data] if layout.data < size else ()
    column = next(
        (k for k, kind in enumerate(kinds(first)) if kind == "n" or is_stamp(first[k])), 0
    )
    words = [at for at in range(layout.data, size) if _is_text(rows[at], column)]
    dropped: set[int] = set()
    starts: dict[int, int] = {}  # row below a repeated heading, to the heading's first row
    footer: list[int] = []
    other: int | None = None  # first row of a heading that is not the table's
    for _, pairs in groupby(enumerate(words), lambda pair: pair[1] - pair[0]):
        group = [at for _, at in pairs]
        if _goes_on(rows, group[0], layout.data):
            continue
        texts, below = [_filled(rows[at]) for at in group], group[-1] + 1
        again = names in texts and texts[texts.index(names) + 1 :] in ([], [units])
        if below == size:
            if names not in texts and any("n" in kinds(text) for text in texts):
                footer = group
            dropped.update(group)
        elif again or all(_beginning(t) in own and _shared(t, names) == 0 for t in texts):
            dropped.update(group)
            starts[below] = group[0]
        elif other is None and any(_shared(text, names) >= 2 for text in texts):
            other = group[0]
    if other is not None:
        raise RecordError(
            f"{of} has another heading at {places[other]}, with other units, or with its "
            "names in another order: keep one table in a file"
        )
    kept = [at for at in range(layout.data, size) if at not in dropped]
    while kept and len(rows[kept[-1]]) != width and "n" not in kinds(rows[kept[-1]]):
        kept.pop()  # other text below the numbers
    return kept, {n: starts[at] for n, at in enumerate(kept) if at in starts}, footer


def _is_text(row: Row, column: int) -> bool:
    """Whether a row holds words where the first row has its first number."""
    cell = row[column] if column < len(row) else None
    if cell in (None, ""):
        return any(map(is_word, row[: column + 1]))
    text = isinstance(cell, str) and not NUMBER.fullmatch(cell)
    return is_word(cell) or (text and any(map(is_word, row[:column])))


def _above(
    of: str, rows: Sequence[Row], places: Sequence[str], data: int, names: Row, headed: bool
) -> list[str]:
    """Sentences on rows of numbers above a table, which are not used.

    Refused where there are so many that they are a table too, or such as it has, and it has no
    names to tell them apart.
    """
    notes = []
    known = [kinds(row) for row in rows[:data]]
    for has_numbers, group in groupby(range(len(known)), lambda at: known[at].count("n") >= 2):
        members = list(group)
        if not has_numbers:
            continue
        first, last = members[0], members[-1]
        where = places[first]
        if last > first:
            where = f"{where.replace(' ', 's ', 1)} to {places[last].split(' ')[1]}"
        before = range(max(first - 2, 0), first)
        titles = [rows[at] for at in before if len(known[at].replace("-", "")) > 1]
        plain = all("t" not in known[at] for at in members)
        width = len(known[first].rstrip("-"))
        alone = plain and len(members) > 2 and not titles and width == len(names)
        same = any(_shared(row, names) >= 2 for row in titles)
        if len(members) >= TABLE or alone or same or (plain and not (headed or titles)):
            raise RecordError(
                f"{of} holds more than one table: {where} hold numbers, and others begin at "
                f"{places[data]}: keep one table in a file"
            )
        if plain or len(members) > 2:
            notes.append(f"{where}: numbers above the table, not used")
    return notes


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


def _filled(row: Row) -> list[Cell]:
    """Cells of a row, without empty ones at its end."""
    return list(row[: len(kinds(row).rstrip("-"))])


def _beginning(row: Row) -> str:
    """First words of a row, without their numbers."""
    return re.sub(r"\d+", "", str(next((cell for cell in row if cell not in (None, "")), "")))
