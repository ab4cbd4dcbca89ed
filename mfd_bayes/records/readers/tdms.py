"""Columns out of LabVIEW's TDMS files."""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers.child import Content, UnreadableError, read_in_child
from mfd_bayes.records.readers.table import Column, Table, bare_unit
from mfd_bayes.units import factor, measure

SAMPLES = 50_000_000  # most samples of all channels: an hour and a half of ten at 1024 Hz
EVEN = 1e-6  # steps of time that differ by a smaller share are equal
SHARE = 0.02  # of a step: channels that are out of step by less are in step
_NUMBERS = "fiub"  # kinds of NumPy's types that are numbers
_KINDS = {"O": "text", "U": "text", "c": "complex numbers"}
_LABVIEW = np.datetime64("1904-01-01", "us")  # a start time that a writer left at its zero


class _Clock(NamedTuple):
    """Sampling times of a waveform: its step and first time, s."""

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
    facts, arrays = read_in_child(_channels, path, "a TDMS file", library="npTDMS", extra="tdms")
    count = Counter(channel["name"] for channel in facts["channels"])
    channels = {
        c["name"] if count[c["name"]] == 1 else f"{c['group']}/{c['name']}": c
        for c in facts["channels"]
    }
    if not channels:
        raise RecordError(f"{path} holds no channel with data")
    columns: dict[str, Column] = {name: arrays[str(k)] for k, name in enumerate(channels)}
    texts = {name: c["kind"] for name, c in channels.items() if c["kind"] not in "fiubM"}
    starts = [c["properties"].get("wf_start_time") for c in channels.values()]
    first = min((start for start in starts if isinstance(start, float)), default=0.0)
    clocks: dict[str, _Clock] = {}
    units = {}
    timed = set()  # channels that are a time by their kind, their name or their unit
    for name, channel in channels.items():
        own = channel["properties"]
        unit = bare_unit(str(own.get("unit_string") or own.get("NI_UnitDescription") or ""))
        units[name] = "s" if channel["kind"] == "M" else unit
        if channel["kind"] in _NUMBERS and (clock := _clock(channel, first)) is not None:
            clocks[name] = clock
        is_time = "time" in channel["name"].lower() or measure(units[name]) == "time"
        if channel["kind"] in _NUMBERS + "M" and is_time:
            timed.add(name)
    times: dict[str, _Clock] = {}  # for each group whose channels share a step: first to last
    for group in () if timed else dict.fromkeys(channels[name]["group"] for name in clocks):
        own = [clock for name, clock in clocks.items() if channels[name]["group"] == group]
        earliest = min(own, key=lambda clock: clock.begin)
        if all(clock.even(earliest) for clock in own):
            ends = [round((c.begin - earliest.begin) / c.step) + c.samples for c in own]
            times[f"{group}/time"] = earliest._replace(samples=max(ends))
    if len(set(times.values())) == 1:  # one for all
        times = {"time": next(iter(times.values()))}
    times = {name: clock for name, clock in times.items() if name not in columns}

    values: dict[str, Column] = {
        name: clock.begin + clock.step * np.arange(clock.samples) for name, clock in times.items()
    }
    return Table(
        path,
        values | columns,
        units={name: unit for name, unit in units.items() if unit} | dict.fromkeys(times, "s"),
        align=lambda used: _align(path, used, times | clocks, texts, timed),
        notes=_differences(clocks),
        head=tuple(facts["settings"]),
    )


def _channels(path: Path) -> Content:
    """Names, properties and numbers of all channels that have data."""
    from nptdms import TdmsFile
    from nptdms.log import log_manager

    log_manager.set_level(logging.ERROR)  # its warnings are errors here
    channels: list[dict[str, Any]] = []
    arrays: dict[str, NDArray[np.generic]] = {}
    # Given a path, nptdms would read an index file next to it, which may belong to another.
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
            if not len(channel):
                continue
            kind, values = np.dtype(channel.dtype).kind, np.empty(0)
            if kind == "M":
                stamps = channel[:].astype("M8[us]")
                values = (stamps - stamps[0]) / np.timedelta64(1, "s")
            elif kind in _NUMBERS:
                values = np.asarray(channel[:], dtype=np.float64)
            arrays[str(len(channels))] = values
            channels.append(
                {
                    "group": channel.group_name,
                    "name": channel.name,
                    "kind": kind,
                    "samples": len(channel),
                    "properties": {n: _plain(value) for n, value in channel.properties.items()},
                }
            )
        settings = [
            f"{name}: {value}"
            for part in (file, *file.groups())
            for name, value in part.properties.items()
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


def _clock(channel: dict[str, Any], first: float) -> _Clock | None:
    """Clock of a waveform over time; start times count from that of the first channel."""
    own = channel["properties"]
    step, offset, began = (own.get(f"wf_{n}") for n in ("increment", "start_offset", "start_time"))
    offset = 0.0 if offset is None else offset
    unit = bare_unit(str(own.get("wf_xunit_string", ""))) or "s"
    if not (isinstance(step, float) and isinstance(offset, float) and measure(unit) == "time"):
        return None
    if not (0.0 < step < math.inf and math.isfinite(offset)):
        return None
    scale, dated = factor(unit, "time"), isinstance(began, float)
    begin = offset * scale + (began - first if isinstance(began, float) else 0.0)
    return _Clock(step * scale, begin, channel["samples"], dated)


def _differences(clocks: Mapping[str, _Clock]) -> tuple[str, ...]:
    """Sentence on channels that do not begin, end or step as the first of them does."""
    said = []
    first = min(clocks, key=lambda name: clocks[name].begin, default="")
    for name, clock in clocks.items():
        earliest = clocks[first]
        if clock.begin >= earliest.end:
            continue  # of another test
        if not clock.even(earliest):
            steps = f"{first} has a step of {earliest.step:g}, {name} of {clock.step:g}"
            return (f"{steps}: they cannot be used together",)
        if clock.begin > earliest.begin:
            said.append(f"{name} begins {clock.begin - earliest.begin:.6g} s after {first}")
        elif clock.samples != earliest.samples:
            said.append(f"{name} has {clock.samples} samples, {first} {earliest.samples}")
    more = f", and {len(said) - 3} more" if len(said) > 3 else ""
    return (f"{', '.join(said[:3])}{more}: only what channels share is used",) if said else ()


def _align(
    path: Path,
    columns: Mapping[str, Column],
    every: Mapping[str, _Clock],
    texts: Mapping[str, str],
    timed: Collection[str],
) -> Mapping[str, Column]:
    """Columns while all of them were measured, at the samples of the one that began last.

    Refused where they have no numbers or other steps, are never measured together, or differ though
    the file has channels that are its time, `timed`.
    """
    for name in columns:
        if name in texts:
            held = _KINDS.get(texts[name], "no numbers")
            raise RecordError(f"channel {name!r} of {path} holds {held}; expected numbers")
    clocks = {n: every[n] for n in columns if n in every and n not in timed}
    if len(set(clocks.values())) < 2:
        return columns
    first, reference = next(iter(clocks.items()))
    for name, clock in clocks.items():
        late = clock.begin - reference.begin
        if not clock.even(reference):
            raise RecordError(
                f"{path}: {first} has a step of {reference.step:g} s and {name} one of "
                f"{clock.step:g} s"
                + (", and the file has one time" if timed else ": resample them first")
            )
        if timed and abs(late) > SHARE * reference.step:
            way = "after" if late > 0 else "before"
            raise RecordError(
                f"{path}: {name} begins {abs(late):.6g} s {way} {first}, and the file has one time"
            )
        if clock.dated != reference.dated and late:
            raise RecordError(
                f"{path}: of {first} and {name} only one has a start time, wf_start_time, which "
                "is not that of the file's first channel: they cannot be aligned"
            )
    if timed:
        return columns
    start = max(clock.begin for clock in clocks.values())
    end = min(clock.end for clock in clocks.values())
    size = math.floor((end - start) / reference.step + SHARE)
    if size < 1:
        raise RecordError(f"{path}: {' and '.join(clocks)} are never measured at the same time")
    aligned = {}
    for name, clock in clocks.items():
        begin = (start - clock.begin) / reference.step
        values = np.asarray(columns[name], dtype=np.float64)
        if abs(begin - round(begin)) < SHARE:
            aligned[name] = values[round(begin) : round(begin) + size]
        else:
            aligned[name] = np.interp(begin + np.arange(size), np.arange(values.size), values)
    size = min(column.size for column in aligned.values())
    return {**columns, **{name: column[:size] for name, column in aligned.items()}}
