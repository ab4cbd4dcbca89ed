"""Columns of numbers out of text, Excel, TDMS, JSON and MATLAB files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from mfd_bayes.errors import RecordError
from mfd_bayes.records.inputs import why_no_file
from mfd_bayes.records.readers.binary import (
    read_excel,
    read_json,
    read_matlab,
    read_tdms,
    read_text,
)
from mfd_bayes.records.table import Table

__all__ = ["SUFFIXES", "Table", "read_table"]

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
