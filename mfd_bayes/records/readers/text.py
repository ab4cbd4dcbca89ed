"""Columns out of text: separated by commas, semicolons, tabs or blanks, below any heading.

This reads what spreadsheets save as CSV, decimal commas included, and what test controllers
write: lines about the test, a row of names, perhaps a row of units, and numbers.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from mfd_bayes.errors import RecordError
from mfd_bayes.records.motion import Array
from mfd_bayes.records.readers.bounds import check_columns, check_text
from mfd_bayes.records.readers.cells import as_number, bad_cell, is_number
from mfd_bayes.records.readers.labels import label, labels
from mfd_bayes.records.readers.layout import (
    SEARCHED,
    Layout,
    body_of,
    find_layout,
    find_numbers,
    first_of,
    gives_units,
    is_narrow,
    is_word,
    left_out,
    units_of,
)
from mfd_bayes.records.readers.table import Table

BLANKS = " "
SEPARATORS = (",", "\t", ";", BLANKS)

_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f]")
# 0,5 · ,5 · 1,25 · 1,2345 · 1234,5: the comma cannot be a thousands separator.
_SURELY_DECIMAL = re.compile(r"(?<![\d.])0*,\d|\d,\d{1,2}(?!\d)|,\d{4}|\d{4},\d|,\d{3}[eE]")
_ERROR = re.compile(r"#(?:N/A|VALUE!|REF!|DIV/0!|NUM!|NAME\?|NULL!)")
_COMMENTS = ("#", "%", "//", ";", "!")  # signs before names, from programs of all kinds
_DIGITS = frozenset("0123456789+-.,")
_COMMA_NUMBER = re.compile(r"[+-]?\d+,\d{3}(?!\d)")


@dataclass(frozen=True, eq=False)
class _Text:
    """Table of a text file: its lines of numbers, without blank lines and comments."""

    path: Path
    separator: str  # one of `SEPARATORS`
    names: tuple[str, ...]
    heading: int  # line number of the names, or of the first numbers, from 1
    lines: list[str]
    numbers: list[int]  # line numbers of `lines` in the file, from 1
    as_in: str  # "one for each name in", or of numbers without names, "as many as in"

    def place(self, row: int) -> str:
        return f"line {self.numbers[row]}"

    def load(self, wanted: Sequence[str]) -> dict[str, Array]:
        """Numbers of columns that exist, checked cell by cell."""
        if not self.lines:
            return {name: np.empty(0) for name in wanted}
        positions = [self.names.index(name) for name in wanted]
        for decimal in self._decimals():
            columns = self._parsed(positions, decimal)
            if columns is not None:
                if decimal == ",":
                    self._check_commas()
                return dict(zip(wanted, columns, strict=True))
        raise self._fault(wanted, positions)

    def patchy(self, wanted: Sequence[str]) -> dict[str, Array]:
        """As `load`, with NaN for cells that hold no finite number."""
        positions = [self.names.index(name) for name in wanted]
        cells = self._frame(positions, dtype=str, keep_default_na=False)
        found = [
            {
                name: np.array([as_number(cell, sign) for cell in cells[at]])
                for name, at in zip(wanted, positions, strict=True)
            }
            for sign in self._decimals()
        ]
        return max(found, key=lambda one: sum(np.isfinite(c).sum() for c in one.values()))

    def _decimals(self) -> tuple[str, ...]:
        return (".",) if self.separator == "," else (".", ",")

    def _parsed(self, positions: Sequence[int], decimal: str) -> list[Array] | None:
        """Columns at positions; None where a cell is not finite with this decimal sign."""
        try:
            frame = self._frame(positions, dtype=np.float64, decimal=decimal)
        except (ValueError, OverflowError):  # pandas' own are a ValueError too
            return None
        columns = [frame[at].to_numpy() for at in positions]
        return columns if all(np.all(np.isfinite(column)) for column in columns) else None

    def _frame(self, positions: Sequence[int], **options: Any) -> Any:
        """Columns at positions as pandas reads them."""
        import pandas as pd

        if pd.__version__.startswith("2."):  # its own parser reads 1e4294967297 as 10
            options["float_precision"] = "round_trip"
        lines = list(self.lines)
        if self.separator != BLANKS:  # every line may lack the last columns
            lines[0] += self.separator * (len(self.names) - 1 - lines[0].count(self.separator))
        frame = pd.read_csv(
            StringIO("\n".join(lines).replace("\N{MINUS SIGN}", "-")),
            sep=r"\s+" if self.separator == BLANKS else self.separator,
            header=None,
            names=list(range(len(self.names))),
            usecols=sorted(set(positions)),
            index_col=False,
            skipinitialspace=True,
            **options,
        )
        if len(frame) != len(self.lines):
            row = next((i for i, line in enumerate(self.lines) if line.count('"') % 2), 0)
            raise RecordError(
                f"{self.path} {self.place(row)} has a quotation mark without its partner, which "
                "would join it with the next lines"
            )
        return frame

    def _check_commas(self) -> None:
        """Refuse numbers whose comma may be a decimal sign or a thousands separator in all."""
        text = "\n".join(self.lines)
        if not _SURELY_DECIMAL.search(text) and (found := _COMMA_NUMBER.search(text)):
            raise RecordError(
                f"numbers of {self.path} such as {found[0]!r} may have a decimal comma or a "
                "thousands separator; write them with a decimal point"
            )

    def _fault(self, wanted: Sequence[str], positions: Sequence[int]) -> RecordError:
        """Error for the first cell that cannot be read."""
        try:
            cells = self._frame(positions, dtype=str, keep_default_na=False)
        except ValueError as error:
            reason = str(error).splitlines()[0]
            return RecordError(f"{self.path} is not a table of separated columns: {reason}")
        columns = {name: list(cells[at]) for name, at in zip(wanted, positions, strict=True)}
        row, name = min((self._first_bad(column), name) for name, column in columns.items())
        if row < len(cells):
            return bad_cell(self.place(row), self.path, name, columns[name][row])
        return self._mixed(columns)

    def _first_bad(self, column: Sequence[str]) -> int:
        """First row that is no finite number with any decimal sign, or the number of rows."""
        bad = (
            row
            for row, cell in enumerate(column)
            if not any(is_number(cell, decimal=sign, finite=True) for sign in self._decimals())
        )
        return next(bad, len(column))

    def _unread(self, columns: dict[str, list[str]]) -> RecordError:
        """Error for the first cell with a sign that numbers do not have."""
        for name, column in columns.items():
            for row, cell in enumerate(column):
                if not cell.strip().isascii():
                    return bad_cell(self.place(row), self.path, name, cell)
        return RecordError(f"{self.path} holds numbers that cannot be read")

    def _mixed(self, columns: dict[str, list[str]]) -> RecordError:
        """Error for columns that hold both decimal points and decimal commas."""
        seen = {
            sign: f"{cell!r} in {self.place(row)}, column {name!r}"
            for name, column in reversed(columns.items())
            for row, cell in reversed(list(enumerate(column)))
            for sign in ".,"
            if sign in cell
        }
        if len(seen) < 2:
            return self._unread(columns)
        return RecordError(
            f"{self.path} holds both points and commas, {seen['.']} and {seen[',']}: expected one "
            "sign of decimals, and no thousands separators"
        )


def read_text(path: Path) -> Table:
    """Table of a .csv, .txt, .dat, .tsv or .asc file.

    A table is a row of names, perhaps a row of units, and rows of numbers; the one with the
    largest share of numbers is taken. Where there is none, the longest block of rows of numbers
    is, and its columns are called "column 1", "column 2", …, or as in a comment right above them.
    Blank lines and those that begin with # are skipped, and headings that are repeated between the
    numbers.
    """
    check_text(path)
    lines = _decoded(path).split("\n")
    kept = [i for i, line in enumerate(lines) if line.strip() and not _is_comment(line)]
    if not kept:
        raise RecordError(f"{path} is empty")
    head = [lines[i] for i in kept[:SEARCHED]]
    check_columns(path, 1 + max(line.count(sign) for line in head for sign in SEPARATORS[:-1]))
    separator, layout = _best(head) or (_written_in(head[0]), Layout(0, None, 1, 0.0, 0))
    heading = [_split(line, separator) for line in head]
    layout = first_of(heading, layout, _reads)
    names = _names(head, layout, separator)
    units = heading[layout.units] if layout.units is not None else []
    top = kept[layout.data if layout.names is None else layout.names]
    headed = layout.names is not None
    if not headed and (said := _commented(lines[:top], separator, len(names))):
        top, (names, units), headed = said[0], said[1:], True
    rows = range(layout.data, len(kept))
    body = body_of(
        _words(lines, kept, rows, separator),
        rows,
        lambda at: _split(lines[kept[at]], separator),
        heading[: layout.data],
        layout,
        _reads,
    )
    of_numbers = _without_footer(lines, [kept[at] for at in body.rows], separator, len(names))
    text = _Text(
        path,
        separator,
        names,
        heading=top + 1,
        lines=[lines[i] for i in of_numbers],
        numbers=[i + 1 for i in of_numbers],
        as_in="one for each name in" if headed else "as many as in",
    )
    places = [f"line {i + 1}" for i in kept]
    notes = left_out(str(path), heading[: layout.data], body, places, names, headed, _reads)
    _check_widths(text)
    _check_order(path, lines, separator, names, top if headed else None)
    return Table(
        path,
        names,
        text.load,
        text.place,
        units_of(names, units),
        headed=headed,
        blocks={row: places[at] for row, at in body.blocks.items()},
        notes=notes,
        patchy=text.patchy,
    )


def _is_comment(line: str) -> bool:
    """Whether a line is a comment, and does not begin with an error of a spreadsheet: "#N/A"."""
    text = line.lstrip()
    return text.startswith("#") and not _ERROR.match(text)


def _commented(
    above: Sequence[str], separator: str, width: int
) -> tuple[int, tuple[str, ...], list[str]] | None:
    """Names, and units, in the comments right above numbers that have none, with their line."""
    comments = [at for at, line in enumerate(above) if line.lstrip().startswith(_COMMENTS)]
    rows = {at: _words_of(above[at], separator, width) for at in comments[-2:]}
    found = [at for at in rows if rows[at]]
    if not found:
        return None
    at = found[0] if len(found) == 2 and gives_units(rows[found[1]], rows[found[0]]) else found[-1]
    units = rows[found[1]] if at != found[-1] else []
    return at, labels(rows[at]), units


def _words_of(comment: str, separator: str, width: int) -> list[str]:
    """Words of a comment, one for each column; empty where it has not so many, or a number."""
    whole = comment.strip()
    for text in (whole.lstrip("".join(_COMMENTS)).strip(), whole):  # a column may be called #
        for sign in dict.fromkeys((separator, *SEPARATORS)):
            words = _split(text, sign)
            if len(words) == width > 1 and not any(map(_reads, words)):
                return words
    return []


def _check_order(
    path: Path, lines: Sequence[str], separator: str, names: Sequence[str], top: int | None
) -> None:
    """Refuse a comment below the names that has them in another order."""
    for at, line in enumerate(lines[top + 1 :] if top is not None else (), start=(top or 0) + 2):
        if line.lstrip().startswith("#"):
            words = _words_of(line, separator, len(names))
            if words and words != list(names) and sorted(words) == sorted(names):
                raise RecordError(
                    f"line {at} of {path} names the columns in another order than line "
                    f"{(top or 0) + 1}: keep one table in a file"
                )


def _words(lines: Sequence[str], kept: Sequence[int], rows: range, separator: str) -> list[int]:
    """Rows that hold words where the first row has its first number."""
    first = _split(lines[kept[rows.start]], separator) if rows else []
    column = next((k for k, cell in enumerate(first) if _reads(cell)), None)
    found: list[int] = []
    if column is None:
        return found
    for at in rows:
        line = lines[kept[at]]
        if column == 0 and line.lstrip()[:1] in _DIGITS:
            continue
        cells = _split(line, separator)
        if any(is_word(cell) for cell in cells[: column + 1]) and not (
            column < len(cells) and _reads(cells[column])
        ):
            found.append(at)
    return found


def _decoded(path: Path) -> str:
    """Text of a file in UTF-8, in UTF-16 with a byte order mark, or of Windows or Japan.

    Numbers and units are the same in all of these; names may look odd.
    """
    with path.open("rb") as file:
        marked = file.read(2) in (b"\xff\xfe", b"\xfe\xff")
    for encoding in ("utf-16",) if marked else ("utf-8-sig", "cp1252", "cp932", "latin-1"):
        try:
            text = path.read_text(encoding=encoding)
        except UnicodeError:
            continue
        if encoding == "utf-8-sig" or not _CONTROL.search(text):
            return text
    raise RecordError(f"{path} is not UTF-8 text, as a {path.suffix} file must be")


def _best(head: Sequence[str]) -> tuple[str, Layout] | None:
    """Separator whose table has the largest share of numbers, and the layout of that table.

    A table has names; without any, it is the longest block of rows of numbers.
    """
    tables: list[tuple[str, Layout]] = []
    blocks: list[tuple[str, Layout]] = []
    for separator in SEPARATORS:
        rows = [_split(line, separator) for line in head]
        layout = find_layout(rows, _reads)
        if layout is not None and not is_narrow(rows, layout):
            # Words with single blanks between them are names only where each has a column.
            names = len(_names(head, layout, separator))
            if separator != BLANKS or names == len(rows[layout.data]):
                tables.append((separator, layout))
        if (block := find_numbers(rows, _reads)) is not None:
            blocks.append((separator, block))
    found = tables or blocks
    return max(found, key=lambda table: (table[1].weight, table[1].count), default=None)


def _reads(cell: object) -> bool:
    return is_number(cell) or is_number(cell, decimal=",")


def _without_footer(lines: list[str], rows: list[int], separator: str, width: int) -> list[int]:
    """Lines of numbers without the text below them, such as "End of test"."""
    last = len(rows)
    while last > 0:
        cells = _split(lines[rows[last - 1]], separator)
        if len(cells) == width or any(map(_reads, cells)):
            break
        last -= 1
    return rows[:last]


def _written_in(line: str) -> str:
    """Separator of a line of names without numbers below it."""
    return next((sign for sign in SEPARATORS[:-1] if sign in line), ",")


def _split(line: str, separator: str) -> list[str]:
    if separator == BLANKS:
        return line.split()
    if separator not in line:
        return [line.strip().strip('"')]
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]


def _names(head: Sequence[str], layout: Layout, separator: str) -> tuple[str, ...]:
    """Names of the columns, each there once, without empty ones at the end."""
    if layout.names is None:
        return tuple(label(at + 1) for at in range(len(_split(head[layout.data], separator))))
    line = head[layout.names]
    names = _split(line, separator)
    if separator == BLANKS:
        # Names may hold single blanks: "Axial Force   Axial Displacement".
        spaced = re.split(r"\s{2,}|\t", line.strip())
        names = spaced if len(spaced) == len(head[layout.data].split()) else names
    while len(names) > 1 and not names[-1]:
        names.pop()
    return labels(names)


def _check_widths(text: _Text) -> None:
    """Refuse a line with more cells than names, unless the others are empty.

    Where blanks separate cells, a line with fewer cells is refused too: no cell can be empty.
    """
    width = len(text.names)
    for line, number in zip(text.lines, text.numbers, strict=True):
        if text.separator != BLANKS and line.count(text.separator) < width:
            continue
        cells = _split(line, text.separator)
        if any(cells[width:]) or (text.separator == BLANKS and len(cells) < width):
            raise RecordError(
                f"line {number} of {text.path}: expected {width} cells, {text.as_in} "
                f"line {text.heading}, found {len(cells)}"
            )
