"""Constant actuations, called levels, in the names and header lines of test files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from mfd_bayes.records.channels import step_of
from mfd_bayes.records.file_name_check import NUMBER, number_in
from mfd_bayes.units import ActuationUnit, parse_actuation

_UNITS = r"psi|ksi|kpa|mpa|bar|kn|n|lbf|lbs|lb|kips|kip"
_DRIVES = r"ma|amps?|a|mv|volts?|v|turns?|clicks?|nm"
_SPELLED = {"kpa": "kPa", "mpa": "MPa", "kn": "kN", "n": "N", "lb": "lbf", "lbs": "lbf"}
_SPELLED |= {"kips": "kip", "nm": "N*m", "mv": "mV", "ma": "mA", "a": "A", "v": "V"}
_SPELLED |= {"amp": "A", "amps": "A", "volt": "V", "volts": "V"}
_WITH_UNIT = re.compile(rf"{NUMBER}[ _-]?({_UNITS})(?![a-z])", re.IGNORECASE)
# what follows a number may not make another of it, or be its unit
_ENDS = r"(?![\d.]*[a-z]|,\d{3}(?!\d)|,\d{1,2}(?![\d.a-z]))"
_PRESSURE = re.compile(rf"(?<![a-z])(?:p|press|pressure)[ _=-]?{NUMBER}{_ENDS}", re.I)
_TENSION = re.compile(rf"(?<![a-z])(?:tension|preload)[ _=-]?{NUMBER}{_ENDS}", re.I)
_SAID = re.compile(
    rf"(?:pressure|tension|preload|actuation|clamping|current|voltage|torque)[^\d\n]{{0,30}}?"
    rf"{NUMBER}\s*({_UNITS}|{_DRIVES})(?![a-z])",
    re.IGNORECASE,
)
_DRIVEN = re.compile(rf"(?<![A-Za-z]){NUMBER}[ _-]?({_DRIVES})(?![a-z])", re.IGNORECASE)

_PRESSURE_UNIT = re.compile(rf"{NUMBER}\s*(psi|ksi|kpa|mpa|bar)(?![a-z])", re.IGNORECASE)


@dataclass(frozen=True)
class Level:
    """A constant actuation: its text, such as "500 psi", and its value in the internal unit."""

    text: str
    value: float
    unit: ActuationUnit
    doubt: str = ""
    """What was assumed, or ""."""


def levels_in(name: str) -> tuple[Level, ...]:
    """Levels in a file's name: ``1000psi``, ``0.5kN``, ``35lb``; ``p500`` is assumed to be psi."""
    found = [_level(m[1], m[2]) for m in _WITH_UNIT.finditer(name)]
    if found:
        return tuple(dict.fromkeys(found))
    pressures, tensions = _PRESSURE.findall(name), _TENSION.findall(name)
    assumed = [_level(number, "psi", "psi is assumed; it may be kPa") for number in pressures]
    assumed += [_level(number, "lbf", "lbf is assumed; it may be N") for number in tensions]
    if not assumed:
        assumed = [_drive(m) for m in _DRIVEN.finditer(name)]
    return tuple(dict.fromkeys(assumed))


def level_in_header(lines: Sequence[str], names: Sequence[str]) -> Level | None:
    """Level in the lines above the numbers or in a column's name, as ``Pressure: 500 psi``.

    A pressure without that word, as ``Brake at 500 psi``, gets a doubt.
    """
    lines = [*names, *(line for line in lines if re.search(r"[A-Za-z]{3}", line))]
    for pattern, doubt in ((_SAID, ""), (_PRESSURE_UNIT, "it is a pressure in the header lines")):
        for line in lines:
            match = pattern.search(line)
            if match:
                return _level(match[1], match[2], doubt)
    return None


_COUNT = r"([+-]?(?:\d+\.?\d*|\.\d+|\d+,\d+)(?:[eE][+-]?\d+)?)(?![\d.,]*\d)"
_HZ = r"(k?hz|s/s|sa/s|sps|1/s|samples?\s*(?:/|per)\s*s(?:ec(?:ond)?)?)(?![a-z])"
_SECONDS = r"(s|ms|us|µs|μs|sec|msec|seconds?|milliseconds?)(?![a-z])"
_BETWEEN = r"[\s\"'=:;,._]*"
_RATES = (
    r"(?:sampl\w*|scan\w*|acqui\w*|logg\w*|daq|abtast\w*|mess|サンプリング)[\s_-]*"
    r"(?:rate|freq\w*|周波数)|abtastrate|messrate|(?<![a-z_])fs(?![a-z])|^\W*rate|data[\s_-]*rate|"
    r"sampled at"
)
_STEPS = (
    r"(?:sampl\w*|scan\w*|log\w*|record\w*|time|abtast\w*|サンプリング)[\s_-]*"
    r"(?:interval\w*|period\w*|step|increment|間隔|周期)|abtastintervall|"
    r"(?<![a-z_])(?:dt|delta[_ ]?[xt])(?![a-z])|^\W*interval"
)
_STATED = tuple(
    (
        re.compile(
            rf"(?:{words}){_BETWEEN}(?:[\[(]?\s*{units}\s*[\])]?)?{_BETWEEN}{_COUNT}"
            rf"{_BETWEEN}(?:[\[(]?\s*{units})?",
            re.IGNORECASE,
        ),
        unit,
    )
    for words, units, unit in ((_RATES, _HZ, "Hz"), (_STEPS, _SECONDS, "s"))
)


def rate_in_header(lines: Sequence[str]) -> tuple[str, str]:
    """Rate, or step, of the samples in the lines above the numbers, and what is assumed of it.

    ``"100 Hz"`` of ``Sample rate: 100 Hz``; empty where the lines state none, or several.
    """
    found: dict[float, tuple[str, str]] = {}
    for line in lines:
        for pattern, usual in _STATED:
            for match in pattern.finditer(line):
                text, doubt = _rate(match, usual)
                if text:
                    found[step_of(text, "rate")] = text, doubt
    return next(iter(found.values())) if len(found) == 1 else ("", "")


def _rate(match: re.Match[str], usual: str) -> tuple[str, str]:
    """Quantity of a rate or a step; empty where its number cannot be read for sure."""
    number, unit = match[2].replace(",", "."), (match[1] or match[3] or "").lower()
    if re.fullmatch(r"[1-9]\d{0,2},\d{3}", match[2]) or not float(number) > 0.0:
        return "", ""
    unit = re.sub(r"^(?:s/s|sa/s|sps|1/s|samples?.*)$", "Hz", unit).replace("hz", "Hz")
    unit = unit.replace("μ", "µ")
    return f"{number} {unit or usual}", "" if unit else f"{usual} is assumed for its rate or step"


def _drive(match: re.Match[str]) -> Level:
    """Current, voltage or setting in a name; a single letter may be a label as well."""
    label = len(match[2]) == 1 and match[1].isdigit()
    doubt = f"{match[0]} is taken for {_SPELLED[match[2].lower()]}" if label else ""
    return _level(match[1], match[2], doubt)


def _level(number: str, unit: str, doubt: str = "") -> Level:
    text = f"{number_in(number):g} {_SPELLED.get(unit.lower(), unit.lower())}"
    value, internal = parse_actuation(text)
    return Level(text, value, internal, doubt)
