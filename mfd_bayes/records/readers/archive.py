"""Limits on the size and the content of a workbook, checked before openpyxl reads it."""

from __future__ import annotations

from copy import copy
from pathlib import Path
from typing import IO
from xml.parsers import expat
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.bounds import UNPACKED, unpacks_to_too_much

CELLS = 2_000_000  # most cells of a sheet: eight minutes of four columns at 1024 Hz
_MB = 2**20
_SHEETS = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
# openpyxl frees these elements as soon as it has read them; all others it keeps in memory.
_PASSING = (f"{_SHEETS} row", f"{_SHEETS} si")
_CELL = f"{_SHEETS} c"
# Far more than any spreadsheet program writes; together they need some 200 MB of memory.
_MOST_HELD = 500_000
_MOST_IN_A_ROW = 8 * 16_384  # elements and attributes; a sheet has 16,384 columns
_LONGEST = _MB  # characters of a text, bytes of a tag; a cell holds 32,767


class _OddError(Exception):
    """A part that no spreadsheet program writes."""


class _Scan:
    """Parser that counts the elements of one XML part and keeps none; other parts pass."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._cells = self._rows = self._held = self._inside = self._depth = self._text = 0
        self._fed, self._broken = 0, False
        self._parser = expat.ParserCreate(namespace_separator=" ")
        self._parser.ordered_attributes = True
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._characters
        self._parser.StartDoctypeDeclHandler = self._doctype

    def feed(self, piece: bytes) -> None:
        if self._broken:
            return
        try:
            self._parser.Parse(piece, False)
        except expat.ExpatError:
            self._broken = True  # openpyxl's parser stops here too
            return
        self._fed += len(piece)
        if self._fed - self._parser.CurrentByteIndex > _LONGEST:
            raise _OddError

    def _start(self, name: str, attributes: list[str]) -> None:
        size = 1 + len(attributes) // 2
        self._text = 0
        if self._depth:
            self._depth += 1
            self._inside += size
            self._cells += name == _CELL
        elif name in _PASSING:
            self._depth, self._inside = 1, size
            self._rows += 1
        else:
            self._held += size
        if self._held > _MOST_HELD or self._inside > _MOST_IN_A_ROW:
            raise _OddError
        if self._cells > CELLS or self._rows > CELLS:
            raise too_many_cells(self._path)

    def _end(self, _name: str) -> None:
        self._text = 0
        self._depth = max(self._depth - 1, 0)

    def _characters(self, text: str) -> None:
        self._text += len(text)
        if self._text > _LONGEST:
            raise _OddError

    def _doctype(self, *_declared: object) -> None:
        raise _OddError  # a declared entity can stand for a text of any length


def check_archive(path: Path, file: IO[bytes]) -> None:
    """Refuse a workbook beyond the limits `UNPACKED` and `CELLS`, or with an odd part.

    Every part is unpacked once, piece by piece, because the sizes in an archive may be false.
    """
    with ZipFile(file) as archive:
        parts = archive.infolist()
        if sum(part.file_size for part in parts) > UNPACKED * _MB:
            raise unpacks_to_too_much(path, "save the sheet as .csv")
        for part in parts:
            try:
                _check_part(archive, part, _Scan(path))
            except _OddError:
                raise RecordError(
                    f"{path} holds a part, {part.filename[:60]!r}, that no spreadsheet program "
                    "writes; save the workbook again as .xlsx, or the sheet as .csv"
                ) from None


def too_many_cells(path: Path) -> RecordError:
    """Error for a sheet with more cells than are read."""
    return RecordError(
        f"{path} has a sheet of more than {CELLS:,} cells, the most that is read; save it as .csv"
    )


def _check_part(archive: ZipFile, part: ZipInfo, scan: _Scan) -> None:
    """Refuse a part that is larger than it declares, or that the scan refuses."""
    if part.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
        raise _OddError  # zipfile unpacks other methods without a limit
    size = 0
    unbounded = copy(part)
    unbounded.file_size += 2 * _MB  # reading would stop at the size that is declared
    with archive.open(unbounded) as content:
        while size <= part.file_size and (piece := content.read(_MB)):
            size += len(piece)
            scan.feed(piece)
    if size != part.file_size:
        raise _OddError
