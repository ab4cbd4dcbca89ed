"""The actuation of a test file, and its rate: from its columns, its header lines or its name."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mfd_bayes.campaign.draft.columns import Guess, numbers_of, unit_of
from mfd_bayes.errors import RecordError
from mfd_bayes.records.channels import step_of
from mfd_bayes.records.file_name_check import NUMBER, number_in
from mfd_bayes.records.readers import Table
from mfd_bayes.units import ActuationUnit, actuation_factor, actuation_kind, parse_actuation

CONSTANT = 0.02
"""An actuation is constant when its standard deviation is below this share of its mean."""

IDLE = "no actuation: only laws with an intercept learn from it, affine and residual_power"
"""Doubt about a test at zero actuation."""

_UNITS = r"psi|ksi|kpa|mpa|bar|kn|n|lbf|lbs|lb|kips|kip"
_DRIVES = r"ma|amps?|a|mv|volts?|v|turns?|clicks?|nm"
_SPELLED = {"kpa": "kPa", "mpa": "MPa", "kn": "kN", "n": "N", "lb": "lbf", "lbs": "lbf"}
_SPELLED |= {"kips": "kip", "nm": "N*m", "mv": "mV", "ma": "mA", "a": "A", "v": "V"}
_SPELLED |= {"amp": "A", "amps": "A", "volt": "V", "volts": "V"}
_WITH_UNIT = re.compile(rf"{NUMBER}[ _-]?({_UNITS})(?![a-z])", re.IGNORECASE)
_DRIVEN = re.compile(rf"(?<![A-Za-z]){NUMBER}[ _-]?({_DRIVES})(?![a-z])", re.IGNORECASE)
# what follows a number may not make another of it, or be its unit
_ENDS = r"(?![\d.]*[a-z]|,\d{3}(?!\d)|,\d{1,2}(?![\d.,a-z]))"
_PRESSURE = re.compile(rf"(?<![a-z])(?:p|press|pressure)[ _=-]?{NUMBER}{_ENDS}", re.I)
_TENSION = re.compile(rf"(?<![a-z])(?:tension|preload)[ _=-]?{NUMBER}{_ENDS}", re.I)
_CALLED = re.compile(
    rf"(?:pressure|tension|preload|actuation|clamping|current|voltage|torque)[^\d\n]{{0,30}}?"
    rf"{NUMBER}\s*({_UNITS}|{_DRIVES})(?![a-z])",
    re.IGNORECASE,
)
_PRESSURE_UNIT = re.compile(rf"{NUMBER}\s*(psi|ksi|kpa|mpa|bar)(?![a-z])", re.IGNORECASE)

_COUNT = r"([+-]?(?:\d+\.?\d*|\.\d+|\d+,\d+)(?:[eE][+-]?\d+)?)(?![\d.,]*\d)"
_HZ = r"(k?hz|s/s|sa/s|sps|1/s|samples?\s*(?:/|per)\s*s(?:ec(?:ond)?)?)(?![a-z])"
_SECONDS = r"(s|ms|us|µs|μs|sec|msec|seconds?|milliseconds?)(?![a-z])"
_BETWEEN = r"[\s\"'=:;,._]*"
_RATE_WORDS = (
    r"(?:sampl\w*|scan\w*|acqui\w*|logg\w*|daq|abtast\w*|mess|サンプリング)[\s_-]*"
    r"(?:rate|freq\w*|周波数)|abtastrate|messrate|(?<![a-z_])fs(?![a-z])|^\W*rate|data[\s_-]*rate|"
    r"sampled at"
)
_STEP_WORDS = (
    r"(?:sampl\w*|scan\w*|log\w*|record\w*|time|abtast\w*|サンプリング)[\s_-]*"
    r"(?:interval\w*|period\w*|step|increment|間隔|周期)|abtastintervall|"
    r"(?<![a-z_])(?:dt|delta[_ ]?[xt])(?![a-z])|^\W*interval"
)
_RATES = tuple(
    (
        re.compile(
            rf"(?:{words}){_BETWEEN}(?:[\[(]?\s*{units}\s*[\])]?)?{_BETWEEN}{_COUNT}"
            rf"{_BETWEEN}(?:[\[(]?\s*{units})?",
            re.IGNORECASE,
        ),
        unit,
    )
    for words, units, unit in ((_RATE_WORDS, _HZ, "Hz"), (_STEP_WORDS, _SECONDS, "s"))
)


@dataclass(frozen=True)
class Level:
    """A constant actuation: its text, such as "500 psi", and its value in the internal unit."""

    text: str
    value: float
    unit: ActuationUnit
    doubt: str = ""
    """What was assumed, or ""."""


def _level(number: str, unit: str, doubt: str = "") -> Level:
    text = f"{number_in(number):g} {_SPELLED.get(unit.lower(), unit.lower())}"
    return Level(text, *parse_actuation(text), doubt)


def levels_in(name: str) -> tuple[Level, ...]:
    """Levels in a file's name: ``1000psi``, ``0.5kN``, ``35lb``; ``p500`` is assumed to be psi."""
    levels = [_level(m[1], m[2]) for m in _WITH_UNIT.finditer(name)]
    if not levels:
        levels = [
            _level(n, "psi", "psi is assumed; it may be kPa") for n in _PRESSURE.findall(name)
        ]
        levels += [_level(n, "lbf", "lbf is assumed; it may be N") for n in _TENSION.findall(name)]
    if not levels:
        for match in _DRIVEN.finditer(name):  # a single letter may be a label as well
            is_label = len(match[2]) == 1 and match[1].isdigit()
            doubt = f"{match[0]} is taken for {_SPELLED[match[2].lower()]}" if is_label else ""
            levels.append(_level(match[1], match[2], doubt))
    return tuple(dict.fromkeys(levels))


def level_in_header(lines: Sequence[str], names: Sequence[str]) -> Level | None:
    """Level in the lines above the numbers or in a column's name, as ``Pressure: 500 psi``.

    A pressure without that word, as ``Brake at 500 psi``, gets a doubt.
    """
    lines = [*names, *(line for line in lines if re.search(r"[A-Za-z]{3}", line))]
    for pattern, doubt in ((_CALLED, ""), (_PRESSURE_UNIT, "it is a pressure in the header lines")):
        for line in lines:
            if match := pattern.search(line):
                return _level(match[1], match[2], doubt)
    return None


def rate_in_header(lines: Sequence[str]) -> tuple[str, str]:
    """Rate, or step, of the samples in the lines above the numbers, and what is assumed of it.

    ``"100 Hz"`` of ``Sample rate: 100 Hz``; empty where the lines state none, or several.
    """
    rates: dict[float, tuple[str, str]] = {}
    for line in lines:
        for pattern, usual in _RATES:
            for match in pattern.finditer(line):
                number, unit = match[2].replace(",", "."), (match[1] or match[3] or "").lower()
                if re.fullmatch(r"[1-9]\d{0,2},\d{3}", match[2]) or not float(number) > 0.0:
                    continue  # it is not known which number it is
                unit = re.sub(r"^(?:s/s|sa/s|sps|1/s|samples?.*)$", "Hz", unit)
                unit = unit.replace("hz", "Hz").replace("μ", "µ")
                text = f"{number} {unit or usual}"
                doubt = "" if unit else f"{usual} is assumed for its rate or step"
                rates[step_of(text, "rate")] = text, doubt
    return next(iter(rates.values())) if len(rates) == 1 else ("", "")


@dataclass(frozen=True, eq=False)
class TestFile:
    """A file with time, displacement and force, and everything that may be its actuation.

    Attributes
    ----------
    columns : dict of str to Guess
        Role to column, without the actuation.
    column : Guess or None
        The column that may hold the actuation.
    header : Level or None
        Level in the header lines.
    named : tuple of Level
        Levels in the file's name.
    """

    __test__ = False

    path: Path
    table: Table
    columns: dict[str, Guess]
    column: Guess | None
    header: Level | None
    named: tuple[Level, ...]

    @property
    def levels(self) -> list[Level]:
        """Every level in the header or the name, the certain ones first."""
        stated = [level for level in (self.header, *self.named) if level is not None]
        return sorted(stated, key=lambda level: bool(level.doubt))


def without_shared_levels(files: list[TestFile]) -> list[TestFile]:
    """Files without the levels that stand in every name, where a name has others as well."""
    if len(files) < 2:
        return files
    shared = set.intersection(*({level.text for level in file.named} for file in files))
    return [
        replace(file, named=tuple(v for v in file.named if v.text not in shared) or file.named)
        for file in files
    ]


def prevailing_unit(files: Sequence[TestFile]) -> ActuationUnit | None:
    """Unit of most files, on a tie "ksi" (pressures) or "kip" (tensions); None if unknown."""
    count: Counter[ActuationUnit] = Counter()
    for file in files:
        certain = [level for level in file.levels if not level.doubt]
        units = {level.unit for level in certain or file.levels}
        if file.column is not None and file.column.unit is not None:
            units.add(actuation_factor(file.column.unit)[1])
        count.update(units)
    return max(count, key=lambda unit: (count[unit], unit == "ksi", unit == "kip"), default=None)


def actuation_of(
    file: TestFile, unit: ActuationUnit | None
) -> tuple[str | Guess | None, str, tuple[str, ...]]:
    """Actuation, where it stands, and what is not certain about it.

    A measured actuation counts before the header, the header before the name; None where none has
    it.

    Raises
    ------
    RecordError
        When the actuation is a pressure where most files have tensions or the reverse.
    """
    stated = file.levels
    levels = [level for level in stated if level.unit == unit]
    measured, mean, doubts = _measured(file, unit)
    if measured is not None:
        others = [v.text for v in levels if abs(mean - v.value) > 0.1 * v.value]
        if others:
            shown = measured if isinstance(measured, str) else "a history"
            doubts += (f"{_or(others)} in the name or header, {shown} in the column",)
        return measured, f"of column {file.column.name if file.column else ''!r}", doubts
    if levels:
        level = levels[0]
        others = [other.text for other in stated if other.text != level.text]
        doubts += (level.doubt,) if level.doubt else ()
        doubts += (f"it could also be {_or(others)}",) if others else ()
        doubts += (IDLE,) if level.value == 0.0 else ()
        place = "in the header" if level == file.header else "in the file's name"
        return level.text, place, doubts
    if stated:
        raise RecordError(
            f"its actuation of {stated[0].text} is {actuation_kind(stated[0].unit)}, and those of "
            "most files are not"
        )
    used = {guess.name for guess in file.columns.values()}
    names = [n for n in file.table.names if n not in used and unit_of(file.table, n, "actuation")]
    hint = f"; columns that might: {', '.join(map(repr, names[:4]))}" if names else ""
    return None, hint, doubts


def _measured(
    file: TestFile, unit: ActuationUnit | None
) -> tuple[str | Guess | None, float, tuple[str, ...]]:
    """Level or history in the column of the actuation, its mean, and doubts; None without use."""
    column = file.column
    if column is None:
        return None, 0.0, ()
    unusable = f"column {column.name!r} holds no actuation that can be used"
    if column.unit is None:
        no_unit = f"column {column.name!r} has no unit: name it, if it is the actuation"
        return None, 0.0, (f"{unusable}: {column.lacking}" if column.lacking else no_unit,)
    values = numbers_of(file.table, column.name)
    scale, internal = actuation_factor(column.unit)
    if values is None or internal != unit or not np.mean(values) > 0:
        return None, 0.0, (unusable,)
    mean = float(np.mean(values))
    if np.std(values) <= CONSTANT * mean:
        return f"{mean:.4g} {column.unit}", scale * mean, column.doubts
    return replace(column, doubts=()), scale * mean, column.doubts


def _or(texts: Sequence[str]) -> str:
    return " or ".join(dict.fromkeys(texts))
