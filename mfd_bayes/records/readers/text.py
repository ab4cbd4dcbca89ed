"""Columns out of text: separated by commas, tabs, semicolons or blanks."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.grid import (
    SEARCHED,
    Layout,
    Row,
    find_table,
    gives_units,
    kinds,
    table_of,
)
from mfd_bayes.records.readers.table import SURELY_DECIMAL, Column, Table, check_names, labels

SIZE, LINE = 256, 2**17  # largest file, MB, and most characters of a line
BLANKS = " "
SEPARATORS = (",", "\t", ";", BLANKS)

_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f]")
_COMMENT = re.compile(r"\s*#(?!N/A|VALUE!|REF!|DIV/0!|NUM!|NAME\?|NULL!)")  # no error of Excel
_COMMENTS = "#%/;!"  # signs before names, from programs of all kinds
_OPEN = re.compile(r'(?:^|[,;\t])\s*"(?:[^"]|"")*$')
# What numbers and time stamps are written with, so that no line is a heading.
_PLAIN = re.compile(r"[\d\s.,;:/eE+\-TZAPM]*", re.ASCII)


def read_text(path: Path) -> Table:
    """Table of a .csv, .txt, .dat, .tsv, .asc or .lvm file.

    A table is a row of names, perhaps a row of units, and rows of numbers; the one with the
    largest share of numbers is taken. Where there is none, the longest block of rows of numbers
    is, and its columns are called "column 1", "column 2", …, or as in a comment right above them.
    Blank lines and those that begin with # are skipped, and headings that are repeated between the
    numbers.
    """
    lines = _decoded(path).split("\n")
    comment = _COMMENT.match
    kept = [i for i, line in enumerate(lines) if line.strip() and not comment(line)]
    if not kept:
        raise RecordError(f"{path} is empty")
    separator, rows, layout = _layout(path, [lines[i] for i in kept[:SEARCHED]])
    row = rows[layout.data if layout.names is None else layout.names]
    width = len(row) if layout.names is None else max(len(kinds(row).rstrip("-")), 1)
    names: Sequence[str] | None = None
    units: Row = ()
    top = kept[layout.data if layout.names is None else layout.names]
    if layout.names is None and (said := _commented(lines[:top], separator, width)):
        top, names, units = said
    body = [lines[i] for i in kept[layout.data :]]
    text = _clean(body, separator, width)
    if text is None:  # line by line, for what stands between the numbers
        odd = next((i for i in kept[layout.data :] if _OPEN.search(lines[i])), None)
        if odd is not None:
            raise RecordError(
                f"line {odd + 1} of {path} has a quotation mark without its partner, which would "
                "join it with the next lines"
            )
        rows = [*rows[: layout.data], *(_split(line, separator) for line in body)]
    places = [f"line {i + 1}" for i in kept]
    table, at = table_of(
        path,
        str(path),
        rows,
        places,
        layout,
        place=places.__getitem__,
        names=names,
        units=units,
        load=None if text is None else lambda columns: _parsed(text, separator, columns),
        decimals=(".",) if separator == "," else (".", ","),
        head=tuple(lines[:top]),
        blank="",
    )
    if table.headed and len(lines) > len(kept):
        _check_order(path, lines, table.names, top)
    for number in at if text is None else ():
        row = rows[number]
        # Between blanks no cell can be empty.
        if any(row[width:]) or (separator == BLANKS and len(row) < width):
            as_in = "one for each name in" if table.headed else "as many as in"
            raise RecordError(
                f"{places[number]} of {path}: expected {width} cells, {as_in} line {top + 1}, "
                f"found {len(row)}"
            )
    return table


def _decoded(path: Path) -> str:
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
        number = text.count("\n", 0, long.start()) + 1
        raise RecordError(
            f"line {number} of {path} is longer than {LINE:,} characters, the most that is read; "
            "expected a line for every sample"
        )
    return text


def _layout(path: Path, head: list[str]) -> tuple[str, list[Row], Layout]:
    """Separator whose table has the largest share of numbers, its first rows, and its layout.

    A table has names; without any, it is the longest block of rows of numbers.
    """
    whole = "\n".join(head)
    found: list[tuple[str, list[Row], Layout]] = []
    for separator in SEPARATORS:
        if separator != BLANKS and separator not in whole:
            continue
        rows: list[Row] = [_split(line, separator) for line in head]
        if separator != BLANKS:
            check_names(path, [""] * max(map(len, rows)))
        layout = find_table(rows, exact=separator != BLANKS)
        while separator == BLANKS and layout is not None and layout.names is not None:
            # Words with single blanks between them are names only where each has a column.
            spaced = re.split(r"\s{2,}|\t", head[layout.names].strip())
            if len(spaced) == len(rows[layout.data]):
                rows[layout.names] = spaced
            if len(rows[layout.names]) == len(rows[layout.data]):
                break
            rows[layout.names] = ()
            layout = find_table(rows)
        if layout is not None:
            found.append((separator, rows, layout))
    if found:
        return max(found, key=lambda f: (f[2].names is not None, f[2].weight, f[2].count))
    separator = next((sign for sign in SEPARATORS[:-1] if sign in head[0]), ",")
    return separator, [_split(line, separator) for line in head], Layout(0, None, 1, 0.0, 0)


def _split(line: str, separator: str) -> list[str]:
    if separator == BLANKS:
        return line.split()
    if separator not in line:
        return [line.strip().strip('"')]
    if '"' not in line:
        return [cell.strip() for cell in line.split(separator)]
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]


def _clean(body: list[str], separator: str, width: int) -> str | None:
    """Text of rows of numbers that stand alone, each with as many cells as names; else None."""
    text = "\n".join(body).replace("\N{MINUS SIGN}", "-")
    if not body or not _PLAIN.fullmatch(text):
        return None
    codes = np.frombuffer(text.encode("ascii"), np.uint8)
    ends = np.append(np.flatnonzero(codes == 10), codes.size)
    if separator == BLANKS:
        blank = codes <= 32
        marks, each = np.flatnonzero(~blank & np.append(True, blank[:-1])), width
    else:
        marks, each = np.flatnonzero(codes == ord(separator)), width - 1
        each += bool(np.all(codes[ends - 1] == ord(separator)))  # one at the end of each line
    return text if np.all(np.diff(np.searchsorted(marks, ends), prepend=0) == each) else None


def _parsed(text: str, separator: str, positions: Sequence[int]) -> Sequence[Column]:
    """Columns of clean rows: numbers where a column holds them alone, else its cells."""
    import pandas as pd

    if not positions:
        return []
    comma = separator != "," and "." not in text and SURELY_DECIMAL.search(text) is not None
    options: dict[str, Any] = {"dtype": np.float64, "decimal": "," if comma else "."}
    if pd.__version__.startswith("2."):  # its own parser reads 1e4294967297 as 10
        options["float_precision"] = "round_trip"
    for kind in (options, {"dtype": str, "keep_default_na": False}):
        try:
            frame = pd.read_csv(
                StringIO(text),
                sep=r"\s+" if separator == BLANKS else separator,
                header=None,
                usecols=sorted(set(positions)),
                skipinitialspace=True,
                index_col=False,
                **kind,
            )
        except (ValueError, OverflowError):  # pandas' own are a ValueError too
            continue
        columns = [frame[k].to_numpy() for k in positions]
        if kind is not options:
            return [column.tolist() for column in columns]
        if all(np.all(np.isfinite(column)) for column in columns):
            return columns
    return []


def _commented(
    above: Sequence[str], separator: str, width: int
) -> tuple[int, tuple[str, ...], list[str]] | None:
    """Names, and units, in the comments right above numbers that have none, with their line."""
    comments = [at for at, line in enumerate(above) if line.lstrip().startswith(tuple(_COMMENTS))]
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
    for text in (whole.lstrip(_COMMENTS).strip(), whole):  # a column may be called #
        for sign in dict.fromkeys((separator, *SEPARATORS)):
            words = _split(text, sign)
            if len(words) == width > 1 and "n" not in kinds(words):
                return words
    return []


def _check_order(path: Path, lines: Sequence[str], names: Sequence[str], top: int) -> None:
    """Refuse a comment below the names that has them in another order."""
    for at, line in enumerate(lines[top + 1 :], start=top + 2):
        if line.startswith("#") or line[:1].isspace():
            words = _words_of(line, ",", len(names)) if line.lstrip().startswith("#") else []
            if words and words != list(names) and sorted(words) == sorted(names):
                raise RecordError(
                    f"line {at} of {path} names the columns in another order than line {top + 1}: "
                    "keep one table in a file"
                )
