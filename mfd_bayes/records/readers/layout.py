"""Which rows of a file are the names, the units and the numbers of its table."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise, takewhile

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.cells import bare_unit
from mfd_bayes.units import DIMENSIONS, UNREAD, measure

Row = Sequence[object]

_MISSING = frozenset(("nan", "na", "n/a", "n.a.", "null", "none", "inf", "infinity"))

ENOUGH = 40  # numbers of a table that is surely more than a few settings
TABLE = 20  # so many rows of numbers are a table by themselves
STEPS = 5  # number of steps over which a time is told
SEARCHED = 200  # number of filled rows, from the first, in which the names are looked for
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


def find_layout(rows: Sequence[Row], is_number: Callable[[object], bool]) -> Layout | None:
    """Layout of the table that weighs most, then of that with the most numbers.

    A table is a row of at least two names, perhaps a row of units, and a row with a number.
    Titles and settings above it ("Station", "Rate 1024") are no table, or a small one, which
    counts the less the fewer numbers it has.
    """
    found = [_layout_at(rows, i, is_number) for i in range(len(rows))]
    return max(
        (layout for layout in found if layout is not None),
        key=lambda layout: (layout.weight, layout.count),
        default=None,
    )


def first_of(rows: Sequence[Row], layout: Layout, is_number: Callable[[object], bool]) -> Layout:
    """Layout of the first table with the same names: a heading may stand above every block."""
    if layout.names is None:
        return layout
    names = _plain(rows[layout.names])
    same = (i for i in range(layout.names) if _plain(rows[i]) == names)
    return next((one for i in same if (one := _layout_at(rows, i, is_number))), layout)


def find_numbers(rows: Sequence[Row], is_number: Callable[[object], bool]) -> Layout | None:
    """Layout of the longest block of rows of numbers, at least two in each, without names.

    All its rows have as many cells. Free text above it is skipped.
    """
    found: list[Layout] = []
    known = ((_filled(row), sum(map(is_number, row))) for row in rows)
    for (width, bare), group in groupby(enumerate(known), lambda row: (row[1][0], row[1][1] >= 2)):
        block = list(group)
        count = sum(numbers for _, (_, numbers) in block)
        if bare:
            found.append(Layout(None, None, block[0][0], count / (width * len(block)), count))
    return max(found, key=lambda layout: layout.count, default=None)


def is_narrow(rows: Sequence[Row], layout: Layout) -> bool:
    """Whether the numbers go on beyond the end of the row above them.

    It is free text then, such as a title, and no row of names.
    """
    return layout.names is not None and _end(rows[layout.names]) < _end(rows[layout.data])


@dataclass(frozen=True)
class Body:
    """Rows of numbers of a table, and what stands between and below them."""

    rows: list[int]
    blocks: dict[int, int]  # number among `rows` of the first below a repeated heading, to its row
    footer: list[int]  # rows with a number in them below the table
    other: int | None  # first row of a heading that is not the table's


def body_of(
    words: Sequence[int],
    rows: range,
    cells: Callable[[int], Row],
    heading: Sequence[Row],
    layout: Layout,
    is_number: Callable[[object], bool],
) -> Body:
    """Rows of numbers, without headings that are repeated above each block, and without a footer.

    Rows of text that stand together are a heading where they hold the row of names as in
    `heading`, or begin as its rows do; below the names, only the same row of units may stand.
    All others are kept, and refused once a column of them is read.

    Parameters
    ----------
    words : sequence of int
        Rows whose first column of numbers holds a word, among `rows`, those from the numbers on.
    rows : range
    cells : callable
        Cells of a row.
    heading : sequence of rows
        All rows above the numbers.
    layout : Layout
    is_number : callable
    """
    names = None if layout.names is None else _plain(heading[layout.names])
    units = None if layout.units is None else _plain(heading[layout.units])
    own = {_beginning(row) for row in heading[: layout.names]}
    dropped: set[int] = set()
    starts: dict[int, int] = {}  # row below a repeated heading, to the heading's first row
    footer: list[int] = []
    other: int | None = None
    for _, pairs in groupby(enumerate(words), lambda pair: pair[1] - pair[0]):
        group = [at for _, at in pairs]
        if _goes_on(group[0], rows, cells, is_number):
            continue
        texts, below = [_plain(cells(at)) for at in group], group[-1] + 1
        if below == rows.stop:
            told = names not in texts and any(is_number(cell) for text in texts for cell in text)
            footer = group if told else []
            dropped.update(group)
            continue
        behind = texts[texts.index(names) + 1 :] if names in texts else []
        again = names in texts and behind in ([], [units])
        known = all(_beginning(text) in own and not _shared(text, names) for text in texts)
        if again or known:
            dropped.update(group)
            starts[below] = group[0]
        elif other is None and any(len(_shared(text, names)) >= 2 for text in texts):
            other = group[0]
    kept = [at for at in rows if at not in dropped]
    blocks = {number: starts[at] for number, at in enumerate(kept) if at in starts}
    return Body(kept, blocks, footer, other)


def left_out(
    of: str,
    above: Sequence[Row],
    body: Body,
    places: Sequence[str],
    names: Row,
    headed: bool,
    is_number: Callable[[object], bool],
) -> tuple[str, ...]:
    """Sentences on rows of numbers above and below a table, which are not used.

    Raises
    ------
    RecordError
        When there are so many above it that they are a table too, or such as it has, and it has no
        names to tell them apart.
    """
    if body.other is not None:
        raise RecordError(
            f"{of} has another heading at {places[body.other]}, with other units, or with its "
            "names in another order: keep one table in a file"
        )
    notes = []
    counts = [sum(map(is_number, row)) for row in above]
    for has_numbers, group in groupby(range(len(above)), lambda at: counts[at] >= 2):
        members = list(group)
        if not has_numbers:
            continue
        first, last = members[0], members[-1]
        where = places[first]
        if last > first:
            where = f"{where.replace(' ', 's ', 1)} to {places[last].split(' ')[1]}"
        titles = [row for row in above[max(first - 2, 0) : first] if _filled(row) > 1]
        plain = all(_filled(above[at]) == counts[at] for at in members)
        alone = plain and len(members) > 2 and not titles and _end(above[first]) == len(names)
        same = any(len(_shared(row, names)) >= 2 for row in titles)
        if len(members) >= TABLE or alone or same or (plain and not (headed or titles)):
            raise RecordError(
                f"{of} holds more than one table: {where} hold numbers, and others begin at "
                f"{places[body.rows[0]]}: keep one table in a file"
            )
        if plain or len(members) > 2:
            notes.append(f"{where}: numbers above the table, not used")
    if len(body.footer) >= TABLE:
        raise RecordError(
            f"{of} holds more than one table: from {places[body.footer[0]]}, rows begin with words"
        )
    if body.footer:
        notes.append(f"{places[body.footer[0]]} and below: numbers below the table, not used")
    return tuple(notes)


def _goes_on(
    at: int, rows: range, cells: Callable[[int], Row], is_number: Callable[[object], bool]
) -> bool:
    """Whether a column counts on into a row by the step of those above: it is a measurement."""
    if at < rows.start + STEPS:
        return False
    for column in zip(*(cells(i) for i in range(at - STEPS, at + 1)), strict=False):
        if all(map(is_number, column)):
            numbers = [_value(cell) for cell in column]
            steps = [b - a for a, b in pairwise(numbers)]
            if 0.0 < max(steps) < 2.0 * min(steps):
                return True
    return False


def _shared(row: Row, names: Row | None) -> list[object]:
    """Names of the table that a row holds too, as a heading in another order does."""
    return [cell for cell in row if names is not None and cell in names]


def _value(cell: object) -> float:
    return float(cell.replace(",", ".") if isinstance(cell, str) else cell)  # type: ignore[arg-type]


def is_word(cell: object) -> bool:
    """Whether a cell holds words, and no mark of a number that is missing."""
    text = cell.strip().lower() if isinstance(cell, str) else ""
    return bool(re.match(r"[^\W\d_]|[*%]", text)) and text not in _MISSING


def _plain(row: Row) -> list[object]:
    """Cells of a row, without empty ones at its end."""
    return list(row[: _end(row)])


def _beginning(row: Row) -> str:
    """First words of a row, without their numbers."""
    first = next((cell for cell in row if _is_filled(cell)), "")
    return re.sub(r"\d+", "", str(first))


def units_of(names: Sequence[str], cells: Row) -> Mapping[str, str]:
    """Name to unit, from a row of units, without empty cells and dashes."""
    pairs = zip(names, cells, strict=False)
    return {name: unit for name, cell in pairs if name and (unit := bare_unit(str(cell or "")))}


def _layout_at(rows: Sequence[Row], at: int, is_number: Callable[[object], bool]) -> Layout | None:
    """Layout of the table whose names are in row `at`; None where there is no table."""
    filled = [cell for cell in rows[at] if _is_filled(cell)]
    if len(filled) < 2 or any(not isinstance(c, str) or is_number(c) for c in filled):
        return None
    below = rows[at + 1] if at + 1 < len(rows) else ()
    units = at + 1 if not any(map(is_number, below)) and gives_units(below, rows[at]) else None
    data = at + 1 if units is None else units + 1
    numbers = (sum(map(is_number, row)) for row in rows[data:])
    counts = list(takewhile(lambda count: count > 0, numbers))
    cells = sum(_is_filled(cell) for row in rows[data : data + len(counts)] for cell in row)
    return Layout(at, units, data, sum(counts) / cells, sum(counts)) if counts else None


def gives_units(row: Row, names: Row) -> bool:
    """Whether a row holds two units or more below names, and at least as many units as words."""
    filled = [at for at, cell in enumerate(row) if _is_filled(cell)]
    if any(at >= len(names) or not _is_filled(names[at]) for at in filled):
        return False
    units = [bare_unit(cell) for at in filled if isinstance(cell := row[at], str)]
    unread = sum(len(unit) > 1 and unit.lower() in UNREAD for unit in units)
    found = [
        "acceleration" if _ACCELERATION.fullmatch(unit) else measure(unit) for unit in units if unit
    ]
    told = sum(of in _TELLING for of in found) + unread
    words = sum(of is None for of in found) - unread
    return told >= 2 and len(units) == len(filled) and 2 * words <= len(units)


def _end(row: Row) -> int:
    return max((at + 1 for at, cell in enumerate(row) if _is_filled(cell)), default=0)


def _filled(row: Row) -> int:
    return sum(map(_is_filled, row))


def _is_filled(cell: object) -> bool:
    return cell is not None and cell != ""
