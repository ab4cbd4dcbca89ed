"""Whether a cell of a table holds a number, and the errors for cells that do not."""

from __future__ import annotations

import math
import re
from pathlib import Path

from mfd_bayes.errors import RecordError

# 1.234,5 · 1,234.5 · 1 234,5 · 1'234.5
_GROUPED = re.compile(r"[+-]?\d{1,3}(?:([ .,'’\u00a0\u202f])\d{3})+(?:(?!\1)[.,]\d*)?")


def is_number(cell: object, *, decimal: str = ".", finite: bool = False) -> bool:
    """Whether a cell is a number, or a text that is one with this decimal sign."""
    if isinstance(cell, str) and decimal != ".":
        cell = cell.replace(".", " ").replace(decimal, ".")
    try:
        value = float(cell)  # type: ignore[arg-type]  # TypeError is caught
    except (TypeError, ValueError, OverflowError):
        return False
    # Python's float accepts 1_000, and digits of other scripts, which no other reader does.
    plain = all(c.isascii() or not c.isdigit() for c in str(cell))
    return plain and "_" not in str(cell) and (not finite or math.isfinite(value))


def as_number(cell: object, decimal: str = ".") -> float:
    """Number of a cell; NaN of one that holds no finite number."""
    if not is_number(cell, decimal=decimal, finite=True):
        return math.nan
    return float(str(cell).replace(decimal, "."))


def bare_unit(text: str) -> str:
    """Unit without brackets: ``"kN"`` of ``"[kN]"``; empty for a dash."""
    return text.strip().strip("[](){}<>-–— ")


def sample(row: int) -> str:
    """Place of a row, from 0, in a file without lines: ``"sample 17"``."""
    return f"sample {row + 1}"


def bad_cell(place: str, path: Path, name: str, found: object) -> RecordError:
    """Error for a cell that holds no finite number: text, an empty cell, nan or infinity."""
    text = str(found).strip()
    shown = repr(text[:40]) if text else "an empty cell"
    if _GROUPED.fullmatch(text) and not is_number(text):
        shown += "; a number is written without a thousands separator"
    return not_a_number(place, path, name, shown)


def not_a_number(place: str, path: Path, name: str, shown: str) -> RecordError:
    """Error for a cell that holds no finite number; `shown` says what it holds."""
    return RecordError(
        f"{place} of {path}, column {name!r}: expected a finite number, found {shown}"
    )


def missing_library(path: Path, library: str, extra: str) -> RecordError:
    """Error for a file whose format needs a library that is not installed."""
    return RecordError(
        f'reading {path} needs {library}, which is not installed: pip install "mfd_bayes[{extra}]"'
    )


def unreadable(path: Path, error: Exception) -> RecordError:
    """Error for a file that the system or a parser cannot read."""
    return RecordError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}")
