"""Columns out of LabVIEW's TDMS files."""

from __future__ import annotations

import logging
import math
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from io import BufferedReader
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np

from mfd_bayes.errors import RecordError
from mfd_bayes.records.motion import Array
from mfd_bayes.records.readers.cells import bad_cell, bare_unit, missing_library, sample, unreadable
from mfd_bayes.records.readers.table import Table
from mfd_bayes.units import factor, measure

SAMPLES = 50_000_000  # most samples of a channel: thirteen hours at 1024 Hz
LISTED = 20_000_000  # most channels that all parts list together, at a microsecond each
EVEN = 1e-6  # steps of time that differ by a smaller share are equal
SHARE = 0.02  # of a step: channels that are out of step by less are in step
_KINDS = {"O": "text", "M": "dates", "c": "complex numbers"}


@dataclass(frozen=True)
class _Clock:
    """Sampling times of a waveform, in the unit of its axis."""

    increment: float
    start: float
    unit: str
    samples: int
    began: float | None = None  # s, of the file's first channel with a start time

    def times(self) -> Array:
        return self.begin + self.increment * np.arange(self.samples, dtype=np.float64)

    @property
    def begin(self) -> float:
        """Time of the first sample, in the unit of the axis."""
        seconds = factor(self.unit, "time")
        return self.start + (0.0 if self.began is None else self.began / seconds)


@dataclass(frozen=True)
class _Channel:
    """Description of a channel."""

    group: str
    name: str
    kind: str  # of numpy's data type: "f", "i", …
    unit: str  # empty where the file gives none
    clock: _Clock | None  # None where the channel is not a waveform over time

    @property
    def numeric(self) -> bool:
        return self.kind in "fiub"

    @property
    def is_time(self) -> bool:
        return self.numeric and ("time" in self.name.lower() or measure(self.unit) == "time")


def read_tdms(path: Path) -> Table:
    """Table of a .tdms file: its channels, called ``group/channel`` where two share a name.

    Where no channel is a time, a column ``time`` is made from the increments of the waveforms;
    ``group/time`` where groups were sampled at different times.
    """
    with _opened(path) as file:
        found = _from_first([_described(channel) for channel in _channels(file) if len(channel)])
    if not found:
        raise RecordError(f"{path} holds no channel with data")
    shared = Counter(channel.name for channel in found)
    channels = {c.name if shared[c.name] == 1 else f"{c.group}/{c.name}": c for c in found}
    timed = any(c.is_time for c in found)
    clocks = {} if timed else _clocks(found)
    clocks = {name: clock for name, clock in clocks.items() if name not in channels}

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        own = {n: channels[n].clock for n in wanted if n in channels and not channels[n].is_time}
        given = {name: clock for name, clock in own.items() if clock is not None}
        if timed:
            _check_alike(path, given)
            given = {}
        given |= {name: clocks[name] for name in wanted if name in clocks}
        with _opened(path) as file:
            columns = {
                name: clocks[name].times()
                if name in clocks
                else _numbers(path, name, file, channels[name])
                for name in wanted
            }
        return columns | _together(path, given, columns)

    units = {name: c.unit for name, c in channels.items() if c.unit}
    units |= {name: clock.unit for name, clock in clocks.items()}
    return Table(path, (*clocks, *channels), load, sample, units, notes=_apart(channels))


def _from_first(channels: Sequence[_Channel]) -> list[_Channel]:
    """Channels with start times counted from the first of them."""
    began = [c.clock.began for c in channels if c.clock and c.clock.began is not None]
    first = min(began, default=0.0)
    return [
        replace(c, clock=replace(c.clock, began=c.clock.began - first))
        if c.clock is not None and c.clock.began is not None
        else c
        for c in channels
    ]


def _apart(channels: Mapping[str, _Channel]) -> tuple[str, ...]:
    """Sentence on channels that do not begin, end or step as the first of them does."""
    clocks = {n: c.clock for n, c in channels.items() if c.numeric and c.clock is not None}
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
    return (f"{', '.join(said[:3])}{more}: only what columns share is used",) if said else ()


def _check_alike(path: Path, clocks: Mapping[str, _Clock]) -> None:
    """Refuse waveforms of different clocks beside a channel of times, which is that of one."""
    names = list(clocks)
    for name in names[1:]:
        one, other = clocks[names[0]], clocks[name]
        steps = one.increment, other.increment
        if (
            not math.isclose(*steps, rel_tol=EVEN)
            or abs(other.begin - one.begin) > SHARE * steps[0]
        ):
            raise RecordError(
                f"{_differ(path, names[0], one, name, other)}, and the file has one time"
            )


def _together(
    path: Path, clocks: Mapping[str, _Clock], columns: Mapping[str, Array]
) -> dict[str, Array]:
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
    found = {}
    for name in names:
        begin, values = start - late[name], columns[name]
        if abs(begin - round(begin)) < SHARE:
            found[name] = values[round(begin) : round(begin) + size]
        else:
            found[name] = np.interp(begin + np.arange(size), np.arange(values.size), values)
    sizes = min(column.size for column in found.values())
    return {name: column[:sizes] for name, column in found.items()}


def _differ(path: Path, one: str, first: _Clock, other: str, second: _Clock) -> str:
    """Sentence on two channels whose clocks differ."""
    if first.unit != second.unit or not math.isclose(
        first.increment, second.increment, rel_tol=EVEN
    ):
        return (
            f"{path}: {one} has a step of {first.increment:g} {first.unit} and {other} one of "
            f"{second.increment:g} {second.unit}"
        )
    late = second.begin - first.begin
    way = "after" if late > 0 else "before"
    return f"{path}: {other} begins {abs(late):.6g} {first.unit} {way} {one}"


class _Stream(BufferedReader):
    """File that is never asked for more bytes than it has: a text may declare gigabytes."""

    def read(self, size: int | None = -1, /) -> bytes:
        left = os.fstat(self.fileno()).st_size - self.tell()
        return super().read(-1 if size is None else min(size, max(left, 0)))


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """File whose description was read and checked; its data are not read yet."""
    try:
        from nptdms import TdmsFile
        from nptdms.log import log_manager
    except ImportError as error:
        raise missing_library(path, "npTDMS", "tdms") from error
    log_manager.set_level(logging.ERROR)  # its warnings are errors here
    try:
        # Given a path, nptdms would read an index file beside it, which may belong to another.
        with path.open("rb", buffering=0) as file, _Stream(file) as stream:
            _check_parts(path, stream)
            with TdmsFile.open(stream) as opened:
                _check_whole(path, opened)
                yield opened
    except RecordError:
        raise
    except OSError as error:
        raise unreadable(path, error) from error
    except Exception as error:  # nptdms raises a dozen kinds on a broken file
        raise RecordError(f"{path} is not a TDMS file that can be read") from error


def _check_parts(path: Path, stream: IO[bytes]) -> None:
    """Refuse a file whose parts together list more channels than `LISTED`."""
    size = path.stat().st_size
    at = channels = listed = 0
    while at + 32 <= size:
        stream.seek(at)
        lead = stream.read(32)
        if not lead.startswith(b"TDSm"):
            break  # nptdms stops here too
        flags = int.from_bytes(lead[4:8], "little")
        order: Literal["big", "little"] = "big" if flags & 64 else "little"
        if flags & 2:  # the part lists channels; with flag 4 those of the parts before end
            channels = int.from_bytes(lead[28:32], order) + (0 if flags & 4 else channels)
        listed += channels
        if listed > LISTED:
            raise RecordError(
                f"{path} lists channels more than {LISTED:,} times over its parts, the most that "
                "is read; defragment it in LabVIEW"
            )
        at += 28 + int.from_bytes(lead[12:20], order)
    stream.seek(0)


def _check_whole(path: Path, file: Any) -> None:
    """Refuse a file that is cut off, or declares more samples than it holds or than are read."""
    for channel, status in (file.file_status.channel_statuses or {}).items():
        if status.read_length < status.expected_length:
            raise RecordError(
                f"{path} is cut off: its last part declares {status.expected_length:,} samples of "
                f"channel {channel} and holds {status.read_length:,}"
            )
    size = path.stat().st_size
    for channel in _channels(file):
        if len(channel) > min(size, SAMPLES):
            limit = f"the {SAMPLES:,} that are read" if size > SAMPLES else "it can hold"
            raise RecordError(
                f"{path} declares {len(channel):,} samples of channel {channel.path}, more "
                f"than {limit}"
            )


def _channels(file: Any) -> Iterator[Any]:
    return (channel for group in file.groups() for channel in group.channels())


def _described(channel: Any) -> _Channel:
    properties = channel.properties
    unit = properties.get("unit_string") or properties.get("NI_UnitDescription") or ""
    return _Channel(
        group=channel.group_name,
        name=channel.name,
        kind=np.dtype(channel.dtype).kind,
        unit=bare_unit(str(unit)),
        clock=_clock(properties, len(channel)),
    )


def _clock(properties: Mapping[str, Any], samples: int) -> _Clock | None:
    """Clock of a waveform; None where the channel has no increment of time."""
    increment = properties.get("wf_increment", math.nan)
    start = properties.get("wf_start_offset", 0.0)
    unit = bare_unit(str(properties.get("wf_xunit_string", ""))) or "s"
    if not all(isinstance(value, int | float) for value in (increment, start)):
        return None
    if not (0 < increment < math.inf and math.isfinite(start)) or measure(unit) != "time":
        return None
    began = _seconds(properties.get("wf_start_time"))
    return _Clock(float(increment), float(start), unit, samples, began)


def _seconds(moment: Any) -> float | None:
    """Seconds of a time stamp since 2020, about; None where a writer left it at its zero, 1904."""
    if isinstance(moment, datetime):
        moment = np.datetime64(moment.replace(tzinfo=None) - (moment.utcoffset() or timedelta()))
    if not isinstance(moment, np.datetime64) or np.isnat(moment) or moment < np.datetime64("1910"):
        return None
    return float((moment - np.datetime64("2020", "us")) / np.timedelta64(1, "s"))


def _clocks(channels: Sequence[_Channel]) -> dict[str, _Clock]:
    """Name to clock: one for all channels, or one for each group whose channels share a step.

    It is that of the first to begin to the last to end.
    """
    groups: dict[str, list[_Channel]] = {}
    for channel in channels:
        if channel.numeric and channel.clock is not None:
            groups.setdefault(channel.group, []).append(channel)
    found: dict[str, _Clock] = {}
    for group, members in groups.items():
        own = [channel.clock for channel in members if channel.clock is not None]
        if (span := _span(own)) is not None:
            found[f"{group}/time"] = span
    if len(set(found.values())) == 1:
        return {"time": next(iter(found.values()))}
    return found


def _span(clocks: Sequence[_Clock]) -> _Clock | None:
    """Clock from the first sample of several to their last; None where their steps differ."""
    first = min(clocks, key=lambda clock: clock.begin)
    alike = all(
        c.unit == first.unit and math.isclose(c.increment, first.increment, rel_tol=EVEN)
        for c in clocks
    )
    if not alike:
        return None
    ends = [round((c.begin - first.begin) / c.increment) + c.samples for c in clocks]
    return replace(first, samples=max(ends))


def _numbers(path: Path, name: str, file: Any, channel: _Channel) -> Array:
    if not channel.numeric:
        held = _KINDS.get(channel.kind, "no numbers")
        raise RecordError(f"channel {name!r} of {path} holds {held}; expected numbers")
    values = np.asarray(file[channel.group][channel.name][:], dtype=np.float64)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise bad_cell(sample(int(bad[0])), path, name, values[bad[0]])
    return values
