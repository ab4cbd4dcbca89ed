"""Columns of numbers out of text, JSON, Excel, MATLAB and LabVIEW's TDMS files.

The libraries of the last three build what a file declares, some of them in a form that ends the
process. So a child process reads those, with a limit of memory and of time; only numbers and texts
come back.
"""

from __future__ import annotations

import contextlib
import csv
import datetime
import faulthandler
import io
import json
import logging
import math
import multiprocessing
import os
import re
import subprocess
import sys
import threading
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError, why_invalid, why_no_file
from mfd_bayes.records.table import (
    COLUMNS,
    SEARCHED,
    SURELY_DECIMAL,
    Array,
    Cell,
    Column,
    Grid,
    Layout,
    Row,
    Table,
    bare_unit,
    check_names,
    find_table,
    gives_units,
    is_grouped,
    is_stamp,
    kinds,
    labels,
    tells,
)
from mfd_bayes.units import factor, measure

SIZE, LINE = 256, 2**17  # largest file, MB, and most characters of a line
LINES, EMPTY = 10_000_000, 200_000  # most lines, and most characters of those without a cell
JSON_SIZE, LISTS, CELLS = 64, 1_000_000, 20_000_000
"""Largest .json file, MB, most lists and objects of it, and most cells of rows of objects."""
BLANKS = " "
_NO_CELL = ',;|" \t'
_BEFORE_NAME = r"\s+(?![\[(])"  # no name begins with a bracket: "Time (s) Force (N)"
SEPARATORS = (",", "\t", ";", "|", BLANKS)

_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f]")
_COMMENT = re.compile(r"\s*#(?!N/A|VALUE!|REF!|DIV/0!|NUM!|NAME\?|NULL!)")  # no error of Excel
_COMMENTS = "#%/;!"  # signs before names, from programs of all kinds
_WRAPPED = re.compile(  # a number as Python shows it: np.float64(0.5)
    r"\b(?:(?:np|numpy|jnp)\.\w+|Decimal|array|tensor|float\d*)\(\s*['\"]?([-+\d.,eE]+|nan|inf)['\"]?"
    r"(?:, dtype=[\w.]+)?\)"
)
_SIGN = re.compile(r"([+\-−])\s+(?=[.,]?\d)")  # of a logger that writes it in a column of its own
_OPEN = re.compile(r'(?:^|[,;\t])\s*"(?:[^"]|"")*$')


def read_text(path: Path) -> Table:
    """Table of a .csv, .txt, .dat, .tsv, .asc or .lvm file.

    Columns without names are called "column 1", "column 2", …, or as in a comment right above the
    numbers. Blank lines and those that begin with # are skipped.
    """
    lines = _decode(path)
    comment = _COMMENT.match
    filled = [i for i, line in enumerate(lines) if line.strip() and not comment(line)]
    while filled and not lines[filled[-1]].strip(_NO_CELL):
        filled.pop()
    if sum(len(lines[i]) for i in filled if not lines[i].strip(_NO_CELL)) > EMPTY:
        raise RecordError(f"{path} is full of lines of separators alone; expected numbers in them")
    if not filled:
        raise RecordError(f"{path} is empty")
    separator, rows, layout = _layout(path, [lines[i] for i in filled[:SEARCHED]])
    top = layout.data if layout.names is None else layout.names
    width = len(rows[top]) if layout.names is None else max(len(kinds(rows[top]).rstrip("-")), 1)
    top, heading = filled[top], None
    if layout.names is None and (caption := _heading_in_comments(lines[:top], separator, width)):
        top, heading = caption[0], caption[1:]
    body = [lines[i] for i in filled[layout.data :]]
    columns = _columns(body, separator, width) if body else None
    if columns is None:  # line by line, for what stands between the numbers
        for index in filled[layout.data :]:
            if '"' in lines[index] and _OPEN.search(lines[index]):
                raise RecordError(
                    f"line {index + 1} of {path} has a quotation mark without its partner, which "
                    "would join it with the next lines"
                )
        rows = [*rows[: layout.data], *(_split(line, separator) for line in body)]
    numbers = [i + 1 for i in filled]
    table = Grid(path, rows, numbers).table(
        layout,
        heading,
        columns,
        decimals=(".", ","),
        head=tuple(lines[:top]),
    )
    if table.headed:
        _check_order(path, lines, table.names, top)
    row_numbers = set(table.rows)
    for number, row in zip(numbers, rows, strict=False) if columns is None else ():
        # Between blanks no cell can be empty.
        short = separator == BLANKS and len(row) < width
        if number in row_numbers and (any(row[width:]) or short):
            as_in = "one for each name in" if table.headed else "as many as in"
            raise RecordError(
                f"line {number} of {path}: expected {width} cells, {as_in} line {top + 1}, found "
                f"{len(row)}"
            )
    return table


def _decode(path: Path) -> list[str]:
    """Lines of a file in UTF-8, UTF-16 or UTF-32, or of Windows or Japan."""
    size = path.stat().st_size / 2**20
    if size > SIZE:
        raise RecordError(
            f"{path} has {size:,.0f} MB; at most {SIZE} MB of a {path.suffix} file are read: save "
            "it as .mat or .tdms, or cut it"
        )
    content = path.read_bytes()
    encodings: tuple[str, ...] = ("utf-8-sig", "cp1252", "cp932", "latin-1")
    if wide := _wide(content[:4000]):
        encodings = (wide,)
    elif b"\x1b$" in content:
        encodings = ("iso2022_jp",)
    for encoding in encodings:
        try:
            text = content.decode(encoding)
        except UnicodeError:
            continue
        text = text.rstrip("\0")  # of a logger that laid out more than it wrote
        if "\0" not in text and (encoding == "utf-8-sig" or not _CONTROL.search(text)):
            break
    else:
        raise RecordError(f"{path} is not UTF-8 text, as a {path.suffix} file must be")
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if (count := text.count("\n")) > LINES:
        raise RecordError(f"{path} has {count:,} lines; at most {LINES:,} are read")
    text = _WRAPPED.sub(r"\1", text) if "(" in text else text
    lines = text.split("\n")
    if long := next((number for number, line in enumerate(lines, 1) if len(line) > LINE), 0):
        raise RecordError(
            f"line {long} of {path} is longer than {LINE:,} characters, the most that is read; "
            "expected a line for every sample"
        )
    return lines


def _wide(head: bytes) -> str:
    """Encoding of a text with two or four bytes for a character; empty of others.

    By its byte order mark, or where every second byte is NUL, or three of four.
    """
    if head[:4] in (b"\xff\xfe\0\0", b"\0\0\xfe\xff"):
        return "utf-32"
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    size = len(head) // 4
    shares = [head[k::4].count(0) / max(size, 1) for k in range(4)]
    for encoding, letters in (
        ("utf-32-le", "x000"),
        ("utf-32-be", "000x"),
        ("utf-16-le", "x0x0"),
        ("utf-16-be", "0x0x"),
    ):
        if all(
            (share > 0.7) == (letter == "0") for share, letter in zip(shares, letters, strict=True)
        ):
            return encoding
    return ""


def _layout(path: Path, lines: list[str]) -> tuple[str, list[Row], Layout]:
    """Separator whose table weighs most, with names before one without, its rows and its layout."""
    candidates: list[tuple[str, list[Row], Layout]] = []
    for separator in SEPARATORS:
        if separator != BLANKS and not any(separator in line for line in lines):
            continue
        if separator == BLANKS and any(map(_has_thousands, lines)):
            continue
        rows: list[Row] = [_split(line, separator) for line in lines]
        if separator != BLANKS:
            check_names(path, [""] * max(map(len, rows)))
        layout = find_table(rows, exact=separator != BLANKS)
        while separator == BLANKS and layout is not None and layout.names is not None:
            # Words with single blanks between them are names only where each has a column.
            for gap in (r"\s{2,}|\t", _BEFORE_NAME):
                if len(rows[layout.names]) != len(rows[layout.data]):
                    rows[layout.names] = re.split(gap, lines[layout.names].strip())
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


def _has_thousands(line: str) -> bool:
    """Whether a cell between tabs or semicolons is one number with blanks in it: 7 586,5."""
    sign = next((sign for sign in "\t;|" if sign in line), "")
    return bool(sign) and any(is_grouped(cell) for cell in _split(line, sign))


def _split(line: str, separator: str) -> list[str]:
    if '"' not in line:
        if separator == BLANKS:
            return line.split()
        cells = [cell.strip() for cell in line.split(separator)]
    else:
        line = " ".join(line.split()) if separator == BLANKS else line
        cells = [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]
    return [_SIGN.sub(r"\1", c) if c[:1] in "+-−" and _SIGN.match(c) else c for c in cells]


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
    lines: Sequence[str], separator: str, width: int
) -> tuple[int, tuple[str, ...], list[str]] | None:
    """Line, names and units in the comments right above numbers that have no names."""
    comments = [i for i, line in enumerate(lines) if line.lstrip().startswith(tuple(_COMMENTS))]
    words = {i: row for i in comments[-2:] if (row := _words(lines[i], separator, width))}
    if not words:
        return None
    top, *_, bottom = *words, *words
    if len(words) == 2 and gives_units(words[bottom], words[top]):
        return top, labels(words[top]), words[bottom]
    return bottom, labels(words[bottom]), []


def _words(comment: str, separator: str, width: int) -> list[str]:
    """Words of a comment, one for each column; empty where it has not so many, or a number."""
    stripped = comment.strip()
    for text in (stripped.lstrip(_COMMENTS).strip(), stripped):  # a column may be called #
        for sign in dict.fromkeys((separator, *SEPARATORS)):
            words = _split(text, sign) if sign != BLANKS else re.split(_BEFORE_NAME, text)
            if len(words) == width > 1 and "n" not in kinds(words):
                if sign == BLANKS and sum(map(tells, words)) < 2:
                    continue  # of a sentence
                return words
    return []


def _check_order(path: Path, lines: Sequence[str], names: Sequence[str], top: int) -> None:
    """Refuse a comment below the names that has them in another order."""
    for row, line in enumerate(lines[top + 1 :], start=top + 2):
        if line.lstrip().startswith("#"):
            words = _words(line, ",", len(names))
            if words and words != list(names) and sorted(words) == sorted(names):
                raise RecordError(
                    f"line {row} of {path} names the columns in another order than line {top + 1}: "
                    "keep one table in a file"
                )


def read_json(path: Path) -> Table:
    """Table of a .json file: an object of lists, a list of objects or of rows, or of pandas.

    It may stand in an object, with names and units beside it; numbers and texts there are settings.
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
    context: dict[str, Any] = {}
    while isinstance(content, dict) and (inner := _inner(content)):
        context |= content
        content = context.pop(inner)
    mapping: dict[str, Any] = content if isinstance(content, dict) else {}
    named, unit_texts = _beside(context | mapping, _UNITS)
    names = _beside(context, _TITLES)[1]
    if isinstance(names, list) and all(isinstance(name, dict) for name in names):
        unit_texts = unit_texts or [str(_beside(name, _UNITS)[1] or "") for name in names]
        names = [_beside(name, ("name", "Name", "label", "id"))[1] for name in names]
    headed = True
    match content:
        case [[*cells], *_] if isinstance(names, list) and len(names) == len(cells):
            columns = _of_rows(path, content, labels([str(name) for name in names]))
        case [[*cells], *_]:
            headed, columns = False, _of_rows(path, content, labels([""] * len(cells)))
        case {"columns": [*names], "data": [*lines]}:
            columns = _of_rows(path, lines, [str(name) for name in names])
        case [{}, *_] if all(_signal(item) is not None for item in content):
            titles = [str(_beside(item, ("name", "Name", "label", "id"))[1]) for item in content]
            columns = dict(zip(labels(titles), map(_signal, content), strict=True))
            unit_texts = [str(_beside(item, _UNITS)[1] or "") for item in content]
        case [*lines]:
            columns = _of_rows(path, lines)
        case {}:
            columns = {k: v for k, v in mapping.items() if isinstance(v, dict | list)}
            signals = {k: _signal(v) for k, v in columns.items() if _signal(v) is not None}
            if signals:
                unit_texts = {k: str(_beside(columns[k], _UNITS)[1] or "") for k in signals}
                columns = signals
        case _:
            raise RecordError(f"{path} must hold an object of lists or a list of objects")
    if isinstance(unit_texts, list) and len(unit_texts) == len(columns) and named not in columns:
        unit_texts = dict(zip(columns, unit_texts, strict=True))
    if isinstance(unit_texts, dict) and all(isinstance(unit, str) for unit in unit_texts.values()):
        columns = {name: column for name, column in columns.items() if name != named}
    else:
        unit_texts = {}
    if not columns:
        raise RecordError(f"{path} holds no columns; expected an object of lists")
    # Columns as pandas writes them have the same row labels; another object is no column.
    labelled = [column for column in columns.values() if isinstance(column, dict)]
    rows = max((list(column) for column in labelled), key=lambda item: len(item), default=[])
    columns = {
        name: [column[row] for row in rows] if isinstance(column, dict) else column
        for name, column in columns.items()
        if not isinstance(column, dict) or column.keys() == set(rows)
    }
    units = {name: unit for name, text in unit_texts.items() if (unit := bare_unit(text))}
    units |= {name: "s" for name, cells in columns.items() if cells and is_stamp(cells[0])}
    stated = context | mapping
    stated |= {k: v for item in context.values() if isinstance(item, dict) for k, v in item.items()}
    settings = tuple(f"{k}: {v}" for k, v in stated.items() if type(v) in (int, float, str))
    return Table(path, columns, units=units, headed=headed, decimals=(".", ","), head=settings)


_UNITS = ("units", "unit", "Units", "Unit")
_TITLES = ("columns", "names", "fields", "header", "headers", "channels", "variables", "labels")
_VALUES = ("data", "values", "Data", "Values", "value", "samples")


def _beside(content: Mapping[str, Any], keys: Sequence[str]) -> tuple[str, Any]:
    """The first of these keys that an object has, and what stands there; "" and None without."""
    key = next((key for key in keys if key in content), "")
    return key, content.get(key)


def _signal(content: Any) -> list[Any] | None:
    """Numbers of an object of one signal, {"unit": "mm", "data": [0, 1]}; None of others."""
    values = _beside(content, _VALUES)[1] if isinstance(content, dict) else None
    flat = isinstance(values, list) and not any(isinstance(v, list | dict) for v in values[:1])
    return values if flat else None


def _inner(content: Mapping[str, Any]) -> str:
    """Key of the one table in an object that is none itself; "" where there is none, or several."""
    if {"columns", "data"} <= content.keys() or _signal(content) is not None:
        return ""
    lists = [v for v in content.values() if isinstance(v, list) and not isinstance(v[:1], dict)]
    flat = [v for v in lists if len(v) >= SHORTEST and not isinstance(v[0], list | dict)]
    if len(flat) >= 2:
        return ""
    tables = [key for key, value in content.items() if _is_table(value)]
    return tables[0] if len(tables) == 1 else ""


def _is_table(content: Any) -> bool:
    """Whether a value is a list of rows, an object of two lists or more, or holds one of these."""
    if isinstance(content, list):
        rows = len(content) >= SHORTEST and isinstance(content[0], list | dict)
        return rows or (len(content) > 1 and all(_signal(item) is not None for item in content))
    if not isinstance(content, dict):
        return False
    lists = [v for v in content.values() if isinstance(v, list) or _signal(v) is not None]
    long = [v for v in lists if isinstance(v, dict) or len(v) >= SHORTEST]
    return len(long) >= 2 or any(_is_table(value) for value in content.values())


def _of_rows(path: Path, rows: list[Any], names: Sequence[str] | None = None) -> dict[str, Any]:
    """Columns of rows that are objects, or lists with a cell for each name."""
    keys: dict[str, None] = {}
    for i, row in enumerate(rows):
        if names is not None and isinstance(row, list) and len(row) == len(names):
            rows[i] = row = dict(zip(names, row, strict=True))
        if not isinstance(row, dict):
            raise RecordError(f"row {i + 1} of {path} must be an object with one value per column")
        keys.update(dict.fromkeys(row))
    check_names(path, [""] * len(keys))
    if len(keys) * len(rows) > CELLS:
        raise RecordError(
            f"{path} has {len(rows):,} rows of {len(keys):,} columns; at most {CELLS:,} cells "
            "are read"
        )
    return {name: [row.get(name) for row in rows] for name in keys}


Content = tuple[dict[str, Any], Mapping[str, NDArray[np.generic]]]
"""Texts and numbers of a file, and its arrays by name."""
Arrays = Iterator[tuple[str, NDArray[np.generic]]]

MEMORY, SECONDS = 2 * 2**30, 120.0
"""Bytes beyond what the process has already, and seconds, that the reading of a file may take."""
EXCEL_CELLS = 2_000_000  # most cells of a workbook: eight minutes of four columns at 1024 Hz
SAMPLES = 50_000_000  # most of all channels of a TDMS file: an hour and a half of ten at 1024 Hz
SIGNALS, SHORTEST = 32, 20
"""Most signals of a matrix and fewest samples of each; another matrix is left out."""
DEEPEST = 4  # structs in structs
EVEN, SHARE = 1e-6, 0.02
"""Steps of time that differ by a smaller share are equal; channels that are out of step by less
than so much of a step are in step."""


class UnreadableError(Exception):
    """Raised by a reader whose message follows the file's name."""


def read_in_child(
    read: Callable[[Path], Content], path: Path, kind: str, *, library: str, extra: str = ""
) -> Content:
    """What a reader returns of a file of a kind, from a process of its own.

    `library` and `extra` are what it needs. Refused where the file is not of that kind, or reading
    it takes more than is allowed.
    """
    path.open("rb").close()
    try:
        import_module(library.lower())  # so that a copy of this process has it
    except ImportError as error:
        raise RecordError(
            f"reading {path} needs {library}, which is not installed: "
            f'pip install "mfd_bayes[{extra}]"'
        ) from error
    advice = "save only the test's own columns, or as .csv"
    try:
        with np.load(io.BytesIO(_from_child(read, path))) as stored:
            arrays = {name: stored[name] for name in stored.files}
        facts = json.loads(str(arrays.pop("facts")))
    except (TimeoutError, subprocess.TimeoutExpired) as error:
        raise RecordError(f"{path} takes more than {SECONDS:g} s to read: {advice}") from error
    except (ValueError, EOFError, zipfile.BadZipFile):  # the process ended before it wrote all
        facts, arrays = {"error": ""}, {}
    error_text = facts.pop("error", None)
    if error_text == "memory":
        raise RecordError(f"{path} needs more than {MEMORY >> 30} GB to be read: {advice}")
    if error_text is not None:
        raise RecordError(f"{path} {error_text or f'is not {kind} that can be read'}")
    return facts, arrays


def _from_child(read: Callable[[Path], Content], path: Path) -> bytes:
    """What a copy of this process says, or a new one: a copy of threads may wait for ever."""
    can_fork = threading.active_count() == 1 and not multiprocessing.current_process().daemon
    if not can_fork or "fork" not in multiprocessing.get_all_start_methods():
        code = (
            "import sys; sys.path[:] = sys.argv[3:]\nfrom pathlib import Path\n"
            "from mfd_bayes.records import readers\nstream = open(readers.os.dup(1), 'wb')\n"
            "stream.write(readers.limited(getattr(readers, sys.argv[1]), Path(sys.argv[2])))"
        )
        words = [sys.executable, "-c", code, read.__name__, str(path), *sys.path]
        return subprocess.run(words, capture_output=True, timeout=SECONDS, check=False).stdout
    context = multiprocessing.get_context("fork")
    source, target = context.Pipe(duplex=False)
    child = context.Process(target=lambda: target.send_bytes(limited(read, path)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about threads of other libraries, which wait
        child.start()
    target.close()
    try:
        if not source.poll(SECONDS):
            raise TimeoutError
        return source.recv_bytes()
    finally:
        child.kill()
        child.join()
        source.close()


def limited(read: Callable[[Path], Content], path: Path) -> bytes:
    """What is read of a file, in a process whose memory is limited from here on."""
    faulthandler.disable()
    nowhere = os.open(os.devnull, os.O_RDWR)
    for output in (1, 2):
        os.dup2(nowhere, output)
    with contextlib.suppress(ImportError, OSError, ValueError):  # as on Windows
        import resource

        has = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        hard_limit = resource.getrlimit(resource.RLIMIT_AS)[1]
        limit = (
            has + MEMORY if hard_limit == resource.RLIM_INFINITY else min(has + MEMORY, hard_limit)
        )
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard_limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    facts: dict[str, Any] = {"error": ""}
    arrays: Mapping[str, Any] = {}
    stream = io.BytesIO()
    try:
        facts, arrays = read(path)
        contents: dict[str, Any] = {"facts": np.array(json.dumps(facts)), **arrays}
        np.savez(stream, **contents)
        return stream.getvalue()
    except UnreadableError as error:
        facts = {"error": str(error)}
    except MemoryError:
        facts = {"error": "memory"}
    except BaseException:  # the libraries raise dozens of kinds
        facts = {"error": ""}
    stream = io.BytesIO()
    np.savez(stream, facts=np.array(json.dumps(facts)))
    return stream.getvalue()


def read_excel(path: Path) -> Table:
    """Table of an .xlsx file: of the sheet whose table weighs most, of several alike the first.

    Columns without a name are called by their number, from A = 1. Formulas count with the values
    that Excel stored.
    """
    with path.open("rb") as file:
        if file.read(4) == bytes.fromhex("D0CF11E0"):
            raise RecordError(
                f"{path} is an old .xls workbook or has a password; save it as .xlsx without one"
            )
    kind = "an Excel workbook (.xlsx)"
    sheets = read_in_child(_sheets, path, kind, library="openpyxl", extra="excel")[0]["sheets"]
    grids: list[tuple[Grid, Layout]] = []
    for title, numbers, rows in sheets:
        if (layout := find_table(rows)) is not None:
            grids.append((Grid(path, rows, numbers, "row", f"sheet {title!r}"), layout))
    if not grids:
        titles = ", ".join(repr(title) for title, _, _ in sheets[:5])
        raise RecordError(
            f"{path} holds no row of two names or more above numbers in its sheets {titles}"
        )
    best, layout = max(grids, key=lambda pair: (pair[1].names is not None, pair[1].weight))
    doubts: tuple[str, ...] = ()
    if layout.names is not None:
        names = best.rows[layout.names]
        alike = [
            grid.sheet.removeprefix("sheet ")
            for grid, grid_layout in grids
            if grid is not best
            and grid_layout.names is not None
            and grid.rows[grid_layout.names] == names
        ]
        if alike:
            doubts = (
                f"{best.sheet} is read; not read, with the same columns: {', '.join(alike[:4])}",
            )
    return best.table(layout, doubts=doubts, decimals=(".", ","))


def _sheets(path: Path) -> Content:
    """Title of each sheet, and numbers and cells of its rows that are not blank."""
    from openpyxl import load_workbook

    warnings.simplefilter("ignore")  # about styles and extensions
    workbook = load_workbook(path, read_only=True, keep_links=False, data_only=True)
    sheets: list[tuple[str, list[int], list[list[Cell]]]] = []
    count = 0
    for sheet in workbook.worksheets:
        sheet.reset_dimensions()  # those that the sheet declares may be false
        numbers, rows = [], []
        for number, row in enumerate(sheet.iter_rows(values_only=True), start=1):
            count += max(len(row), 1)
            if count > EXCEL_CELLS:
                raise UnreadableError(
                    f"has more than {EXCEL_CELLS:,} cells, the most that is read; save the sheet "
                    "as .csv"
                )
            cells = [_cell(cell) for cell in row]
            if any(cell is not None for cell in cells):
                numbers.append(number)
                rows.append(cells)
        sheets.append((sheet.title, numbers, rows))
    return {"sheets": sheets}, {}


def _cell(cell: Any) -> Cell:
    """A cell as a number or a text: time stamps as texts."""
    match cell:
        case str():
            return cell.strip() or None
        case datetime.timedelta():
            seconds, micros = divmod(round(cell.total_seconds() * 1e6), 10**6)
            return f"{seconds // 3600}:{seconds // 60 % 60:02}:{seconds % 60:02}.{micros:06}"
        case bool():
            return str(cell).upper()
        case int() | float():
            return float(cell)
    return None if cell is None else str(cell)


def read_matlab(path: Path) -> Table:
    """Table of a .mat file: vectors, columns of matrices, fields of structs as ``struct.field``."""
    import scipy.io  # noqa: F401  # a copy of this process has it then

    kind = "a MATLAB file, v5 or v7.3,"
    facts, arrays = read_in_child(_matlab, path, kind, library="h5py")
    if not arrays:
        raise RecordError(f"{path} holds no numeric column")
    columns = {
        name: arrays[str(k)].astype(np.float64, copy=False) for k, name in enumerate(facts["names"])
    }
    units = {name: unit for name, unit in facts["units"].items() if name in columns}
    return Table(path, columns, units=units, head=tuple(facts["settings"]))


def _matlab(path: Path) -> Content:
    """Signals of a file and their names, and its scalars as "name: value"."""
    hdf5 = b"\x89HDF\r\n\x1a\n"  # v7.3, behind 512 bytes of text
    with path.open("rb") as file:
        head = file.read(512 + len(hdf5))
    signals: dict[str, NDArray[np.generic]] = {}
    settings = []
    units: dict[str, str] = {}
    variables = _v73(path) if head.startswith(hdf5) or head.endswith(hdf5) else _v5(path, units)
    for name, array in variables:
        if array.size == 1:
            settings.append(f"{name}: {array.reshape(-1)[0]:.9g}")
        elif array.size and max(array.shape) == array.size:
            signals[name] = array.reshape(-1)
        elif array.ndim == 2 and max(array.shape) >= SHORTEST and min(array.shape) <= SIGNALS:
            upright = array.shape[0] >= array.shape[1]  # signals run along the longer side
            for k, values in enumerate(array.T if upright else array, start=1):
                signals[f"{name}(:,{k})" if upright else f"{name}({k},:)"] = values
    if len(signals) > COLUMNS:
        signals = {name: array for name, array in signals.items() if not name.endswith(")")}
    arrays = {str(k): array for k, array in enumerate(signals.values())}
    return {"names": list(signals), "settings": settings, "units": units}, arrays


def _v5(path: Path, units: dict[str, str]) -> Arrays:
    """Name and numbers of each array of numbers in a file of version 5; `units` gets the units."""
    from scipy.io import loadmat

    for name, value in loadmat(path, struct_as_record=True).items():
        if not name.startswith("__"):
            yield from _inside(name, value, 0, units)


def _inside(name: str, value: Any, depth: int, units: dict[str, str]) -> Arrays:
    """A variable's numbers, or those of its fields; Simulink's label follows a signal's name.

    A struct of Data with a Name and a Unit, as dSPACE writes, is a signal of that name.
    """
    if not isinstance(value, np.ndarray):
        return
    if value.dtype.kind in "fiub":
        yield name, value
    if value.dtype.names is None or depth >= DEEPEST or value.size > SIGNALS:
        return
    for number, element in enumerate(value.reshape(-1), start=1):
        prefix = f"{name}({number})" if value.size > 1 else name
        fields = dict(zip(value.dtype.names, element, strict=True))
        label = np.asarray(fields.get("label", ""))
        text = label.dtype.kind == "U" and label.size == 1
        words = f" {label.reshape(-1)[0]}".rstrip() if text else ""
        title, unit = (_word_of(fields, keys) for keys in (("Name", "name"), _UNITS))
        for field, content in fields.items():
            signal = f"{prefix}.{field}{words * (field == 'values')}"
            if title and field in _VALUES:
                signal = f"{prefix}.{title}" if title in units else title
                units[signal] = bare_unit(unit)
            yield from _inside(signal, content, depth + 1, units)


def _word_of(fields: Mapping[str, Any], keys: Sequence[str]) -> str:
    """Text of the first of these fields that is there; empty without one."""
    word = np.asarray(_beside(fields, keys)[1])
    return str(word.reshape(-1)[0]).strip() if word.dtype.kind == "U" and word.size == 1 else ""


def _v73(path: Path) -> Arrays:
    """Name and numbers of each array of numbers in a file of version 7.3, which is HDF5."""
    os.environ["HDF5_PLUGIN_PRELOAD"] = "::"  # a plugin would be foreign code
    import h5py

    def arrays_of(group: Any, prefix: str, depth: int) -> Arrays:
        for name in group:
            if name.startswith("#"):  # the contents of cells and objects
                continue
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                raise UnreadableError(f"has a link to elsewhere, {name[:60]!r}")
            item = group[name]
            if isinstance(item, h5py.Group):
                if depth < DEEPEST and "MATLAB_sparse" not in item.attrs:
                    yield from arrays_of(item, f"{prefix}{name}.", depth + 1)
            elif isinstance(item, h5py.Dataset):
                if item.is_virtual or item.external:
                    raise UnreadableError(f"takes {name[:60]!r} from another file")
                kind = bytes(item.attrs.get("MATLAB_class", b""))
                numeric = item.dtype.kind in "fiub" and kind not in (b"char", b"cell")
                if numeric and item.shape and "MATLAB_empty" not in item.attrs:
                    yield prefix + name, np.asarray(item[()]).T  # in MATLAB's order

    with h5py.File(path, "r") as file:
        yield from arrays_of(file, "", 0)


class _Clock(NamedTuple):
    """Sampling times of a waveform: step and first time, s."""

    step: float
    begin: float

    def differs(self, clock: _Clock) -> bool:
        same_step = math.isclose(self.step, clock.step, rel_tol=EVEN)
        return not same_step or abs(self.begin - clock.begin) > SHARE * self.step


def read_tdms(path: Path) -> Table:
    """Table of a .tdms file: its channels, called ``group/channel`` where two share a name.

    Where no channel is a time, a column ``time`` is made from the increments of the waveforms;
    ``group/time`` where groups were sampled at different times.
    """
    facts, arrays = read_in_child(_channels, path, "a TDMS file", library="npTDMS", extra="tdms")
    count = Counter(channel["name"] for channel in facts["channels"])
    channels = {
        c["name"] if count[c["name"]] == 1 else f"{c['group']}/{c['name']}": c
        for c in facts["channels"]
    }
    if not channels:
        raise RecordError(f"{path} holds no channel with data")
    columns: dict[str, Column] = {name: arrays[str(k)] for k, name in enumerate(channels)}
    units = {name: c["unit"] for name, c in channels.items() if c["unit"]}
    numeric = {name: c for name, c in channels.items() if c["numeric"]}
    timed = {  # channels that are a time by their kind, their name or their unit
        name
        for name, c in numeric.items()
        if "time" in c["name"].lower() or measure(c["unit"]) == "time"
    }
    waves = {name: c["clock"] for name, c in numeric.items() if c["clock"] and name not in timed}
    zero = min((began for _, began, _ in waves.values() if began is not None), default=0.0)
    clocks = {
        name: _Clock(step, offset + (0.0 if began is None else began - zero))
        for name, (step, began, offset) in waves.items()
    }
    times: dict[str, tuple[_Clock, int]] = {}  # for each group whose channels share a clock
    notes = []
    for group in () if timed else dict.fromkeys(channels[name]["group"] for name in clocks):
        members = [name for name in clocks if channels[name]["group"] == group]
        sizes = [len(columns[name]) for name in members]
        if problem := _out_of_step({name: clocks[name] for name in members}):
            notes.append(problem)
        else:
            times[f"{group}/time"] = clocks[members[0]], max(sizes)
        if min(sizes) < max(sizes):
            notes.append(
                f"channels of {group!r} have {min(sizes)} to {max(sizes)} samples: only those that "
                "the used ones share are read"
            )
    if len(set(times.values())) == 1:  # one for all
        times = {"time": next(iter(times.values()))}
    times = {name: time for name, time in times.items() if name not in columns}
    values: dict[str, Column] = {
        name: begin + step * np.arange(size) for name, ((step, begin), size) in times.items()
    }
    clocks |= {name: clock for name, (clock, _) in times.items()}
    texts = channels.keys() - numeric.keys()
    return Table(
        path,
        values | columns,
        units=units | dict.fromkeys(times, "s"),
        align=lambda selected: _align(path, selected, clocks, texts),
        notes=tuple(notes),
        head=tuple(facts["settings"]),
    )


def _channels(path: Path) -> Content:
    """Names, properties and numbers of all channels that have data."""
    from nptdms import TdmsFile
    from nptdms.log import log_manager

    log_manager.set_level(logging.ERROR)  # its warnings are errors here
    channels: list[dict[str, Any]] = []
    arrays: dict[str, NDArray[np.generic]] = {}
    # Given a path, nptdms would read an index file next to it, which may belong to another.
    with path.open("rb") as stream, TdmsFile.open(stream) as file:
        for name, status in (file.file_status.channel_statuses or {}).items():
            if status.read_length < status.expected_length:
                raise UnreadableError(
                    f"is cut off: its last part declares {status.expected_length:,} samples of "
                    f"channel {name} and holds {status.read_length:,}"
                )
        all_channels = [channel for group in file.groups() for channel in group.channels()]
        if sum(map(len, all_channels)) > SAMPLES:
            raise UnreadableError(f"holds more than {SAMPLES:,} samples, the most that are read")
        for channel in all_channels:
            if not len(channel):
                continue
            kind, values, properties = np.dtype(channel.dtype).kind, np.empty(0), channel.properties
            unit = bare_unit(
                str(properties.get("unit_string") or properties.get("NI_UnitDescription") or "")
            )
            if kind == "M":
                stamps = channel[:].astype("M8[us]")
                values, unit = (stamps - stamps[0]) / np.timedelta64(1, "s"), "s"
            elif kind in "fiub":
                values = np.asarray(channel[:], dtype=np.float64)
            arrays[str(len(channels))] = values
            channels.append(
                {
                    "group": channel.group_name,
                    "name": channel.name,
                    "numeric": kind in "fiubM",
                    "unit": unit,
                    "clock": _clock(properties),
                }
            )
        settings = [
            f"{name}: {value}"
            for item in (file, *file.groups())
            for name, value in item.properties.items()
        ]
    return {"channels": channels, "settings": settings}, arrays


def _clock(properties: Mapping[str, Any]) -> tuple[float, float | None, float] | None:
    """Step of a waveform, its start since 2020 and what is added to it, s; None without a step."""
    step, offset = (properties.get(f"wf_{name}", 0.0) for name in ("increment", "start_offset"))
    unit = bare_unit(str(properties.get("wf_xunit_string", ""))) or "s"
    numbers = all(isinstance(v, int | float | np.number) for v in (step, offset))
    if not numbers or measure(unit) != "time" or not 0.0 < step < math.inf > abs(offset):
        return None
    start, scale = properties.get("wf_start_time"), factor(unit, "time")
    began = None
    if isinstance(start, np.datetime64) and start > np.datetime64("1914"):
        began = float((start - np.datetime64("2020", "us")) / np.timedelta64(1, "s"))
    return float(step) * scale, began, float(offset) * scale


def _out_of_step(clocks: Mapping[str, _Clock]) -> str:
    """Why waveforms cannot be used together; empty where they can."""
    for name, candidate in clocks.items():
        reference, clock = next(iter(clocks.items()))
        if candidate.differs(clock):
            problem = f"has a step of {candidate.step:g} s, {reference} one of {clock.step:g} s"
            if math.isclose(candidate.step, clock.step, rel_tol=EVEN):
                way = "after" if candidate.begin > clock.begin else "before"
                problem = f"begins {abs(candidate.begin - clock.begin):.6g} s {way} {reference}"
            return f"{name} {problem}: they cannot be used together"
    return ""


def _align(
    path: Path,
    columns: Mapping[str, Column],
    all_clocks: Mapping[str, _Clock],
    texts: Collection[str],
) -> Mapping[str, Column]:
    """Columns as far as all waveforms among them go."""
    if wrong := next((name for name in columns if name in texts), None):
        raise RecordError(f"channel {wrong!r} of {path} holds no real numbers; expected numbers")
    clocks = {name: all_clocks[name] for name in columns if name in all_clocks}
    if problem := _out_of_step(clocks):
        raise RecordError(f"{path}: {problem}")
    size = min((len(columns[name]) for name in clocks), default=None)
    return {name: c[:size] if name in clocks else c for name, c in columns.items()}


FORMATS: Mapping[str, Callable[[Path], Table]] = MappingProxyType(
    {
        **dict.fromkeys((".csv", ".txt", ".dat", ".tsv", ".asc", ".lvm"), read_text),
        ".xlsx": read_excel,
        ".tdms": read_tdms,
        ".json": read_json,
        ".mat": read_matlab,
    }
)
"""The function that reads a file into a Table, by the file's suffix in lower case."""

SUFFIXES = tuple(FORMATS)  # suffixes of the files that can be read, in lower case


def read_table(path: Path) -> Table:
    """Table of a file whose suffix is one of `SUFFIXES`, if it is what that says."""
    suffix = path.suffix.lower()
    try:
        if path.is_dir():
            raise RecordError(f"{path} is a folder: give a test file or a campaign.toml")
        if suffix not in FORMATS:
            raise RecordError(
                f"{path} has the unknown suffix {suffix!r}; expected {', '.join(SUFFIXES)}"
            )
        if reason := why_no_file(path):
            raise RecordError(f"{path} {reason}")
        if path.stat().st_size == 0:
            raise RecordError(f"{path} is empty")
        return FORMATS[suffix](path)
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror or error}") from error
    except MemoryError as error:
        raise RecordError(f"{path} does not fit into this machine's memory") from error
