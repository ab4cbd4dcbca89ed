"""Ground motions: PEER's .AT2, K-NET's files, numbers alone in rows, and CSV with units."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import (
    BuildingError,
    MfdError,
    UnitError,
    path_of,
    real_number,
    real_numbers,
    why_no_file,
)
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.table import Table, header_unit, stated_unit
from mfd_bayes.units import GRAVITY, convert, factor, measure, split_quantity

Array = NDArray[np.float64]

LARGEST = 64 * 2**20  # largest file, bytes
MOST = 200_000  # most samples
WEAKEST, STRONGEST = 1e-4, 5.0  # peaks that are believed, g
UNSTATED = 2.0  # largest peak of numbers that are in g because nothing states their unit, g
SAME_PEAK = 1.2  # quotient of a peak in the header and that of the values: filters change it
LONGEST_STEP = 0.2  # that a file may have unless it is stated, s: it may be in ms
SAME_STEP = 5e-3  # share by which two steps of one motion may differ: files round them
HEAD = 50  # lines in which a header may say the step
UNEVEN = 0.1  # largest departure of times from even ones, in steps

# --- units

_UNITS = {
    **dict.fromkeys(("g", "g's", "gs", "gn"), GRAVITY),
    **dict.fromkeys(("%g", "%ofg"), 0.01 * GRAVITY),
    **dict.fromkeys(("mg", "milli-g"), 0.001 * GRAVITY),
    **dict.fromkeys(("gal", "gals"), 1.0 / 2.54),
    **dict.fromkeys(("ms2", "ms-2"), 1.0 / 0.0254),
    **dict.fromkeys(("mgal", "milligal"), 0.001 / 2.54),
}
_RATES = {"hz": "Hz", "khz": "kHz", "sps": "Hz", "samples/s": "Hz", "samples/sec": "Hz"}


def acceleration_factor(unit: str) -> float:
    """Factor from a unit of acceleration to in/s²: "g", "gal", "%g", "cm/s^2", "(CM/SEC/SEC)".

    Upper and lower case are the same, for headers are in capitals; g is that of gravity, no gram.
    """
    text = unit.strip().strip("\"'").lower()
    if bracketed := re.fullmatch(r"[(\[]([^()\[\]]*)[)\]]", text):
        text = bracketed[1].strip()
    text = text.removesuffix(".")
    if twice := re.fullmatch(r"([^()\[\]]+?)\s*[(\[]([^()\[\]]+)[)\]]", text):
        a, b = map(_factor, twice.groups())  # "gal (cm/s/s)"
        if a and b and math.isclose(a, b, rel_tol=1e-6):
            return a
    if value := _UNITS.get(text.replace(" ", "")):
        return value
    if tenths := re.fullmatch(r"(g|gals?)\s*/\s*(\d+)", text):  # "G/10"
        return _UNITS[tenths[1]] / float(tenths[2])
    text = re.sub(r"\s*\bper\b\s*", "/", text)
    text = re.sub(r"(?<=[a-z])\.(?=[a-z])", "*", text)
    text = re.sub(r"(?<=[a-z])(-?2)\b", r"^\1", text)  # "cm/s2", "cm s-2"
    try:
        return convert(text, "in/s^2")
    except UnitError as error:
        raise UnitError(f"unit {unit!r} is no acceleration such as 'g' or 'm/s^2'") from error


def parse_acceleration(text: str) -> float:
    """Acceleration of ``"0.3 g"`` or ``"3 m/s^2"``, in/s²."""
    value, unit = split_quantity(text, example="0.3 g")
    try:
        return value * acceleration_factor(unit)
    except UnitError as error:
        raise UnitError(
            f"expected an acceleration such as '0.3 g' or '3 m/s^2', got {text!r}"
        ) from error


def _factor(unit: str) -> float | None:
    """Factor of a unit of acceleration to in/s²; None for any other unit."""
    try:
        return acceleration_factor(unit)
    except UnitError:
        return None


def _seconds(value: float, unit: str) -> float | None:
    """Step, s, of a value in a unit of time, or in one of a rate; None for any other unit."""
    unit = unit.strip().lower()
    try:
        scale = factor(_RATES.get(unit, unit), "rate" if unit in _RATES else "time")
        step = 1.0 / (value * scale) if unit in _RATES else value * scale
    except (UnitError, ZeroDivisionError):
        return None
    return step if 0.0 < step < math.inf else None


# --- a motion, and where it comes from


@dataclass(frozen=True, eq=False)
class Ground:
    """A ground motion."""

    name: str
    step: float  # s
    # (T,), in/s², from time 0; a copy of what is given, which cannot be changed
    acceleration: Array

    def __post_init__(self) -> None:
        name, acceleration = self.name, self.acceleration
        if not isinstance(name, str):
            raise BuildingError(f"name of a ground motion must be text, got {name!r}")
        values = np.array(real_numbers(f"{name}: acceleration", acceleration, BuildingError))
        if values.ndim != 1 or not 2 <= values.size <= MOST:
            raise BuildingError(f"{name}: expected 2 to {MOST} values, got {values.size}")
        if not np.all(np.isfinite(values)):
            row = int(np.argmin(np.isfinite(values))) + 1
            raise BuildingError(f"{name}: value {row} of the ground motion is no finite number")
        if not np.any(values):
            raise BuildingError(f"{name}: the ground does not move: all values are 0")
        values.flags.writeable = False
        object.__setattr__(self, "step", _checked_step(name, self.step))
        object.__setattr__(self, "acceleration", values)

    @property
    def time(self) -> Array:
        """Times of the samples, (T,), s."""
        return np.asarray(self.step * np.arange(self.acceleration.size), dtype=np.float64)

    @property
    def peak(self) -> float:
        """Largest acceleration, in/s²."""
        return float(np.max(np.abs(self.acceleration)))

    @property
    def words(self) -> str:
        """Name, peak in g and duration, in words."""
        peak, duration = self.peak / GRAVITY, float(self.time[-1])
        return f"{self.name}: peak {peak:.3g} g, {duration:.4g} s in steps of {self.step:.4g} s"

    def scaled(self, scale: float) -> Ground:
        """The motion times a factor, which its name says; no number, or zero, is refused."""
        scale = real_number("factor", scale, BuildingError)
        name = f"{self.name} × {scale:.3g}"
        return replace(self, name=name, acceleration=scale * self.acceleration)

    def with_peak(self, peak: float) -> Ground:
        """The motion scaled to a peak above zero, in/s²."""
        peak = real_number("peak", peak, BuildingError, (0.0, np.inf), exclusive=True)
        return self.scaled(peak / self.peak)


def _checked_step(name: str, step: object) -> float:
    label = f"{name}: the step of a ground motion"
    return real_number(label, step, BuildingError, (0.0, np.inf), exclusive=True)


def parse_ground(text: str, *, of: str = "--ground") -> tuple[Path, float | None, str]:
    """File, step and unit of ``"Rinaldi.AT2:0.01s"`` or ``"a.txt:0.01s:cm/s^2"``.

    Step and unit are taken off the end; the path before them may have colons.
    """
    name, step, unit = text, None, ""
    while ":" in name and not os.path.lexists(name):
        head, tail = name.rsplit(":", 1)
        match = re.fullmatch(rf"\s*({_NUMBER})\s*([A-Za-zµ]+)\s*", tail)
        seconds = _seconds(_float(match[1]), match[2]) if match else None
        if step is None and seconds is not None:
            step = seconds
        elif not unit and _factor(tail):
            unit = tail.strip()
        elif re.search(r"[/\\]", tail):  # "run 10:30/quake.txt", "C:\gm\quake.txt"
            break
        else:
            raise BuildingError(
                f"{of} {text!r}: expected FILE, FILE:0.01s or FILE:0.01s:g, got {tail!r}"
            )
        name = head
    return Path(name), step, unit


def read_ground(
    path: str | PathLike[str],
    *,
    step: float | None = None,
    unit: str = "",
    scale: float = 1.0,
    meant: bool = False,
) -> Ground:
    """Ground motion of a file, times a `scale`.

    With the suffix .csv it is a table with a column of the time and one of the acceleration, with
    units in its header; with any other PEER's .AT2, one of K-NET's files, or numbers alone. Step, s
    and unit are given where the file does not say them; the unit is "g" by default, but for a CSV.
    A scaled peak above 5 g or below 0.0001 g is refused unless it is `meant`, and so is one above
    2 g where neither the file nor `unit` says the unit.
    """
    path = path_of("ground", path, BuildingError)
    if step is not None:
        step = _checked_step(path.name, step)
    if not isinstance(unit, str):
        raise BuildingError(f"unit must be text, such as 'g' or 'm/s^2', got {unit!r}")
    try:
        if reason := why_no_file(path):
            raise BuildingError(f"{path} {reason}")
        if path.stat().st_size > LARGEST:
            raise BuildingError(f"{path} is larger than {LARGEST >> 20} MB")
        read = _read_csv if path.suffix.lower() == ".csv" else _read_text
        values, file_step, stated = read(path, step, unit)
    except OSError as error:
        raise BuildingError(f"cannot read {path}: {error.strerror or error}") from error
    except UnitError as error:
        raise BuildingError(f"{path}: {error}") from error
    # bytes that are not UTF-8 become escapes
    ground = Ground(path.name.encode(errors="backslashreplace").decode(), file_step, values)
    if step is None and file_step > LONGEST_STEP:
        raise BuildingError(
            f"{path}: the file's step is {file_step:.6g} s, and steps are at most {LONGEST_STEP} "
            "s: give it as FILE:0.01s, or step=0.01 in Python"
        )
    ground = ground if scale == 1.0 else ground.scaled(scale)
    peak, strongest = ground.peak / GRAVITY, STRONGEST if stated else UNSTATED
    if not (meant or WEAKEST <= peak <= strongest):
        advice = "correct the unit of its values" if stated else "give the unit of its values"
        raise BuildingError(
            f"{path}: its peak would be {peak:.3g} g, and ground motions have {WEAKEST:g} to "
            f"{STRONGEST:g} g, or {UNSTATED:g} g where no unit is stated: {advice}, as "
            "FILE:cm/s^2 (unit='cm/s^2' in Python), or give a --scale"
        )
    return ground


def _agreed_step(path: Path, dt: float | None, option: float | None) -> float | None:
    """Step of a file, s, or the one that is given where the file does not say it."""
    if dt is None or option is None or math.isclose(dt, option, rel_tol=SAME_STEP):
        return option if dt is None else dt
    raise BuildingError(
        f"{path}: the file's step is {dt:.6g} s, and {option:.6g} s was given: leave the step out, "
        "or correct the file"
    )


def _agreed_factor(label: str, file_unit: str, user_unit: str) -> float:
    """Factor of the unit that a file says to in/s²; `label` is the place at which it is said."""
    user_factor, file_factor = (
        acceleration_factor(user_unit) if user_unit else None,
        _factor(file_unit),
    )
    of_others = re.search(r"\d|count", file_unit, re.IGNORECASE) or measure(file_unit.lower())
    if file_factor is None and (user_factor is None or of_others):
        advice = "correct the file" if of_others else "give the unit as FILE:cm/s^2"
        raise BuildingError(
            f"{label}, which is no acceleration such as 'g' or 'cm/s^2': {advice}"
            + ("" if of_others else ", or unit='cm/s^2' in Python")
        )
    if (
        file_factor is not None
        and user_factor is not None
        and not math.isclose(file_factor, user_factor, rel_tol=1e-6)
    ):
        raise BuildingError(
            f"{label}, and {user_unit!r} was given: leave the unit out, or correct the file"
        )
    return file_factor or user_factor or 0.0


# --- tables


def _read_csv(path: Path, step: float | None, unit: str) -> tuple[Array, float, bool]:
    """Accelerations, in/s², step, s, and true, as its unit is stated, of a table."""
    try:
        table = read_table(path)
        moves = _columns(table, ("acc", "a_", "ag", "ground"), _factor)
        if len(moves) != 1:
            raise BuildingError(
                f"{path} needs one column of the acceleration, such as 'acceleration_g'; it has "
                f"{', '.join(table.names[:20])}"
            )
        times = _columns(table, ("time", "t_", "t["), lambda unit: _seconds(1.0, unit))[:1]
        columns = table.columns([*moves, *times])
    except MfdError as error:
        raise BuildingError(str(error)) from error
    _refuse_one_sign(path, columns[moves[0]])
    column_unit = _column_unit(table, moves[0]) or unit
    if not column_unit:
        raise BuildingError(f"{path}: the column {moves[0]!r} has no unit, such as acceleration_g")
    for name in times:
        step = _even_step(
            path, columns[name], factor(_column_unit(table, name) or "s", "time"), step
        )
    if step is None:
        raise BuildingError(f"{path} needs a column of the time, such as 'time_s', or a step")
    scale = _agreed_factor(
        f"{path}: the unit of the column {moves[0]!r} is {column_unit!r}", column_unit, unit
    )
    return scale * columns[moves[0]], step, True


def _columns(
    table: Table, beginnings: tuple[str, ...], measures: Callable[[str], float | None]
) -> list[str]:
    """Names of the columns that begin so; where none does, of those with a unit of that kind."""
    named = [name for name in table.names if name.lower().startswith(beginnings)]
    return named or [name for name in table.names if measures(_column_unit(table, name))]


def _column_unit(table: Table, name: str) -> str:
    """Unit of a column, by the row of units or by its name; "" where neither has one."""
    row, header = table.units.get(name, ""), header_unit(name) or stated_unit(name) or ""
    a, b = (_factor(unit) or _seconds(1.0, unit) for unit in (row, header))
    if a and b and not math.isclose(a, b, rel_tol=1e-5):
        raise BuildingError(
            f"{table.path}: the column {name!r} is in {header!r} by its name and in {row!r} by the "
            "row of units: correct the file"
        )
    return row or header


def _even_step(path: Path, written: Array, unit: float, user_step: float | None) -> float:
    """Step, s, of even times that are `written` in a unit, s; the given one if any.

    Times that are written more coarsely than the step are read only where it is given.
    """
    digits = next((n for n in range(15) if np.allclose(written, written.round(n), 1e-12, 0)), 15)
    time, number, digit = unit * written, np.arange(written.size), unit * 10.0**-digits
    if (
        user_step is not None
        and digit > 1.01 * user_step
        and np.ptp(time - user_step * number) <= digit * 1.001
    ):
        return user_step
    step = float(time[-1] - time[0]) / max(time.size - 1, 1)
    error = np.max(np.abs(time - (time[0] + step * number)))
    rounding = digit if digit <= 0.5 * step else 0.0
    is_even = error <= max(UNEVEN * step, rounding) and np.all(np.diff(time) > 0.0)
    if not (step > 0.0 and is_even):
        raise BuildingError(f"{path}: the time of a ground motion must grow by one even step")
    _agreed_step(path, step, user_step)
    return user_step or step


# --- numbers in rows below a header

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?"
_WHOLE = rf"({_NUMBER})(?![\d.]|,\d|[+-]\d|[eEdD][+-]?\d)"  # never the beginning of a longer one
_OTHER = re.compile(r"(?<!wave )\b(?:VELOCITY|DISPLACEMENT)\b|\A\.[VD]T2\b", re.IGNORECASE)
_COUNTS = re.compile(r"(?:\b(?:in|of|are)\s+|[,:=(]\s*)counts\b(?!\s*/)", re.IGNORECASE)
_SENSITIVITY = re.compile(r"\b(?:m?V(?:olts?)?|counts?)\s*/\s*g\b", re.IGNORECASE)
_VALUE = re.compile(rf"{_NUMBER}|[+-]?(?:nan|inf(?:inity)?)", re.IGNORECASE)
_GLUED = re.compile(rf"{_NUMBER}(?:[+-](?:\d+\.\d*|\.\d+)(?:[eEdD][+-]?\d+)?)+")  # "0.123-0.456"
_STEP = re.compile(
    r"\b(?:DT|DELTA[ _-]?T|TIME[ _-]?(?:STEP|INTERVAL|INCREMENT)|STEP|SPACING|SPACED|RATE|SPS"
    r"|SAMPLED"
    r"|INTERVALS?(?=\s+OF\b)|(?:SAMPL(?:E|ING)|DIGITI[SZ](?:ATION|ING))[ _-]?"
    r"(?:INTERVAL|PERIOD|STEP|TIME|RATE|FREQ(?:UENCY)?)"
    r"|SAMPLES[ _]?(?:PER|/)[ _]?S(?:EC(?:OND)?)?)(?![A-Z0-9])\.?"
    r"(?:_([A-Z]+)|\s*[(\[]([^)\]]*)[)\]])?\s*([:=]|OF\b|AT\b|IS\b)?\s*",
    re.IGNORECASE,
)
_STEP_AHEAD = re.compile(  # "at 0.020 sec intervals", "50 sps"
    rf"(?:^|[\s,]){_WHOLE}\s*(?:([A-Za-zµ]+)[\s-]+(?:TIME[ -])?INTERVALS?\b|(SPS)\b)", re.IGNORECASE
)
_OF_RATE = re.compile(r"RATE|FREQ|SPS|SAMPLES", re.IGNORECASE)
_AFTER_STEP = re.compile(
    rf"{_WHOLE}(?:\s*[(\[]?\s*([A-Za-zµ/]+)\.?\s*[)\]]?(?=[\s,;.]|$)(?!\s*[:=])"
    r"|\s*(?:$|[,;](?!\d)|\s[A-Za-z]\w*\s*[:=]))"
)
_POINTS_AND_STEP = re.compile(rf"\s*{_WHOLE}[\s,]+{_WHOLE}[\s,]+NPTS[\s,]+DT\b", re.IGNORECASE)
_POINTS = re.compile(
    r"(?:\bNPTS|\bNDATA|(?:\bN(?:UMBER|O\.?|_)|#)[ _]?(?:OF[ _])?(?:DATA[ _])?"
    r"(?:DATA|POINTS|SAMPLES)|^\s*(?:DATA[ _])?(?:POINTS|SAMPLES)(?=\s*[:=]))"
    r"\s*(?:[:=]\s*(.*)|\s(\d.*))"
    r"|(?:^|[,:=])\s*(\d\S*)\s+(?:[A-Z]+\.?\s+){0,2}(?:POINTS|PTS|SAMPLES)\b"
    r"(?!\s*(?:/|PER\b|ACROSS\b|(?:IN|ON)\s+(?:A|EACH)\b))",
    re.IGNORECASE,
)
_PEAK = re.compile(
    r"\b(?:PGA|PEAK|MAX)(?:IMUM)?[. ]*(?:GROUND )?(?:ACC[A-Z]*\.?)?\s*"
    rf"(?:[_(\[]\s*([^)\]:=\s]+)[)\]]?)?\s*[:=]?\s*{_WHOLE}(?:\s*([A-Za-z%][\w%/^*]*))?",
    re.IGNORECASE,
)
_UNIT = re.compile(
    r"\bUNITS?\b(?:\s+(?:OF|ARE|IS|IN)\b|\s*[:=]|(?=\s*[(\[]))\s*(.*)", re.IGNORECASE
)
_OF_OTHERS = re.compile(r"(?:OF\s+)?(?:TIME|VEL|DISP)", re.IGNORECASE)
_OF_ACCELERATION = re.compile(r"(?:OF\s+)?ACC[A-Z]*\.?\s*(?:ARE\b|IS\b|[:=])?\s*", re.IGNORECASE)
_PHRASE = re.compile(r"[,;]|\.(?=\s|$)|\s{2,}|\s+[A-Z]\w*\s*[:=]", re.IGNORECASE)  # its end
_OF_ACC = re.compile(
    r"\bACC(?:EL\w*)?\b.*?(?:[(\[]\s*([^()\[\]]+)[)\]]|\bIN\s+(g(?:/10+)?)(?![\w/]))", re.IGNORECASE
)
_SLASHED = re.compile(r"[^\s,;:=()\[\]]*/[^\s,;:=()\[\]]+|\bgals?\b", re.IGNORECASE)  # "cm/s/s"
_NOT_OF_VALUES = re.compile(r"\b(?:PGA|PEAK|MAX|MIN|MEAN|RMS|SENSIT)", re.IGNORECASE)
_SCALE = re.compile(
    r"\b(?:SCAL(?:E|ING)|CONVERSION|CALIBRATION|MULTIPLICATION)[ _-]*FACTOR\s*[:=]?\s*(.*)",
    re.IGNORECASE,
)


_LAYOUTS = {
    "COSMOS (V0, V1, V2)": r"\(Format v\d|Integer-header values follow",
    "GeoNet (V1A, V2A)": r"\A\.V[12]A\b|\bCusp\b|\bGNS\b|transition bands|Accelerometer Axis",
    "the USGS (SMC)": r"\A\.smc\b"
    r"|^\s*\d\s+(?:(?:UN)?CORRECTED|VELOCITY|DISPLACEMENT|RESPONSE|FOURIER|UNKNOWN)[^\n]*\n\*",
    "BHRC (V1, V2, V3)": r"\bBHRC\b|\bVOL[123]DS\b",
    "CSMIP or USC (V1, V2, V3)": r"\bCSMIP\b|corrected accelerogram|Fourier amplitude spectra"
    r"|points? of \w* ?accel\w* data",
    "SAC in numbers": r"-12345(?:\.0*)?\s+-12345",
    "IRIS (SLIST, TSPAIR)": r"^TIMESERIES\b",
    "the CWB": r"^#StationCode|^#AmplitudeUnit",
}
"""Words of files, of which the suffix is the first line, that have more numbers than values."""


def _read_text(path: Path, step: float | None, unit: str) -> tuple[Array, float, bool]:
    """Accelerations, in/s², step, s, and whether their unit is stated, of a text with a header."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    try:
        return _read_rows(path, lines, step, unit)
    except BuildingError as error:
        text = "\n".join([path.suffix, *lines[:HEAD]])
        for name, words in _LAYOUTS.items():
            if re.search(words, text, re.IGNORECASE | re.MULTILINE):
                raise BuildingError(
                    f"{error}; this looks like a file of {name}: save the acceleration alone, one "
                    "value a line, and give its step and unit as FILE:0.01s:cm/s^2"
                ) from error
        raise


def _read_rows(
    path: Path, lines: Sequence[str], step: float | None, unit: str
) -> tuple[Array, float, bool]:
    """As `_read_text`, of lines whose values are one block, along its rows."""
    head, end = _head(lines), len(lines)
    while end > head and not _begins_as_data(lines[end - 1]):  # "*** End data ***"
        end -= 1
    header, body = lines[:head], lines[head:end]
    if "." not in (text := "\n".join(body)) and re.search(r"\d,\d", text):
        raise BuildingError(f"{path} may have decimal commas: write its numbers with points")
    rows: list[list[str]] = []
    for number, line in enumerate(body, head + 1):
        for word in (words := _words(line)):
            if not _VALUE.fullmatch(word):
                glued = ", which run together" if re.fullmatch(r"[\d.eEdD+-]+", word) else ""
                raise BuildingError(
                    f"{path} line {number}: expected numbers, got {word[:40]!r}{glued}"
                )
        rows += [words] if words else []
    if not rows:
        raise BuildingError(f"{path} holds no numbers")
    points, steps = _points(path, header), list(_steps(header))
    if points != sum(map(len, rows)) and (lead := _number_line(path, rows)):
        rows = rows[lead[0] :]
        steps += [("its first numbers", lead[1])] if lead[1] else []
    values = np.array([_float(word) for row in rows for word in row])
    width = len(rows[0]) if len({len(row) for row in rows}) == 1 else 1
    if points is None or points == values.size / width:
        _refuse_columns(path, values, width, points)
    if points is not None and points != values.size:
        raise BuildingError(
            f"{path}: the header says NPTS = {points}, and there are {values.size} values"
        )
    if points is None:
        _refuse_blocks(path, rows)
    _refuse_one_sign(path, values)
    scale, file_unit, phrase = _scale(path, header)
    for other_unit, quote in _units(header):
        a, b = _factor(file_unit), _factor(other_unit)
        if file_unit and a != b and not (a and b and math.isclose(a, b, rel_tol=1e-6)):
            raise BuildingError(
                f"{path}: the header says {phrase!r} and {quote!r}: correct the file"
            )
        file_unit, phrase = (file_unit, phrase) if file_unit else (other_unit, quote)
    text = "\n".join([path.suffix, *header])
    if not file_unit and not unit and (match := _SENSITIVITY.search(text)):
        raise BuildingError(
            f"{path}: the header says {match[0]!r}, and not that the numbers are accelerations: "
            "give the unit as FILE:cm/s^2 (unit='cm/s^2' in Python) if they are"
        )
    of_others = _COUNTS.search(text) or ("acc" not in text.lower() and _OTHER.search(text))
    if not file_unit and of_others:
        raise BuildingError(
            f"{path}: the header says {of_others[0].strip(' ,:=(')!r}, and not that the numbers "
            "are accelerations: correct the file if they are, with 'UNITS OF G' in its header"
        )
    readable = [(quote, seconds) for quote, seconds in steps if seconds is not None]
    if readable and max(s for _, s in readable) > (1.0 + SAME_STEP) * min(s for _, s in readable):
        several = " and ".join(repr(quote) for quote, _ in readable)
        raise BuildingError(f"{path}: {several} are different steps: correct the file")
    step = _agreed_step(path, readable[0][1] if readable else None, step)
    if step is None:
        unread = next((quote for quote, seconds in steps if seconds is None), "")
        reason = f" (it has {unread!r}, which cannot be read)" if unread else ""
        raise BuildingError(
            f"{path} does not say its step (NPTS= …, DT= … SEC){reason}: give it as FILE:0.01s, or "
            "step=0.01 in Python"
        )
    unit_factor = acceleration_factor(unit or "g")
    if phrase:
        unit_factor = _agreed_factor(f"{path}: the header says {phrase!r}", file_unit, unit)
    acceleration = scale * unit_factor * values
    _check_peak(path, header, acceleration)
    return acceleration, step, bool(phrase or unit)


def _refuse_one_sign(path: Path, values: Array) -> None:
    """Refuse values that are never below zero, or never above."""
    if np.any(values) and (np.all(values >= 0.0) or np.all(values <= 0.0)):
        raise BuildingError(
            f"{path}: ground moves to both sides, and all its values are of one sign: expected "
            "accelerations over time, not a spectrum, a table of peaks, or values with an offset"
        )


def _refuse_columns(path: Path, values: Array, width: int, points: int | None) -> None:
    """Refuse rows whose numbers are of different quantities, (T, width).

    The first rises or falls throughout, as a time or a period does; or, in at most four columns, a
    number is closer to the one below it than to the next in its row.
    """
    table = values.reshape(-1, width)
    fewest = 3 if width <= 3 else 6  # rows that show it
    if width == 1 or len(table) < fewest:
        return
    steps, grid = np.diff(table[:, 0]), np.linspace(table[0, 0], table[-1, 0], len(table))
    is_even = np.all(np.abs(table[:, 0] - grid) <= UNEVEN * np.abs(np.mean(steps)))
    if (np.all(steps > 0.0) or np.all(steps < 0.0)) and (is_even or len(table) >= 10):
        is_motion = is_even and steps[0] > 0.0 and np.any(table[:, 1:] < 0.0)
        kind = "time and acceleration" if is_motion else "a spectrum"
    elif (points is not None and points < values.size) or (
        width <= 4 and np.mean(np.diff(table, axis=0) ** 2) < 0.5 * np.mean(np.diff(values) ** 2)
    ):
        kind = f"{width} components"
    else:
        return
    raise BuildingError(
        f"{path} looks like columns of {kind}: save an acceleration over time as .csv, with names "
        "such as time_s,acceleration_g in its first line"
    )


def _refuse_blocks(path: Path, rows: Sequence[Sequence[str]]) -> None:
    """Refuse rows that are not of one layout, where no header says how many values there are."""
    width = len(rows[0])
    uneven = [row for row in rows[:-1] if len(row) != width]
    uneven += [rows[-1]] if len(rows[-1]) > width else []
    integral = [all(re.fullmatch(r"[+-]?\d+", word) for word in row) for row in rows]
    if width >= 3 and not all(integral):
        uneven += [
            row for row, w in zip(rows, integral, strict=True) if w and any(map(_float, row))
        ]
    if uneven:
        raise BuildingError(
            f"{path}: the row {' '.join(uneven[0])[:60]!r} is of another layout than other rows: "
            "leave out all numbers that are no accelerations, or say NPTS= … and DT= … in the "
            "header"
        )


def _check_peak(path: Path, header: Sequence[str], acceleration: Array) -> None:
    """Refuse values whose peak, in/s², is not the one that the header says with a unit."""
    peaks = []
    for line in header:
        for match in _PEAK.finditer(line):
            scale = _factor(match[1] or match[3] or "")
            if scale and not re.search(r"uncor|raw", line, re.IGNORECASE):
                peaks.append((abs(_float(match[2])) * scale, match[0].strip()))
    if not peaks or max(peaks)[0] > SAME_PEAK * min(peaks)[0]:
        return
    stated, quote = peaks[0]
    peak = float(np.max(np.abs(acceleration)))
    if not stated / SAME_PEAK <= peak <= SAME_PEAK * stated:
        raise BuildingError(
            f"{path}: the header says {quote!r}, {stated / GRAVITY:.3g} g, and the peak of the "
            f"values would be {peak / GRAVITY:.3g} g: correct the unit, take an offset off the "
            "values, or correct the file"
        )


def _head(lines: Sequence[str]) -> int:
    """Number of lines of the header: the values begin below what says the step."""
    are_numbers = (bool(w := _words(line)) and _numbers(w) == len(w) for line in lines)
    begin = next((i for i, numbers in enumerate(are_numbers) if numbers), len(lines))
    says = [i for i, line in enumerate(lines[:HEAD]) if any(_steps([line]))]
    step_line = max((i for i in says if i < begin), default=says[0] if says else -1)
    if step_line >= 0:
        data_lines = (i for i in range(step_line + 1, len(lines)) if _begins_as_data(lines[i]))
        begin = next(data_lines, step_line + 1)
    width = len(_words(lines[begin])) if begin < len(lines) else 0
    while begin - 1 > step_line:  # a first row of values, one of which is no number
        words = _words(lines[begin - 1])
        alike = _begins_as_data(lines[begin - 1]) or 2 * _numbers(words) > width
        if not ((len(words) == width and alike) or any(map(_GLUED.fullmatch, words))):
            break
        begin -= 1
    return begin


def _steps(header: Sequence[str]) -> Iterator[tuple[str, float | None]]:
    """Words of each step that a header says, and the step, s; None where it cannot be read."""
    for line in header:
        if match := _POINTS_AND_STEP.match(line):
            yield match[0].strip(), _float(match[2])
            continue
        if match := _STEP_AHEAD.search(line):
            yield match[0].strip(" ,"), _seconds(_float(match[1]), match[2] or match[3])
            continue
        matches = list(_STEP.finditer(line))
        ends = [*(match.start() for match in matches[1:]), len(line)]
        for match, end in zip(matches, ends, strict=False):
            text, unit, step = line[match.end() : end], match[1] or match[2] or "", None
            if value := _AFTER_STEP.match(text):
                word = value[2] or ""
                if not (word and unit and _seconds(1.0, word) != _seconds(1.0, unit)):
                    default = "Hz" if _OF_RATE.search(match[0]) else "s"
                    step = _seconds(_float(value[1]), word or unit or default)
            if step is not None or match[3] in (":", "="):
                yield f"{match[0]}{text}".strip()[:60], step


def _points(path: Path, header: Sequence[str]) -> int | None:
    """Number of values that a header says."""
    for line in header:
        if match := _POINTS_AND_STEP.match(line) or _POINTS.search(line):
            number = re.match(rf"{_WHOLE}(?![A-Za-z])", next(filter(None, match.groups()), ""))
            value = _float(number[1]) if number else math.nan
            if not value.is_integer():
                raise BuildingError(
                    f"{path}: the number of values in {match[0].strip()[:60]!r} cannot be read"
                )
            return int(value)
    return None


def _number_line(path: Path, rows: Sequence[Sequence[str]]) -> tuple[int, float | None] | None:
    """Rows that are a header of numbers, and its step: "40 0.0100 656" above 40 values."""
    total = sum(map(len, rows))
    if rows[0][0].isdigit() and int(rows[0][0]) == total - 1 > 1 and len(rows[0]) == 1:
        return 1, None
    for height in (1, 2):
        lead = [word for row in rows[:height] for word in row]
        if len(lead) < 2 or (height == 2 and [len(row) for row in rows[:2]] != [1, 1]):
            continue
        for points, step in (lead[:2], lead[1::-1]):
            if not re.fullmatch(r"\d+\.?0*", points) or not 1e-5 < _float(step) <= LONGEST_STEP:
                continue
            if float(points) == total - len(lead):
                return height, _float(step)
            values = [word for row in rows[height:] for word in row]
            if (
                points.isdigit()
                and int(points) >= 10
                and 2 * sum(map(str.isdigit, values)) < len(values)
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
    stated, fallback = [], []
    for line in header:
        match = _UNIT.search(line)
        if match and not _OF_OTHERS.match(match[1]):
            text = _OF_ACCELERATION.sub("", match[1], count=1)
            inner = re.match(r"[(\[{<]([^)\]}>]*)[)\]}>](?!\s*[*x/])", text)
            phrases = [inner[1]] if inner else [phrase.strip() for phrase in _PHRASE.split(text)]
            unit = next(
                (phrase for phrase in phrases if not _seconds(1.0, phrase)), ""
            )  # "sec, cm/s/s"
            end = line.index(unit, match.start()) + len(unit) + bool(inner) if unit else len(line)
            stated.append((re.sub(r"\(\d+\)$", "", unit), line[match.start() : end].strip()))
        elif not _NOT_OF_VALUES.search(line):
            words = [word[0].removesuffix(".") for word in _SLASHED.finditer(line)]
            words += [unit for of in _OF_ACC.finditer(line) for unit in of.groups() if unit]
            fallback += [(unit, line.strip()[:60]) for unit in words if _factor(unit)]
    return stated or fallback


def _scale(path: Path, header: Sequence[str]) -> tuple[float, str, str]:
    """Factor of the values, with its unit and words: "Scale Factor 3920(gal)/6182761" of K-NET."""
    for match in filter(None, map(_SCALE.search, header)):
        quote, text = match[0].strip(), match[1].strip()
        fraction = re.fullmatch(rf"({_NUMBER})\s*\(([^)]+)\)\s*/\s*({_NUMBER})", text)
        if fraction and _factor(fraction[2]) and _float(fraction[3]) != 0.0:
            return _float(fraction[1]) / _float(fraction[3]), fraction[2], quote
        if not (re.fullmatch(_NUMBER, text) and _float(text) == 1.0):
            raise BuildingError(
                f"{path}: the header says {quote!r}, which cannot be read: expected such as 'Scale "
                "Factor 3920(gal)/6182761'; multiply the values by it, and remove this line"
            )
    return 1.0, "", ""


def _float(word: str) -> float:
    """A number, whose exponent may be one of Fortran, "1.0D-02"."""
    return float(word.upper().replace("D", "E"))


def _words(line: str) -> list[str]:
    return line.replace(",", " ").replace(";", " ").split()


def _numbers(words: Sequence[str]) -> int:
    return sum(_VALUE.fullmatch(word) is not None for word in words)


def _begins_as_data(line: str) -> bool:
    words = _words(line)
    return bool(words) and bool(_VALUE.fullmatch(words[0]) or _GLUED.match(words[0]))


def example_ground() -> str:
    """An artificial ground motion in PEER's layout, for trying out.

    White noise through the soil's filter of Kanai and Tajimi, ω = 2π 2.5 Hz and ζ = 0.6, under an
    envelope; 20 s with a peak of 0.35 g. No earthquake looks quite like it.
    """
    return files("mfd_bayes.applications.buildings").joinpath("example.AT2").read_text("utf-8")
