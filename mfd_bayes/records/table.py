"""The columns of a file: which cells of a grid are names, units and numbers, and what they read."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Any
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError
from mfd_bayes.units import DIMENSIONS, UNREAD, measure

Array = NDArray[np.float64]
Cell = str | float | None
Column = Sequence[Cell] | NDArray[np.generic]

COLUMNS, NAME = 1000, 300  # most columns of a file, and characters of a column's name
NUMBER = re.compile(
    r"[+\-−]?(?:(?:\d+[.,]?\d*|[.,]\d+)(?:[eEdD][+-]?\d+)?|nan|inf|infinity)", re.ASCII | re.I
)
"""A number as programs write it, with a decimal point or a decimal comma."""
# 1.234,5 · 1,234.5 · 1 234,5 · 1'234.5
_GROUPED = re.compile(r"[+-]?\d{1,3}(?:([ .,'’\u00a0\u2009\u202f])\d{3})+(?:(?!\1)[.,]\d*)?")
_THOUSANDS = re.compile(
    r"(?<![\d.,])(\d{1,3}(?:(?:\.\d{3})+(?=,\d)|(?:,\d{3})+(?=\.\d)"
    r"|(?:['’\u00a0\u2009\u202f]\d{3})+))(?:[.,](\d+))?(?!\d)"
)
_BEHIND_COLON = re.compile(r"(?<=[:=;\t])(\s*\d{1,3}(?: \d{3})+)(?!\d)")
_DECIMAL_COMMA = re.compile(r"(?<![\d.,])(\d{4,}|\d+(?=,\d{4})),(\d+)(?![\d.,]*\d)")
# 0,5 · ,5 · 1,25 · 1,2345 · 1234,5: the comma cannot be a thousands separator.
SURELY_DECIMAL = re.compile(r"(?<![\d.])0*,\d|\d,\d{1,2}(?!\d)|,\d{4}|\d{4},\d|,\d{3}[eE]")
_OVERFLOW = re.compile(r"[+-]?(inf\w*|over\w*|ovl\w*|ovf\w*|o\.?l\.?|1\.#\w*|#+)", re.IGNORECASE)
_COMMA_NUMBER = re.compile(r"[+-]?\d+,\d{3}(?!\d)")
_LABEL = re.compile(r"column \d+(: )?(.*)", re.DOTALL)


def is_grouped(cell: str) -> bool:
    """Whether a cell is a number with thousands separators."""
    return bool(_GROUPED.fullmatch(cell.strip()))


def ungrouped(text: str, *, heading: bool = False) -> str:
    """Text whose numbers have no thousands separators, where these are sure: 2.000,0 is 2000.0.

    In a heading, a number behind a colon is one with blanks too, and in 1500,5 stands no 5.
    """
    text = _THOUSANDS.sub(lambda m: re.sub(r"\D", "", m[1]) + (f".{m[2]}" if m[2] else ""), text)
    if heading:
        text = _BEHIND_COLON.sub(lambda m: m[1].replace(" ", ""), text)
        text = _DECIMAL_COMMA.sub(r"\1.\2", text)
    return text


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


_SUFFIX = r"_((?:[^_\s]+_per_)?[^_\s]+)"
_BRACKETS = r"\s*[\[(]([^\[\]()]+)[\])]"
_REMARKS = re.compile(
    "raw|meas(ured)?|corr(ected)?|filt(ered)?|smoothed|avg|average|mean|abs|max|min|rms|total|net|"
    "main|left|right|top|bot(tom)?|upper|lower|north|south|east|west|front|rear|back|lvdt|sensor|"
    "(load)?cell|actuator|machine|ch(annel)?|[xyz]|axial|lateral|vertical|horizontal|relative|"
    "absolute|calibrated|zeroed|command|cmd|feedback|fbk|analog|digital|signal|data|scaled|elapsed|"
    "test|local|utc|fwd|bwd|forward|backward"
)
"""Words that people put in brackets behind a name, and that are no units."""


ROLE_WORDS = {
    role: {word: score for score, words in scored.items() for word in words.split()}
    for role, scored in {
        "time": {4: "time zeit", 3: "timestamp elapsed t", 2: "seconds sec"},
        "displacement": {
            4: "displacement disp displ lvdt stroke weg",
            3: "deflection travel extension displacment",
            2: "position pos x d motion",
        },
        "force": {4: "force load loadcell kraft", 2: "f reaction resistance cell"},
        "actuation": {
            6: "pressure actuation tension preload druck",
            5: "press clamping clamp psi kpa mpa bar",
            3: "current amperage voltage torque strom",
        },
    }.items()
}
"""Score of a word in a column's name for each role."""

CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")


def tells(word: str) -> bool:
    """Whether a word of a heading names a motion, a force or such, or is or has a unit."""
    tokens = re.findall(r"[a-z]+", CAMEL.sub(" ", word).lower())
    is_name = any(token in scores for scores in ROLE_WORDS.values() for token in tokens)
    is_name = is_name or any(token.startswith("acc") for token in tokens)
    return is_name or measure(header_unit(word) or bare_unit(word)) is not None


def header_unit(name: str) -> str | None:
    """Last part of a column's name: ``"kip"`` of ``"force_kip"`` or ``"Force [kip]"``.

    None where the name has one part. The last part may be no unit: ``"force"`` of
    ``"axial_force"``.
    """
    name = normalize("NFKC", own_name(name))  # as the brackets of a Japanese keyboard, and ㎜
    match = re.search(rf"{_BRACKETS}$", name) or re.search(rf"{_SUFFIX}$", name)
    if match is None or match[1].strip(" :,;0123456789") == "" != match[1].strip():  # "log(:,1)"
        return None
    return match[1].strip().replace("_per_", "/")


def stated_unit(name: str, row: str = "") -> str | None:
    """What a file says to be the unit of a column, whether known or not; None where it says none.

    In brackets, as a last word that is known to be one ("load_tonf"), or in its row of units.
    """
    if bare_unit(row):
        return bare_unit(row)
    name = normalize("NFKC", own_name(name))
    for match in re.finditer(r"\[([^\]]+)\]|\(([^()]+)\)|[<{]([^<>{}]+)[>}]", name):
        text = bare_unit(match[match.lastindex or 0])
        if not re.search(r"[^\W\d_]|[%°\"″′”]", text) or _REMARKS.fullmatch(text.lower()):
            continue
        words = re.findall(r"[^\W\d_]+", text)
        multiple = re.fullmatch(r"[x×*]?\s*\d[\d^.,]*\s*[x×*]?\s*(\D+)", text)  # 10^3 N, x1000 N
        if multiple and measure(multiple[1]):
            return text
        is_remark = re.search(r"[\s,;:=]|^[^\W\d_]+[ _.-]?\d+$", text)  # "as wired", "ch2"
        if times := re.match(r"\s*[x×*/]\s*\d[\d.,^]*", name[match.end() :]):
            return f"{text}{times[0]}"  # kN x10
        if measure(text) or not is_remark or any(len(w) > 1 and measure(w) for w in words):
            return text
    tail = re.search(r"(?:_|[\s,/:]+)([^\W\d_]{2,})\s*$", name)
    return tail[1] if tail and tail[1].lower() in UNREAD else None


def parse(column: Column, decimal: str = ".") -> Array:
    """Numbers of a column, (T,), with this sign of decimals; NaN where there is none."""
    if isinstance(column, np.ndarray):
        return np.asarray(column.reshape(-1), dtype=np.float64)
    separator = "," if decimal == "." else "."
    values = np.full(len(column), np.nan)
    for row, cell in enumerate(column):
        if isinstance(cell, str):
            text = cell.strip()
            if separator in text or not NUMBER.fullmatch(text):
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
    """Columns of a file; a column that is not used may hold anything."""

    path: Path
    cells: Mapping[str, Column]  # by name, in the file's order
    rows: Sequence[int] = ()  # number of each row; without them, a row is a "sample"
    affixes: tuple[str, str] = ("sample ", "")  # what stands before and after that number
    units: Mapping[str, str] = field(default_factory=dict)  # by column, where the file gives one
    numbers: Sequence[int] = ()  # of the columns, from 1; by default in their order
    headed: bool = True  # whether the file has names; without them, they are "column 1", …
    blocks: Mapping[int, str] = field(default_factory=dict)
    """Row to the place of a repeated heading above it."""
    align: Callable[[Mapping[str, Column]], Mapping[str, Column]] = dict
    """Gives columns that are used together the same rows, or refuses them."""
    notes: tuple[str, ...] = ()  # on numbers of the file that are not in the table,
    doubts: tuple[str, ...] = ()  # and on those that may belong to it
    decimals: tuple[str, ...] = (".",)  # signs of decimals that its numbers may have
    head: tuple[str, ...] = ()  # texts above it, and settings with it: "Sample rate: 100 Hz"

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
        prefix, suffix = self.affixes
        return f"{prefix}{self.rows[row] if len(self.rows) else row + 1}{suffix}"

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
        numeric = [name for name in names if name not in self.stamped]
        read = [{n: parse(cells[n], sign) for n in numeric} for sign in self.decimals]
        values = max(
            read, key=lambda candidate: sum(np.isfinite(v).sum() for v in candidate.values())
        )
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
        cell = self.align({key: self.cells[key] for key in names})[name][row]
        text = "" if cell is None else str(cell).strip()
        label = repr(text[:60]) if text else "an empty cell"
        if not text and self.path.suffix.lower() == ".xlsx":
            label += ", or a formula without a stored value: save it in Excel"
        if any(np.isfinite(parse([cell], sign)[0]) for sign in self.decimals):
            label += (
                ", and others with the other sign: the file holds both points and commas; expected "
                "one sign of decimals, and no thousands separators"
            )
        elif _GROUPED.fullmatch(text) and (len(self.decimals) == 1 or not NUMBER.fullmatch(text)):
            label += "; a number is written without a thousands separator"
        elif is_stamp(text):
            label += ", which is a time stamp: expected a number, as in the first row"
        elif _OVERFLOW.fullmatch(text):
            label += ", an overflow of the logger: take such rows out"
        elif row == 0 and len(re.findall(r"\d+", text)) > 3:
            label += "; of a time, expected elapsed seconds, or such as 2024-03-05 10:00:00.250"
        return RecordError(
            f"{self.place(row)} of {self.path}, column {name!r}: expected a finite number, "
            f"found {label}"
        )

    def part(self, start: int, stop: int, doubt: str) -> Table:
        """Table of rows `start` to before `stop`; `doubt` says what is left out."""
        return replace(
            self,
            cells={name: column[start:stop] for name, column in self.cells.items()},
            rows=self.rows[start:stop] if len(self.rows) else range(start + 1, stop + 1),
            blocks={row - start: heading for row, heading in self.blocks.items() if row > start},
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
                f"{listed(self.names, 20, str)}"
            )
        return self.names[numbers.index(column)]

    def called(self, role: str) -> list[str]:
        """Name of the column that is called like a role, perhaps with a unit, if there is one."""
        pattern = re.compile(rf"{role}({_SUFFIX}|{_BRACKETS})?", re.IGNORECASE)
        matches = [name for name in self.names if pattern.fullmatch(own_name(name))]
        if len(matches) > 1:
            raise RecordError(
                f"{self.path} has several columns for {role}, {', '.join(matches)}; say which, as "
                f"{role} = {{ column = {self.number_of(matches[0])} }}"
            )
        return matches

    def no_column(self, name: str) -> RecordError:
        """Error for a name that no column, or more than one, has."""
        shared = [self.number_of(column) for column in self.names if own_name(column) == name]
        if len(shared) > 1:
            choices = " or ".join(f"{{ column = {number} }}" for number in shared)
            return RecordError(
                f"more than one column {name!r} in {self.path}: say which by its number, {choices}"
            )
        how = "" if self.headed else "; it has no names: give { column = 1 } or another number"
        return RecordError(
            f"missing column {name!r} in {self.path}; it has {listed(self.names, 20, str)}{how}"
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


def listed(names: Sequence[str], limit: int = 4, written: Callable[[str], str] = repr) -> str:
    """The first names, and how many more there are."""
    text = ", ".join(map(written, names[:limit]))
    return text if len(names) <= limit else f"{text} and {len(names) - limit} more"


_NAMES = "jan feb mar apr may jun jul aug sep oct nov dec"
_MONTHS = {name: number for number, name in enumerate(_NAMES.split(), start=1)}
_MONTHS |= {"mär": 3, "mrz": 3, "mai": 5, "okt": 10, "dez": 12}
_CLOCK = re.compile(
    r"(?<![\d:.,])(?:(?P<h>\d{1,4}):(?P<m>[0-5]?\d):(?P<s>[0-5]?\d)(?:[.,:](?P<f>\d{1,9}))?"
    r"|(?P<m2>\d{1,3}):(?P<s2>[0-5]\d)[.,](?P<f2>\d{1,9}))"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?:Z|UTC|GMT|[+-]\d{2}:?\d{2})?(?=$|[,; ])"
)
_DATE = re.compile(
    r"|\d{8}|\d{4}([-/.])\d{1,2}\1\d{1,2}|\d{1,2}([-/.])\d{1,2}\2(?:\d{4}|\d\d)"
    r"|\d{1,2}[- ./]{0,2}[^\W\d_]{3,9}\.?[- ,/]{0,2}(?:\d{4}|\d\d)"  # 5-Mar-24
    r"|(?:[^\W\d_]{3}\s+)?[^\W\d_]{3,9}\.?\s+\d{1,2},?\s+\d{4}"  # Tue Mar 05 2024
    r"|\d+\s*d(?:ays?)?"
)
_DAY = 86_400 * 10**9  # ns
_GAP = 10  # an order of dates makes a gap where a step is so many times longer than usual


def _match(cell: object) -> tuple[re.Match[str], str] | None:
    """Clock time of a cell and the text of its date, which may be empty; None if it has none."""
    if not isinstance(cell, str) or not re.search(r":|\d{8}[T ]\d", cell):
        return None
    text = re.sub(r"^[^\W\d_]{2,3}, ", "", cell.strip("'[]() "))  # Tue, 05 Mar 2024
    text = re.sub(r"^(\d{8})[T ](\d{2})(\d{2})(\d{2})", r"\1T\2:\3:\4", text)  # 20240305T100000
    joined = r"(?<=\d)[T_](?=\d)|(?<=\d{4}):(?=\d\d:)|(?<=\d)-(?=\d\d:\d\d:)"
    text = re.sub(joined, " ", text)
    clock = _CLOCK.search(text)
    if clock is None:
        return None
    day = f"{text[: clock.start()].rstrip(' ,;')} {text[clock.end() :].lstrip(' ,;')}".strip()
    return (clock, day) if _DATE.fullmatch(day) else None


def is_stamp(cell: object) -> bool:
    """Whether a cell is a text with a clock time, with or without a date."""
    return _match(cell) is not None


def elapsed(path: Path, name: str, cells: Sequence[object], dates: str) -> Array:
    """Seconds since the first row of a column of time stamps, (T,); NaN for other cells.

    Clock times without a date go on after midnight. `dates` is "day first", "month first", or ""
    for the order that reads most of them without a time that goes back or a step far longer than
    usual. Refused where both orders do, with other times.
    """
    matches = [_match(cell) for cell in cells]
    orders = [dates] if dates else ["day first", "month first"]
    read = [_seconds(matches, month_first=order == "month first") for order in orders]
    count = max(np.isfinite(seconds).sum() for seconds in read)
    read = [seconds for seconds in read if np.isfinite(seconds).sum() == count]
    if len(read) == 1 or np.array_equal(read[0], read[1], equal_nan=True):
        return read[0]
    regular = []
    for seconds in read:
        steps = np.diff(seconds[np.isfinite(seconds)])
        if not steps.size or (steps.min() >= 0.0 and steps.max() <= _GAP * np.median(steps)):
            regular.append(seconds)
    if len(regular) != 1:
        raise RecordError(
            f"the dates of column {name!r} of {path}, such as {str(cells[-1]).strip()!r}, may have "
            'the day or the month first: write dates = "day first" or dates = "month first" for it'
        )
    return regular[0]


def _seconds(matches: Sequence[tuple[re.Match[str], str] | None], *, month_first: bool) -> Array:
    """Seconds of stamps, to the nanosecond, since the first of them."""
    days = {text: _day(text, month_first) for text in {match[1] for match in matches if match}}
    twelve = True  # whether hours run from 1 to 12, without AM and PM
    rows, times = [], []
    for row, match in enumerate(matches):
        if match is None or (day := days[match[1]]) is None:
            continue
        groups = match[0].groupdict()
        hour, half = int(groups["h"] or 0), groups["half"]
        twelve = twelve and groups["h"] is not None and 1 <= hour <= 12 and not half
        if half:
            hour = hour % 12 + 12 * (half[0] in "Pp")
        minutes = 60 * hour + int(groups["m"] or groups["m2"])
        seconds = 86_400 * day + 60 * minutes + int(groups["s"] or groups["s2"])
        rows.append(row)
        times.append(seconds * 10**9 + int((groups["f"] or groups["f2"] or "").ljust(9, "0")))
    values = np.full(len(matches), np.nan)
    if rows:
        total = np.array([time - times[0] for time in times], dtype=np.int64)
        if not any(days):  # clock times alone
            turn = _DAY // 2 if twelve else _DAY
            total += turn * np.concatenate([[0], np.cumsum(np.diff(total) < -turn // 2)])
        values[rows] = total / 1e9
    return values


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


Row = Sequence[Cell]

ENOUGH = 40  # numbers of a table that is surely more than a few settings
TABLE = 20  # so many rows of numbers are a table by themselves
STEPS = 5  # steps of a column that show that it is a time
SEARCHED = 200  # filled rows, from the first, in which the names are looked for
_MISSING = frozenset(("nan", "na", "n/a", "n.a.", "null", "none", "inf", "infinity"))
# Ratios, rates and masses do not show that a row holds units: "1", "cycles" or "t" may be text.
_TELLING = {dimension.measure for dimension in DIMENSIONS.values()} - {"ratio", "rate", "mass"}
_TELLING |= {"acceleration", "length / time ** 2"}
_ACCELERATION = re.compile(
    r"(?:%|m|milli-?)?\s*g(?:'?s)?|gals?|(?:[cm]?m|in|ft)/s(?:ec)?\^?2", re.IGNORECASE
)  # no gram


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
    for top in range(len(rows) - 1):
        if numbers[top] or filled[top] < 2 or any(map(_is_date, rows[top])):
            continue
        has_units = not numbers[top + 1] and gives_units(rows[top + 1], rows[top])
        data = top + 1 + has_units
        if has_units and top + 2 < len(rows) and filled[top + 2] and not numbers[top + 2]:
            data += not any(map(is_stamp, rows[top + 2]))  # a third row: "Avg", "Smp"
        end = numbers.index(0, data) if 0 in numbers[data:] else len(rows)
        if end > data and (not exact or len(_cells(rows[top])) >= len(_cells(rows[data]))):
            count = sum(numbers[data:end])
            share = count / sum(filled[data:end])
            tables.append(Layout(top, top + 1 if has_units else None, data, share, count))
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


def _is_date(cell: Cell) -> bool:
    """Whether a cell is a date or a clock time, as in a remark: 05.03.2024, 10:00."""
    pattern = r"\d{1,4}([-/.:])\d{1,2}(?:\1\d{1,4})?"
    return (
        isinstance(cell, str) and not NUMBER.fullmatch(cell) and bool(re.fullmatch(pattern, cell))
    )


def gives_units(row: Row, names: Row) -> bool:
    """Whether a row holds two units or more below names, and at least as many units as words."""
    filled = [k for k, cell in enumerate(row) if cell not in (None, "")]
    if any(k >= len(names) or names[k] in (None, "") for k in filled):
        return False
    units = [unit for cell in row if isinstance(cell, str) and (unit := bare_unit(cell))]
    unread = sum(len(unit) > 1 and unit.lower() in UNREAD for unit in units)
    measures = ["acceleration" if _ACCELERATION.fullmatch(u) else measure(u) for u in units]
    telling = sum(of in _TELLING for of in measures) + unread
    return telling >= 2 and 2 * (measures.count(None) - unread) <= len(filled)


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

    def refusal(self, reason: str) -> RecordError:
        """Error for a grid that may hold more than one table."""
        of = f"{self.sheet} of {self.path}" if self.sheet else self.path
        return RecordError(f"{of} holds more than one table: {reason}: keep one table in a file")

    def table(
        self,
        layout: Layout,
        heading: tuple[Sequence[str], Row] | None = None,
        columns: Sequence[Column] | None = None,
        **extra: Any,
    ) -> Table:
        """Table of a layout; `extra` goes to the table.

        `heading` are names and units that do not stand in the layout's rows; `columns` are all
        numbers, where nothing stands between them.
        """
        rows, data = self.rows, layout.data
        first_row = rows[data] if data < len(rows) else ()
        if heading is not None:
            names, units = heading
            indices = list(range(len(names)))
        else:
            title: Row = () if layout.names is None else _cells(rows[layout.names])
            units = () if layout.units is None else rows[layout.units]
            kind = kinds(first_row)
            indices = [
                k
                for k in range(max(len(title), len(kind)))
                if (k < len(title) and title[k] is not None)
                or kind[k : k + 1] == "n"
                or (not title and kind[k : k + 1] == "t")
            ]
            texts = [
                " ".join(str(title[k] or "").split()) if k < len(title) else "" for k in indices
            ]
            names = labels(texts, [k + 1 for k in indices])
        headed = heading is not None or layout.names is not None
        notes = self._above(data, names, headed=headed)
        body: Sequence[int] = range(data, len(self.numbers))
        blocks: dict[int, str] = {}
        if columns is None:
            body, blocks, footer = self._body(layout, len(names))
            notes += footer
        blank = "" if self.word == "line" else None  # of a short row
        cells: dict[str, Column] = {}
        column_units = {}
        first_row = rows[body[0]] if len(body) else ()
        for name, k in zip(names, indices, strict=True):
            if columns is None:
                cells[name] = [rows[i][k] if k < len(rows[i]) else blank for i in body]
            else:
                cells[name] = columns[k]
            if k < len(first_row) and is_stamp(first_row[k]):
                column_units[name] = "s"
            elif k < len(units) and (unit := bare_unit(str(units[k] or ""))):
                column_units[name] = unit
        head = tuple(
            " ".join(f"{c:g}" if isinstance(c, float) else str(c) for c in row if c is not None)
            for row in rows[:data]
        )
        return Table(
            self.path,
            cells,
            [self.numbers[row] for row in body],
            (f"{self.word} ", f" of {self.sheet}" if self.sheet else ""),
            column_units,
            [k + 1 for k in indices],
            headed,
            blocks,
            notes=tuple(notes),
            **{**extra, "head": extra.get("head") or head},
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
        first_row = rows[data] if data < len(rows) else ()
        numbers = (k for k, cell in enumerate(first_row) if kinds([cell]) == "n" or is_stamp(cell))
        column = next(numbers, 0)
        words = [i for i in range(data, len(rows)) if _is_text(rows[i], column)]
        dropped: set[int] = set()
        headings: dict[int, str] = {}
        notes = []
        for _, pairs in groupby(enumerate(words), lambda pair: pair[1] - pair[0]):
            group = [i for _, i in pairs]
            if _goes_on(rows, group[0], data) and not _STATISTIC.match(str(rows[group[0]][0])):
                continue
            texts, end = [_cells(rows[i]) for i in group], group[-1] + 1
            again = names in texts and texts[texts.index(names) + 1 :] in ([], [units])
            has_numbers = names not in texts and "n" in "".join(map(kinds, texts))
            if end == len(rows) and has_numbers and len(group) >= TABLE:
                continue  # no footer: the `window` may leave them out
            if end == len(rows) or again:
                dropped.update(group)
                headings[end] = self.place(group[0])
            elif any(_shared(text, names) >= 2 for text in texts):
                reason = "has other units, or the names in another order"
                raise self.refusal(f"the heading at {self.place(group[0])} {reason}")
            if end == len(rows) and has_numbers:
                notes = [f"{self.place(group[0])} and below: numbers below the table, not used"]
        body = [i for i in range(data, len(rows)) if i not in dropped]
        while body and len(rows[body[-1]]) != width and "n" not in kinds(rows[body[-1]]):
            body.pop()  # other text below the numbers
        return body, {n: headings[i] for n, i in enumerate(body) if i in headings}, notes

    def _above(self, data: int, names: Row, *, headed: bool) -> list[str]:
        """Sentences on rows of numbers above a table, which are not used."""
        notes = []
        kind = [kinds(row) for row in self.rows[:data]]
        for has_numbers, group in groupby(range(data), lambda i: kind[i].count("n") >= 2):
            if not has_numbers:
                continue
            members = list(group)
            top, bottom = members[0], members[-1]
            location = self.place(top)
            if bottom > top:
                location = f"{self.word}s {self.numbers[top]} to {self.numbers[bottom]}"
            preceding = range(max(top - 2, 0), top)
            titles = [self.rows[i] for i in preceding if len(kind[i].strip("-")) > 1]
            bare = "t" not in "".join(kind[top : bottom + 1])
            alike = len(members) > 2 and len(kind[top].rstrip("-")) == len(names)
            if (
                len(members) >= TABLE
                or (bare and not titles and (alike or not headed))
                or any(_shared(row, names) >= 2 for row in titles)
            ):
                raise self.refusal(
                    f"{location} hold numbers, and others begin at {self.place(data)}"
                )
            if bare or len(members) > 2:
                notes.append(f"{location}: numbers above the table, not used")
        return notes


def _is_text(row: Row, column: int) -> bool:
    """Whether a row holds words where the first row has its first number."""
    cell = row[column] if column < len(row) else None
    if cell in (None, ""):
        label = next((str(c) for c in row if c not in (None, "")), "")
        return any(map(_is_word, row[: column + 1])) or bool(_STATISTIC.match(label))
    return _is_word(cell) or (kinds([cell]) == "t" and any(map(_is_word, row[:column])))


def _is_word(cell: Cell) -> bool:
    """Whether a cell holds words, and no mark of a number that is missing, nor a time stamp."""
    text = cell.strip().lower() if isinstance(cell, str) else ""
    return (
        bool(re.match(r"[\[(]?[^\W\d_]|[*%=]|-{3}", text))
        and text not in _MISSING
        and not is_stamp(text)
    )


_STATISTIC = re.compile(r"\s*(max|min|mean|avg|average|std|sum|total|count|peak|rms|mittel)", re.I)


def _goes_on(rows: Sequence[Row], index: int, start: int) -> bool:
    """Whether a column counts on into a row by the step of those above: it is a measurement."""
    if index < start + STEPS:
        return False
    for column in zip(*rows[index - STEPS : index + 1], strict=False):
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
