"""Columns out of LabVIEW's TDMS files."""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.child import Content, UnreadableError, read_in_child
from mfd_bayes.records.readers.table import Array, Column, Table, bare_unit
from mfd_bayes.units import factor, measure

SAMPLES = 50_000_000  # most samples of all channels: an hour and a half of ten at 1024 Hz
EVEN = 1e-6  # steps of time that differ by a smaller share are equal
SHARE = 0.02  # of a step: channels that are out of step by less are in step
_KINDS = {"O": "text", "U": "text", "c": "complex numbers"}
_LABVIEW = np.datetime64("1904-01-01", "us")  # a start time that a writer left at its zero


@dataclass(frozen=True)
class _Clock:
    """Sampling times of a waveform: `start` and `increment` in a unit, `began` in s."""

    increment: float
    start: float
    unit: str
    samples: int
    began: float | None = None  # since the file's first channel with a start time

    @property
    def begin(self) -> float:
        """Time of the first sample, in the unit of the axis."""
        return self.start + (0.0 if self.began is None else self.began / factor(self.unit, "time"))


@dataclass(frozen=True, eq=False)
class _Channel:
    """A channel: its numbers, and its clock where it is a waveform over time."""

    group: str
    name: str
    kind: str  # of numpy's data type: "f", "i", …
    unit: str  # empty where the file gives none
    clock: _Clock | None
    values: Array


def read_tdms(path: Path) -> Table:
    """Table of a .tdms file: its channels, called ``group/channel`` where two share a name.

    Where no channel is a time, a column ``time`` is made from the increments of the waveforms;
    ``group/time`` where groups were sampled at different times.
    """
    try:
        import nptdms  # noqa: F401  # a copy of this process has it then
    except ImportError as error:
        raise RecordError(
            f'reading {path} needs npTDMS, which is not installed: pip install "mfd_bayes[tdms]"'
        ) from error
    facts, arrays = read_in_child(_channels, path, "a TDMS file")
    found = [
        _described(one, np.array(values, dtype=np.float64))
        for one, values in zip(facts["channels"], arrays, strict=True)
    ]
    if not found:
        raise RecordError(f"{path} holds no channel with data")
    first = min(
        (c.clock.began for c in found if c.clock and c.clock.began is not None), default=0.0
    )
    found = [
        replace(c, clock=replace(c.clock, began=c.clock.began - first))
        if c.clock is not None and c.clock.began is not None
        else c
        for c in found
    ]
    shared = Counter(channel.name for channel in found)
    channels = {c.name if shared[c.name] == 1 else f"{c.group}/{c.name}": c for c in found}
    timed = {n for n, c in channels.items() if c.kind in "fiubM" and _is_time(c)}
    clocks = {} if timed else {n: c for n, c in _clocks(found).items() if n not in channels}

    def load(wanted: Sequence[str]) -> dict[str, Column]:
        for name in wanted:
            kind = channels[name].kind if name in channels else "f"
            if kind not in "fiubM":
                held = _KINDS.get(kind, "no numbers")
                raise RecordError(f"channel {name!r} of {path} holds {held}; expected numbers")
        own = {n: channels[n].clock for n in wanted if n in channels and n not in timed}
        given = {name: clock for name, clock in own.items() if clock is not None}
        if timed:
            _check_alike(path, given)
            given = {}
        columns: dict[str, Column] = {
            name: clocks[name].begin + clocks[name].increment * np.arange(clocks[name].samples)
            if name in clocks
            else channels[name].values.copy()
            for name in wanted
        }
        given |= {name: clocks[name] for name in wanted if name in clocks}
        return columns | _together(path, given, columns)

    units = {name: "s" if c.kind == "M" else c.unit for name, c in channels.items()}
    units |= {name: clock.unit for name, clock in clocks.items()}
    return Table(
        path,
        (*clocks, *channels),
        load,
        lambda row: f"sample {row + 1}",
        {name: unit for name, unit in units.items() if unit},
        notes=_apart(channels),
        head=tuple(facts["settings"]),
    )


def _channels(path: Path) -> Content:
    """Names, properties and numbers of all channels that have data."""
    from nptdms import TdmsFile
    from nptdms.log import log_manager

    log_manager.set_level(logging.ERROR)  # its warnings are errors here
    channels: list[dict[str, Any]] = []
    arrays: list[NDArray[np.generic]] = []
    # Given a path, nptdms would read an index file beside it, which may belong to another.
    with path.open("rb") as stream, TdmsFile.open(stream) as file:
        for name, status in (file.file_status.channel_statuses or {}).items():
            if status.read_length < status.expected_length:
                raise UnreadableError(
                    f"is cut off: its last part declares {status.expected_length:,} samples of "
                    f"channel {name} and holds {status.read_length:,}"
                )
        every = [channel for group in file.groups() for channel in group.channels()]
        if sum(map(len, every)) > SAMPLES:
            raise UnreadableError(f"holds more than {SAMPLES:,} samples, the most that are read")
        for channel in every:
            kind = np.dtype(channel.dtype).kind
            if not len(channel):
                continue
            values = np.empty(0)
            if kind == "M":
                stamps = channel[:].astype("M8[us]")
                values = (stamps - stamps[0]) / np.timedelta64(1, "s")
            elif kind in "fiub":
                values = np.asarray(channel[:], dtype=np.float64)
            own = {name: _plain(value) for name, value in channel.properties.items()}
            channels.append(
                {"group": channel.group_name, "name": channel.name, "kind": kind}
                | {"samples": len(channel), "properties": own}
            )
            arrays.append(values)
        settings = [
            f"{name}: {value}"
            for one in (file, *file.groups())
            for name, value in one.properties.items()
        ]
    return {"channels": channels, "settings": settings}, arrays


def _plain(value: Any) -> float | str | None:
    """A property as a number or a text; a moment as its seconds since 2020, about."""
    if isinstance(value, np.datetime64):
        if np.isnat(value) or abs(value - _LABVIEW) < np.timedelta64(3650, "D"):
            return None
        return float((value - np.datetime64("2020", "us")) / np.timedelta64(1, "s"))
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        return str(value)
    return float(value)


def _described(one: dict[str, Any], values: Array) -> _Channel:
    own = one["properties"]
    unit = own.get("unit_string") or own.get("NI_UnitDescription") or ""
    increment, start = own.get("wf_increment"), own.get("wf_start_offset", 0.0)
    axis = bare_unit(str(own.get("wf_xunit_string", ""))) or "s"
    clock = None
    if (
        isinstance(increment, float)
        and isinstance(start, float)
        and 0.0 < increment < math.inf
        and math.isfinite(start)
        and measure(axis) == "time"
    ):
        began = own.get("wf_start_time")
        known = began if isinstance(began, float) else None
        clock = _Clock(increment, start, axis, one["samples"], known)
    return _Channel(one["group"], one["name"], one["kind"], bare_unit(str(unit)), clock, values)


def _is_time(channel: _Channel) -> bool:
    """Whether a channel is a time by its kind, its name or its unit."""
    named = "time" in channel.name.lower() or measure(channel.unit) == "time"
    return channel.kind == "M" or named


def _apart(channels: Mapping[str, _Channel]) -> tuple[str, ...]:
    """Sentence on channels that do not begin, end or step as the first of them does."""
    clocks = {n: c.clock for n, c in channels.items() if c.kind in "fiub" and c.clock is not None}
    said = []
    first = min(clocks, key=lambda name: clocks[name].begin, default="")
    for name, clock in clocks.items():
        one = clocks[first]
        if clock.begin >= one.begin + one.increment * one.samples:
            continue  # of another test
        if not math.isclose(clock.increment, one.increment, rel_tol=EVEN):
            steps = f"{first} has a step of {one.increment:g}, {name} of {clock.increment:g}"
            return (f"{steps}: they cannot be used together",)
        if clock.begin > one.begin:
            said.append(f"{name} begins {clock.begin - one.begin:.6g} {clock.unit} after {first}")
        elif clock.samples != one.samples:
            said.append(f"{name} has {clock.samples} samples, {first} {one.samples}")
    more = f", and {len(said) - 3} more" if len(said) > 3 else ""
    return (f"{', '.join(said[:3])}{more}: only what channels share is used",) if said else ()


def _check_alike(path: Path, clocks: Mapping[str, _Clock]) -> None:
    """Refuse waveforms of different clocks beside a channel of times, which is that of one."""
    for name, other in list(clocks.items())[1:]:
        first, one = next(iter(clocks.items()))
        even = math.isclose(one.increment, other.increment, rel_tol=EVEN)
        if not even or abs(other.begin - one.begin) > SHARE * one.increment:
            raise RecordError(
                f"{_differ(path, first, one, name, other)}, and the file has one time"
            )


def _together(
    path: Path, clocks: Mapping[str, _Clock], columns: Mapping[str, Column]
) -> dict[str, Column]:
    """Columns while all of them were measured, at the samples of the one that began last.

    Raises
    ------
    RecordError
        When they have other steps, or are never measured together.
    """
    if len(set(clocks.values())) < 2:
        return {}
    names = list(clocks)
    first = clocks[names[0]]
    late: dict[str, float] = {}
    for name, clock in clocks.items():
        alike = math.isclose(clock.increment, first.increment, rel_tol=EVEN)
        if clock.unit != first.unit or not alike:
            raise RecordError(f"{_differ(path, names[0], first, name, clock)}: resample them first")
        if (clock.began is None) != (first.began is None) and (clock.began or first.began):
            raise RecordError(
                f"{path}: of {names[0]} and {name} only one has a start time, wf_start_time, which "
                "is not that of the file's first channel: they cannot be aligned"
            )
        late[name] = (clock.begin - first.begin) / first.increment
    start = max(late.values())
    size = math.floor(min(late[n] + c.samples for n, c in clocks.items()) - start + SHARE)
    if size < 1:
        raise RecordError(f"{path}: {' and '.join(names)} are never measured at the same time")
    found: dict[str, Column] = {}
    for name in names:
        begin, values = start - late[name], np.asarray(columns[name], dtype=np.float64)
        if abs(begin - round(begin)) < SHARE:
            found[name] = values[round(begin) : round(begin) + size]
        else:
            found[name] = np.interp(begin + np.arange(size), np.arange(values.size), values)
    sizes = min(len(column) for column in found.values())
    return {name: column[:sizes] for name, column in found.items()}


def _differ(path: Path, one: str, first: _Clock, other: str, second: _Clock) -> str:
    """Sentence on two channels whose clocks differ."""
    even = math.isclose(first.increment, second.increment, rel_tol=EVEN)
    if first.unit != second.unit or not even:
        return (
            f"{path}: {one} has a step of {first.increment:g} {first.unit} and {other} one of "
            f"{second.increment:g} {second.unit}"
        )
    late = second.begin - first.begin
    way = "after" if late > 0 else "before"
    return f"{path}: {other} begins {abs(late):.6g} {first.unit} {way} {one}"


def _clocks(channels: Sequence[_Channel]) -> dict[str, _Clock]:
    """Name to clock: one for all channels, or one for each group whose channels share a step.

    It is that of the first to begin to the last to end.
    """
    groups: dict[str, list[_Clock]] = {}
    for channel in channels:
        if channel.kind in "fiub" and channel.clock is not None:
            groups.setdefault(channel.group, []).append(channel.clock)
    found: dict[str, _Clock] = {}
    for group, own in groups.items():
        first = min(own, key=lambda clock: clock.begin)
        alike = all(
            c.unit == first.unit and math.isclose(c.increment, first.increment, rel_tol=EVEN)
            for c in own
        )
        if alike:
            ends = [round((c.begin - first.begin) / c.increment) + c.samples for c in own]
            found[f"{group}/time"] = replace(first, samples=max(ends))
    if len(set(found.values())) == 1:
        return {"time": next(iter(found.values()))}
    return found
