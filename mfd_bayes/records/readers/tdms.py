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
from mfd_bayes.records.readers.child import (
    Content,
    UnreadableError,
    import_library,
    read_in_child,
)
from mfd_bayes.records.readers.table import Column, Table, bare_unit
from mfd_bayes.units import factor, measure

SAMPLES = 50_000_000  # most samples of all channels: an hour and a half of ten at 1024 Hz
EVEN = 1e-6  # steps of time that differ by a smaller share are equal
SHARE = 0.02  # of a step: channels that are out of step by less are in step
_KINDS = {"O": "text", "U": "text", "c": "complex numbers"}
_LABVIEW = np.datetime64("1904-01-01", "us")  # a start time that a writer left at its zero


@dataclass(frozen=True)
class _Clock:
    """Sampling times of a waveform: its step, first time and end, s."""

    step: float
    begin: float
    samples: int
    dated: bool  # whether the file says when it began

    @property
    def end(self) -> float:
        return self.begin + self.step * self.samples

    def even(self, other: _Clock) -> bool:
        """Whether the steps are the same."""
        return math.isclose(self.step, other.step, rel_tol=EVEN)


def read_tdms(path: Path) -> Table:
    """Table of a .tdms file: its channels, called ``group/channel`` where two share a name.

    Where no channel is a time, a column ``time`` is made from the increments of the waveforms;
    ``group/time`` where groups were sampled at different times.
    """
    import_library(path, "nptdms", "npTDMS", "tdms")
    facts, arrays = read_in_child(_channels, path, "a TDMS file")
    found = facts["channels"]
    if not found:
        raise RecordError(f"{path} holds no channel with data")
    shared = Counter(one["name"] for one in found)
    names = [c["name"] if shared[c["name"]] == 1 else f"{c['group']}/{c['name']}" for c in found]
    columns = dict(zip(names, arrays, strict=True))
    starts = (one["properties"].get("wf_start_time") for one in found)
    first = min((start for start in starts if isinstance(start, float)), default=0.0)
    kinds, units, groups, clocks = {}, {}, {}, {}
    for name, one in zip(names, found, strict=True):
        kind, own = one["kind"], one["properties"]
        unit = own.get("unit_string") or own.get("NI_UnitDescription") or ""
        kinds[name], groups[name] = kind, one["group"]
        units[name] = "s" if kind == "M" else bare_unit(str(unit))
        if kind in "fiub" and (clock := _clock(one, first)) is not None:
            clocks[name] = clock
    timed = {  # channels that are a time by their kind, their name or their unit
        name
        for name in names
        if kinds[name] in "fiubM"
        and ("time" in name.rpartition("/")[2].lower() or measure(units[name]) == "time")
    }
    times: dict[str, _Clock] = {}  # for each group whose channels share a step: first to last
    for group in () if timed else dict.fromkeys(groups[name] for name in clocks):
        own = [clock for name, clock in clocks.items() if groups[name] == group]
        begin = min(own, key=lambda clock: clock.begin)
        if all(clock.even(begin) for clock in own):
            ends = [round((c.begin - begin.begin) / c.step) + c.samples for c in own]
            times[f"{group}/time"] = replace(begin, samples=max(ends))
    if len(set(times.values())) == 1:  # one for all
        times = {"time": next(iter(times.values()))}
    times = {name: clock for name, clock in times.items() if name not in columns}

    def load(wanted: Sequence[str]) -> dict[str, Column]:
        for name in wanted:
            if name in kinds and kinds[name] not in "fiubM":
                held = _KINDS.get(kinds[name], "no numbers")
                raise RecordError(f"channel {name!r} of {path} holds {held}; expected numbers")
        own = {n: clock for n in wanted if n not in timed and (clock := (times | clocks).get(n))}
        read: dict[str, Column] = {
            name: times[name].begin + times[name].step * np.arange(times[name].samples)
            if name in times
            else np.array(columns[name], dtype=np.float64)
            for name in wanted
        }
        return read | _together(path, own, read, timed=bool(timed))

    return Table(
        path,
        (*times, *names),
        load,
        units={name: unit for name, unit in units.items() if unit} | dict.fromkeys(times, "s"),
        notes=_apart(clocks),
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


def _clock(one: dict[str, Any], first: float) -> _Clock | None:
    """Clock of a waveform over time; start times count from that of the first channel."""
    own = one["properties"]
    step, start, began = (own.get(f"wf_{n}") for n in ("increment", "start_offset", "start_time"))
    start = 0.0 if start is None else start
    unit = bare_unit(str(own.get("wf_xunit_string", ""))) or "s"
    if not (isinstance(step, float) and isinstance(start, float) and measure(unit) == "time"):
        return None
    if not (0.0 < step < math.inf and math.isfinite(start)):
        return None
    scale, dated = factor(unit, "time"), isinstance(began, float)
    begin = start * scale + (began - first if isinstance(began, float) else 0.0)
    return _Clock(step * scale, begin, one["samples"], dated)


def _apart(clocks: Mapping[str, _Clock]) -> tuple[str, ...]:
    """Sentence on channels that do not begin, end or step as the first of them does."""
    said = []
    first = min(clocks, key=lambda name: clocks[name].begin, default="")
    for name, clock in clocks.items():
        one = clocks[first]
        if clock.begin >= one.end:
            continue  # of another test
        if not clock.even(one):
            steps = f"{first} has a step of {one.step:g}, {name} of {clock.step:g}"
            return (f"{steps}: they cannot be used together",)
        if clock.begin > one.begin:
            said.append(f"{name} begins {clock.begin - one.begin:.6g} s after {first}")
        elif clock.samples != one.samples:
            said.append(f"{name} has {clock.samples} samples, {first} {one.samples}")
    more = f", and {len(said) - 3} more" if len(said) > 3 else ""
    return (f"{', '.join(said[:3])}{more}: only what channels share is used",) if said else ()


def _together(
    path: Path, clocks: Mapping[str, _Clock], columns: Mapping[str, Column], *, timed: bool
) -> dict[str, Column]:
    """Columns while all of them were measured, at the samples of the one that began last.

    Refused where they have other steps, are never measured together, or differ though the file
    has one time for all of them, which is `timed`.
    """
    if len(set(clocks.values())) < 2:
        return {}
    first, one = next(iter(clocks.items()))
    for name, clock in clocks.items():
        late = clock.begin - one.begin
        if not clock.even(one):
            raise RecordError(
                f"{path}: {first} has a step of {one.step:g} s and {name} one of {clock.step:g} s"
                + (", and the file has one time" if timed else ": resample them first")
            )
        if timed and abs(late) > SHARE * one.step:
            way = "after" if late > 0 else "before"
            raise RecordError(
                f"{path}: {name} begins {abs(late):.6g} s {way} {first}, and the file has one time"
            )
        if clock.dated != one.dated and late:
            raise RecordError(
                f"{path}: of {first} and {name} only one has a start time, wf_start_time, which "
                "is not that of the file's first channel: they cannot be aligned"
            )
    if timed:
        return {}
    start = max(clock.begin for clock in clocks.values())
    size = math.floor((min(c.end for c in clocks.values()) - start) / one.step + SHARE)
    if size < 1:
        raise RecordError(f"{path}: {' and '.join(clocks)} are never measured at the same time")
    found: dict[str, Column] = {}
    for name, clock in clocks.items():
        begin, values = (start - clock.begin) / one.step, np.asarray(columns[name], np.float64)
        if abs(begin - round(begin)) < SHARE:
            found[name] = values[round(begin) : round(begin) + size]
        else:
            found[name] = np.interp(begin + np.arange(size), np.arange(values.size), values)
    size = min(map(len, found.values()))
    return {name: column[:size] for name, column in found.items()}
