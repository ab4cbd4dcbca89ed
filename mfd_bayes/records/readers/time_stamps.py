"""Time stamps of loggers as seconds since the first row: dates with clock times, or these alone."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError

_NAMES = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_MONTHS = {name: number for number, name in enumerate(_NAMES, start=1)}
_MONTHS |= {"mär": 3, "mrz": 3, "mai": 5, "okt": 10, "dez": 12}
_CLOCK = re.compile(
    r"(?<![\d:.,])(?:(?P<h>\d{1,4}):(?P<m>[0-5]\d):(?P<s>[0-5]\d)(?:[.,:](?P<f>\d{1,9}))?"
    r"|(?P<m2>\d{1,3}):(?P<s2>[0-5]\d)[.,](?P<f2>\d{1,9}))"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>Z|UTC|GMT|[+-]\d{2}:?\d{2})?(?=$|[,; ])"
)
_DATE = re.compile(
    r"|\d{8}|\d{4}([-/.])\d{1,2}\1\d{1,2}|\d{1,2}([-/.])\d{1,2}\2(?:\d{4}|\d\d)"
    r"|\d{1,2}[- .]{1,2}[^\W\d_]{3,9}\.?[- ,]{1,2}(?:\d{4}|\d\d)"  # 5-Mar-24
    r"|(?:[^\W\d_]{3}\s+)?[^\W\d_]{3,9}\.?\s+\d{1,2},?\s+\d{4}"  # Tue Mar 05 2024
    r"|\d+\s*d(?:ays?)?"
)
_DAY = 86_400 * 10**9  # ns
_GAP = 10  # an order of dates makes a gap where a step is so many times longer than usual


def _match(cell: object) -> tuple[re.Match[str], str] | None:
    """Clock time of a cell and the text of its date, which may be empty; None if it has none."""
    if not isinstance(cell, str) or (":" not in cell and "T" not in cell):
        return None
    text = cell.strip().strip("'")
    text = re.sub(r"^(\d{8})[T ](\d{2})(\d{2})(\d{2})", r"\1T\2:\3:\4", text)  # 20240305T100000
    text = re.sub(r"(?<=\d)[T_](?=\d)", " ", text)
    clock = _CLOCK.search(text)
    if clock is None:
        return None
    day = f"{text[: clock.start()].rstrip(' ,;')} {text[clock.end() :].lstrip(' ,;')}".strip()
    return (clock, day) if _DATE.fullmatch(day) else None


def is_stamp(cell: object) -> bool:
    """Whether a cell is a text with a clock time, with or without a date."""
    return _match(cell) is not None


def elapsed(path: Path, name: str, cells: Sequence[object], dates: str = "") -> NDArray[np.float64]:
    """Seconds since the first row of a column of time stamps, (T,); NaN for other cells.

    Clock times without a date go on after midnight. `dates` is "day first", "month first", or ""
    where the stamps themselves must tell which: the order that reads most of them, without a time
    that goes back or a step far longer than usual. Refused where both do, with other times.
    """
    matches = [_match(cell) for cell in cells]
    orders = [dates] if dates else ["day first", "month first"]
    read = [_seconds(matches, month_first=order == "month first") for order in orders]
    counts = [np.isfinite(seconds).sum() for seconds in read]
    read = [seconds for seconds, n in zip(read, counts, strict=True) if n == max(counts)]
    if len(read) == 1 or np.array_equal(read[0], read[1], equal_nan=True):
        return read[0]
    even = []
    for seconds in read:
        steps = np.diff(seconds[np.isfinite(seconds)])
        if not steps.size or (steps.min() >= 0.0 and steps.max() <= _GAP * np.median(steps)):
            even.append(seconds)
    if len(even) != 1:
        raise RecordError(
            f"the dates of column {name!r} of {path}, such as {str(cells[-1]).strip()!r}, may have "
            'the day or the month first: write dates = "day first" or dates = "month first" for it'
        )
    return even[0]


def _seconds(
    matches: Sequence[tuple[re.Match[str], str] | None], *, month_first: bool
) -> NDArray[np.float64]:
    """Seconds of stamps, to the nanosecond, since the first of them."""
    days = {text: _day(text, month_first) for text in {match[1] for match in matches if match}}
    twelve = True  # whether hours run from 1 to 12, without AM and PM
    rows, times = [], []
    for row, match in enumerate(matches):
        if match is None or (day := days[match[1]]) is None:
            continue
        part = match[0].groupdict()
        hour = int(part["h"] or 0)
        twelve = twelve and part["h"] is not None and 1 <= hour <= 12 and not part["half"]
        if part["half"]:
            hour = hour % 12 + 12 * (part["half"][0] in "Pp")
        minutes = 60 * hour + int(part["m"] or part["m2"])
        if part["zone"] and part["zone"][0] in "+-":
            digits = part["zone"][1:].replace(":", "")
            minutes -= int(part["zone"][0] + "1") * (60 * int(digits[:2]) + int(digits[2:]))
        seconds = 60 * minutes + int(part["s"] or part["s2"])
        rows.append(row)
        times.append(
            (86_400 * day + seconds) * 10**9 + int((part["f"] or part["f2"] or "").ljust(9, "0"))
        )
    out = np.full(len(matches), np.nan)
    if rows:
        total = np.array([time - times[0] for time in times], dtype=np.int64)
        if not any(days):  # clock times alone
            turn = _DAY // 2 if twelve else _DAY
            total += turn * np.concatenate([[0], np.cumsum(np.diff(total) < -turn // 2)])
        out[rows] = total / 1e9
    return out


def _day(text: str, month_first: bool) -> int | None:
    """Number of a day, 0 where there is no date; None of a date that does not exist."""
    if text.isdigit():  # 20240305
        text = f"{text[:4]}-{text[4:6]}-{text[6:]}"
    numbers = re.findall(r"\d+", text)
    if len(numbers) < 2:  # none, or a number of days
        return int(numbers[0]) if numbers else 0
    if len(numbers) == 2:  # 5-Mar-24
        words = re.findall(r"[^\W\d_]{3,}", text.lower())
        numbers.insert(1, str(_MONTHS.get(words[-1][:3], 0)))
    elif month_first and len(numbers[0]) < 4:
        numbers = [numbers[1], numbers[0], numbers[2]]
    day, month, year = numbers if len(numbers[0]) < 4 else numbers[::-1]
    try:
        return date(int(year) + 2000 * (len(year) == 2), int(month), int(day)).toordinal()
    except ValueError:
        return None
