"""Workbooks that would take more memory than they may are refused before they are parsed."""

import struct
import subprocess
import sys
from zipfile import ZIP_DEFLATED, ZIP_LZMA, ZipFile

import pytest
from openpyxl import Workbook

from mfd_bayes.records.readers import read_table

SHEET = "xl/worksheets/sheet1.xml"
OPEN = (
    b'<?xml version="1.0"?>'
    b'<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>'
)
CLOSE = b"</sheetData></worksheet>"
CELL = b'<c r="A1"><v>1</v></c>'
NAMES = b'<row><c t="str"><v>a</v></c><c t="str"><v>b</v></c></row>'
NUMBERS = b"<row><c><v>1</v></c><c><v>2</v></c></row>"


def write(path, *pieces, method=ZIP_DEFLATED):
    """Workbook whose sheet is made of (bytes, times)."""
    Workbook().save(path.with_name("plain.xlsx"))
    with ZipFile(path.with_name("plain.xlsx")) as plain, ZipFile(path, "w", method) as made:
        for name in plain.namelist():
            if name != SHEET:
                made.writestr(name, plain.read(name))
        with made.open(SHEET, "w", force_zip64=True) as part:
            for piece, times in pieces:
                for _ in range(times):
                    part.write(piece)


def declare(path, size):
    """Let an archive say that its sheet has this size."""
    raw = bytearray(path.read_bytes())
    entry = raw.rindex(b"PK\x01\x02", 0, raw.rindex(SHEET.encode()))
    raw[entry + 24 : entry + 28] = struct.pack("<I", size)
    path.write_bytes(raw)


def odd(path):
    return (
        f"{path} holds a part, '{SHEET}', that no spreadsheet program writes; save the workbook "
        "again as .xlsx, or the sheet as .csv"
    )


def too_large(path):
    return f"{path} unpacks to more than 256 MB, the most that is read; save the sheet as .csv"


def too_many(path):
    return (
        f"{path} has a sheet of more than 2,000,000 cells, the most that is read; save it as .csv"
    )


def test_what_is_made_here_is_read_where_nothing_is_wrong(tmp_path):
    write(tmp_path / "a.xlsx", (OPEN + NAMES + NUMBERS * 3 + CLOSE, 1))
    assert read_table(tmp_path / "a.xlsx").columns(["b"])["b"].tolist() == [2, 2, 2]


def test_a_bomb_is_refused_without_unpacking_it(tmp_path, refused):
    path = tmp_path / "a.xlsx"
    write(path, (OPEN, 1), (b" " * 2**20, 260), (CLOSE, 1))
    assert path.stat().st_size < 1e6
    assert refused(path) == too_large(path)


def test_a_bomb_that_says_it_is_small_is_refused(tmp_path, refused):
    path = tmp_path / "a.xlsx"
    write(path, (OPEN, 1), (b"<row/>" * 2**14, 400), (CLOSE, 1))
    declare(path, 1000)
    assert refused(path) == odd(path)


@pytest.mark.parametrize(
    "pieces",
    [
        ((OPEN + b"<row>", 1), (CELL * 10_000, 10), (b"</row>" + CLOSE, 1)),
        ((OPEN, 1), (b"<row/>" + b"<a b=''/>" * 10_000, 50), (CLOSE, 1)),
        ((OPEN, 1), (b"<a>" * 10_000, 60), (CLOSE, 1)),
        ((OPEN + b"<row><c><v>", 1), (b"x" * 2**20, 3), (b"</v></c></row>" + CLOSE, 1)),
        ((OPEN + b"<row ", 1), (b"x='' " * 2**18, 3), (b"/>" + CLOSE, 1)),
    ],
    ids=["one row of cells", "elements that stay", "depth", "one text", "one tag"],
)
def test_xml_that_would_grow_in_memory_is_refused(tmp_path, refused, pieces):
    path = tmp_path / "a.xlsx"
    write(path, *pieces)
    assert refused(path) == odd(path)


def test_entities_are_refused(tmp_path, refused):
    path = tmp_path / "a.xlsx"
    bomb = OPEN.replace(b"<worksheet", b'<!DOCTYPE w [<!ENTITY a "1">]><worksheet')
    write(path, (bomb + b"<row><c><v>&a;</v></c></row>" + CLOSE, 1))
    assert refused(path) == odd(path)


def test_packings_that_excel_does_not_use_are_refused(tmp_path, refused):
    path = tmp_path / "a.xlsx"
    write(path, (OPEN + NAMES + NUMBERS + CLOSE, 1), method=ZIP_LZMA)
    assert "that no spreadsheet program writes" in refused(path)


def test_more_cells_than_are_read_are_refused(tmp_path, refused, monkeypatch):
    monkeypatch.setattr("mfd_bayes.records.readers.archive.CELLS", 2_000)
    path = tmp_path / "a.xlsx"
    write(path, (OPEN + NAMES, 1), (NUMBERS, 990), (CLOSE, 1))
    assert read_table(path).columns(["a"])["a"].size == 990
    write(path, (OPEN + NAMES, 1), (NUMBERS, 1_000), (CLOSE, 1))
    assert refused(path) == too_many(path).replace("2,000,000", "2,000")


@pytest.mark.parametrize(
    "rows",
    [b'<row r="999999999999"><c><v>1</v></c></row>', b'<row><c r="ZZZ1"><v>1</v></c></row>' * 200],
    ids=["a row far below", "cells far right"],
)
def test_empty_cells_before_a_far_one_count(tmp_path, refused, rows):
    path = tmp_path / "a.xlsx"
    write(path, (OPEN + NAMES + rows + CLOSE, 1))
    assert refused(path) == too_many(path)


PEAK = """
import resource, sys
from pathlib import Path

import openpyxl

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers import read_table

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

before = peak()
try:
    read_table(Path(sys.argv[1]))
except RecordError:
    print(peak() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="peaks are told in other units elsewhere")
def test_refusing_a_bomb_takes_little_memory(tmp_path):
    path = tmp_path / "a.xlsx"
    # openpyxl alone would take a gigabyte for this row.
    write(path, (OPEN + b"<row>", 1), (CELL * 100_000, 15), (b"</row>" + CLOSE, 1))
    command = [sys.executable, "-c", PEAK, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert int(done.stdout) < 60_000  # kB
