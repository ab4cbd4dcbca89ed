"""Ground motions as text: PEER's .AT2, or numbers alone in rows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import BuildingError

Array = NDArray[np.float64]

_HEAD = 50  # lines in which a header may say the step
_STEP = re.compile(r"\bDT\s*=\s*((\d+\.?\d*|\.\d+)(e[+-]?\d+)?)", re.IGNORECASE)
_POINTS = re.compile(r"\bNPTS\s*=\s*(\d+)", re.IGNORECASE)
_UNIT = re.compile(r"\bUNITS\s+OF\s+([a-z][a-z0-9/*^²]*)", re.IGNORECASE)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?")

_COLUMNS = (2, 3)  # numbers in each row of a table of the time and one or two accelerations
_ROWS = 3  # fewest rows in which a column can be seen to rise evenly
_UNEVEN = 0.1  # largest departure of times from even ones, in steps: files round them


@dataclass(frozen=True, eq=False)
class Text:
    """A ground motion as its file has it: values, (T,), and what its header says.

    `step`, s, is None, and `unit` is "", where the header does not say it.
    """

    values: Array
    step: float | None
    unit: str


def read_text(path: Path) -> Text:
    """Values along the rows of a file, and its header's step and unit.

    Raises
    ------
    BuildingError
        When a word is no number, values are missing, or the file looks like a table with a column
        of the time.
    OSError
        When the file cannot be read.
    """
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    said = next((i + 1 for i, line in enumerate(lines[:_HEAD]) if _STEP.search(line)), None)
    head = said or next((i for i, line in enumerate(lines) if _is_data(line)), len(lines))
    end = len(lines)
    while end > head and not _is_data(lines[end - 1]):  # "*** End data ***"
        end -= 1
    rows = [
        _numbers(path, number, line) for number, line in enumerate(lines[head:end], start=head + 1)
    ]
    values = [value for row in rows for value in row]
    if not values:
        raise BuildingError(f"{path} holds no numbers")
    header = "\n".join(lines[:head])
    points = _POINTS.search(header)
    if points and int(points[1]) != len(values):
        raise BuildingError(
            f"{path}: the header says NPTS = {points[1]}, and there are {len(values)} values"
        )
    if not points and _has_times(rows):
        raise BuildingError(
            f"{path} looks like columns of time and acceleration: save it as .csv with names such "
            "as time_s,acceleration_g in its first line"
        )
    step, unit = _STEP.search(header), _UNIT.search(header)
    return Text(np.array(values), float(step[1]) if step else None, unit[1] if unit else "")


def _numbers(path: Path, number: int, line: str) -> list[float]:
    """Numbers of a line."""
    found = []
    for word in _words(line):
        try:
            found.append(float(word.replace("D", "E").replace("d", "e")))
        except ValueError:
            raise BuildingError(
                f"{path} line {number}: expected numbers, got {word[:40]!r}"
            ) from None
    return found


def _has_times(rows: Sequence[Sequence[float]]) -> bool:
    """Whether all rows have the same two or three numbers, the first of which rises evenly."""
    filled = [row for row in rows if row]
    if len(filled) < _ROWS or {len(row) for row in filled} - {len(filled[0])}:
        return False
    first = np.array([row[0] for row in filled])
    step = (first[-1] - first[0]) / (len(first) - 1)
    even = first[0] + step * np.arange(len(first))
    return (
        len(filled[0]) in _COLUMNS
        and bool(np.all(np.diff(first) > 0.0))
        and bool(np.all(np.abs(first - even) <= _UNEVEN * step))
    )


def _words(line: str) -> list[str]:
    return line.replace(",", " ").replace(";", " ").split()


def _is_data(line: str) -> bool:
    words = _words(line)
    return bool(words) and all(_NUMBER.fullmatch(word) for word in words)
