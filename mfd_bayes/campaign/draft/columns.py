"""The role and unit of each column of a test file, guessed from names and numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.campaign.draft.shapes import by_loop
from mfd_bayes.errors import MfdError, UnitError
from mfd_bayes.records.channels import Source
from mfd_bayes.records.columns import stated_unit
from mfd_bayes.records.file_name_check import SLOW_PERIOD, SLOW_RATE
from mfd_bayes.records.loops import roughness
from mfd_bayes.records.motion import cycle_turns
from mfd_bayes.records.readers import Table
from mfd_bayes.records.readers.table import own_name
from mfd_bayes.records.trace import check_magnitude
from mfd_bayes.units import actuation_factor, factor, force_meant

Array = NDArray[np.float64]

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

_UNIT_ALONE = 1.0
"""Score of a unit for a role where no word has a score."""

_NOT_MEASURED = frozenset(
    {"command", "cmd", "setpoint", "target", "ref", "reference", "desired", "error", "nominal"}
)

_ANY = "any actuation"

_KINDS = {
    "time": ("time",),
    "displacement": ("displacement",),
    "force": ("force",),
    "velocity": ("velocity",),
    "actuation": ("pressure", "force", _ANY),
}

FAST_CYCLE, SLOWEST_STEP = 100.0, 10.0
"""Without a unit, times with longer cycles may be ms; with such steps too, in s, they are ms."""

_COUNTERS = frozenset(
    {
        *("scan", "scans", "sample", "samples", "index", "idx", "no", "nr", "num", "number"),
        *("#", "n", "count", "counter", "counts", "record", "rec", "point", "points", "pt"),
        *("pts", "row", "line", "frame", "reading", "step", "lfd", "i", "k", "id", "seq"),
        *("sequence", "datapoint", "tick", "ticks", "block", "set", "obs", "observation"),
    }
)
"""Words in the name of a column that counts samples."""

_EARLIEST = 20_000.0
_DATES = {
    "day": (_EARLIEST, 800_000.0),
    **{unit: (5e8 * by, 6e9 * by) for unit, by in (("s", 1.0), ("ms", 1e3), ("us", 1e6))},
}
"""Ranges of dates of these decades: days of Excel and of MATLAB, seconds since 1970 and 1904."""

_BRACKETS = re.compile(r"[\[(<{]\s*([^\])>}]+?)\s*[\])>}]\s*$")
_BEHIND = re.compile(r"[\s,/:]+([^\s,:]+)\s*$")
_SUFFIX = re.compile(r"_((?:[^_\s]+_per_)?[^_\s]+)$")
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_METRIC = re.compile(r"\b(?:N|kN|MN|mm|cm|m|kPa|MPa|bar)\b")


@dataclass(frozen=True)
class Guess:
    """A column guessed for a role; `unit` is None where it is unknown."""

    name: str
    unit: str | None
    doubts: tuple[str, ...] = ()
    """What is not certain, with the alternatives."""
    number: int | None = None
    """Number of a column, from 1, that has no name of its own; None of others."""
    lacking: str = ""
    """Why its unit is unknown, and what may be written; empty where nothing more is known."""
    sign: int = 1
    rate: str = ""
    """In place of a column of times: the rate, or the step, that the file states."""

    @property
    def key(self) -> tuple[str, str | None, int | None, int, str]:
        """What the campaign file says of it."""
        return self.name, self.unit, self.number, self.sign, self.rate

    @property
    def source(self) -> Source:
        """The column as it is read; one of an unknown unit or rate is read somehow."""
        if not self.name:
            return Source(rate=self.rate or "1 Hz")
        return Source(self.name, self.unit, sign=self.sign)


def guess_columns(table: Table) -> dict[str, Guess]:
    """Role to column, guessed from names and units, or else from numbers.

    Only time, displacement and force are guessed from numbers. Where no unit of time is given, its
    steps decide between s and ms.
    """
    found: dict[str, Guess] = {}
    taken: set[str] = set()
    for role in ("actuation", "time", "displacement", "force", "velocity"):
        guess = _by_name(table, role, taken)
        if guess is not None:
            found[role] = guess
            taken.add(guess.name)
    missing = {"time", "displacement", "force"} - found.keys()
    if missing:
        found |= _by_numbers(table, missing, taken)
    found = {role: _with_unit(table, role, guess, found) for role, guess in found.items()}
    found = _checked_velocity(table, found)
    return {role: _numbered(table, guess) for role, guess in found.items()}


NO_TIME = 'the file has none, and states no rate: write time = { rate = "100 Hz" } with its own'


def timed_by_rate(found: dict[str, Guess], rate: str, doubt: str) -> dict[str, Guess]:
    """Guesses with the rate that a file states, where no column is a time.

    Where it states none, the time is left open, if displacement and force have their names.
    """
    time = found.get("time")
    if time is None and not {"displacement", "force"} <= found.keys():
        return found
    if time is None or (rate and time.lacking):
        doubts = (doubt,) if doubt else ()
        guess = Guess("", "s", doubts, rate=rate) if rate else Guess("", None, lacking=NO_TIME)
        return found | {"time": guess}
    return found


def _numbered(table: Table, guess: Guess) -> Guess:
    """Guess with the column's number where it has no name of its own."""
    if own_name(guess.name) == guess.name:
        return guess
    return replace(guess, number=table.number_of(guess.name))


def unit_of(table: Table, name: str, role: str) -> str | None:
    """Unit of a column for a role, from its name or the file's row of units; None if unknown."""
    own = normalize("NFKC", own_name(name))
    candidates = [m[1] for m in (p.search(own) for p in (_BRACKETS, _SUFFIX, _BEHIND)) if m]
    candidates += [table.units.get(name, ""), own.strip()]
    for text in candidates:
        for unit in (text.replace("_per_", "/"), text.lower().replace("_per_", "/")):
            if any(_measures(unit, kind) for kind in _KINDS[role]):
                return unit
    return None


def numbers_of(table: Table, name: str) -> Array | None:
    """Numbers of a column, (T,), or None where it holds anything else."""
    try:
        numbers = table.columns([name])[name]
        check_magnitude(name, numbers)
    except MfdError:
        return None
    return numbers


def times_of(table: Table, name: str) -> Array | None:
    """As `numbers_of`, for a time: a date in ns or us may be large."""
    try:
        return table.columns([name])[name]
    except MfdError:
        return None


def _measures(unit: str, kind: str) -> bool:
    try:
        if kind != _ANY:
            factor(unit, kind)
        elif actuation_factor(unit)[1] == "%" and unit != "%":
            return False
    except UnitError:
        return False
    return True


def _by_name(table: Table, role: str, taken: set[str]) -> Guess | None:
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
    unit = unit_of(table, best, role)
    fewest = max(scores[best] - 1, min(scores[best], 2))
    rivals = [n for n, score in scores.items() if n != best and score >= fewest]
    doubts: list[str] = []
    if scores[best] == _UNIT_ALONE:
        doubts.append(f"column for {role} chosen by its unit alone")
    if rivals:
        doubts.append(f"column for {role} could also be {_listed(rivals)}")
    return Guess(best, unit, tuple(doubts))


def _score(table: Table, name: str, role: str) -> float:
    """Score of a column's name and unit for a role; 0 where it cannot have the role."""
    plain = _BRACKETS.sub("", normalize("NFKC", own_name(name)))
    words = re.findall(r"[a-z]+", _CAMEL.sub(" ", plain).lower())
    own = max((_WORDS[role].get(word, 0) for word in words), default=0)
    others = [known.get(w, 0) for r, known in _WORDS.items() if r != role for w in words]
    other = max(others, default=0)
    if own and _NOT_MEASURED & set(words):
        own = 1
    unit = unit_of(table, name, role)
    if own and unit is None and _measures_else(table, name, role):
        return 0.0
    if not own:
        # of actuations, a unit alone can tell only a pressure: load cells are many
        alone = unit is not None and (role != "actuation" or _measures(unit, "pressure"))
        return _UNIT_ALONE if alone and not other else 0.0
    return own + (1.0 if unit is not None else 0.0) if own >= other else 0.0


def _measures_else(table: Table, name: str, role: str) -> bool:
    """Whether the unit of a column is that of another role."""
    match = _BRACKETS.search(normalize("NFKC", own_name(name)))
    stated = match[1] if match else table.units.get(name, "")
    return bool(stated) and any(
        _measures(stated, kind)
        for r, kinds in _KINDS.items()
        if r != role
        for kind in kinds
        if kind != _ANY
    )


def _by_numbers(table: Table, missing: set[str], taken: set[str]) -> dict[str, Guess]:
    """Time: the column that increases steadily; then the pair that looks most like a loop."""
    columns = {
        name: values
        for name in table.names
        if name not in taken and table.names.count(name) == 1
        if (values := times_of(table, name)) is not None and values.size > 2
        if _steady(values) or numbers_of(table, name) is not None
    }
    found: dict[str, Guess] = {}
    if "time" in missing:
        steady = [name for name, values in columns.items() if _steady(values)]
        steady.sort(key=lambda name: bool(np.ptp(np.diff(columns[name])) == 0.0))  # a counter last
        if steady:
            found["time"] = _guessed("time", steady)
            del columns[steady[0]]
    moving = sorted(
        (name for name, v in columns.items() if np.ptp(v) > 0 and not _steady(v)),
        key=lambda name: roughness(columns[name]),
    )
    if {"displacement", "force"} <= missing:
        moving = by_loop({name: columns[name] for name in moving})
    for role in ("displacement", "force"):
        if role in missing and moving:
            found[role] = _guessed(role, moving)
            moving = moving[1:]
    return found


def _guessed(role: str, names: list[str]) -> Guess:
    others = f"; it could also be {_listed(names[1:])}" if names[1:] else ""
    return Guess(names[0], None, (f"column for {role} guessed from the numbers{others}",))


def _steady(values: Array) -> bool:
    steps = np.diff(values)
    return bool(np.all(steps > 0) and steps.max() < 20 * np.median(steps))


def _with_unit(table: Table, role: str, guess: Guess, found: Mapping[str, Guess]) -> Guess:
    """Guess with a unit where its name, the other columns or the steps of time tell it."""
    unit = guess.unit or unit_of(table, guess.name, role)
    if role == "time":
        return _timed(table, replace(guess, unit=unit), found)
    if unit is not None:
        return replace(guess, unit=unit)
    if said := stated_unit(own_name(guess.name), table.units.get(guess.name, "")):
        return replace(guess, unit=None, lacking=unread(said, role))
    if role == "actuation":
        return guess
    metric = _is_metric(table, found)
    if metric is None:
        return guess
    units = {"displacement": ("in", "mm"), "force": ("kip", "kN"), "velocity": ("in/s", "mm/s")}
    unit = units[role][metric]
    other = units[role][not metric]
    doubt = f"no unit of {role} is given; {unit} matches the other columns, {other} does not"
    return replace(guess, unit=unit, doubts=(*guess.doubts, doubt))


def unread(said: str, role: str) -> str:
    """Sentence on a unit that a file states and that is none of a role."""
    return f"{said!r}, as the file says, is no known unit of {role}{force_meant(said)}"


def _is_metric(table: Table, found: Mapping[str, Guess]) -> bool | None:
    """Whether the given units of displacement, force and velocity are metric; None without any."""
    stated = [
        unit
        for role in ("displacement", "force", "velocity")
        if role in found and (unit := unit_of(table, found[role].name, role)) is not None
    ]
    return bool(_METRIC.search(" ".join(stated))) if stated else None


def _timed(table: Table, guess: Guess, found: Mapping[str, Guess]) -> Guess:
    """Time with its unit, from the steps where none is given and they can tell it."""
    stamps = times_of(table, guess.name) if guess.name in table.stamped else None
    if stamps is not None and np.any(np.diff(stamps) == 0.0) and stamps[-1] > stamps[0]:
        new = np.flatnonzero(np.diff(stamps) > 0.0)
        first, last = (new[0], new[-1]) if new.size > 1 else (0, stamps.size - 1)
        rate = (last - first) / (stamps[last] - stamps[first])
        return Guess(
            *("", None),
            lacking=f"time stamps of {guess.name!r} are equal in several rows, about {rate:.3g} in "
            'a second: write the rate in place of the column, time = { rate = "100 Hz" }',
        )
    if guess.unit is not None:
        return guess
    if said := stated_unit(own_name(guess.name), table.units.get(guess.name, "")):
        return replace(guess, lacking=unread(said, "time"))
    values = times_of(table, guess.name)
    if values is None or values.size < 3 or values[-1] <= values[0]:
        return guess
    if (since := float(values[0])) >= _EARLIEST and np.ptp(values) < 0.05 * since:
        return replace(guess, **_date_unit(since))
    if lacking := _no_time(own_name(guess.name), values) or _of_two_units(table, values, found):
        return replace(guess, lacking=lacking)
    unit = "ms" if _is_slow(table, values, found) else "s"
    doubt = f"no unit of time is given; the steps look like {unit}"
    return replace(guess, unit=unit, doubts=(*guess.doubts, doubt))


def _no_time(name: str, values: Array) -> str:
    """Why a column is a count or a date, and what to write; empty where it may be a time."""
    steps = np.diff(values)
    whole = bool(np.all(values == np.round(values)))
    words = set(re.findall(r"[^\W\d_]+|#", _CAMEL.sub(" ", name).lower()))
    if whole and (words & _COUNTERS or np.all(steps == 1.0)):
        return (
            f"{name or 'this column'!r} counts samples and is no time: at which rate? Write it in "
            'place of the column, time = { rate = "100 Hz" }'
        )
    return ""


def _date_unit(since: float) -> dict[str, Any]:
    """Unit of a time that counts from 1900, 1904, 1970 or the year 0, and the doubt about it."""
    for unit, (low, high) in _DATES.items():
        if low < since < high:
            doubt = f"no unit of time is given; it looks like a date, counted in {unit}"
            return {"unit": unit, "doubts": (doubt,)}
    return {"lacking": "it begins at a number too large for a time: what does it count?"}


def _of_two_units(table: Table, values: Array, found: Mapping[str, Guess]) -> str:
    """Why the steps of a time do not tell its unit; empty where they do."""
    cycle = _cycle(table, values, found.get("displacement"))
    step = float(np.median(np.diff(values)))
    if step < SLOWEST_STEP and FAST_CYCLE < cycle < SLOW_PERIOD and step * SLOW_RATE >= 1.0:
        return (
            f"its steps may be s or ms: one gives a cycle of {cycle:.3g} s, the other of "
            f"{cycle / 1000:.3g} s"
        )
    if cycle / 1000 > SLOW_PERIOD and step >= 1000 * SLOWEST_STEP:
        return "its steps are neither those of s nor of ms"
    return ""


def _is_slow(table: Table, values: Array, found: Mapping[str, Guess]) -> bool:
    """Whether times without a unit are ms: in s, a cycle would take hours, or a sample too long."""
    cycle = _cycle(table, values, found.get("displacement"))
    step = float(np.median(np.diff(values)))
    return cycle > FAST_CYCLE and step * SLOW_RATE >= 1.0


def _cycle(table: Table, time: Array, displacement: Guess | None) -> float:
    """Time of a cycle, in the unit of the time; 0 where it cannot be told."""
    motion = None if displacement is None else numbers_of(table, displacement.name)
    if motion is None or motion.size != time.size:
        return 0.0
    turns = cycle_turns(motion).size
    return float(np.ptp(time)) / max(turns / 2, 1.0)


def _checked_velocity(table: Table, found: dict[str, Guess]) -> dict[str, Guess]:
    """Guesses, without the velocity unless it has a unit and is the displacement's slope."""
    if "velocity" not in found:
        return found
    roles = ("time", "displacement", "velocity")
    wanted = [found[role].name for role in roles if role in found]
    try:
        values = table.columns(wanted)
    except MfdError:
        values = {}
    if found["velocity"].unit is not None and len(wanted) == len(roles) == len(values):
        time, displacement, velocity = (values[name] for name in wanted)
        with np.errstate(all="ignore"):
            slope = np.gradient(displacement, time)
            alike = np.corrcoef(slope, velocity)[0, 1]
        if alike > 0.9:
            return found
    return {role: guess for role, guess in found.items() if role != "velocity"}


def _listed(names: list[str]) -> str:
    shown = ", ".join(repr(name) for name in names[:4])
    return shown if len(names) <= 4 else f"{shown} and {len(names) - 4} more"
