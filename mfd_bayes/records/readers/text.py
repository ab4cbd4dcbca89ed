"""Columns out of text, separated by commas, tabs, semicolons or blanks, and out of JSON."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mfd_bayes.errors import RecordError
from mfd_bayes.records.inputs import why_invalid
from mfd_bayes.records.table import (
    SEARCHED,
    SURELY_DECIMAL,
    Array,
    Grid,
    Layout,
    Row,
    Table,
    bare_unit,
    check_names,
    find_table,
    gives_units,
    is_stamp,
    kinds,
    labels,
)

SIZE, LINE = 256, 2**17  # largest file, MB, and most characters of a line
JSON_SIZE, LISTS, CELLS = 64, 1_000_000, 20_000_000
"""Largest .json file, MB, most lists and objects of it, and most cells of rows of objects."""
BLANKS = " "
SEPARATORS = (",", "\t", ";", BLANKS)

_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f]")
_COMMENT = re.compile(r"\s*#(?!N/A|VALUE!|REF!|DIV/0!|NUM!|NAME\?|NULL!)")  # no error of Excel
_COMMENTS = "#%/;!"  # signs before names, from programs of all kinds
_OPEN = re.compile(r'(?:^|[,;\t])\s*"(?:[^"]|"")*$')


def read_text(path: Path) -> Table:
    """Table of a .csv, .txt, .dat, .tsv, .asc or .lvm file.

    Columns without names are called "column 1", "column 2", …, or as in a comment right above the
    numbers. Blank lines and those that begin with # are skipped.
    """
    lines = _decode(path).split("\n")
    comment = _COMMENT.match
    kept = [i for i, line in enumerate(lines) if line.strip() and not comment(line)]
    if not kept:
        raise RecordError(f"{path} is empty")
    separator, rows, layout = _layout(path, [lines[i] for i in kept[:SEARCHED]])
    top = layout.data if layout.names is None else layout.names
    width = len(rows[top]) if layout.names is None else max(len(kinds(rows[top]).rstrip("-")), 1)
    top, heading = kept[top], None
    if layout.names is None and (above := _heading_in_comments(lines[:top], separator, width)):
        top, heading = above[0], above[1:]
    body = [lines[i] for i in kept[layout.data :]]
    columns = _columns(body, separator, width) if body else None
    if columns is None:  # line by line, for what stands between the numbers
        for at in kept[layout.data :]:
            if _OPEN.search(lines[at]):
                raise RecordError(
                    f"line {at + 1} of {path} has a quotation mark without its partner, which "
                    "would join it with the next lines"
                )
        rows = [*rows[: layout.data], *(_split(line, separator) for line in body)]
    numbers = [i + 1 for i in kept]
    table = Grid(path, rows, numbers).table(
        layout,
        heading,
        columns,
        decimals=(".",) if separator == "," else (".", ","),
        head=tuple(lines[:top]),
    )
    if table.headed:
        _check_order(path, lines, table.names, top)
    used = set(table.rows)
    for number, row in zip(numbers, rows, strict=False) if columns is None else ():
        # Between blanks no cell can be empty.
        short = separator == BLANKS and len(row) < width
        if number in used and (any(row[width:]) or short):
            as_in = "one for each name in" if table.headed else "as many as in"
            raise RecordError(
                f"line {number} of {path}: expected {width} cells, {as_in} line {top + 1}, found "
                f"{len(row)}"
            )
    return table


def _decode(path: Path) -> str:
    """Text of a file in UTF-8, in UTF-16 with a byte order mark, or of Windows or Japan.

    Numbers and units are the same in all of these; names may look odd.
    """
    size = path.stat().st_size / 2**20
    if size > SIZE:
        raise RecordError(
            f"{path} has {size:,.0f} MB; at most {SIZE} MB of a {path.suffix} file are read: save "
            "it as .mat or .tdms, or cut it"
        )
    content = path.read_bytes()
    marked = content[:2] in (b"\xff\xfe", b"\xfe\xff")
    for encoding in ("utf-16",) if marked else ("utf-8-sig", "cp1252", "cp932", "latin-1"):
        try:
            text = content.decode(encoding)
        except UnicodeError:
            continue
        if encoding == "utf-8-sig" or not _CONTROL.search(text):
            break
    else:
        raise RecordError(f"{path} is not UTF-8 text, as a {path.suffix} file must be")
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if long := re.search(rf"[^\n]{{{LINE + 1}}}", text):
        raise RecordError(
            f"line {text.count(chr(10), 0, long.start()) + 1} of {path} is longer than {LINE:,} "
            "characters, the most that is read; expected a line for every sample"
        )
    return text


def _layout(path: Path, lines: list[str]) -> tuple[str, list[Row], Layout]:
    """Separator whose table weighs most, with names before one without, its rows and its layout."""
    candidates: list[tuple[str, list[Row], Layout]] = []
    for separator in SEPARATORS:
        if separator != BLANKS and not any(separator in line for line in lines):
            continue
        rows: list[Row] = [_split(line, separator) for line in lines]
        if separator != BLANKS:
            check_names(path, [""] * max(map(len, rows)))
        layout = find_table(rows, exact=separator != BLANKS)
        while separator == BLANKS and layout is not None and layout.names is not None:
            # Words with single blanks between them are names only where each has a column.
            spaced = re.split(r"\s{2,}|\t", lines[layout.names].strip())
            if len(spaced) == len(rows[layout.data]):
                rows[layout.names] = spaced
            if len(rows[layout.names]) == len(rows[layout.data]):
                break
            rows[layout.names] = ()
            layout = find_table(rows)
        if layout is not None:
            candidates.append((separator, rows, layout))
    if candidates:
        return max(candidates, key=lambda c: (c[2].names is not None, c[2].weight, c[2].count))
    separator = next((sign for sign in SEPARATORS[:-1] if sign in lines[0]), ",")
    return separator, [_split(line, separator) for line in lines], Layout(0, None, 1, 0.0, 0)


def _split(line: str, separator: str) -> list[str]:
    if separator == BLANKS:
        return line.split()
    if '"' not in line:
        return [cell.strip() for cell in line.split(separator)]
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]


def _columns(body: list[str], separator: str, width: int) -> list[Array] | None:
    """Columns of rows that hold finite numbers alone, one for each name; None of other rows."""
    text = "\n".join(body).replace("\N{MINUS SIGN}", "-")
    if separator != "," and "." not in text and SURELY_DECIMAL.search(text):
        text = text.replace(",", ".")
    delimiter = None if separator == BLANKS else separator
    try:
        values = np.loadtxt(text.split("\n"), delimiter=delimiter, comments=None, ndmin=2)
    except ValueError:
        return None
    if values.shape != (len(body), width) or not np.isfinite(values).all():
        return None
    return list(values.T)


def _heading_in_comments(
    above: Sequence[str], separator: str, width: int
) -> tuple[int, tuple[str, ...], list[str]] | None:
    """Line, names and units in the comments right above numbers that have no names."""
    comments = [at for at, line in enumerate(above) if line.lstrip().startswith(tuple(_COMMENTS))]
    words = {at: row for at in comments[-2:] if (row := _words(above[at], separator, width))}
    if not words:
        return None
    first, *_, last = *words, *words
    if len(words) == 2 and gives_units(words[last], words[first]):
        return first, labels(words[first]), words[last]
    return last, labels(words[last]), []


def _words(comment: str, separator: str, width: int) -> list[str]:
    """Words of a comment, one for each column; empty where it has not so many, or a number."""
    whole = comment.strip()
    for text in (whole.lstrip(_COMMENTS).strip(), whole):  # a column may be called #
        for sign in dict.fromkeys((separator, *SEPARATORS)):
            words = _split(text, sign)
            if len(words) == width > 1 and "n" not in kinds(words):
                return words
    return []


def _check_order(path: Path, lines: Sequence[str], names: Sequence[str], top: int) -> None:
    """Refuse a comment below the names that has them in another order."""
    for at, line in enumerate(lines[top + 1 :], start=top + 2):
        if line.lstrip().startswith("#"):
            words = _words(line, ",", len(names))
            if words and words != list(names) and sorted(words) == sorted(names):
                raise RecordError(
                    f"line {at} of {path} names the columns in another order than line {top + 1}: "
                    "keep one table in a file"
                )


def read_json(path: Path) -> Table:
    """Table of a .json file: an object of lists, a list of objects or of rows, or of pandas.

    Numbers and texts beside the columns are its settings.
    """
    size = path.stat().st_size / 2**20
    if size > JSON_SIZE:
        raise RecordError(
            f"{path} has {size:,.0f} MB; at most {JSON_SIZE} MB of a .json file are read"
        )
    try:
        text = path.read_text(encoding="utf-8-sig")
        if text.count("[") + text.count("{") > LISTS:
            raise RecordError(
                f"{path} holds more than {LISTS:,} lists and objects, the most that are read; "
                "expected one list for each column"
            )
        content = json.loads(text)
    except UnicodeDecodeError as error:
        raise RecordError(f"{path} is not UTF-8 text, as a .json file must be") from error
    except (ValueError, RecursionError) as error:
        raise RecordError(f"{path} is not valid JSON: {why_invalid(error)}") from error
    headed = not (isinstance(content, list) and bool(content) and isinstance(content[0], list))
    whole: dict[str, Any] = content if isinstance(content, dict) else {}
    match content:
        case [[*cells], *_]:
            columns = _of_rows(path, content, labels([""] * len(cells)))
        case {"columns": [*names], "data": [*lines]}:
            columns = _of_rows(path, lines, [str(name) for name in names])
        case [*lines]:
            columns = _of_rows(path, lines)
        case {}:
            columns = {k: v for k, v in whole.items() if isinstance(v, dict | list)}
        case _:
            raise RecordError(f"{path} must hold an object of lists or a list of objects")
    named = next((key for key in ("units", "unit") if key in whole), "")
    given = whole.get(named)
    if isinstance(given, list):
        given = dict(zip([name for name in columns if name != named], given, strict=False))
    if isinstance(given, dict) and all(isinstance(unit, str) for unit in given.values()):
        columns = {name: column for name, column in columns.items() if name != named}
    else:
        given = {}
    if not columns:
        raise RecordError(f"{path} holds no columns; expected an object of lists")
    # Columns as pandas writes them have the same row labels; another object is no column.
    labelled = [column for column in columns.values() if isinstance(column, dict)]
    rows = max((list(column) for column in labelled), key=lambda each: len(each), default=[])
    columns = {
        name: [column[row] for row in rows] if isinstance(column, dict) else column
        for name, column in columns.items()
        if not isinstance(column, dict) or column.keys() == set(rows)
    }
    units = {name: unit for name, text in given.items() if (unit := bare_unit(text))}
    units |= {name: "s" for name, cells in columns.items() if cells and is_stamp(cells[0])}
    settings = tuple(f"{k}: {v}" for k, v in whole.items() if type(v) in (int, float, str))
    return Table(path, columns, units=units, headed=headed, head=settings)


def _of_rows(path: Path, rows: list[Any], names: Sequence[str] | None = None) -> dict[str, Any]:
    """Columns of rows that are objects, or lists with a cell for each name."""
    every: dict[str, None] = {}
    for i, row in enumerate(rows):
        if names is not None and isinstance(row, list) and len(row) == len(names):
            rows[i] = row = dict(zip(names, row, strict=True))
        if not isinstance(row, dict):
            raise RecordError(f"row {i + 1} of {path} must be an object with one value per column")
        every.update(dict.fromkeys(row))
    check_names(path, [""] * len(every))
    if len(every) * len(rows) > CELLS:
        raise RecordError(
            f"{path} has {len(rows):,} rows of {len(every):,} columns; at most {CELLS:,} cells "
            "are read"
        )
    return {name: [row.get(name) for row in rows] for name in every}
