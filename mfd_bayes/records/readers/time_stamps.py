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
_DATE = (
    r"(?:(?P<y>\d{4})(?P<s1>[-/.])(?P<m>\d{1,2})(?P=s1)(?P<d>\d{1,2})"  # 2024-03-05
    r"|(?P<cy>\d{4})(?P<cm>\d{2})(?P<cd>\d{2})"  # 20240305
    r"|(?P<a>\d{1,2})(?P<s2>[-/.])(?P<b>\d{1,2})(?P=s2)(?P<ab>\d{4}|\d{2})"  # 03/05/2024
    r"|(?P<nd>\d{1,2})[- .]{1,2}(?P<nm>[^\W\d_]{3,9})\.?[- ,]{1,2}(?P<ny>\d{4}|\d{2})"  # 5-Mar-24
    r"|(?:[^\W\d_]{3}\s+)?(?P<um>[^\W\d_]{3,9})\.?\s+(?P<ud>\d{1,2}),?\s+(?P<uy>\d{4})"  # Mar 5 24
    r")"
)
_CLOCK = (
    r"(?:(?P<h>\d{1,4}):(?P<min>[0-5]\d):(?P<sec>[0-5]\d)(?:[.,:](?P<frac>\d{1,9}))?"
    r"|(?P<min2>\d{1,3}):(?P<sec2>[0-5]\d)[.,](?P<frac2>\d{1,9}))"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
    r"\s*(?P<zone>Z|UTC|GMT|[+-]\d{2}:?\d{2})?"
)
_STAMP = re.compile(rf"(?:{_DATE}(?:[T,;_ ]\s*|\s+))?{_CLOCK}")
_REVERSED = re.compile(rf"{_CLOCK}[,; ]\s*{_DATE}")
_NAMED = re.compile(  # Tue Mar 05 10:00:00 2024
    rf"(?:[^\W\d_]{{3}}\s+)?(?P<um>[^\W\d_]{{3}})\s+(?P<ud>\d{{1,2}})\s+{_CLOCK}\s+(?P<uy>\d{{4}})"
)
_DAYS = re.compile(rf"(?P<days>\d+)\s*(?:days?|d)[, ]\s*{_CLOCK}")  # 0 days 00:00:01.5
_DAY = 86_400 * 10**9  # ns
_GAP = 10  # an order of dates makes a gap where a step is so many times longer than usual


def _match(text: str) -> re.Match[str] | None:
    text = re.sub(r"^(\d{8})[T ](\d{2})(\d{2})(\d{2})", r"\1T\2:\3:\4", text)  # 20240305T100000
    forms = (_STAMP, _REVERSED, _NAMED, _DAYS)
    return next((match for form in forms if (match := form.fullmatch(text))), None)


def is_stamp(cell: object) -> bool:
    """Whether a cell is a text with a clock time, with or without a date."""
    return isinstance(cell, str) and _match(cell.strip().strip("'")) is not None


def elapsed(path: Path, name: str, cells: Sequence[object], dates: str = "") -> NDArray[np.float64]:
    """Seconds since the first row of a column of time stamps, (T,); NaN for other cells.

    Clock times without a date go on after midnight. `dates` is "day first", "month first", or ""
    where the stamps themselves must tell which.

    Raises
    ------
    RecordError
        When both orders of day and month are possible and give other times.
    """
    texts = [cell.strip().strip("'") if isinstance(cell, str) else "" for cell in cells]
    matches = [_match(text) for text in texts]
    orders = [dates] if dates else ["day first", "month first"]
    read = [_seconds(matches, month_first=order == "month first") for order in orders]
    counts = [int(np.isfinite(seconds).sum()) for seconds in read]
    found = [seconds for seconds, n in zip(read, counts, strict=True) if n == max(counts)]
    if len(found) == 1 or np.array_equal(found[0], found[1], equal_nan=True):
        return found[0]
    whole = []  # without a time that goes back, or a step far longer than usual
    for seconds in found:
        steps = np.diff(seconds[np.isfinite(seconds)])
        if not steps.size or (steps.min() >= 0.0 and steps.max() <= _GAP * np.median(steps)):
            whole.append(seconds)
    if len(whole) != 1:
        raise RecordError(
            f"the dates of column {name!r} of {path}, such as {texts[-1]!r}, may have the day "
            'or the month first: write dates = "day first" or dates = "month first" for it'
        )
    return whole[0]


def _seconds(matches: Sequence[re.Match[str] | None], *, month_first: bool) -> NDArray[np.float64]:
    """Seconds of stamps, to the nanosecond, since the first of them."""
    days, clocks = np.full(len(matches), -1, np.int64), np.zeros(len(matches), np.int64)
    dated = False
    twelve = True  # whether hours run from 1 to 12, without AM and PM
    for at, match in enumerate(matches):
        if match is None:
            continue
        part = match.groupdict()
        try:
            day = _day(part, month_first)
        except ValueError:  # there is no such day
            continue
        hour = int(part["h"] or 0)
        if part["half"]:
            twelve = False
            hour = hour % 12 + 12 * (part["half"][0] in "Pp")
        twelve = twelve and part["h"] is not None and 1 <= hour <= 12
        minutes = 60 * hour + int(part["min"] or part["min2"])
        if part["zone"] and part["zone"][0] in "+-":
            digits = part["zone"][1:].replace(":", "")
            minutes -= int(part["zone"][0] + "1") * (60 * int(digits[:2]) + int(digits[2:]))
        fraction = int((part["frac"] or part["frac2"] or "").ljust(9, "0"))
        clocks[at] = (60 * minutes + int(part["sec"] or part["sec2"])) * 10**9 + fraction
        days[at] = 0 if day is None else day
        dated = dated or day is not None
    good = np.flatnonzero(days >= 0)
    out = np.full(len(matches), np.nan)
    if not good.size:
        return out
    total = clocks[good] + (days[good] - days[good[0]]) * _DAY
    if not dated:
        turn = _DAY // 2 if twelve else _DAY
        passed = np.concatenate([[0], np.cumsum(np.diff(total) < -turn // 2)])
        total = total + passed * turn
    out[good] = (total - total[0]) / 1e9
    return out


def _day(part: dict[str, str | None], month_first: bool) -> int | None:
    """Day of a stamp, since the year 1; None where it has no date."""

    def of(*names: str) -> str:
        return next((text for name in names if (text := part.get(name))), "")

    if days := of("days"):
        return int(days)
    year, month, day = of("y", "cy", "ab", "ny", "uy"), of("m", "cm", "b"), of("d", "cd", "a")
    if not year:
        return None
    if month_first and of("a"):
        month, day = day, month
    number = _MONTHS.get(of("nm", "um")[:3].lower(), 0) if not month else int(month)
    full = int(year) + 2000 * (len(year) == 2)
    return date(full, number, int(day or of("nd", "ud"))).toordinal()
