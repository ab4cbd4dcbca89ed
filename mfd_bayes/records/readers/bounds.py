"""Limits on the files that are read, and checks of text and JSON before they are parsed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mfd_bayes.errors import RecordError

TEXT = 256  # largest text file, MB: an hour and a half of four columns at 1024 Hz
LINE = 2**17  # most characters of a line
COLUMNS = 1000  # most columns of a file
NAME = 300  # most characters of a column's name
JSON = 64  # largest JSON file, MB
LISTS = 1_000_000  # most lists and objects of a JSON file: each needs some hundred bytes of memory
UNPACKED = 256  # largest size of a packed file after unpacking, MB
CELLS = 20_000_000  # most cells of a JSON file whose rows are objects
_MB = 2**20


def check_text(path: Path) -> None:
    """Refuse a text file that is larger than `TEXT` or has a line longer than `LINE`."""
    _check_size(path, TEXT)
    # In this encoding every byte is a character, and all line ends are recognised.
    with path.open(encoding="latin-1") as file:
        for number, line in enumerate(iter(lambda: file.readline(LINE + 1), ""), start=1):
            if len(line) > LINE:
                raise RecordError(
                    f"line {number} of {path} is longer than {LINE:,} characters, the most that is "
                    "read; expected a line for every sample"
                )


def check_columns(path: Path, count: int) -> None:
    """Refuse a file with more columns than `COLUMNS`."""
    if count > COLUMNS:
        raise RecordError(
            f"{path} has {count:,} columns; at most {COLUMNS:,} are read: expected a line for "
            "every sample"
        )


def check_names(path: Path, names: Sequence[str]) -> None:
    """Refuse a file with more columns than `COLUMNS`, or a name longer than `NAME`."""
    check_columns(path, len(names))
    for number, name in enumerate(names, start=1):
        if len(name) > NAME:
            raise RecordError(
                f"the name of column {number} of {path}, {name[:40] + '…'!r}, is longer than "
                f"{NAME} characters, the most that is read"
            )


def read_json_text(path: Path) -> str:
    """Text of a JSON file; one beyond the limits `JSON` and `LISTS` is refused."""
    _check_size(path, JSON)
    text = path.read_text(encoding="utf-8-sig")
    if text.count("[") + text.count("{") > LISTS:
        raise RecordError(
            f"{path} holds more than {LISTS:,} lists and objects, the most that are read; "
            "expected one list for each column"
        )
    return text


def unpacks_to_too_much(path: Path, way_out: str) -> RecordError:
    """Error for a packed file that is larger than `UNPACKED`, with what to do instead."""
    return RecordError(
        f"{path} unpacks to more than {UNPACKED} MB, the most that is read; {way_out}"
    )


def _check_size(path: Path, most: int) -> None:
    size = path.stat().st_size
    if size > most * _MB:
        raise RecordError(
            f"{path} has {size / _MB:,.0f} MB; at most {most} MB of a {path.suffix} file are "
            "read: save it as .mat or .tdms, or cut it"
        )
