"""The columns of a file, each read when it is asked for: one parser of numbers, one of dates."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from functools import cached_property
from pathlib import Path
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError

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
    """Unique names: "column 3: force_kip", by its number, where a name is empty or there twice."""
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
    """Numbers of a column, (T,), with this sign of decimals; NaN where there is none."""
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
    cells : mapping of str to column
        By name, in the file's order.
    rows, where : sequence of int, (str, str)
        Number of each row, and what stands before and after it: ("row ", " of sheet 'A'").
        Without them, a row is a "sample".
    units : mapping of str to str
        By column, where the file gives one.
    numbers : sequence of int
        Of the columns, from 1; by default in their order.
    headed : bool
        Whether the file has names; without them, they are "column 1", …
    blocks : mapping of int to str
        Row to the place of a repeated heading above it.
    align : callable
        Gives columns that are used together the same rows, or refuses them.
    notes, doubts : tuple of str
        On numbers of the file that are not in the table, and on those that may belong to it.
    decimals : tuple of str
        Signs of decimals that its numbers may have.
    head : tuple of str
        Texts above the table, and settings with it: "Sample rate: 100 Hz".
    """

    path: Path
    cells: Mapping[str, Column]
    rows: Sequence[int] = ()
    where: tuple[str, str] = ("sample ", "")
    units: Mapping[str, str] = field(default_factory=dict)
    numbers: Sequence[int] = ()
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
        """Name of a row, from 0: "line 17"."""
        before, after = self.where
        return f"{before}{self.rows[row] if len(self.rows) else row + 1}{after}"

    def columns(self, names: Sequence[str], dates: str = "") -> dict[str, Array]:
        """Columns by name, (T,) each, in the file's units; `dates` is the order in time stamps.

        Refused where one is missing or empty, differs in length or times, or has a cell without a
        finite number.
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
        if len(self.rows):  # other columns of a sheet may go on below these
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
        cell = self.align({each: self.cells[each] for each in names})[name][row]
        text = "" if cell is None else str(cell).strip()
        shown = repr(text[:60]) if text else "an empty cell"
        if not text and self.path.suffix.lower() == ".xlsx":
            shown += ", or a formula without a stored value: save it in Excel"
        if any(np.isfinite(parse([cell], sign)[0]) for sign in self.decimals):
            shown += (
                ", and others with the other sign: the file holds both points and commas; expected "
                "one sign of decimals, and no thousands separators"
            )
        elif _GROUPED.fullmatch(text) and (len(self.decimals) == 1 or not NUMBER.fullmatch(text)):
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
            rows=self.rows[first:last] if len(self.rows) else range(first + 1, last + 1),
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


_NAMES = "jan feb mar apr may jun jul aug sep oct nov dec"
_MONTHS = {name: number for number, name in enumerate(_NAMES.split(), start=1)}
_MONTHS |= {"mär": 3, "mrz": 3, "mai": 5, "okt": 10, "dez": 12}
_CLOCK = re.compile(
    r"(?<![\d:.,])(?:(?P<h>\d{1,4}):(?P<m>[0-5]\d):(?P<s>[0-5]\d)(?:[.,:](?P<f>\d{1,9}))?"
    r"|(?P<m2>\d{1,3}):(?P<s2>[0-5]\d)[.,](?P<f2>\d{1,9}))"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>Z|UTC|GMT|[+-]\d{2}:?\d{2})?(?=$|[,; ])"
)
_DATE = re.compile(
    r"|\d{8}|\d{4}([-/.])\d{1,2}\1\d{1,2}|\d{1,2}([-/.])\d{1,2}\2(?:\d{4}|\d\d)"
    r"|\d{1,2}[- .]{1,2}[^\W\d_]{3,9}\.?[- ,]{1,2}(?:\d{4}|\d\d)"  # 5-Mar-24
    r"|(?:[^\W\d_]{3}\s+)?[^\W\d_]{3,9}\.?\s+\d{1,2},?\s+\d{4}"  # Tue Mar 05 2024
    r"|\d+\s*d(?:ays?)?"
)
_DAY = 86_400 * 10**9  # ns
_GAP = 10  # an order of dates makes a gap where a step is so many times longer than usual


def _match(cell: object) -> tuple[re.Match[str], str] | None:
    """Clock time of a cell and the text of its date, which may be empty; None if it has none."""
    if not isinstance(cell, str) or (":" not in cell and "T" not in cell):
        return None
    text = cell.strip().strip("'")
    text = re.sub(r"^(\d{8})[T ](\d{2})(\d{2})(\d{2})", r"\1T\2:\3:\4", text)  # 20240305T100000
    text = re.sub(r"(?<=\d)[T_](?=\d)", " ", text)
    clock = _CLOCK.search(text)
    if clock is None:
        return None
    day = f"{text[: clock.start()].rstrip(' ,;')} {text[clock.end() :].lstrip(' ,;')}".strip()
    return (clock, day) if _DATE.fullmatch(day) else None


def is_stamp(cell: object) -> bool:
    """Whether a cell is a text with a clock time, with or without a date."""
    return _match(cell) is not None


def elapsed(path: Path, name: str, cells: Sequence[object], dates: str = "") -> Array:
    """Seconds since the first row of a column of time stamps, (T,); NaN for other cells.

    Clock times without a date go on after midnight. `dates` is "day first", "month first", or ""
    for the order that reads most of them without a time that goes back or a step far longer than
    usual. Refused where both orders do, with other times.
    """
    matches = [_match(cell) for cell in cells]
    orders = [dates] if dates else ["day first", "month first"]
    read = [_seconds(matches, month_first=order == "month first") for order in orders]
    most = max(np.isfinite(seconds).sum() for seconds in read)
    read = [seconds for seconds in read if np.isfinite(seconds).sum() == most]
    if len(read) == 1 or np.array_equal(read[0], read[1], equal_nan=True):
        return read[0]
    even = []
    for seconds in read:
        steps = np.diff(seconds[np.isfinite(seconds)])
        if not steps.size or (steps.min() >= 0.0 and steps.max() <= _GAP * np.median(steps)):
            even.append(seconds)
    if len(even) != 1:
        raise RecordError(
            f"the dates of column {name!r} of {path}, such as {str(cells[-1]).strip()!r}, may have "
            'the day or the month first: write dates = "day first" or dates = "month first" for it'
        )
    return even[0]


def _seconds(matches: Sequence[tuple[re.Match[str], str] | None], *, month_first: bool) -> Array:
    """Seconds of stamps, to the nanosecond, since the first of them."""
    days = {text: _day(text, month_first) for text in {match[1] for match in matches if match}}
    twelve = True  # whether hours run from 1 to 12, without AM and PM
    rows, times = [], []
    for row, match in enumerate(matches):
        if match is None or (day := days[match[1]]) is None:
            continue
        part = match[0].groupdict()
        hour, half, zone = int(part["h"] or 0), part["half"], part["zone"] or ""
        twelve = twelve and part["h"] is not None and 1 <= hour <= 12 and not half
        if half:
            hour = hour % 12 + 12 * (half[0] in "Pp")
        minutes = 60 * hour + int(part["m"] or part["m2"])
        if zone[:1] in ("+", "-"):
            digits = zone[1:].replace(":", "")
            minutes -= int(f"{zone[0]}1") * (60 * int(digits[:2]) + int(digits[2:]))
        seconds = 86_400 * day + 60 * minutes + int(part["s"] or part["s2"])
        rows.append(row)
        times.append(seconds * 10**9 + int((part["f"] or part["f2"] or "").ljust(9, "0")))
    out = np.full(len(matches), np.nan)
    if rows:
        total = np.array([time - times[0] for time in times], dtype=np.int64)
        if not any(days):  # clock times alone
            turn = _DAY // 2 if twelve else _DAY
            total += turn * np.concatenate([[0], np.cumsum(np.diff(total) < -turn // 2)])
        out[rows] = total / 1e9
    return out


def _day(text: str, month_first: bool) -> int | None:
    """Number of a day, 0 where there is no date; None of a date that does not exist."""
    if text.isdigit():  # 20240305
        text = f"{text[:4]}-{text[4:6]}-{text[6:]}"
    numbers = re.findall(r"\d+", text)
    if len(numbers) < 2:  # none, or a number of days
        return int(numbers[0]) if numbers else 0
    if len(numbers) == 2:  # 5-Mar-24
        words = re.findall(r"[^\W\d_]{3,}", text.lower())
        numbers.insert(1, str(_MONTHS.get(words[-1][:3], 0)))
    elif month_first and len(numbers[0]) < 4:
        numbers = [numbers[1], numbers[0], numbers[2]]
    day, month, year = numbers if len(numbers[0]) < 4 else numbers[::-1]
    try:
        return date(int(year) + 2000 * (len(year) == 2), int(month), int(day)).toordinal()
    except ValueError:
        return None
