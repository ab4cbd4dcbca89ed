"""A test file, checked and in internal units, and the traces cut from it.

Its signals are columns less what is taken off them. Nothing is evaluated: each key has one meaning.
``{ name = "load", minus = { name = "pressure", times = "518.7 mm^2" }, minus_mass = "3 kg" }`` is
F = load - pressure x area - mass x acceleration.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from math import ceil, inf
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import MfdError, RecordError, UnitError, hash_file, path_of, real_number
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.table import Table, header_unit, own_name, stated_unit
from mfd_bayes.records.trace import (
    Array,
    Trace,
    check_magnitude,
    check_size,
    check_trace,
    despiked,
    smallest_turn,
    turning_points,
)
from mfd_bayes.units import (
    DAMPER,
    ActuationUnit,
    Axes,
    actuation_factor,
    factor,
    measure,
    parse_actuation,
    parse_mass,
    parse_quantity,
    same_unit,
    split_quantity,
)

SAMPLES = 20  # fewest samples that a record, or a window of it, may have
GAP = 10.0  # a step longer than this many median steps is a gap in time
PAUSE = 1.9  # a step longer than this many median steps is a pause
SHORTEST = 1e-9  # shortest step in time that is accepted, s
JITTER = 0.01  # above this jitter, in steps, samples are interpolated onto a uniform grid


@dataclass(frozen=True)
class Clock:
    """When samples were taken."""

    rate: float  # Hz; (T - 1) over the duration without pauses
    jitter: float  # largest distance of a sample from a uniform grid between the ends, in steps
    pauses: int  # number of steps longer than `PAUSE` median steps
    longest: float  # s; longest step

    def words(self) -> str:
        """Rate, and how even it is, in words."""
        text = f"{self.rate:.6g} Hz, jitter {self.jitter:.2%} of a step"
        if self.jitter > JITTER and self.pauses:
            times = "once" if self.pauses == 1 else f"{self.pauses} times"
            text += f"; the logger pauses {times}, for up to {self.longest:.3g} s"
        return text


def after_gaps(time: Array) -> NDArray[np.intp]:
    """Samples of an increasing time, (T,), s, before which there is a gap."""
    steps = np.diff(time)
    return np.flatnonzero(steps > GAP * np.median(steps)) + 1


def longest_piece(
    time: Array, row_name: Callable[[int], str], window: tuple[float, float] | None
) -> tuple[slice, str]:
    """Samples of the longest piece of a time without a gap, and a sentence where there is one.

    `row_name` names a row, from 0; only the part of a piece inside the window counts.
    """
    steps, gap_ends = np.diff(time), after_gaps(time)
    if not gap_ends.size:
        return slice(0, time.size), ""
    bounds = [0, *(int(k) for k in gap_ends), time.size]
    start, end = (-np.inf, np.inf) if window is None else window
    spans = [min(time[b - 1], end) - max(time[a], start) for a, b in pairwise(bounds)]
    best = int(np.argmax(spans))
    begin, stop = bounds[best], bounds[best + 1]
    missing = float(steps[gap_ends - 1].max())
    gaps = "a gap" if gap_ends.size == 1 else f"{gap_ends.size} gaps, the longest"
    k = int(gap_ends[np.argmax(steps[gap_ends - 1])])
    share = (time[stop - 1] - time[begin]) / (time[-1] - time[0])
    return slice(begin, stop), (
        f"time has {gaps} of {missing:.4g} s before {row_name(k)}, after {time[k - 1]:g} s; the "
        f"longest unbroken piece is used, {time[begin]:g} s to {time[stop - 1]:g} s, "
        f"{share:.0%} of the record"
    )


def check_increasing(table: Table, time: Array) -> None:
    """Refuse a time of a table, (T,), s, that is too short, stands still or goes back."""
    path, row_name = table.path, table.place
    if time.size < SAMPLES:
        raise RecordError(f"{path} has {time.size} samples; at least {SAMPLES} are needed")
    steps = np.diff(time)
    if not np.all(steps > 0):
        row = int(np.argmax(steps <= 0)) + 1
        if row in table.blocks:
            raise RecordError(
                f"{path} holds {len(table.blocks) + 1} blocks: the heading is repeated from "
                f"{table.blocks[row]}, and time starts again below it, {time[row]:g} s after "
                f"{time[row - 1]:g} s: keep one block in a file"
            )
        coarse = table.stamped and steps[row - 1] == 0.0
        raise RecordError(
            f"time in {path} does not increase at {row_name(row)}: "
            f"{time[row]:g} s after {time[row - 1]:g} s"
            + ('; where time stamps are too coarse, write rate = "100 Hz"' if coarse else "")
        )
    shortest = int(np.argmin(steps))
    if steps[shortest] < SHORTEST:
        raise RecordError(
            f"time in {path} increases by {steps[shortest]:.2g} s at "
            f"{row_name(shortest + 1)}; expected {SHORTEST:g} s or more"
        )


def clock_of(time: Array) -> Clock:
    """Rate and evenness of an increasing time, (T,), s."""
    steps = np.diff(time)
    median = float(np.median(steps))
    step = float(time[-1] - time[0]) / (time.size - 1)
    jitter = float(np.max(np.abs(time - np.linspace(time[0], time[-1], time.size)))) / step
    late = steps > PAUSE * median
    pauses = int(np.count_nonzero(late))
    rate = 1.0 / float(np.mean(steps[~late]))
    return Clock(rate if pauses else 1.0 / step, jitter, pauses, float(steps.max()))


def checked_window(
    window: object, name: str = "a window", error: type[MfdError] = RecordError
) -> tuple[float, float]:
    """Two times, s, the first before the second; either may be infinite."""
    expected = f"{name} must be two times in s, the earlier one first, got {window!r}"
    if isinstance(window, str | bytes) or not isinstance(window, Sequence | np.ndarray):
        raise error(expected)
    try:
        start, end = (t if t in (-inf, inf) else real_number(name, t, error) for t in window)
    except (TypeError, ValueError, error) as fault:
        raise error(expected) from fault
    if not start < end:
        raise error(expected)
    return float(start), float(end)


def parse_window(text: str, *, of: str = "", timed: bool = True) -> tuple[float, float]:
    """Start and end, in s, of ``"0 s to 60 s"``; `of` is what it is of, for messages.

    Where samples are numbered, those of ``"0 to 300"``.
    """
    bounds, of = text.split(" to "), of or "a window"
    numbered = re.fullmatch(r"\s*(\d{1,9}) to (\d{1,9})\s*", text)
    if not timed and numbered is None:
        raise UnitError(f"{of} must be two numbers of samples such as '0 to 300', got {text!r}")
    if len(bounds) != 2:
        raise UnitError(f"{of} must be two times such as '0 s to 60 s', got {text!r}")
    if numbered and not timed:
        start, end = float(numbered[1]), float(numbered[2])
    else:
        start, end = (parse_quantity(bound, "time", of=of) for bound in bounds)
    if not start < end:
        raise UnitError(f"{of} must end after it starts, got {text!r}")
    return start, end


MOST_SAMPLES = 6000  # most samples of a trace at the default rate


def decimate(values: Array, share: Fraction, start: int, end: int) -> Array:
    """Signal, (N,), from sample `start` to `end` at a lower rate, without delay.

    `share` is the new rate over the old. A symmetric low-pass filter, flat to 0.7 of the new
    Nyquist frequency and at least 40 dB down above it. It also uses the samples before `start` and
    after `end`, and beyond the ends of the signal its point reflection, which keeps value and
    slope there.
    """
    from scipy.signal import firwin, resample_poly

    numerator, denominator = share.numerator, share.denominator
    # The filter reaches over ten new samples; the padding is a whole number of new samples.
    blocks = -(-10 // numerator)
    pad = blocks * denominator
    padded = np.pad(values, pad, mode="reflect", reflect_type="odd")
    taps = firwin(20 * denominator + 1, 0.84 / denominator, window=("kaiser", 5.0))
    window: Any = taps  # scipy's documentation allows taps here, its type stubs do not
    piece = padded[start : end + 2 * pad + 1]
    fine = resample_poly(piece, numerator, denominator, window=window, padtype="line")
    count = (end - start) * numerator // denominator + 1
    return np.asarray(fine[blocks * numerator :][:count], dtype=np.float64)


def default_rate(
    time: Array, displacement: Array, turns: NDArray[np.intp], gap: float, record_rate: float
) -> float:
    """Lowest sampling rate, Hz, that resolves the crossing of a gap and the half-cycles.

    At least 20 samples per crossing of the gap after a turning point, by the lower quartile of
    the crossing times, and 40 per median half-cycle, if the record has them; then the next
    higher rate that is the record's over a whole number. At most `MOST_SAMPLES` samples, which
    comes before all else: a long record gets fewer samples per crossing.
    """
    crossings = crossing_times(time, displacement, turns, gap)
    needs = [20 / float(np.quantile(crossings, 0.25))] if crossings else []
    if turns.size > 1:
        needs.append(40 / float(np.median(np.diff(time[turns]))))
    target_rate = max(needs, default=record_rate)
    divisor = max(1, int(record_rate / target_rate * (1 + 1e-9)))
    return record_rate / max(divisor, ceil(time.size / MOST_SAMPLES))


def crossing_times(
    time: Array, displacement: Array, turns: NDArray[np.intp], gap: float
) -> list[float]:
    """Times, s, from each turning point to a distance `gap` from it, if reached before the next."""
    times = []
    for start, end in zip(turns, [*turns[1:], time.size - 1], strict=False):  # there may be none
        distance = np.abs(displacement[start : end + 1] - displacement[start])
        reached = int(np.argmax(distance >= gap))
        if distance[reached] >= gap and reached > 0:
            share = (gap - distance[reached - 1]) / (distance[reached] - distance[reached - 1])
            k = start + reached
            times.append(float(time[k - 1] + share * (time[k] - time[k - 1]) - time[start]))
    return times


ROLES = ("time", "displacement", "force", "velocity", "actuation")
"""What a column can be; a record needs a time and a displacement."""


def unit_of(
    table: Table, role: str, name: str, units: Mapping[str, str], axes: Axes = DAMPER
) -> str:
    """Unit of a column: as given, or from its name, or from the file's row of units."""
    word = axes.name(role)
    if unit := units.get(role):
        return unit
    ours, theirs = header_unit(name), table.units.get(name)
    if theirs is None:
        if ours is None:
            if name not in table.names:
                raise table.no_column(name)
            raise RecordError(
                f"column {name!r} of {table.path} has no unit in its name; give the unit of {word}"
            )
        return ours
    if ours is None or measure(ours) in (None, "ratio"):  # "force" of "axial_force", 1 of "force_1"
        return theirs
    if not same_unit(ours, theirs):
        raise RecordError(
            f"column {name!r} of {table.path} is in {ours!r} by its name and in {theirs!r} by the "
            f"file's own units; give the unit of {word}"
        )
    return ours


SHARE = 0.1  # of a half-cycle: the length over which the acceleration is smoothed
DATE = 1e8  # s: a time that begins later, after three years, is a date, and its first row is 0 s


@dataclass(frozen=True)
class Subtracted:
    """A column that is taken off, times a quantity such as an area."""

    column: str | int
    unit: str | None = None
    times: str = ""


@dataclass(frozen=True)
class Source:
    """A column of a file, by its name or its number from 1, and what is done to it.

    The keys of a column in a campaign file (`campaign.schema`), which checks which role may have
    which; `rate` stands in place of a column of times.
    """

    column: str | int | None = None
    unit: str | None = None
    minus: Subtracted | None = None
    minus_mass: str = ""
    tare: str = ""
    arm: str = ""
    measured_at: str = ""
    sign: int = 1
    rate: str = ""
    dates: str = ""

    @property
    def plain(self) -> bool:
        """Whether it is the column alone."""
        return self == Source(self.column, self.unit)

    def words(self) -> str:
        """What the signal is, in words."""
        text = f"{'-1 × ' if self.sign < 0 else ''}{self.column} [{self.unit}]"
        if self.measured_at:
            text += f" measured at a radius of {self.measured_at}, wanted at {self.arm}"
        elif self.arm:
            text += f" {'×' if measure(str(self.unit)) == 'ratio' else '÷'} an arm of {self.arm}"
        if self.minus is not None:
            times = f" × {self.minus.times}" if self.minus.times else ""
            text += f" − {self.minus.column}{times}"
        if self.minus_mass:
            text += f" − {self.minus_mass} × acceleration"
        if self.tare:
            text += f" − {'its mean over ' if ' to ' in self.tare else ''}{self.tare}"
        return text

    def scale(self, role: str, unit: str, of: str, axes: Axes = DAMPER) -> tuple[float, str]:
        """Factor from a unit of the column to the internal one of its role, and a unit of the role.

        `of` is what has the unit, for messages.
        """
        if self.measured_at and not self.arm:
            raise UnitError(f"measured_at of {of} needs an arm, the radius of interest")
        if not self.arm:
            return self.sign * axes.factor(unit, role, of=of), unit
        radius = _radius(self.arm, f"arm of {of}")
        if self.measured_at:
            ratio = radius / _radius(self.measured_at, f"measured_at of {of}")
            scale = ratio if role == "displacement" else 1 / ratio
            return self.sign * factor(unit, role, of=of) * scale, unit
        arm, length = split_quantity(self.arm)
        if role == "displacement":
            if measure(unit) == "ratio":
                return self.sign * factor(unit, "dimensionless", of=of) * radius, length
            raise UnitError(
                f"unit {unit!r} of {of} is no angle: with an arm it must be one such as 'deg' or "
                "'rad', or a length with measured_at, the radius at which it was measured"
            )
        scale = factor(f"{unit}/{length}", role, of=f"{of} over its arm")
        terms = [term.strip() for term in unit.replace("·", "*").split("*")]  # "kN" of "kN*m"
        return self.sign * scale / arm, next((p for p in terms if measure(p) == "force"), "kip")


NO_ACTUATION = "100 %"
"""That of tests which have none, of a model in which nothing follows it."""

NUMBERED = Source(rate="1 Hz")
"""The time of samples that are numbered."""


def used_columns(table: Table, sources: Mapping[str, Source]) -> list[str]:
    """Names of all columns that the sources need, each once."""
    columns = [source.column for source in sources.values() if source.column is not None]
    columns += [s.minus.column for s in sources.values() if s.minus is not None]
    return list(dict.fromkeys(table.name_of(column) for column in columns))


def step_of(rate: str, of: str) -> float:
    """Step of time, s, of a rate, "100 Hz", or of a step itself, "10 ms"."""
    value, unit = split_quantity(rate, of=of, example="100 Hz")
    if not value > 0.0:
        raise UnitError(f"{of}: expected a rate above 0, got {rate!r}")
    if measure(unit) == "time":
        return value * factor(unit, "time", of=of)
    return 1.0 / (value * factor(unit, "rate", of=of))


def _take_off(
    table: Table,
    role: str,
    source: Source,
    signals: Mapping[str, Array],
    raw: Mapping[str, Array],
    axes: Axes,
) -> Array:
    """Signal of a role, internal units, less all that its source takes off."""
    signal, of = signals[role], f"the {role} of {table.path}"
    if source.minus is not None:
        subtrahend, minus = source.minus, f"minus of {role}"
        name = table.name_of(subtrahend.column)
        unit = unit_of(
            table, minus, name, {} if subtrahend.unit is None else {minus: subtrahend.unit}
        )
        column = f"column {name!r} of {table.path}"
        if subtrahend.times:
            value, times_unit = split_quantity(subtrahend.times, of=f"times of {column}")
            scale = axes.factor(
                f"{unit}*{times_unit}", role, of=f"{column} times {subtrahend.times}"
            )
            signal = signal - raw[name] * value * scale
        else:
            signal = signal - raw[name] * axes.factor(unit, role, of=column)
    if source.minus_mass:
        mass = parse_mass(source.minus_mass, of=f"minus_mass of {of}")
        if mass < 0.0:
            raise UnitError(
                f"minus_mass of {of}: expected a mass of 0 or more, got {source.minus_mass!r}"
            )
        check_increasing(table, signals["time"])
        signal = signal - mass * acceleration(signals["time"], signals["displacement"])
    if " to " in source.tare:
        start, end = parse_window(source.tare, timed=axes.timed)
        in_window = (signals["time"] >= start) & (signals["time"] <= end)
        if not in_window.any():
            raise RecordError(f"tare of {of}: no sample lies in {source.tare}")
        signal = signal - float(np.mean(signal[in_window]))
    elif source.tare:
        number, unit = split_quantity(source.tare, of=f"tare of {of}")
        try:  # what the column reads at zero, or what the signal does
            signal = signal - number * source.scale(role, unit, f"tare of {of}", axes)[0]
        except UnitError:
            signal = signal - parse_quantity(source.tare, role, of=f"tare of {of}")
    return signal


def acceleration(time: Array, displacement: Array) -> Array:
    """Acceleration, (T,), in/s², of a displacement in in at times in s.

    The second derivative of a cubic fitted to the samples about each (Savitzky and Golay, 1964),
    over a tenth of the median half-cycle; uneven times are evened first. Each piece between gaps
    in time is taken by itself; one of fewer than `SAMPLES` samples has none.
    """
    from scipy.signal import savgol_filter

    result = np.zeros(time.size)
    for piece in np.split(np.arange(time.size), after_gaps(time)):
        if piece.size < SAMPLES:
            continue
        t, x = time[piece], displacement[piece]
        grid = np.linspace(t[0], t[-1], t.size)
        turns = turning_points(x, smallest_turn(x))
        half = float(np.median(np.diff(turns))) if turns.size > 1 else float(t.size)
        window = min(max(2 * int(0.5 * SHARE * half) + 1, 5), t.size - 1 + t.size % 2)
        smooth = np.interp(grid, t, x)
        smooth = savgol_filter(smooth, window, 3, deriv=2, delta=grid[1] - grid[0])
        result[piece] = np.interp(t, grid, smooth)
    return result


def _radius(text: str, of: str) -> float:
    radius = parse_quantity(text, "displacement", of=of)
    if not radius > 0.0:
        raise UnitError(f"{of}: expected a radius above 0, got {text!r}")
    return radius


def sources_of(
    table: Table,
    columns: Mapping[str, str | int | Source] | None,
    units: Mapping[str, str] | None,
    actuation: str | None,
    axes: Axes,
) -> dict[str, Source]:
    """Role to its source, as given or from headers such as ``time_s``, with its column and unit.

    A column for the actuation is looked for only where `actuation`, a constant, is not given; one
    for the time only where there is no rate.
    """
    for name, mapping in (("columns", columns), ("units", units)):
        if mapping is not None and not isinstance(mapping, Mapping):
            raise RecordError(f"{name} must be a mapping from roles, got {type(mapping).__name__}")
    requested = {
        axes.role(r): c if isinstance(c, Source) else Source(c) for r, c in (columns or {}).items()
    }
    stated = {r: s.unit for r, s in requested.items() if s.unit is not None}
    stated |= {axes.role(r): unit for r, unit in (units or {}).items()}
    if not axes.timed:
        requested["time"] = NUMBERED
        stated.pop("time", None)
    if unknown := next((role for role in (*requested, *stated) if role not in ROLES), ""):
        names = ", ".join(map(axes.name, ROLES))
        raise RecordError(f"unknown role {unknown!r} of a column; expected {names}")
    roles = {r: table.name_of(s.column) for r, s in requested.items() if s.column is not None}
    explicit = bool({"time", "displacement"} & roles.keys())  # then what is not named is not used
    rated = "time" in requested and bool(requested["time"].rate)
    required = ["displacement"] if rated else ["time", "displacement"]
    optional = [] if explicit else ["force", "velocity", *["actuation"] * (actuation is None)]
    for role in required + optional:
        if role not in roles:
            for name in table.called(axes.name(role)):
                roles[role] = name
    if actuation is not None and "actuation" in roles:
        raise RecordError(f"actuation of {table.path} is given as {actuation!r} and as a column")
    if missing := [role for role in required if role not in roles]:
        raise _no_column_for(missing[0], table, axes)
    sources = {"time": requested["time"]} if rated else {}
    for role in (role for role in ROLES if role in roles):
        name, source = roles[role], requested.get(role, Source(roles[role]))
        sources[role] = replace(source, column=name, unit=unit_of(table, role, name, stated, axes))
    return sources


def _no_column_for(role: str, table: Table, axes: Axes) -> RecordError:
    """Error for a role that no column of a table has."""
    name, columns = axes.name(role), ", ".join(table.names[:20])
    if not table.headed:
        return RecordError(
            f"{table.path} has no names, only {columns}: say in a campaign "
            'which is which, as time = { column = 1, unit = "ms" }; mfd-bayes init guesses it'
        )
    examples = {"time": "time_s", "displacement": "displacement_mm"}
    example = examples.get(name, f"{name}_{axes.motion.unit}")
    rate = '; where it has none, give its rate: rate = "100 Hz"' if role == "time" else ""
    return RecordError(
        f"no column for {name} in {table.path}, which has {columns}: rename it in the file, as "
        f"{example}, or name it in [columns] of a campaign, or in Python by columns{rate}"
    )


def signals_of(
    table: Table, sources: Mapping[str, Source], axes: Axes
) -> tuple[dict[str, Array], dict[str, tuple[str, str]], ActuationUnit | None]:
    """Role to signal, internal units, and to name and unit; unit of a measured actuation."""
    raw = table.columns(used_columns(table, sources), sources["time"].dates)
    signals: dict[str, Array] = {}
    columns: dict[str, tuple[str, str]] = {}
    internal: ActuationUnit | None = None
    for role, source in sources.items():
        name, unit = str(source.column), str(source.unit)
        of = f"column {name!r} of {table.path}"
        with np.errstate(over="ignore"):  # check_size refuses infinity
            if role == "time":
                signals[role] = _times(table, source, raw)
            elif role == "actuation":
                scale, internal = actuation_factor(unit, of=of)
                signals[role] = raw[name] * scale
            else:
                scale, unit = source.scale(role, unit, of, axes)
                signals[role] = raw[name] * scale
        check_size(of, role, signals[role])
        if source.rate:
            name, unit = f"sample number at {source.rate}", "s"
        if owner := next((r for r, (column, _) in columns.items() if column == name), ""):
            raise RecordError(f"column {name!r} of {table.path} is given for {owner} and {role}")
        columns[role] = name, unit
    if not axes.timed:
        del columns["time"]
    for role, source in sources.items():
        if not source.plain and source.column is not None:
            signals[role] = _take_off(table, role, source, signals, raw, axes)
            check_size(f"the {role} of {table.path}", role, signals[role])
    if "actuation" in signals:
        if np.mean(signals["actuation"]) < 0:
            raise RecordError(f"the actuation of {table.path} is negative on average")
        # Single samples below zero are the sensor's noise.
        signals["actuation"] = np.maximum(signals["actuation"], 0.0)
    for signal in signals.values():
        signal.flags.writeable = False
    return signals, columns, internal


def _times(table: Table, source: Source, raw: Mapping[str, Array]) -> Array:
    """Times, s, of a rate or of a column; dates are counted from the first row."""
    if source.rate:
        rows = next(iter(raw.values())).size
        return step_of(source.rate, f"the rate of {table.path}") * np.arange(rows, dtype=np.float64)
    name = str(source.column)
    scale, _ = source.scale("time", str(source.unit), f"column {name!r} of {table.path}")
    start = raw[name][np.argmax(np.isfinite(raw[name]))]
    with np.errstate(over="ignore", invalid="ignore"):  # check_size refuses infinity
        times: Array = (raw[name] - start if start * scale >= DATE else raw[name]) * scale
    return times


def part_for(table: Table, sources: Mapping[str, Source], window: tuple[float, float]) -> Table:
    """The table, or the rows about a window, s, where others have no numbers or times that go back.

    Those are the rows that hold all times of the window; where there are none, or several, the
    table is refused later, with the place of its first fault.
    """
    raw = table.values(used_columns(table, sources), sources["time"].dates)
    bad = np.any([np.isnan(column) for column in raw.values()], axis=0)
    time = _times(table, sources["time"], raw)
    backward = np.append(False, np.diff(time) <= 0.0)
    in_window = time[(time >= window[0]) & (time <= window[1])]
    if (
        not np.any(bad | backward)
        or not in_window.size
        or any(map(backward.__getitem__, table.blocks))
    ):
        return table
    bounds = np.unique([0, *np.flatnonzero(bad | backward), *np.flatnonzero(bad) + 1, time.size])
    pieces = [
        (int(start), int(end))
        for start, end in pairwise(bounds)
        if time[start] <= in_window.min() and time[end - 1] >= in_window.max()
    ]
    if len(pieces) != 1:
        return table
    ((start, end),) = pieces
    faults = {"cells that hold no numbers": bad, "times that go back": backward}
    text = " and ".join(
        f"{words}, the first at {table.place(int(np.argmax(rows)))},"
        for words, rows in faults.items()
        if np.any(rows)
    )
    return table.part(
        start,
        end,
        f"{text} lie outside the window: {table.place(start)} to {table.place(end - 1)} are read",
    )


Window = tuple[float, float]

STILL = 1e-9  # a peak-to-peak displacement of at most this, in, is no motion


@dataclass(frozen=True, eq=False)
class Record:
    """A test as measured, in internal units. Made by `read_record`, which checks it.

    Attributes
    ----------
    path, sha256 : Path, str
        The file, and the hash of its bytes.
    time : (T,), s
        Strictly increasing, without a gap.
    displacement : (T,), in
    force : (T,), kip, or None
    velocity : (T,), in/s, or None
    actuation : float or (T,), ksi (pressure) or kip (tension), or None
    actuation_unit : "ksi", "kip" or None
    columns : dict
        Role to the column's name and unit in the file; of a derived one, a unit of its role.
    other_columns : tuple of str
        Names of the file's columns that have no role.
    rivals : dict
        Those of them that could have the role of a time, a displacement or a force by their unit:
        name to the role and the numbers, (T,), in s, in or kip.
    clock : Clock
        Its rate, and how even that is.
    derived : dict
        Role to what it is made of, in words, where it is more than a column.
    gap : str
        Which piece of the file this is, where time has a gap.
    window : (float, float), s, or None
        Window that `trace` takes by default.
    given_actuation : str
        The constant actuation as it was given; "" where there is none.
    stated_units : dict
        Role to what the file's row of units, or a channel's properties, say of its column.
    notes, doubts : tuple of str
        Sentences on numbers of the file that are not in the record, and on those of them that
        probably belong to it.
    axes : Axes
        What displacement and force are, where they are a model's own motion and response.
    """

    path: Path
    sha256: str
    time: Array
    displacement: Array
    force: Array | None
    velocity: Array | None
    actuation: float | Array | None
    actuation_unit: ActuationUnit | None
    columns: dict[str, tuple[str, str]]
    other_columns: tuple[str, ...]
    rivals: dict[str, tuple[str, Array]]
    clock: Clock
    derived: dict[str, str] = field(default_factory=dict)
    gap: str = ""
    window: Window | None = None
    given_actuation: str = ""
    stated_units: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    axes: Axes = DAMPER

    def __repr__(self) -> str:
        force = "no force" if self.force is None else f"force {np.ptp(self.force):.4g} kip in all"
        return (
            f"Record({self.path.name!r}; {self.time.size} samples over {np.ptp(self.time):.4g} s, "
            f"{self.rate:.4g} Hz; displacement {np.ptp(self.displacement):.4g} in in all; {force})"
        )

    @property
    def rate(self) -> float:
        """Sampling rate, Hz."""
        return self.clock.rate

    @property
    def jitter(self) -> float:
        """Largest distance of a sample from a uniform grid between the ends, in steps."""
        return self.clock.jitter

    @cached_property
    def turning_points(self) -> int:
        """Number of turning points."""
        return _turns(self.displacement).size

    def around(
        self, trace: Trace, since: float = -math.inf
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Displacements at both ends and the turns of what a trace of it leaves out, in.

        First of what comes before the trace, since a time in s, then of what comes after it; empty
        where all of the record is in it.
        """
        check_trace(trace, RecordError)
        if since != -math.inf:
            since = real_number("since, in s,", since, RecordError)
        if self.window is None:
            return (), ()
        preceding = (self.time > since) & (self.time < trace.time[0])
        pieces = (self.displacement[preceding], self.displacement[self.time > trace.time[-1]])
        ends = [x[[0, *_turns(x), -1]].tolist() if x.size else [] for x in pieces]
        return tuple(ends[0]), tuple(ends[1])

    def trace(
        self, rate: float | None = None, *, window: Window | None = None, gap: float | None = None
    ) -> Trace:
        """Trace of this record, or of a window of it, at a sampling rate.

        Parameters
        ----------
        rate : float, Hz, optional
            Decimated to this rate behind a low-pass filter without delay; every sample is kept
            where the record's own rate is lower.
        window : (float, float), s, optional
            In the record's own time; the record's by default.
        gap : float, in, optional
            Width of the device's gap: without a rate, one that resolves it is taken.
        """
        if gap is not None:
            gap = real_number("gap, in inches,", gap, RecordError, (0.0, math.inf), exclusive=True)
        if rate is not None:
            rate = real_number("rate, in Hz,", rate, RecordError, (0.0, math.inf), exclusive=True)
        cut = _slice(self, self.window if window is None else window)
        grid = self.time
        signals = {role: getattr(self, role) for role in ROLES if role != "time"}
        signals = {role: v for role, v in signals.items() if isinstance(v, np.ndarray)}
        if rate is None and gap is not None:
            x = self.displacement[cut]
            rate = default_rate(self.time[cut], x, _turns(x), gap, self.rate)
        if rate is None or rate >= self.rate * (1 - 1e-9):
            return self._as_trace(grid[cut], {role: v[cut] for role, v in signals.items()})
        if self.jitter > JITTER:  # only even samples can be filtered
            duration = float(self.time[-1] - self.time[0])
            grid = self.time[0] + np.arange(int(duration * self.rate) + 1) / self.rate
            signals = {role: np.interp(grid, self.time, v) for role, v in signals.items()}
        start, end = self.time[cut][[0, -1]]
        begin, stop = np.flatnonzero((grid >= start) & (grid <= end))[[0, -1]].tolist()
        share = 1 / Fraction(min(self.rate / rate, 1e9)).limit_denominator(1000)
        count = (stop - begin) * share.numerator // share.denominator + 1
        if count < SAMPLES:
            raise RecordError(f"{rate:g} Hz leaves fewer than {SAMPLES} samples of {self.path}")
        time = grid[begin] + np.arange(count) / (float(share) * self.rate)
        signals = {role: decimate(v, share, begin, stop) for role, v in signals.items()}
        return self._as_trace(time, signals)

    def _as_trace(self, time: Array, signals: dict[str, Array]) -> Trace:
        history = signals.get("actuation")
        trace = Trace.from_arrays(
            time,
            signals["displacement"],
            # The filter may go below zero next to a jump.
            self.actuation if history is None else np.maximum(history, 0.0),
            signals.get("force"),
            signals.get("velocity"),
        )
        return trace if self.axes.timed else replace(trace, timed=False)


def read_record(
    path: str | Path,
    columns: Mapping[str, str | int | Source] | None = None,
    units: Mapping[str, str] | None = None,
    actuation: str | None = None,
    *,
    window: str | Window | None = None,
    axes: Axes = DAMPER,
) -> Record:
    """Record of a file that `readers` can read, checked and in internal units.

    Parameters
    ----------
    path : str or Path
    columns : mapping, optional
        Role (`ROLES`) to a column's name, its number from 1, or a `Source`. Where it gives neither
        time nor displacement, the other roles are taken from headers such as ``time_s`` or
        ``displacement_in``.
    units : mapping, optional
        Role to unit. By default the unit is read from the column's name, behind its last
        underscore or in brackets, or else from the file's row of units.
    actuation : str, optional
        Constant level: ``"500 psi"`` or ``"30 lbf"``. For a measured one, name its column.
    window : str or (float, float), s, optional
        Window that `Record.trace` takes by default: ``"0 s to 60 s"``.
    axes : Axes, optional
        `Model.axes` of a model with other quantities than displacement and force, or without time:
        columns are then called by its names, samples are numbered where time does not matter.

    Raises
    ------
    RecordError
        When the file, a column, a cell, the time or the motion cannot be used.
    UnitError
        When a unit is unknown or does not measure what its column should.
    """
    path = path_of("path", path, RecordError)
    table = read_table(path)
    sources = sources_of(table, columns, units, actuation, axes)
    if isinstance(window, str):
        window = parse_window(window, timed=axes.timed)
    if window is not None:
        window = checked_window(window)
        table = part_for(table, sources, window)
    signals, names, unit = signals_of(table, sources, axes)
    check_increasing(table, signals["time"])
    piece, gap = longest_piece(signals["time"], table.place, window)
    if piece.stop - piece.start < SAMPLES:
        raise RecordError(f"{gap}: fewer than the {SAMPLES} samples that are needed in {path}")
    rows = signals["time"].size
    signals = {role: signal[piece] for role, signal in signals.items()}
    level: float | Array | None = signals.get("actuation")
    if actuation is not None:
        level, unit = parse_actuation(actuation, of=f"the actuation of {path}")
    other_columns = tuple(n for n in table.names if n not in used_columns(table, sources))
    rivals = _rivals(table, other_columns, names) if axes.of_damper else {}
    record = Record(
        path=path,
        sha256=hash_file(path),
        time=signals["time"],
        displacement=signals["displacement"],
        force=signals.get("force"),
        velocity=signals.get("velocity"),
        actuation=level,
        actuation_unit=unit,
        columns=names,
        other_columns=other_columns,
        rivals={
            name: (role, values[piece])
            for name, (role, values) in rivals.items()
            if values.size == rows
        },
        clock=clock_of(signals["time"]),
        derived={
            role: source.words()
            for role, source in sources.items()
            if not source.plain and source.column is not None
        },
        gap=gap,
        window=window,
        given_actuation=actuation or "",
        stated_units={r: table.units[n] for r, (n, _) in names.items() if n in table.units},
        notes=table.notes,
        doubts=table.doubts,
        axes=axes,
    )
    displacement = despiked(record.displacement[_slice(record, window)])
    location = f"{path}" + (" in the window" if window else "")
    if np.ptp(displacement) <= (STILL if axes.of_damper else 0.0):
        raise RecordError(f"{axes.motion.name} in {location} is constant")
    count = _turns(displacement).size
    if count < 2:
        raise RecordError(f"motion in {location} has {count} turning points; at least 2 are needed")
    return record


_NOT_MEASURED = re.compile(r"command|cmd|setpoint|target|ref|reference|desired|error|nominal")


def _rivals(
    table: Table, names: Sequence[str], columns: Mapping[str, tuple[str, str]]
) -> dict[str, tuple[str, Array]]:
    """Columns that could have a role by their unit: name to role and numbers, internal units.

    A time increases, and may be called as the one that is used where it has no unit.
    """
    rivals: dict[str, tuple[str, Array]] = {}
    kinds = {"time": "time", "length": "displacement", "force": "force"}
    for name in names:
        unit = stated_unit(name, table.units.get(name, "")) or header_unit(name) or ""
        role = kinds.get(measure(unit) or "")
        if role is None and "time" in columns and _same_name(name, columns["time"][0]):
            role, unit = "time", columns["time"][1]
        if role is None or any(map(_NOT_MEASURED.fullmatch, re.findall(r"[a-z]+", name.lower()))):
            continue
        try:
            values = table.columns([name])[name] * factor(unit, role)
            check_magnitude(name, values)
        except MfdError:
            continue
        if role != "time" or np.all(np.diff(values) > 0.0):
            rivals[name] = role, values
    return rivals


def _same_name(name: str, reference: str) -> bool:
    """Whether two columns have one name but for numbers and what is in brackets."""
    bare = [re.sub(r"[\[(].*?[\])]|[\d\W_]+", "", own_name(n)).lower() for n in (name, reference)]
    return bare[0] == bare[1] != ""


def _slice(record: Record, window: Window | None) -> slice:
    """Samples of a window, both ends included."""
    if window is None:
        return slice(0, record.time.size)
    start, end = checked_window(window)
    begin = int(np.searchsorted(record.time, start, side="left"))
    stop = int(np.searchsorted(record.time, end, side="right"))
    if not stop - begin >= SAMPLES:
        unit = " s" if record.axes.timed else ""
        raise RecordError(
            f"window {start:g}{unit} to {end:g}{unit} holds {max(stop - begin, 0)} samples of "
            f"{record.path}, which runs from {record.time[0]:g}{unit} to "
            f"{record.time[-1]:g}{unit}; "
            f"at least {SAMPLES} are needed"
        )
    return slice(begin, stop)


def _turns(displacement: Array) -> NDArray[np.intp]:
    return turning_points(displacement, smallest_turn(displacement))
