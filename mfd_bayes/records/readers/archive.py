"""Bounds on what reading a zipped workbook may take, checked before anything parses it."""

from __future__ import annotations

from copy import copy
from pathlib import Path
from typing import IO
from xml.parsers import expat
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.bounds import UNPACKED, unpacks_to_too_much

CELLS = 2_000_000
"""Most cells of a sheet: eight minutes of four columns at 1024 Hz."""

_MB = 2**20
_SHEETS = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
# openpyxl forgets what is inside these as soon as it has read them; the rest it holds.
_PASSING = (f"{_SHEETS} row", f"{_SHEETS} si")
_CELL = f"{_SHEETS} c"
# Far more than any spreadsheet program writes; all of it together takes some 200 MB to hold.
_MOST_HELD = 500_000
_MOST_IN_A_ROW = 8 * 16_384  # elements and attributes; a sheet has 16,384 columns
_LONGEST = _MB  # characters of a text, bytes of a tag; a cell holds 32,767


class _OddError(Exception):
    """What no spreadsheet program writes."""


class _TooManyCellsError(Exception):
    """More cells in a part than are read."""


class _Weight:
    """Elements of an XML part, counted as they go by and not held."""

    def __init__(self) -> None:
        self.cells = self.rows = self.held = self.inside = self.depth = self.text = 0

    def start(self, name: str, attributes: list[str]) -> None:
        size = 1 + len(attributes) // 2
        self.text = 0
        if self.depth:
            self.depth += 1
            self.inside += size
            self.cells += name == _CELL
        elif name in _PASSING:
            self.depth, self.inside = 1, size
            self.rows += 1
        else:
            self.held += size
        if self.held > _MOST_HELD or self.inside > _MOST_IN_A_ROW:
            raise _OddError
        if self.cells > CELLS or self.rows > CELLS:
            raise _TooManyCellsError

    def end(self, _name: str) -> None:
        self.text = 0
        self.depth = max(self.depth - 1, 0)

    def characters(self, text: str) -> None:
        self.text += len(text)
        if self.text > _LONGEST:
            raise _OddError

    def doctype(self, *_declared: object) -> None:
        # Declared entities can stand for texts without bound.
        raise _OddError


class _Scan:
    """XML parser that weighs a part piece by piece; parts that are no XML have no weight."""

    def __init__(self) -> None:
        weight = _Weight()
        self._fed = 0
        self._parser = expat.ParserCreate(namespace_separator=" ")
        self._parser.ordered_attributes = True
        self._parser.StartElementHandler = weight.start
        self._parser.EndElementHandler = weight.end
        self._parser.CharacterDataHandler = weight.characters
        self._parser.StartDoctypeDeclHandler = weight.doctype
        self._broken = False

    def feed(self, piece: bytes) -> None:
        if self._broken:
            return
        try:
            self._parser.Parse(piece, False)
        except expat.ExpatError:
            self._broken = True  # where openpyxl's parser stops too
            return
        self._fed += len(piece)
        if self._fed - self._parser.CurrentByteIndex > _LONGEST:
            raise _OddError


def check_archive(path: Path, file: IO[bytes]) -> None:
    """Refuse a workbook that would take more memory than `UNPACKED` and `CELLS` allow.

    Every part is unpacked once, piece by piece, because an archive may lie about sizes.

    Raises
    ------
    RecordError
        When the parts unpack to too much, a sheet has too many cells, or a part is packed or
        written as no spreadsheet program does it.
    """
    with ZipFile(file) as archive:
        parts = archive.infolist()
        if sum(part.file_size for part in parts) > UNPACKED * _MB:
            raise unpacks_to_too_much(path, "save the sheet as .csv")
        for part in parts:
            try:
                _weigh(archive, part)
            except _OddError:
                raise RecordError(
                    f"{path} holds a part, {part.filename[:60]!r}, that no spreadsheet program "
                    "writes; save the workbook again as .xlsx, or the sheet as .csv"
                ) from None
            except _TooManyCellsError:
                raise too_many_cells(path) from None


def too_many_cells(path: Path) -> RecordError:
    """Error for a sheet with more cells than are read."""
    return RecordError(
        f"{path} has a sheet of more than {CELLS:,} cells, the most that is read; save it as .csv"
    )


def _weigh(archive: ZipFile, part: ZipInfo) -> None:
    """Refuse a part that is larger than it says, or heavier than is read."""
    if part.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
        raise _OddError  # zipfile unpacks others without a bound
    size, scan = 0, _Scan()
    unbounded = copy(part)
    unbounded.file_size += 2 * _MB  # reading would stop at the size that is declared
    with archive.open(unbounded) as content:
        while size <= part.file_size and (piece := content.read(_MB)):
            size += len(piece)
            scan.feed(piece)
    if size != part.file_size:
        raise _OddError
