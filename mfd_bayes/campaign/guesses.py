"""What the columns of a test file are, its rate and its actuation: by names, units and numbers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path
from unicodedata import normalize

import numpy as np

from mfd_bayes.errors import MfdError, RecordError, UnitError
from mfd_bayes.records.data_quality import (
    NUMBER,
    SLOW_PERIOD,
    SLOW_RATE,
    level_text,
    readings,
)
from mfd_bayes.records.loops import follows, roughness
from mfd_bayes.records.record import Source, step_of
from mfd_bayes.records.table import (
    CAMEL,
    ROLE_WORDS,
    Table,
    header_unit,
    listed,
    own_name,
    stated_unit,
    ungrouped,
)
from mfd_bayes.records.trace import Array, check_magnitude, cycle_turns
from mfd_bayes.units import (
    ActuationUnit,
    Axes,
    Axis,
    actuation_factor,
    actuation_kind,
    check_unit,
    factor,
    force_meant,
    has_angle,
    measure,
    measures,
    parse_actuation,
)

ESSENTIAL = ("time", "displacement", "force")
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
    "day": (_EARLIEST, 8e5),
    "s": (5e8, 6e9),
    "ms": (5e11, 6e12),
    "us": (5e14, 6e15),
}
"""Ranges of dates of these decades: days of Excel and of MATLAB, seconds since 1970 and 1904."""

_LONGEST_OF_DAYS, _SHORTEST = 1e-3, 1e-5
"""Most step of a date in days; steps that are shorter, without a unit, are parts of a day."""

_IN_BRACKETS = re.compile(r"[\[(<{]\s*([^\])>}]+?)\s*[\])>}]\s*$")
_AT_THE_END = (
    _IN_BRACKETS,
    re.compile(r"_((?:[^_\s]+_per_)?[^_\s]+)$"),
    re.compile(r"[\s,/:]+([^\s,:]+)\s*$"),
)
_METRIC = re.compile(r"\b(?:N|kN|MN|mm|cm|m|kPa|MPa|bar)\b")

SURE = 0.3  # correlation of a force with the direction of a motion from which two make a loop
ALIKE = 0.8  # least correlation of a column with the chosen one, of which it is a rival
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


def guess_columns(table: Table, axes: Axes) -> dict[str, Guess]:
    """Role to column of a model's motion and response, of time and of actuation.

    Guessed from names and units, or else from numbers; those of a user's own axes by name alone.
    A rate that the file states stands in place of a time that it has not; where it states none,
    the time is left open, if displacement and force have their names.
    """
    user_axes = {} if axes.of_damper else {"displacement": axes.motion, "force": axes.response}
    roles = ("actuation",) * axes.actuated + ("time",) * axes.timed + ("displacement", "force")
    guesses: dict[str, Guess] = {}
    for role in roles:
        used_names = [guess.name for guess in guesses.values()]
        named = (
            _of_axis(table, user_axes[role])
            if role in user_axes
            else _by_name(table, role, used_names)
        )
        if named is not None:
            guesses[role] = named
    missing = [role for role in roles if role not in {*guesses, *user_axes, "actuation"}]
    torque, angle = (rotational(table, used_names) for used_names in ("N*m", "rad"))
    if not user_axes and torque and angle and {"displacement", "force"} & set(missing):
        raise RecordError(
            f"no column for {' and '.join(r for r in missing if r != 'time')}: {torque!r} is a "
            f"torque and {angle!r} an angle; a device that turns needs a model of your own, as "
            "--model my_model.py:Brake"
        )
    if missing:
        guesses |= _by_numbers(table, missing, [guess.name for guess in guesses.values()])
    if not user_axes and {"displacement", "force"} <= guesses.keys():
        guesses |= _by_motion(table, guesses["displacement"], guesses["force"])
    for role, guess in guesses.items():
        column = (
            guess if guess.unit or role in user_axes else _with_unit(table, role, guess, guesses)
        )
        if role == "time" and (problem := _equal_stamps(table, guess.name)):
            column = Guess("", None, lacking=problem)
        if own_name(column.name) != column.name:  # no name of its own
            column = replace(column, number=table.number_of(column.name))
        guesses[role] = column
    rate, doubt = rate_in_header(table.head)
    time = guesses.get("time")
    lacks = bool(rate and time.lacking) if time else {"displacement", "force"} <= guesses.keys()
    if axes.timed and lacks and (rate or not (table.notes or table.blocks)):
        doubts = [doubt] if doubt else []
        counter = time.name if time else ""
        count = numbers_of(table, counter, is_time=True) if counter else None
        if count is not None and np.ptp(np.diff(count)) >= 1.0 and not np.any(count % 1.0):
            doubts.append(f"{counter!r} does not count on evenly: samples may be lost")
        stated = Guess("", "s", tuple(doubts), rate=rate)
        guesses["time"] = stated if rate else Guess("", None, lacking=NO_TIME)
    return guesses


def rotational(table: Table, kind: str) -> str:
    """The first column whose unit is one of a torque, "N*m", or has an angle, "rad"; or ""."""
    for name in table.names:
        title = normalize("NFKC", own_name(name))
        texts = [match[1] for pattern in _AT_THE_END if (match := pattern.search(title))]
        for unit in filter(None, (table.units.get(name), *texts)):
            unit = {"nm": "N*m", "rpm": "rad/s", "rev/min": "rad/s"}.get(unit.lower(), unit)
            unit = re.sub(r"(?<=N)[. ·](?=m)", "*", unit)
            if measure(unit) and (has_angle(unit) if kind == "rad" else measures(unit, kind)):
                return name
    return ""


def _of_axis(table: Table, axis: Axis) -> Guess | None:
    """The first column that is called as a user's own axis, with its unit."""
    for name in table.names:
        if re.match(axis.name, re.sub(r"^[^a-z]+", "", name.lower())):
            for unit in filter(None, (table.units.get(name), header_unit(name), axis.unit)):
                try:
                    check_unit(unit, axis, "")
                except UnitError:
                    continue
                guessed = unit == axis.unit != "1" and unit not in name
                doubt = f"no unit is given: that of the model, {unit}, is taken"
                return Guess(name, unit, (doubt,) if guessed else ())
    return None


def unit_of(table: Table, name: str, role: str) -> str | None:
    """Unit of a column for a role, from its name or the file's row of units; None if unknown."""
    title = normalize("NFKC", own_name(name))
    texts = [match[1] for pattern in _AT_THE_END if (match := pattern.search(title))]
    bracketed = stated_unit(name) or ""  # "Force (N)[1]"
    is_length = any(
        word in ROLE_WORDS["displacement"] for word in re.findall(r"[a-z]+", title.lower())
    )
    for text in (*texts, table.units.get(name, ""), title.strip(), bracketed):
        for unit in (text.replace("_per_", "/"), text.lower().replace("_per_", "/")):
            if unit != text and measure(text):  # Nm is no nanometre
                continue
            if role == "displacement" and text.lower() == "nm" and not (is_length and text == "nm"):
                continue
            if _fits(unit, role):
                return unit
    return None


def _fits(unit: str, role: str) -> bool:
    """Whether a unit is one of a role, or of the dimension "pressure"."""
    if unit in ("Mm", "Ms"):  # no motion has megametres
        return False
    try:
        if role == "actuation":
            return actuation_factor(unit)[1] != "%" or unit == "%"
        factor(unit, role)
    except UnitError:
        return False
    return True


def numbers_of(table: Table, name: str, *, is_time: bool = False) -> Array | None:
    """Numbers of a column, (T,), or None where it holds anything else; a time may be a date."""
    try:
        numbers = table.columns([name])[name]
        if not is_time:
            check_magnitude(name, numbers)
    except MfdError:
        return None
    return numbers


def _by_name(table: Table, role: str, excluded: Sequence[str]) -> Guess | None:
    """Column whose name and unit have the highest score for a role."""
    names = [name for name in table.names if name not in excluded and table.names.count(name) == 1]
    scores = {name: score for name in names if (score := _score(table, name, role)) > 0}
    if not scores:
        return None
    best = max(scores, key=lambda name: scores[name])
    fewest = max(scores[best] - 1, min(scores[best], 2))
    rivals = [name for name, score in scores.items() if name != best and score >= fewest]
    unit_doubts = (
        (f"column for {role} chosen by its unit alone",) if scores[best] == _UNIT_ALONE else ()
    )
    rival_doubts = (f"column for {role} could also be {listed(rivals)}",) if rivals else ()
    return Guess(best, unit_of(table, best, role), unit_doubts + rival_doubts)


def _score(table: Table, name: str, role: str) -> float:
    """Score of a column's name and unit for a role; 0 where it cannot have the role."""
    text = normalize("NFKC", own_name(name))
    words = re.findall(r"[a-z]+", CAMEL.sub(" ", _IN_BRACKETS.sub("", text)).lower())
    scores = {
        r: max((points.get(w, 0) for w in words), default=0) for r, points in ROLE_WORDS.items()
    }
    score, rival = scores.pop(role), max(scores.values())
    if score and any(map(_NOT_MEASURED.fullmatch, words)):
        score = 1
    unit = unit_of(table, name, role)
    if not score:
        # of actuations, a unit alone can tell only a pressure: load cells are many
        tells = unit is not None and (role != "actuation" or _fits(unit, "pressure"))
        return _UNIT_ALONE if tells and not rival else 0.0
    if unit is None:
        match = _IN_BRACKETS.search(text)
        stated = match[1] if match else table.units.get(name, "")
        if stated and any(_fits(stated, kind) for kind in (*ESSENTIAL, "velocity", "pressure")):
            return 0.0  # the unit is that of another role
    return score + (unit is not None) if score >= rival else 0.0


def _by_motion(table: Table, motion: Guess, force: Guess) -> dict[str, Guess]:
    """Displacement and force once more, beside the columns that move as they do.

    A force that does not follow the direction of the motion gives way to one that does. A column
    whose unit alone tells its role is a rival if its numbers are like those of the chosen one.
    """
    x, f = (numbers_of(table, guess.name) for guess in (motion, force))
    if x is None or f is None or not x.size == f.size > 2:
        return {}
    guesses = {"displacement": motion, "force": force}
    rivals: dict[str, dict[str, Array]] = {"displacement": {}, "force": {}}
    for role, columns in rivals.items():
        for name in table.names:
            if name in (motion.name, force.name) or table.names.count(name) > 1:
                continue
            words = re.findall(r"[a-z]+", own_name(name).lower())
            values = numbers_of(table, name) if _score(table, name, role) > 0 else None
            if values is None or any(map(_NOT_MEASURED.fullmatch, words)):
                continue
            if values.size == x.size and np.ptp(values) > 0.0:
                columns[name] = values
    if rivals["force"] and follows(x, f) < SURE:
        best = max(rivals["force"], key=lambda name: follows(x, rivals["force"][name]))
        if follows(x, rivals["force"][best]) > SURE:
            doubt = (
                f"column for force chosen by its loops; {force.name!r} does not follow the motion"
            )
            guesses["force"] = Guess(best, unit_of(table, best, "force"), (doubt,))
            return guesses
    for role, signal in (("displacement", x), ("force", f)):
        guess = guesses[role]
        alike = [
            name
            for name, values in rivals[role].items()
            if np.ptp(signal) > 0.0
            and _score(table, name, role) == _UNIT_ALONE
            and abs(np.corrcoef(values, signal)[0, 1]) > ALIKE
            and (role == "displacement" or unit_of(table, name, role) == guess.unit)
            and not any(repr(name) in doubt for doubt in guess.doubts)
        ]
        if alike:
            doubt = f"column for {role} could also be {listed(alike)}"
            guesses[role] = replace(guess, doubts=(*guess.doubts, doubt))
    return guesses


def _by_numbers(table: Table, missing: Sequence[str], excluded: Sequence[str]) -> dict[str, Guess]:
    """Time: the column that increases steadily; then the pair that looks most like a loop."""
    signals: dict[str, Array] = {}
    steady: dict[str, bool] = {}  # to whether it is a counter
    for name in table.names:
        values = None
        if name not in excluded and table.names.count(name) == 1:
            values = numbers_of(table, name, is_time=True)
        if values is None or values.size < 3:
            continue
        steps = np.diff(values)
        if np.all(steps > 0) and steps.max() < 20 * np.median(steps):
            steady[name] = bool(np.ptp(steps) == 0.0)
        elif np.ptp(values) > 0 and numbers_of(table, name) is not None:
            signals[name] = values
    names = sorted(signals, key=lambda name: roughness(signals[name]))
    if {"displacement", "force"} <= set(missing):
        names = by_loop({name: signals[name] for name in names})
    guesses: dict[str, Guess] = {}
    for role in missing:
        candidates = sorted(steady, key=lambda name: steady[name]) if role == "time" else names
        if candidates:
            hint = f"; it could also be {listed(candidates[1:])}" if candidates[1:] else ""
            doubt = f"column for {role} guessed from the numbers{hint}"
            guesses[role] = Guess(candidates[0], unit_of(table, candidates[0], role), (doubt,))
            names = names if role == "time" else names[1:]
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


def _with_unit(table: Table, role: str, guess: Guess, guesses: Mapping[str, Guess]) -> Guess:
    """Guess without a unit: that which the other columns or the steps of time tell."""
    stated = stated_unit(guess.name, table.units.get(guess.name, ""))
    if stated:
        text = f"{stated!r}, as the file says, is no known unit of {role}{force_meant(stated)}"
        return replace(guess, lacking=text)
    if role == "time":
        return _with_unit_of_time(table, guess, guesses.get("displacement"))
    columns = [(r, guesses[r]) for r in ("displacement", "force") if r in guesses]
    stated_units = [unit for r, rival in columns if (unit := unit_of(table, rival.name, r))]
    if role == "actuation" or not stated_units:
        return guess
    unit, rival = {"displacement": ("in", "mm"), "force": ("kip", "kN")}[role]
    if _METRIC.search(" ".join(stated_units)):
        unit, rival = rival, unit
    doubt = f"no unit of {role} is given; {unit} matches the other columns, {rival} does not"
    return replace(guess, unit=unit, doubts=(*guess.doubts, doubt))


def _equal_stamps(table: Table, name: str) -> str:
    """What to write in place of time stamps that are equal in several rows; empty of others."""
    stamps = numbers_of(table, name, is_time=True) if name in table.stamped else None
    if stamps is None or np.all(np.diff(stamps) != 0.0) or not stamps[-1] > stamps[0]:
        return ""
    changes = np.flatnonzero(np.diff(stamps) > 0.0)
    start, end = (changes[0], changes[-1]) if changes.size > 1 else (0, stamps.size - 1)
    rate = (end - start) / (stamps[end] - stamps[start])
    return (
        f"time stamps of {name!r} are equal in several rows, about {rate:.3g} in a second: write "
        'the rate in place of the column, time = { rate = "100 Hz" }'
    )


def _with_unit_of_time(table: Table, guess: Guess, displacement: Guess | None) -> Guess:
    """A time with the unit that its numbers look like; or what it lacks."""
    values = numbers_of(table, guess.name, is_time=True)
    if values is None or values.size < 3 or values[-1] <= values[0]:
        return guess
    is_coarse = np.median(np.diff(values)) > _LONGEST_OF_DAYS  # 36000 s since midnight
    if values[0] >= _EARLIEST and np.ptp(values) < 0.05 * values[0]:
        for unit, (low, high) in _DATES.items():
            if low < values[0] < high and not (unit == "day" and is_coarse):
                doubt = f"no unit of time is given; it looks like a date, counted in {unit}"
                return replace(guess, unit=unit, doubts=(doubt,))
        text = "it begins at a number too large for a time: what does it count?"
        return replace(guess, lacking=text)
    name, steps = own_name(guess.name), np.diff(values)
    words = re.findall(r"[^\W\d_]+|#", CAMEL.sub(" ", name).lower())
    is_whole = bool(np.all(values == np.round(values)))
    if is_whole and (any(map(_COUNTER.fullmatch, words)) or np.all(steps == 1.0)):
        text = (
            f"{name or 'this column'!r} counts samples and is no time: at which rate? "
            'Write it in place of the column, time = { rate = "100 Hz" }'
        )
        return replace(guess, lacking=text)
    motion = None if displacement is None else numbers_of(table, displacement.name)
    cycle = 0.0  # time of a cycle, in the unit of the time
    if motion is not None and motion.size == values.size:
        cycle = float(np.ptp(values)) / max(cycle_turns(motion).size / 2, 1.0)
    step = float(np.median(steps))
    if step < _SHORTEST:
        return replace(guess, lacking='its steps are too short for s: are they of a "day"?')
    is_slow = step * SLOW_RATE >= 1.0
    if step < SLOWEST_STEP and FAST_CYCLE < cycle < SLOW_PERIOD and is_slow:
        text = f"one gives a cycle of {cycle:.3g} s, the other of {cycle / 1000:.3g} s"
        return replace(guess, lacking=f"its steps may be s or ms: {text}")
    if cycle / 1000 > SLOW_PERIOD and step >= 1000 * SLOWEST_STEP:
        return replace(guess, lacking="its steps are neither those of s nor of ms")
    unit = "ms" if cycle > FAST_CYCLE and is_slow else "s"
    doubt = f"no unit of time is given; the steps look like {unit}"
    return replace(guess, unit=unit, doubts=(*guess.doubts, doubt))


CONSTANT = 0.02
"""An actuation is constant when its standard deviation is below this share of its mean."""

IDLE = "no actuation: only laws with an intercept learn from it, affine and residual_power"
"""Doubt about a test at zero actuation."""

_UNITS = r"psi|ksi|kpa|mpa|bar|kn|n|lbf|lbs|lb|kips|kip"
_DRIVES = r"ma|amps?|a|mv|volts?|v|turns?|clicks?|nm"
_WITH_UNIT = re.compile(rf"{NUMBER}[ _-]?({_UNITS})(?![a-z])", re.IGNORECASE)
_DRIVEN = re.compile(
    rf"(?:(?<![a-z])|(?<=\dhz)|(?<=\dmm)){NUMBER}[ _-]?({_DRIVES})(?![a-z])", re.IGNORECASE
)
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
_EACH = r"(?:samples?|scans?|points?|pts|readings?)\s*(?:/|per)\s*s(?:ec(?:ond)?)?"
_HZ = rf"(k?hz|k?s/s|k?sa/s|k?sps|1/s|{_EACH})(?![a-z])"
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
    r"(?<![a-z_])(?:dt|ts|delta[_ ]?[xt])(?![a-z])|^\W*interval"
)
_OF_LOGGER = re.compile(r"(?:max|min)\w*\.?[\s_-]*$", re.IGNORECASE)  # what it can do
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


NAMED = "in the file's name"


@dataclass(frozen=True)
class GuessedLevel:
    """A constant actuation: its text, such as "500 psi", and its value in the internal unit."""

    text: str
    value: float
    unit: ActuationUnit
    place: str  # where it stands
    doubt: str = ""  # what was assumed


def _level(
    name: str, match: re.Match[str], source: str, doubt: str = "", *, unit: str = "", joined: bool
) -> GuessedLevel:
    """Level of a number and its unit; where the number may be another, with that doubt.

    Of ``1_5bar`` the last part counts, unless numbers are `joined`.
    """
    unit = unit or match[2]
    words, numbers = readings(name, match)
    decimals = re.match(r"[_-](\d{1,3})(?![\da-z])", name[match.end() :], re.IGNORECASE)
    if match.re in (_PRESSURE, _TENSION) and decimals and re.fullmatch(r"\d\d?", match[1]):
        words, numbers = words + decimals[0], (numbers[0], float(f"{match[1]}.{decimals[1]}"))
    if joined and len(numbers) > 1 and "x" not in match[1].lower():
        numbers = (*numbers[1:], numbers[0])
    text, *rivals = (level_text(number, unit) for number in numbers)
    if rivals:
        doubt += f"{'; ' if doubt else ''}{words} may be {_or((text, *rivals))}"
    return GuessedLevel(text, *parse_actuation(text), source, doubt)


_PARTS = re.compile(
    rf"(?<![\d.,])(0|[1-9]\d{{0,2}})([ _-])(\d+)[ _-]?"
    rf"(?:{_UNITS}|{_DRIVES}|hz|mm|in|inch)(?![a-z])",
    re.IGNORECASE,
)
_BARE_ZERO = re.compile(r"(?<![a-z])(?:p|press|pressure|tension|preload)[ _=-]?0[_-]\d", re.I)


def writes_decimals(names: Sequence[str]) -> bool:
    """Whether names have ``_``, ``-`` or a blank for a decimal point, or between thousands.

    They do where a number begins with 0_, or where the last parts are as long as one that is
    nothing but zeros: ``1_0bar`` beside ``0_5bar``, ``2 000psi`` beside ``1 500psi``.
    """
    groups = [match.groups() for name in names for match in _PARTS.finditer(ungrouped(name))]
    short = [tail for head, sign, tail in groups if head == "0" and (sign == "_" or len(tail) < 3)]
    lengths = {len(tail) for *_, tail in groups}
    zeros = len(lengths) == 1 and any(not tail.strip("0") for *_, tail in groups)
    return bool(short) or zeros or any(map(_BARE_ZERO.search, names))


def levels_in(name: str, *, joined: bool = False) -> tuple[GuessedLevel, ...]:
    """Levels in a file's name: ``1000psi``, ``0.5kN``, ``35lb``; ``p500`` is assumed to be psi.

    `joined` says that names write decimals as ``1_5bar``.
    """
    name = ungrouped(name)
    levels = [_level(name, m, NAMED, joined=joined) for m in _WITH_UNIT.finditer(name)]
    for pattern, unit, rival in ((_PRESSURE, "psi", "kPa"), (_TENSION, "lbf", "N")):
        doubt = f"{unit} is assumed; it may be {rival}"
        matches = () if levels else pattern.finditer(name)
        levels += [_level(name, m, NAMED, doubt, unit=unit, joined=joined) for m in matches]
    for match in () if levels else _DRIVEN.finditer(name):
        is_label = len(match[2]) == 1 and match[1].isdigit()  # a single letter may be a label
        doubt = f"{match[0]} is taken for {match[2].upper()}" if is_label else ""
        levels.append(_level(name, match, NAMED, doubt, joined=joined))
    return tuple(dict.fromkeys(levels))


def level_in_header(lines: Sequence[str], names: Sequence[str]) -> tuple[GuessedLevel, ...]:
    """Level in the lines above the numbers or in a column's name, as ``Pressure: 500 psi``.

    A pressure without that word, as ``Brake at 500 psi``, gets a doubt.
    """
    lines = [*names, *(line for line in lines if re.search(r"[A-Za-z]{3}", line))]
    lines = [ungrouped(line, heading=True) for line in lines]
    for pattern, doubt in ((_CALLED, ""), (_PRESSURE_UNIT, "it is a pressure in the header lines")):
        for line in lines:
            if match := pattern.search(line):
                joined = writes_decimals([line])
                return (_level(line, match, "in the header", doubt, joined=joined),)
    return ()


def rate_in_header(lines: Sequence[str]) -> tuple[str, str]:
    """Rate, or step, of the samples in the lines above the numbers, and what is assumed of it.

    ``"100 Hz"`` of ``Sample rate: 100 Hz``; empty where the lines state none, or several.
    """
    rates: dict[float, tuple[str, str]] = {}
    for line in (normalize("NFKC", ungrouped(text, heading=True)) for text in lines):
        for pattern, default in _RATES:
            for match in pattern.finditer(line):
                number, unit = match[2].replace(",", "."), (match[1] or match[3] or "").lower()
                if re.fullmatch(r"[1-9]\d{0,2},\d{3}", match[2]) or not float(number) > 0.0:
                    continue  # it is not known which number it is
                if _OF_LOGGER.search(line[: match.start()]):
                    continue
                if not unit and re.match(r"\s*[\[(]?[^\W\d_]|\d{3}(?!\d)", line[match.end() :]):
                    continue  # a unit that is not read, or a part of a number
                unit = re.sub(rf"^(k?)(?:s/s|sa/s|sps|1/s|{_EACH})$", r"\1Hz", unit)
                unit = unit.replace("hz", "Hz").replace("μ", "µ")
                text = f"{number} {unit or default}"
                doubt = "" if unit else f"{default} is assumed for its rate or step"
                rates[step_of(text, "rate")] = text, doubt
    return next(iter(rates.values())) if len(rates) == 1 else ("", "")


@dataclass(frozen=True, eq=False)
class TestFile:
    """A file with a motion and a response, and everything that may be its actuation."""

    __test__ = False

    path: Path
    table: Table
    columns: dict[str, Guess]  # by role, without the actuation
    column: Guess | None  # that may hold the actuation
    levels: tuple[
        GuessedLevel, ...
    ]  # in the header lines or the file's name, the certain ones first


def without_shared_levels(files: list[TestFile]) -> list[TestFile]:
    """Files without the levels that stand in every name, where a name has others as well."""
    if len(files) < 2:
        return files
    names = [{level.text for level in file.levels if level.place == NAMED} for file in files]
    shared = set.intersection(*names)
    return [
        file
        if texts == shared
        else replace(
            file, levels=tuple(v for v in file.levels if v.place != NAMED or v.text not in shared)
        )
        for file, texts in zip(files, names, strict=True)
    ]


def prevailing_unit(files: Sequence[TestFile]) -> ActuationUnit | None:
    """Unit of most files, on a tie "ksi" (pressures) or "kip" (tensions); None if unknown."""
    count: Counter[ActuationUnit] = Counter()
    for file in files:
        certain = [level for level in file.levels if not level.doubt]
        units = {level.unit for level in certain or file.levels}
        if file.column and file.column.unit:
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
    levels = [level for level in file.levels if level.unit == unit]
    doubts: tuple[str, ...] = ()
    if file.column is not None:
        measured, mean, doubts = _measured(file.table, file.column, unit)
        if measured is not None:
            rivals = [v.text for v in levels if abs(mean - v.value) > 0.1 * v.value]
            if rivals:
                text = measured if isinstance(measured, str) else "a history"
                doubts += (f"{_or(rivals)} in the name or header, {text} in the column",)
            return measured, f"of column {file.column.name!r}", doubts
    if levels:
        level = levels[0]
        rivals = [rival.text for rival in file.levels if rival.text != level.text]
        doubts += (level.doubt,) if level.doubt else ()
        doubts += (f"it could also be {_or(rivals)}",) if rivals else ()
        doubts += (IDLE,) if level.value == 0.0 else ()
        return level.text, level.place, doubts
    if file.levels:
        stated = file.levels[0]
        raise RecordError(
            f"its actuation of {stated.text} is {actuation_kind(stated.unit)}, and those of most "
            "files are not"
        )
    assigned = {guess.name for guess in file.columns.values()}
    names = [
        n for n in file.table.names if n not in assigned and unit_of(file.table, n, "actuation")
    ]
    hint = f"; columns that might: {listed(names)}" if names else ""
    return None, hint, doubts


def _measured(
    table: Table, column: Guess, unit: ActuationUnit | None
) -> tuple[str | Guess | None, float, tuple[str, ...]]:
    """Level or history in the column of the actuation, its mean, and doubts; None without use."""
    doubt, values = f"column {column.name!r} holds no actuation that can be used", None
    if column.lacking:
        doubt += f": {column.lacking}"
    elif column.unit is None:
        doubt = f"column {column.name!r} has no unit: name it, if it is the actuation"
    elif actuation_factor(column.unit)[1] == unit:
        values = numbers_of(table, column.name)
    if column.unit is None or values is None or not np.mean(values) > 0:
        return None, 0.0, (doubt,)
    mean = float(np.mean(values))
    constant = np.std(values) <= CONSTANT * mean
    actuation = f"{mean:.4g} {column.unit}" if constant else replace(column, doubts=())
    return actuation, actuation_factor(column.unit)[0] * mean, column.doubts


def _or(texts: Sequence[str]) -> str:
    return " or ".join(dict.fromkeys(texts))
