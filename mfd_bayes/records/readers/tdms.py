"""Columns out of LabVIEW's TDMS files."""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Mapping, Sequence
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

    def fits(self, other: _Clock, *, timed: bool) -> bool:
        """Whether both ran together with one step; where the file has one time, from one begin."""
        late = abs(self.begin - other.begin)
        together = self.begin < other.end and other.begin < self.end
        if timed:
            together = late <= SHARE * self.step
        return self.even(other) and together and (self.dated == other.dated or not late)


def read_tdms(path: Path) -> Table:
    """Table of a .tdms file: its channels, called ``group/channel`` where two share a name.

    Where no channel is a time, a column ``time`` is made from the increments of the waveforms;
    ``group/time`` where groups were sampled at different times. Channels that ran together with
    one step are cut to what they share, at the samples of the one that began last.
    """
    facts, arrays = read_in_child(_channels, path, "a TDMS file", library="npTDMS", extra="tdms")
    count = Counter(channel["name"] for channel in facts["channels"])
    channels = {
        c["name"] if count[c["name"]] == 1 else f"{c['group']}/{c['name']}": c
        for c in facts["channels"]
    }
    if not channels:
        raise RecordError(f"{path} holds no channel with data")
    starts = [c["properties"].get("wf_start_time") for c in channels.values()]
    first = min((start for start in starts if isinstance(start, float)), default=0.0)
    columns: dict[str, Column] = {}
    clocks: dict[str, _Clock] = {}
    units: dict[str, str] = {}
    timed = False  # whether a channel is a time by its kind, its name or its unit
    for k, (name, channel) in enumerate(channels.items()):
        own, kind = channel["properties"], channel["kind"]
        units[name] = bare_unit(str(own.get("unit_string") or own.get("NI_UnitDescription") or ""))
        if kind not in "fiubM":
            columns[name] = [_KINDS.get(kind, "no numbers")] * channel["samples"]
            continue
        columns[name] = arrays[str(k)]
        units[name] = "s" if kind == "M" else units[name]
        if "time" in channel["name"].lower() or measure(units[name]) == "time":
            timed = True
        elif kind != "M" and (clock := _clock(channel, first)) is not None:
            clocks[name] = clock
    together: list[list[str]] = []  # names of channels that were sampled together
    for name in sorted(clocks, key=lambda name: clocks[name].begin):
        for names in together:
            if clocks[name].fits(clocks[names[0]], timed=timed):
                names.append(name)
                break
        else:
            together.append([name])
    times: dict[str, Column] = {}
    apart: dict[str, str] = {}
    notes = []
    for number, names in enumerate(together):
        own, group = [clocks[name] for name in names], channels[names[0]]["group"]
        title = "time" if len(together) == 1 else f"{group}/time"
        words = "" if number == 0 else _why_apart(together[0][0], names[0], clocks, timed=timed)
        apart |= dict.fromkeys([*names, title], words)
        if number and not own[0].even(clocks[together[0][0]]):
            notes.append(f"{words}: they cannot be used together")
        if timed:
            continue
        if any(clock[1:3] != own[0][1:3] for clock in own):
            notes.append(_difference(names, own))
        start, step = max(clock.begin for clock in own), own[0].step
        size = math.floor((min(clock.end for clock in own) - start) / step + SHARE)
        for name, clock in zip(names, own, strict=True):
            values, late = np.asarray(columns[name], dtype=np.float64), (start - clock.begin) / step
            if abs(late - round(late)) < SHARE:
                columns[name] = values[round(late) : round(late) + size]
            else:
                at = np.arange(values.size)
                columns[name] = np.interp(late + np.arange(size), at, values)
        others = {channels[n]["group"] for other in together if other is not names for n in other}
        if title not in columns and group not in others:
            times[title] = start + step * np.arange(size)
            units[title] = "s"
    return Table(
        path,
        times | columns,
        units={name: unit for name, unit in units.items() if unit},
        apart=apart,
        notes=tuple(notes),
        head=tuple(facts["settings"]),
    )


def _why_apart(first: str, name: str, clocks: Mapping[str, _Clock], *, timed: bool) -> str:
    """Why a channel cannot be used together with the one that begins first."""
    one, other = clocks[first], clocks[name]
    late = other.begin - one.begin
    if not one.even(other):
        return f"{first} has a step of {one.step:g} s and {name} one of {other.step:g} s"
    if one.dated != other.dated:
        return f"of {first} and {name} only one has a start time, wf_start_time"
    then = "the file has one time" if timed else "they are never measured at the same time"
    return f"{name} begins {late:.6g} s after {first}, and {then}"


def _difference(names: Sequence[str], clocks: Sequence[_Clock]) -> str:
    """Sentence on channels that do not begin or end as the first of them does."""
    said = []
    for name, clock in zip(names, clocks, strict=True):
        if clock.begin > clocks[0].begin:
            said.append(f"{name} begins {clock.begin - clocks[0].begin:.6g} s after {names[0]}")
        elif clock.samples != clocks[0].samples:
            said.append(f"{name} has {clock.samples} samples, {names[0]} {clocks[0].samples}")
    more = f", and {len(said) - 3} more" if len(said) > 3 else ""
    return f"{', '.join(said[:3])}{more}: only what channels share is used"


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
            elif kind in "fiub":
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
