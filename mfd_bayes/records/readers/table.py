"""The columns of a file, each read when it is asked for, and the one parser of their numbers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.time_stamps import elapsed, is_stamp

Array = NDArray[np.float64]
Cell = str | float | None
Column = Sequence[Cell] | NDArray[np.generic]

COLUMNS, NAME = 1000, 300  # most columns of a file, and characters of a column's name
NUMBER = re.compile(
    r"[+\-−]?(?:(?:\d+[.,]?\d*|[.,]\d+)(?:[eEdD][+-]?\d+)?|nan|inf|infinity)", re.ASCII | re.I
)
"""A number as programs write it, with a decimal point or a decimal comma."""
# 1.234,5 · 1,234.5 · 1 234,5 · 1'234.5
_GROUPED = re.compile(r"[+-]?\d{1,3}(?:([ .,'’\u00a0\u202f])\d{3})+(?:(?!\1)[.,]\d*)?")
# 0,5 · ,5 · 1,25 · 1,2345 · 1234,5: the comma cannot be a thousands separator.
SURELY_DECIMAL = re.compile(r"(?<![\d.])0*,\d|\d,\d{1,2}(?!\d)|,\d{4}|\d{4},\d|,\d{3}[eE]")
_COMMA_NUMBER = re.compile(r"[+-]?\d+,\d{3}(?!\d)")
_LABEL = re.compile(r"column \d+(: )?(.*)", re.DOTALL)


def labels(names: Sequence[str], numbers: Sequence[int] | None = None) -> tuple[str, ...]:
    """Names of which each is there once: by its number, "column 3: force_kip", where it is not.

    `names` are empty where a column has none; `numbers`, from 1, are by default in their order.
    """
    count = Counter(names)
    return tuple(
        f"column {number}{f': {name}' if name else ''}"
        if not name or count[name] > 1 or _LABEL.fullmatch(name)
        else name
        for number, name in zip(numbers or range(1, len(names) + 1), names, strict=True)
    )


def own_name(name: str) -> str:
    """Name that the file gives a column, without its number; empty where it gives none."""
    match = _LABEL.fullmatch(name)
    return name if match is None else match[2]


def bare_unit(text: str) -> str:
    """Unit without brackets: ``"kN"`` of ``"[kN]"``; empty for a dash."""
    return normalize("NFKC", text).strip().strip("[](){}<>-–— ")


def parse(column: Column, decimal: str = ".") -> Array:
    """Numbers of a column, (T,), with this sign of decimals; NaN for a cell that holds none."""
    if isinstance(column, np.ndarray):
        return np.asarray(column.reshape(-1), dtype=np.float64)
    other = "," if decimal == "." else "."
    values = np.full(len(column), np.nan)
    for row, cell in enumerate(column):
        if isinstance(cell, str):
            text = cell.strip()
            if other in text or not NUMBER.fullmatch(text):
                continue
            cell = float(text.replace("−", "-").replace(",", ".").upper().replace("D", "E"))
        if type(cell) in (int, float):
            try:
                values[row] = float(cell)  # type: ignore[arg-type]  # mypy does not see `type`
            except OverflowError:
                continue
    values[np.isinf(values)] = np.nan
    return values


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of a file; a column that is not used may hold anything.

    Attributes
    ----------
    path : Path
    cells : mapping of str to column
        Cells, or numbers, by the column's name, in the file's order.
    places : sequence of str
        Names of the rows: "line 17"; by default "sample 17".
    units : mapping of str to str
        By column, where the file gives one.
    numbers : tuple of int, optional
        Of the columns, from 1; by default in their order.
    headed : bool
        Whether the file has names; without them, they are "column 1", …
    blocks : mapping of int to str
        Row to the place of a repeated heading above it.
    align : callable
        What is done to columns that are used together: it gives them with the same rows, or
        refuses them.
    notes, doubts : tuple of str
        Sentences on numbers of the file that are not in the table, and on those that probably
        belong to it.
    decimals : tuple of str
        Signs of decimals that its numbers may have.
    head : tuple of str
        Texts above the table, and settings with it: "Sample rate: 100 Hz".
    """

    path: Path
    cells: Mapping[str, Column]
    places: Sequence[str] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    numbers: tuple[int, ...] | None = None
    headed: bool = True
    blocks: Mapping[int, str] = field(default_factory=dict)
    align: Callable[[Mapping[str, Column]], Mapping[str, Column]] = dict
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    decimals: tuple[str, ...] = (".",)
    head: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_names(self.path, self.names)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns, in the file's order."""
        return tuple(self.cells)

    @cached_property
    def stamped(self) -> frozenset[str]:
        """Columns of time stamps; they are read as seconds since the first row."""
        return frozenset(n for n, cells in self.cells.items() if len(cells) and is_stamp(cells[0]))

    def place(self, row: int) -> str:
        """Name of a row, from 0."""
        return self.places[row] if self.places else f"sample {row + 1}"

    def columns(self, names: Sequence[str], dates: str = "") -> dict[str, Array]:
        """Columns by name, each (T,), in the file's units; `dates` is the order in time stamps.

        Raises
        ------
        RecordError
            When a column is missing, named twice, empty, of another length or other times,
            or holds text or a value that is not finite.
        """
        values = self.values(names, dates)
        bad = {n: int(np.argmax(np.isnan(v))) for n, v in values.items() if np.isnan(v).any()}
        if bad:
            name = min(bad, key=lambda name: (bad[name], name))
            raise self._bad_cell(name, bad[name], names)
        return values

    def values(self, names: Sequence[str], dates: str = "") -> dict[str, Array]:
        """As `columns`, with NaN for a cell that holds no finite number."""
        for name in names:
            if name not in self.cells:
                raise self.no_column(name)
        cells = self.align({name: self.cells[name] for name in names})
        if self.places:  # other columns of a sheet may go on below these
            size = max((_filled(column) for column in cells.values()), default=0)
            cells = {name: column[:size] for name, column in cells.items()}
        plain = [name for name in names if name not in self.stamped]
        read = [{n: parse(cells[n], sign) for n in plain} for sign in self.decimals]
        values = max(read, key=lambda each: sum(np.isfinite(v).sum() for v in each.values()))
        if values is not read[0]:
            self._check_comma()
        for name in self.stamped.intersection(names):
            values[name] = elapsed(self.path, name, list(cells[name]), dates)
        values = {name: np.where(np.isinf(values[name]), np.nan, values[name]) for name in names}
        sizes = {name: column.size for name, column in values.items()}
        if len(set(sizes.values())) > 1:
            lengths = ", ".join(f"{name} {size}" for name, size in sizes.items())
            raise RecordError(f"columns of {self.path} have different lengths: {lengths}")
        if 0 in sizes.values():
            raise RecordError(f"{self.path} has columns but no data")
        return values

    def _check_comma(self) -> None:
        """Refuse numbers whose comma may stand for decimals or for thousands."""
        text = "\n".join(c for cells in self.cells.values() for c in cells if isinstance(c, str))
        if not SURELY_DECIMAL.search(text) and (number := _COMMA_NUMBER.search(text)):
            raise RecordError(
                f"numbers of {self.path} such as {number[0]!r} may have a decimal comma or a "
                "thousands separator; write them with a decimal point"
            )

    def _bad_cell(self, name: str, row: int, names: Sequence[str]) -> RecordError:
        """Error for a cell that holds no finite number: text, an empty cell, nan or infinity."""
        cells = self.align({each: self.cells[each] for each in names})
        cell = cells[name][row]
        text = "" if cell is None else str(cell).strip()
        shown = repr(text[:60]) if text else "an empty cell"
        if any(np.isfinite(parse([cell], sign)[0]) for sign in self.decimals):
            seen = {
                sign: f"{c!r} in {self.place(at)}, column {other!r}"
                for other in reversed(names)
                for at, c in reversed(list(enumerate(cells[other])))
                for sign in ".,"
                if isinstance(c, str) and sign in c
            }
            return RecordError(
                f"{self.path} holds both points and commas, {seen.get('.')} and {seen.get(',')}: "
                "expected one sign of decimals, and no thousands separators"
            )
        if _GROUPED.fullmatch(text) and (len(self.decimals) == 1 or not NUMBER.fullmatch(text)):
            shown += "; a number is written without a thousands separator"
        elif is_stamp(text):
            shown += ", which is a time stamp: expected a number, as in the first row"
        return RecordError(
            f"{self.place(row)} of {self.path}, column {name!r}: expected a finite number, "
            f"found {shown}"
        )

    def part(self, first: int, last: int, doubt: str) -> Table:
        """Table of rows `first` to before `last`; `doubt` says what is left out."""
        return replace(
            self,
            cells={name: column[first:last] for name, column in self.cells.items()},
            places=[self.place(row) for row in range(first, last)],
            blocks={row - first: at for row, at in self.blocks.items() if row > first},
            doubts=(*self.doubts, doubt),
        )

    def number_of(self, name: str) -> int:
        """Number of a column in the file, from 1."""
        return (self.numbers or range(1, len(self.names) + 1))[self.names.index(name)]

    def name_of(self, column: str | int) -> str:
        """Name of a column that is given by its name or its number, from 1."""
        if isinstance(column, str):
            return column
        numbers = self.numbers or range(1, len(self.names) + 1)
        if column not in numbers:
            raise RecordError(
                f"column {column} of {self.path}: it has columns {min(numbers)} to {max(numbers)}, "
                f"{_listed(self.names)}"
            )
        return self.names[numbers.index(column)]

    def no_column(self, name: str) -> RecordError:
        """Error for a name that no column, or more than one, has."""
        shared = [self.number_of(other) for other in self.names if own_name(other) == name]
        if len(shared) > 1:
            which = " or ".join(f"{{ column = {number} }}" for number in shared)
            return RecordError(
                f"more than one column {name!r} in {self.path}: say which by its number, {which}"
            )
        how = "" if self.headed else "; it has no names: give { column = 1 } or another number"
        return RecordError(
            f"missing column {name!r} in {self.path}; it has {_listed(self.names)}{how}"
        )


def check_names(path: Path, names: Sequence[str]) -> None:
    """Refuse a file with more columns than `COLUMNS`, or a name longer than `NAME`."""
    if len(names) > COLUMNS:
        raise RecordError(
            f"{path} has {len(names):,} columns; at most {COLUMNS:,} are read: expected a line for "
            "every sample"
        )
    for number, name in enumerate(names, start=1):
        if len(name) > NAME:
            raise RecordError(
                f"the name of column {number} of {path}, {name[:40] + '…'!r}, is longer than "
                f"{NAME} characters, the most that is read"
            )


def _filled(column: Column) -> int:
    """Number of rows of a column, without those at its end that have no cell."""
    size = len(column)
    while size and column[size - 1] is None:
        size -= 1
    return size


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:20])
    return shown if len(names) <= 20 else f"{shown} and {len(names) - 20} more"
