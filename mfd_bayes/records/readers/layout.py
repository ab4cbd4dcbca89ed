"""Which rows of a file are the names, the units and the numbers of its table."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, takewhile

from mfd_bayes.records.readers.cells import bare_unit
from mfd_bayes.units import DIMENSIONS, measure

Row = Sequence[object]

ENOUGH = 40  # numbers of a table that is surely more than a few settings
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
    units = at + 1 if not any(map(is_number, below)) and _gives_units(below, rows[at]) else None
    data = at + 1 if units is None else units + 1
    numbers = (sum(map(is_number, row)) for row in rows[data:])
    counts = list(takewhile(lambda count: count > 0, numbers))
    cells = sum(_is_filled(cell) for row in rows[data : data + len(counts)] for cell in row)
    return Layout(at, units, data, sum(counts) / cells, sum(counts)) if counts else None


def _gives_units(row: Row, names: Row) -> bool:
    """Whether a row holds two units or more below names, and at least as many units as words."""
    filled = [at for at, cell in enumerate(row) if _is_filled(cell)]
    if any(at >= len(names) or not _is_filled(names[at]) for at in filled):
        return False
    units = [bare_unit(cell) for at in filled if isinstance(cell := row[at], str)]
    found = [
        "acceleration" if _ACCELERATION.fullmatch(unit) else measure(unit) for unit in units if unit
    ]
    told = sum(of in _TELLING for of in found)
    words = sum(of is None for of in found)
    return told >= 2 and len(units) == len(filled) and 2 * words <= len(units)


def _end(row: Row) -> int:
    return max((at + 1 for at, cell in enumerate(row) if _is_filled(cell)), default=0)


def _filled(row: Row) -> int:
    return sum(map(_is_filled, row))


def _is_filled(cell: object) -> bool:
    return cell is not None and cell != ""
