"""Columns out of LabVIEW's TDMS files."""

from __future__ import annotations

import logging
import math
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np

from mfd_bayes.errors import RecordError
from mfd_bayes.records.motion import Array
from mfd_bayes.records.readers.cells import bad_cell, bare_unit, missing_library, sample, unreadable
from mfd_bayes.records.readers.table import Table
from mfd_bayes.units import measure

SAMPLES = 50_000_000  # most samples of a channel: thirteen hours at 1024 Hz
LISTED = 20_000_000  # most channels that all parts list together, at a microsecond each
_KINDS = {"O": "text", "M": "dates", "c": "complex numbers"}


@dataclass(frozen=True)
class _Clock:
    """Sampling times of a waveform, in the unit of its axis."""

    increment: float
    start: float
    unit: str
    samples: int

    def times(self) -> Array:
        return self.start + self.increment * np.arange(self.samples, dtype=np.float64)


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
        found = [_described(channel) for channel in _channels(file) if len(channel)]
    if not found:
        raise RecordError(f"{path} holds no channel with data")
    shared = Counter(channel.name for channel in found)
    channels = {c.name if shared[c.name] == 1 else f"{c.group}/{c.name}": c for c in found}
    clocks = {} if any(c.is_time for c in found) else _clocks(found)
    clocks = {name: clock for name, clock in clocks.items() if name not in channels}

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        with _opened(path) as file:
            return {
                name: clocks[name].times()
                if name in clocks
                else _numbers(path, name, file, channels[name])
                for name in wanted
            }

    units = {name: c.unit for name, c in channels.items() if c.unit}
    units |= {name: clock.unit for name, clock in clocks.items()}
    return Table(path, (*clocks, *channels), load, sample, units)


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
    return _Clock(float(increment), float(start), unit, samples)


def _clocks(channels: Sequence[_Channel]) -> dict[str, _Clock]:
    """Name to clock: one for all channels, or one for each group whose channels share one."""
    groups: dict[str, set[_Clock]] = {}
    for channel in channels:
        if channel.numeric and channel.clock is not None:
            groups.setdefault(channel.group, set()).add(channel.clock)
    shared = set().union(*groups.values())
    if len(shared) == 1:
        return {"time": shared.pop()}
    return {f"{group}/time": own.pop() for group, own in groups.items() if len(own) == 1}


def _numbers(path: Path, name: str, file: Any, channel: _Channel) -> Array:
    if not channel.numeric:
        held = _KINDS.get(channel.kind, "no numbers")
        raise RecordError(f"channel {name!r} of {path} holds {held}; expected numbers")
    values = np.asarray(file[channel.group][channel.name][:], dtype=np.float64)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise bad_cell(sample(int(bad[0])), path, name, values[bad[0]])
    return values
