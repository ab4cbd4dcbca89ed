"""Ground motions as text: PEER's .AT2, K-NET's files, or numbers alone in rows."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import BuildingError, UnitError
from mfd_bayes.response.measures import acceleration_factor
from mfd_bayes.units import factor

Array = NDArray[np.float64]

LONGEST_STEP = 0.2
"""Longest step that a file may have without being asked, s: it may be in ms."""

SAME_STEP = 5e-3
"""Share by which two steps of one motion may differ: files round them."""

_HEAD = 50  # lines in which a header may say the step
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?"
_WHOLE = (
    rf"({_NUMBER})(?![\d.]|,\d|[+-]\d|[eEdD][+-]?\d)"  # and never the beginning of a longer one
)
_VALUE = re.compile(rf"{_NUMBER}|[+-]?(?:nan|inf(?:inity)?)", re.IGNORECASE)

_GLUED = re.compile(rf"{_NUMBER}(?:[+-](?:\d+\.\d*|\.\d+)(?:[eEdD][+-]?\d+)?)+")  # "0.123-0.456"

_STEP = re.compile(
    r"\b(?:DT|DELTA[ _-]?T|TIME[ _-]?(?:STEP|INTERVAL|INCREMENT)|STEP|SPACING|SPACED|RATE|SPS"
    r"|SAMPLED"
    r"|(?:SAMPL(?:E|ING)|DIGITI[SZ](?:ATION|ING))[ _-]?"
    r"(?:INTERVAL|PERIOD|STEP|TIME|RATE|FREQ(?:UENCY)?)"
    r"|SAMPLES[ _]?(?:PER|/)[ _]?S(?:EC(?:OND)?)?)(?![A-Z0-9])\.?"
    r"(?:_([A-Z]+)|\s*[(\[]([^)\]]*)[)\]])?\s*([:=]|OF\b|AT\b|IS\b)?\s*",
    re.IGNORECASE,
)
_OF_RATE = re.compile(r"RATE|FREQ|SPS|SAMPLES", re.IGNORECASE)
_POINTS_AND_STEP = re.compile(rf"\s*{_WHOLE}[\s,]+{_WHOLE}[\s,]+NPTS[\s,]+DT\b", re.IGNORECASE)
_POINTS = re.compile(
    r"\b(?:NPTS|NDATA|N(?:UMBER|O\.?)[ _]OF[ _](?:DATA[ _])?(?:POINTS|SAMPLES))\s*[:=]\s*(.*)"
    r"|^\s*(\d\S*)\s+(?:points|pts)\b",
    re.IGNORECASE,
)
_UNIT = re.compile(
    r"\bUNITS?\b(?:\s+(?:OF|ARE|IS|IN)\b|\s*[:=]|(?=\s*[(\[]))\s*(.*)", re.IGNORECASE
)
_OF_OTHERS = re.compile(r"(?:OF\s+)?(?:TIME|VEL|DISP)", re.IGNORECASE)
_OF_ACCELERATION = re.compile(r"(?:OF\s+)?ACC[A-Z]*\.?\s*(?:ARE\b|IS\b|[:=])?\s*", re.IGNORECASE)
_PHRASE = re.compile(r"[,;]|\.(?=\s|$)|\s{2,}|\s+[A-Z]\w*\s*[:=]", re.IGNORECASE)  # its end
_OF_ACC = re.compile(
    r"\bACC(?:EL\w*)?\b.*?(?:[(\[]\s*([^()\[\]]+)[)\]]|\bIN\s+(g)\b)", re.IGNORECASE
)
_WORDS = re.compile(r"[^\s,;:=()\[\]]*/[^\s,;:=()\[\]]+|\bgals?\b", re.IGNORECASE)  # "cm/s/s"
_NOT_OF_VALUES = re.compile(r"\b(?:PGA|PEAK|MAX|MIN|MEAN|RMS|SENSIT)", re.IGNORECASE)
_SCALE = re.compile(
    r"\b(?:SCAL(?:E|ING)|CONVERSION|CALIBRATION|MULTIPLICATION)[ _-]*FACTOR\s*[:=]?\s*(.*)",
    re.IGNORECASE,
)
_RATES = {"hz": "Hz", "khz": "kHz", "sps": "Hz", "samples/s": "Hz", "samples/sec": "Hz"}

_FEW_COLUMNS = 3  # up to so many columns, three rows show whether the first one rises evenly
_UNEVEN = 0.1  # largest departure of times from even ones, in steps: files round them


@dataclass(frozen=True, eq=False)
class Text:
    """A ground motion as its file has it: values, (T,), and what its header says.

    `step`, s, is None, and `unit` and `said`, the words around it, are "" where the header does
    not say it. `unread` is what it says of the step in words that cannot be read.
    """

    values: Array
    step: float | None
    unit: str
    said: str
    unread: str


def read_text(path: Path) -> Text:
    """Values along the rows of a file, and its header's step and unit.

    Raises
    ------
    BuildingError
        When a word is no number, values are missing, the header contradicts itself or has a
        factor that cannot be read, or the file looks like a table with a column of the time.
    OSError
        When the file cannot be read.
    """
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    head = _head(lines)
    end = len(lines)
    while end > head and not _begins_as_data(lines[end - 1]):  # "*** End data ***"
        end -= 1
    header, body = lines[:head], lines[head:end]
    if "." not in (joined := "\n".join(body)) and re.search(r"\d,\d", joined):
        raise BuildingError(f"{path} may have decimal commas: write its numbers with points")
    rows = [(n, words) for n, line in enumerate(body, head + 1) if (words := _words(line))]
    values = [_numbers(path, number, words) for number, words in rows]
    if not values:
        raise BuildingError(f"{path} holds no numbers")
    points = _points(path, header)
    steps = list(_steps(header))
    if points != sum(map(len, values)) and (lead := _number_line(path, [w for _, w in rows])):
        values = values[lead[0] :]
        steps += [("its first numbers", lead[1])] if lead[1] else []
    count = sum(map(len, values))
    if points is not None and points != count:
        raise BuildingError(
            f"{path}: the header says NPTS = {points}, and there are {count} values"
        )
    if points is None and _has_times(values):
        raise BuildingError(
            f"{path} looks like columns of time and acceleration: save it as .csv with names such "
            "as time_s,acceleration_g in its first line"
        )
    scale, unit, said = _scale(path, header)
    for own, place in _units(header):
        if unit and not _alike(unit, own):
            raise BuildingError(f"{path}: the header says {said!r} and {place!r}: correct the file")
        unit, said = (unit, said) if unit else (own, place)
    known = [(place, step) for place, step in steps if step is not None]
    if known and max(s for _, s in known) > (1.0 + SAME_STEP) * min(s for _, s in known):
        two = " and ".join(repr(place) for place, _ in known)
        raise BuildingError(f"{path}: {two} are different steps: correct the file")
    unread = next((place for place, step in steps if step is None), "")
    flat = scale * np.array([value for row in values for value in row])
    return Text(flat, known[0][1] if known else None, unit, said, unread)


def _head(lines: Sequence[str]) -> int:
    """Number of lines of the header: the values begin below what says the step."""
    first = next((i for i, line in enumerate(lines) if _is_data(line)), len(lines))
    says = [i for i, line in enumerate(lines[:_HEAD]) if any(_steps([line]))]
    said = max((i for i in says if i < first), default=says[0] if says else -1)
    if said >= 0:
        below = (i for i in range(said + 1, len(lines)) if _begins_as_data(lines[i]))
        first = next(below, said + 1)
    width = len(_words(lines[first])) if first < len(lines) else 0
    while first - 1 > said and _is_meant_as_data(lines[first - 1], width):
        first -= 1  # a first row of values, one of which is no number
    return first


def _steps(header: Sequence[str]) -> Iterator[tuple[str, float | None]]:
    """Words of each step that a header says, and the step, s; None where it cannot be read."""
    for line in header:
        if match := _POINTS_AND_STEP.match(line):
            yield match[0].strip(), _float(match[2])
            continue
        found = list(_STEP.finditer(line))
        for match, end in zip(found, [*(m.start() for m in found[1:]), len(line)], strict=False):
            text = line[match.end() : end]
            rate = _OF_RATE.search(match[0]) is not None
            step = _step(text, match[1] or match[2] or "", is_rate=rate)
            if step is not None or match[3] in (":", "="):
                yield f"{match[0]}{text}".strip()[:60], step


def _step(text: str, unit: str, *, is_rate: bool) -> float | None:
    """Step, s, of "1.0D-02 SEC, …", "10 ms" or "100Hz"; None where it is not read whole."""
    number = re.match(_WHOLE, text)
    if not number:
        return None
    rest = text[number.end() :]
    word = re.match(r"\s*[(\[]?\s*([A-Za-zµ/]+)\.?\s*[)\]]?(?=[\s,;.]|$)(?!\s*[:=])", rest)
    if not word and not re.match(r"\s*(?:$|[,;](?!\d)|\s[A-Z]\w*\s*[:=])", rest, re.IGNORECASE):
        return None
    if word and unit and _seconds(1.0, word[1]) != _seconds(1.0, unit):
        return None
    return _seconds(_float(number[1]), word[1] if word else unit or ("Hz" if is_rate else "s"))


def _seconds(value: float, unit: str) -> float | None:
    """Step, s, of a value in a unit of time, or in one of a rate; None for any other unit."""
    unit = unit.strip().lower()
    try:
        if unit in _RATES:
            step = 1.0 / (value * factor(_RATES[unit], "rate"))
        else:
            step = value * factor(unit, "time")
    except (UnitError, ZeroDivisionError):
        return None
    return step if 0.0 < step < math.inf else None


def parse_step(text: str) -> float | None:
    """Step, s, of "0.01s", "10 ms" or "100 Hz"; None for any other text."""
    match = re.fullmatch(rf"\s*({_NUMBER})\s*([A-Za-zµ]+)\s*", text)
    return _seconds(_float(match[1]), match[2]) if match else None


def _points(path: Path, header: Sequence[str]) -> int | None:
    """Number of values that a header says."""
    for line in header:
        match = _POINTS_AND_STEP.match(line) or _POINTS.search(line)
        if not match:
            continue
        text = match[1] or match[2]
        number = re.match(rf"{_WHOLE}(?![A-Za-z])", text)
        value = _float(number[1]) if number else math.nan
        if not value.is_integer():
            raise BuildingError(
                f"{path}: the number of values in {match[0].strip()[:60]!r} cannot be read"
            )
        return int(value)
    return None


def _number_line(path: Path, rows: Sequence[Sequence[str]]) -> tuple[int, float | None] | None:
    """Rows that are a header of numbers, and its step: "40 0.0100 656" above 40 values.

    Raises
    ------
    BuildingError
        When the first row looks like one, and the number of values is another.
    """
    total = sum(map(len, rows))
    if rows[0][0].isdigit() and int(rows[0][0]) == total - 1 > 1 and len(rows[0]) == 1:
        return 1, None
    for height in (1, 2):
        lead = [word for row in rows[:height] for word in row]
        if height == 2 and [len(row) for row in rows[:2]] != [1, 1]:
            continue
        for points, step in (lead[:2], lead[1::-1]) if len(lead) > 1 else ():
            if not re.fullmatch(r"\d+\.?0*", points) or not 1e-5 < _float(step) <= LONGEST_STEP:
                continue
            if float(points) == total - len(lead):
                return height, _float(step)
            rest = [word for row in rows[height:] for word in row]
            if (
                points.isdigit()
                and int(points) >= 10
                and 2 * sum(map(str.isdigit, rest)) < len(rest)
            ):
                raise BuildingError(
                    f"{path}: {' '.join(lead[:6])!r} looks like a number of values and a step, and "
                    f"there are {total - len(lead)} values: correct it, or remove this line"
                )
    return None


def _units(header: Sequence[str]) -> list[tuple[str, str]]:
    """Units of the values that a header says, each with the words that say it.

    Where it says none after the word UNITS, those of accelerations that stand in it.
    """
    found, other = [], []
    for line in header:
        match = _UNIT.search(line)
        if match and not _OF_OTHERS.match(match[1]):
            text = _OF_ACCELERATION.sub("", match[1], count=1)
            inner = re.match(r"[(\[]([^)\]]*)[)\]]", text)
            parts = [inner[1]] if inner else [part.strip() for part in _PHRASE.split(text)]
            unit = next((part for part in parts if not _seconds(1.0, part)), "")  # "sec, cm/s/s"
            end = line.index(unit, match.start()) + len(unit) + bool(inner) if unit else len(line)
            found.append((re.sub(r"\(\d+\)$", "", unit), line[match.start() : end].strip()))
        elif not _NOT_OF_VALUES.search(line):
            words = [word[0].removesuffix(".") for word in _WORDS.finditer(line)]
            words += [unit for of in _OF_ACC.finditer(line) for unit in of.groups() if unit]
            other += [(unit, line.strip()[:60]) for unit in words if _factor(unit)]
    return found or other


def _scale(path: Path, header: Sequence[str]) -> tuple[float, str, str]:
    """Factor of the values, with its unit and words: "Scale Factor 3920(gal)/6182761" of K-NET."""
    for line in header:
        if not (match := _SCALE.search(line)):
            continue
        said, text = match[0].strip(), match[1].strip()
        parts = re.fullmatch(rf"({_NUMBER})\s*\(([^)]+)\)\s*/\s*({_NUMBER})", text)
        if parts and _factor(parts[2]) and _float(parts[3]) != 0.0:
            return _float(parts[1]) / _float(parts[3]), parts[2], said
        if not (re.fullmatch(_NUMBER, text) and _float(text) == 1.0):
            raise BuildingError(
                f"{path}: the header says {said!r}, which cannot be read: expected such as 'Scale "
                "Factor 3920(gal)/6182761'; multiply the values by it, and remove this line"
            )
    return 1.0, "", ""


def _factor(unit: str) -> float | None:
    """Factor of a unit of acceleration to in/s²; None for any other unit."""
    try:
        return acceleration_factor(unit)
    except UnitError:
        return None


def _alike(one: str, other: str) -> bool:
    """Whether two units are the same, or neither of them can be read."""
    a, b = _factor(one), _factor(other)
    return a == b if a is None or b is None else math.isclose(a, b, rel_tol=1e-6)


def _numbers(path: Path, number: int, words: Sequence[str]) -> list[float]:
    """Numbers of a line."""
    for word in words:
        if not _VALUE.fullmatch(word):
            raise BuildingError(f"{path} line {number}: expected numbers, got {word[:40]!r}")
    return [_float(word) for word in words]


def _float(word: str) -> float:
    """A number, whose exponent may be one of Fortran, "1.0D-02"."""
    return float(word.upper().replace("D", "E"))


def _has_times(rows: Sequence[Sequence[float]]) -> bool:
    """Whether all rows have the same number of numbers, the first of which rises evenly."""
    width = len(rows[0])
    fewest = 3 if width <= _FEW_COLUMNS else 6
    if width < 2 or len(rows) < fewest or {len(row) for row in rows} != {width}:
        return False
    first = np.array([row[0] for row in rows])
    step = (first[-1] - first[0]) / (len(first) - 1)
    even = first[0] + step * np.arange(len(first))
    return bool(np.all(np.diff(first) > 0.0) and np.all(np.abs(first - even) <= _UNEVEN * step))


def _words(line: str) -> list[str]:
    return line.replace(",", " ").replace(";", " ").split()


def _is_data(line: str) -> bool:
    words = _words(line)
    return bool(words) and all(_VALUE.fullmatch(word) for word in words)


def _begins_as_data(line: str) -> bool:
    words = _words(line)
    return bool(words) and bool(_VALUE.fullmatch(words[0]) or _GLUED.match(words[0]))


def _is_meant_as_data(line: str, width: int) -> bool:
    """Whether a line above a row of `width` values looks like such a row, with a fault in it."""
    words = _words(line)
    numbers = sum(_VALUE.fullmatch(word) is not None for word in words)
    alike = len(words) == width and (_begins_as_data(line) or 2 * numbers > width)
    return alike or any(_GLUED.fullmatch(word) for word in words)
