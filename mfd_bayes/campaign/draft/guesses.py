"""What the columns of a test file are, its rate and its actuation: by names, units and numbers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path
from typing import Any
from unicodedata import normalize

import numpy as np

from mfd_bayes.errors import MfdError, RecordError, UnitError
from mfd_bayes.records.channels import Source, stated_unit, step_of
from mfd_bayes.records.data_quality import NUMBER, SLOW_PERIOD, SLOW_RATE, number_in
from mfd_bayes.records.loops import follows, roughness
from mfd_bayes.records.readers import Table
from mfd_bayes.records.readers.table import own_name
from mfd_bayes.records.trace import Array, check_magnitude, cycle_turns
from mfd_bayes.units import (
    ActuationUnit,
    actuation_factor,
    actuation_kind,
    factor,
    force_meant,
    parse_actuation,
)

_WORDS: Mapping[str, Mapping[str, int]] = {
    "time": {"time": 4, "timestamp": 3, "elapsed": 3, "t": 3, "zeit": 4, "seconds": 2, "sec": 2},
    "displacement": {
        **dict.fromkeys(("displacement", "disp", "displ", "lvdt", "stroke", "weg"), 4),
        **dict.fromkeys(("deflection", "travel", "extension", "displacment"), 3),
        **dict.fromkeys(("position", "pos", "x", "d", "motion"), 2),
    },
    "force": {
        **dict.fromkeys(("force", "load", "loadcell", "kraft"), 4),
        **dict.fromkeys(("f", "reaction", "resistance", "cell"), 2),
    },
    "velocity": {**dict.fromkeys(("velocity", "vel", "speed"), 4), "v": 2},
    "actuation": {
        **dict.fromkeys(("pressure", "actuation", "tension", "preload", "druck"), 6),
        **dict.fromkeys(("press", "clamping", "clamp", "psi", "kpa", "mpa", "bar"), 5),
        **dict.fromkeys(("current", "amperage", "voltage", "torque", "strom"), 3),
    },
}
"""Score of a word in a column's name for each role."""

_UNIT_ALONE = 1.0  # score of a unit for a role where no word has a score
_NOT_MEASURED = re.compile(r"command|cmd|setpoint|target|ref|reference|desired|error|nominal")
_COUNTER = re.compile(
    r"#|n|i|k|no|nr|num|number|id|idx|index|seq|sequence|counts?|counter|scans?|samples?|rec|record"
    r"|pts?|points?|datapoint|row|line|lfd|frame|reading|step|ticks?|block|set|obs|observation"
)
"""Words in the name of a column that counts samples."""

FAST_CYCLE, SLOWEST_STEP = 100.0, 10.0
"""Without a unit, times with longer cycles may be ms; with such steps too, in s, they are ms."""

_EARLIEST = 20_000.0
_DATES = {
    "day": (_EARLIEST, 800_000.0),
    **{unit: (5e8 * by, 6e9 * by) for unit, by in (("s", 1.0), ("ms", 1e3), ("us", 1e6))},
}
"""Ranges of dates of these decades: days of Excel and of MATLAB, seconds since 1970 and 1904."""

_IN_BRACKETS = re.compile(r"[\[(<{]\s*([^\])>}]+?)\s*[\])>}]\s*$")
_AT_THE_END = (
    _IN_BRACKETS,
    re.compile(r"_((?:[^_\s]+_per_)?[^_\s]+)$"),
    re.compile(r"[\s,/:]+([^\s,:]+)\s*$"),
)
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_METRIC = re.compile(r"\b(?:N|kN|MN|mm|cm|m|kPa|MPa|bar)\b")

SURE = 0.3  # correlation of a force with the direction of a motion from which two make a loop
_MOST_PAIRED = 8  # signals of which all pairs are compared

NO_TIME = 'the file has none, and states no rate: write time = { rate = "100 Hz" } with its own'


@dataclass(frozen=True)
class Guess:
    """A column guessed for a role."""

    name: str  # "" where a rate stands in place of a column of times
    unit: str | None  # None where it is unknown
    doubts: tuple[str, ...] = ()  # what is not certain, with the alternatives
    number: int | None = None  # of a column that has no name of its own, from 1
    lacking: str = ""  # why its unit is unknown, and what may be written
    sign: int = 1
    rate: str = ""  # the rate, or the step, that the file states

    @property
    def source(self) -> Source:
        """The column as it is read; one of an unknown rate is read somehow."""
        if not self.name:
            return Source(rate=self.rate or "1 Hz")
        return Source(self.name, self.unit, sign=self.sign)


def guess_columns(table: Table) -> dict[str, Guess]:
    """Role to column, guessed from names and units, or else from numbers.

    Only time, displacement and force are guessed from numbers. Where no unit of time is given, its
    steps decide between s and ms.
    """
    guesses: dict[str, Guess] = {}
    for role in ("actuation", "time", "displacement", "force", "velocity"):
        guess = _by_name(table, role, [guess.name for guess in guesses.values()])
        if guess is not None:
            guesses[role] = guess
    missing = [role for role in ("time", "displacement", "force") if role not in guesses]
    if missing:
        guesses |= _by_numbers(table, missing, [guess.name for guess in guesses.values()])
    guesses = {role: _with_unit(table, role, guess, guesses) for role, guess in guesses.items()}
    if "velocity" in guesses and not _is_slope(table, guesses):
        del guesses["velocity"]
    for role, guess in guesses.items():
        if guess.name and own_name(guess.name) != guess.name:  # no name of its own
            guesses[role] = replace(guess, number=table.number_of(guess.name))
    return guesses


def timed_by_rate(guesses: dict[str, Guess], rate: str, doubt: str) -> dict[str, Guess]:
    """Guesses with the rate that a file states, where no column is a time.

    Where it states none, the time is left open, if displacement and force have their names.
    """
    time = guesses.get("time")
    if time is None and not {"displacement", "force"} <= guesses.keys():
        return guesses
    if time is None or (rate and time.lacking):
        doubts = (doubt,) if doubt else ()
        guess = Guess("", "s", doubts, rate=rate) if rate else Guess("", None, lacking=NO_TIME)
        return guesses | {"time": guess}
    return guesses


def unit_of(table: Table, name: str, role: str) -> str | None:
    """Unit of a column for a role, from its name or the file's row of units; None if unknown."""
    own = normalize("NFKC", own_name(name))
    texts = [match[1] for pattern in _AT_THE_END if (match := pattern.search(own))]
    for text in (*texts, table.units.get(name, ""), own.strip()):
        for unit in (text.replace("_per_", "/"), text.lower().replace("_per_", "/")):
            if _fits(unit, role):
                return unit
    return None


def _fits(unit: str, role: str) -> bool:
    """Whether a unit is one of a role, or of the dimension "pressure"."""
    try:
        if role == "actuation":
            return actuation_factor(unit)[1] != "%" or unit == "%"
        factor(unit, role)
    except UnitError:
        return False
    return True


def numbers_of(table: Table, name: str, *, is_time: bool = False) -> Array | None:
    """Numbers of a column, (T,), or None where it holds anything else.

    A time may be as large as a date in ns.
    """
    try:
        numbers = table.columns([name])[name]
        if not is_time:
            check_magnitude(name, numbers)
    except MfdError:
        return None
    return numbers


def _by_name(table: Table, role: str, taken: Sequence[str]) -> Guess | None:
    """Column whose name and unit have the highest score for a role."""
    scores = {
        name: score
        for name in table.names
        if name not in taken and table.names.count(name) == 1
        if (score := _score(table, name, role)) > 0
    }
    if not scores:
        return None
    best = max(scores, key=lambda name: scores[name])
    fewest = max(scores[best] - 1, min(scores[best], 2))
    rivals = [name for name, score in scores.items() if name != best and score >= fewest]
    doubts: list[str] = []
    if scores[best] == _UNIT_ALONE:
        doubts.append(f"column for {role} chosen by its unit alone")
    if rivals:
        doubts.append(f"column for {role} could also be {_listed(rivals)}")
    return Guess(best, unit_of(table, best, role), tuple(doubts))


def _score(table: Table, name: str, role: str) -> float:
    """Score of a column's name and unit for a role; 0 where it cannot have the role."""
    text = normalize("NFKC", own_name(name))
    words = re.findall(r"[a-z]+", _CAMEL.sub(" ", _IN_BRACKETS.sub("", text)).lower())
    own = max((_WORDS[role].get(word, 0) for word in words), default=0)
    others = (scores for other, scores in _WORDS.items() if other != role)
    other = max((scores.get(word, 0) for scores in others for word in words), default=0)
    if own and any(map(_NOT_MEASURED.fullmatch, words)):
        own = 1
    unit = unit_of(table, name, role)
    if not own:
        # of actuations, a unit alone can tell only a pressure: load cells are many
        tells = unit is not None and (role != "actuation" or _fits(unit, "pressure"))
        return _UNIT_ALONE if tells and not other else 0.0
    if unit is None:
        match = _IN_BRACKETS.search(text)
        stated = match[1] if match else table.units.get(name, "")
        dimensions = ("time", "displacement", "force", "velocity", "pressure")
        if stated and any(_fits(stated, dimension) for dimension in dimensions):
            return 0.0  # the unit is that of another role
    return own + (unit is not None) if own >= other else 0.0


def _by_numbers(table: Table, missing: Sequence[str], taken: Sequence[str]) -> dict[str, Guess]:
    """Time: the column that increases steadily; then the pair that looks most like a loop."""
    signals: dict[str, Array] = {}
    steady: dict[str, bool] = {}  # to whether it is a counter
    for name in table.names:
        if name in taken or table.names.count(name) > 1:
            continue
        values = numbers_of(table, name, is_time=True)
        if values is None or values.size < 3:
            continue
        steps = np.diff(values)
        if np.all(steps > 0) and steps.max() < 20 * np.median(steps):
            steady[name] = bool(np.ptp(steps) == 0.0)
        elif np.ptp(values) > 0 and numbers_of(table, name) is not None:
            signals[name] = values
    guesses: dict[str, Guess] = {}
    if "time" in missing and steady:
        guesses["time"] = _guessed("time", sorted(steady, key=lambda name: steady[name]))
    names = sorted(signals, key=lambda name: roughness(signals[name]))
    if {"displacement", "force"} <= set(missing):
        names = by_loop({name: signals[name] for name in names})
    for role in ("displacement", "force"):
        if role in missing and names:
            guesses[role] = _guessed(role, names)
            names = names[1:]
    return guesses


def by_loop(signals: Mapping[str, Array]) -> list[str]:
    """Names of signals, the displacement first, then the force, then the others in their order.

    A friction force follows the direction of the motion, and is rougher than the motion: that the
    motion follows the direction of the force is seldom. Where no two signals follow each other,
    the order stays as given.
    """
    names = list(signals)
    pairs = {
        (x, f): follows(signals[x], signals[f]) for x, f in permutations(names[:_MOST_PAIRED], 2)
    }
    best = max(pairs, key=lambda pair: pairs[pair], default=None)
    if best is None or pairs[best] < SURE:
        return names
    motion, force = best
    rougher = np.log10(roughness(signals[force]) / roughness(signals[motion]))
    if pairs[motion, force] - pairs[force, motion] + rougher < 0.0:
        motion, force = force, motion
    return [motion, force, *(name for name in names if name not in best)]


def _guessed(role: str, names: list[str]) -> Guess:
    others = f"; it could also be {_listed(names[1:])}" if names[1:] else ""
    return Guess(names[0], None, (f"column for {role} guessed from the numbers{others}",))


def _with_unit(table: Table, role: str, guess: Guess, guesses: Mapping[str, Guess]) -> Guess:
    """Guess with a unit where its name, the other columns or the steps of time tell it."""
    unit = guess.unit or unit_of(table, guess.name, role)
    stated = stated_unit(own_name(guess.name), table.units.get(guess.name, ""))
    lacking = (
        f"{stated!r}, as the file says, is no known unit of {role}{force_meant(stated)}"
        if stated
        else ""
    )
    if role == "time":
        if problem := _equal_stamps(table, guess.name):
            return Guess("", None, lacking=problem)
        if unit is not None or lacking:
            return replace(guess, unit=unit, lacking="" if unit else lacking)
        return replace(guess, **_unit_of_time(table, guess, guesses.get("displacement")))
    if unit is not None:
        return replace(guess, unit=unit)
    if lacking:
        return replace(guess, unit=None, lacking=lacking)
    others = [
        other
        for r in ("displacement", "force", "velocity")
        if r in guesses and (other := unit_of(table, guesses[r].name, r)) is not None
    ]
    if role == "actuation" or not others:
        return guess
    units = {"displacement": ("in", "mm"), "force": ("kip", "kN"), "velocity": ("in/s", "mm/s")}
    unit, other = units[role]
    if _METRIC.search(" ".join(others)):
        unit, other = other, unit
    doubt = f"no unit of {role} is given; {unit} matches the other columns, {other} does not"
    return replace(guess, unit=unit, doubts=(*guess.doubts, doubt))


def _equal_stamps(table: Table, name: str) -> str:
    """What to write in place of time stamps that are equal in several rows; empty of others."""
    stamps = numbers_of(table, name, is_time=True) if name in table.stamped else None
    if stamps is None or np.all(np.diff(stamps) != 0.0) or not stamps[-1] > stamps[0]:
        return ""
    new = np.flatnonzero(np.diff(stamps) > 0.0)
    first, last = (new[0], new[-1]) if new.size > 1 else (0, stamps.size - 1)
    rate = (last - first) / (stamps[last] - stamps[first])
    return (
        f"time stamps of {name!r} are equal in several rows, about {rate:.3g} in a second: write "
        'the rate in place of the column, time = { rate = "100 Hz" }'
    )


def _unit_of_time(table: Table, guess: Guess, displacement: Guess | None) -> dict[str, Any]:
    """Unit of a time by its numbers, with a doubt; or what it lacks: a count, a date, s or ms."""
    values = numbers_of(table, guess.name, is_time=True)
    if values is None or values.size < 3 or values[-1] <= values[0]:
        return {}
    given, since = "no unit of time is given; ", float(values[0])
    if since >= _EARLIEST and np.ptp(values) < 0.05 * since:
        for unit, (low, high) in _DATES.items():
            if low < since < high:
                return {
                    "unit": unit,
                    "doubts": (f"{given}it looks like a date, counted in {unit}",),
                }
        return {"lacking": "it begins at a number too large for a time: what does it count?"}
    name, steps = own_name(guess.name), np.diff(values)
    words = re.findall(r"[^\W\d_]+|#", _CAMEL.sub(" ", name).lower())
    is_whole = bool(np.all(values == np.round(values)))
    if is_whole and (any(map(_COUNTER.fullmatch, words)) or np.all(steps == 1.0)):
        return {
            "lacking": f"{name or 'this column'!r} counts samples and is no time: at which rate? "
            'Write it in place of the column, time = { rate = "100 Hz" }'
        }
    motion = None if displacement is None else numbers_of(table, displacement.name)
    cycle = 0.0  # time of a cycle, in the unit of the time
    if motion is not None and motion.size == values.size:
        cycle = float(np.ptp(values)) / max(cycle_turns(motion).size / 2, 1.0)
    step = float(np.median(steps))
    is_slow = step * SLOW_RATE >= 1.0
    if step < SLOWEST_STEP and FAST_CYCLE < cycle < SLOW_PERIOD and is_slow:
        return {
            "lacking": f"its steps may be s or ms: one gives a cycle of {cycle:.3g} s, the other "
            f"of {cycle / 1000:.3g} s"
        }
    if cycle / 1000 > SLOW_PERIOD and step >= 1000 * SLOWEST_STEP:
        return {"lacking": "its steps are neither those of s nor of ms"}
    unit = "ms" if cycle > FAST_CYCLE and is_slow else "s"
    return {"unit": unit, "doubts": (*guess.doubts, f"{given}the steps look like {unit}")}


def _is_slope(table: Table, guesses: Mapping[str, Guess]) -> bool:
    """Whether the velocity has a unit and is the slope of the displacement."""
    roles = ("time", "displacement", "velocity")
    if guesses["velocity"].unit is None or not all(role in guesses for role in roles):
        return False
    names = [guesses[role].name for role in roles]
    try:
        columns = table.columns(names)
    except MfdError:
        return False
    time, displacement, velocity = (columns[name] for name in names)
    with np.errstate(all="ignore"):
        slope = np.gradient(displacement, time)
        return bool(np.corrcoef(slope, velocity)[0, 1] > 0.9)


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(repr(name) for name in names[:4])
    return shown if len(names) <= 4 else f"{shown} and {len(names) - 4} more"


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
    """A file with time, displacement and force, and everything that may be its actuation."""

    __test__ = False

    path: Path
    table: Table
    columns: dict[str, Guess]  # by role, without the actuation
    column: Guess | None  # that may hold the actuation
    header: Level | None  # level in the header lines
    named: tuple[Level, ...]  # levels in the file's name

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
    it. Refused where it is a pressure and most files have tensions, or the reverse.
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
