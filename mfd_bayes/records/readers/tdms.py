"""Columns out of LabVIEW's TDMS files. nptdms is met here alone."""

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
from mfd_bayes.records.readers.cells import bad_cell, bare_unit, missing_library, sample, unreadable
from mfd_bayes.records.readers.table import Array, Table
from mfd_bayes.units import measure

SAMPLES = 50_000_000
"""Most samples of a channel: thirteen hours at 1024 Hz."""

LISTED = 20_000_000
"""Most channels that all parts of a file may list together: reading one takes a microsecond."""

_KINDS = {"O": "text", "M": "dates", "c": "complex numbers"}


@dataclass(frozen=True)
class _Clock:
    """When the samples of a waveform were taken, in the unit of its axis."""

    increment: float
    start: float
    unit: str
    samples: int


@dataclass(frozen=True)
class _Channel:
    """What a file says of a channel.

    Attributes
    ----------
    group, name : str
    kind : str
        Of numpy's data type: "f", "i", …
    unit : str
        Empty where the file gives none.
    clock : _Clock or None
        None where the channel is no waveform over time.
    """

    group: str
    name: str
    kind: str
    unit: str
    clock: _Clock | None

    @property
    def numeric(self) -> bool:
        return self.kind in "fiub"

    @property
    def is_time(self) -> bool:
        return self.numeric and ("time" in self.name.lower() or measure(self.unit) == "time")


def read_tdms(path: Path) -> Table:
    """Table of a .tdms file: its channels, called ``group/channel`` where two share a name.

    Where no channel is a time but waveforms have increments, there is a column ``time`` besides;
    ``group/time`` where groups were sampled at different times.

    Raises
    ------
    RecordError
        When nptdms is not installed, or the file is not TDMS, holds no channel with data, ends
        early, or declares more samples than it can hold or than are read.
    """
    with _opened(path) as file:
        found = [
            _described(path, channel)
            for group in file.groups()
            for channel in group.channels()
            if len(channel)
        ]
    if not found:
        raise RecordError(f"{path} holds no channel with data")
    shared = Counter(channel.name for channel in found)
    channels = {c.name if shared[c.name] == 1 else f"{c.group}/{c.name}": c for c in found}
    clocks = {} if any(c.is_time for c in found) else _clocks(found)
    clocks = {name: clock for name, clock in clocks.items() if name not in channels}

    def load(wanted: Sequence[str]) -> dict[str, Array]:
        with _opened(path) as file:
            return {
                name: _ticks(clocks[name])
                if name in clocks
                else _numbers(path, name, file, channels[name])
                for name in wanted
            }

    units = {name: c.unit for name, c in channels.items() if c.unit}
    units |= {name: clock.unit for name, clock in clocks.items()}
    return Table(path, (*clocks, *channels), load, sample, units)


class _Stream(BufferedReader):
    """File of which no more is asked for at once than it has: texts may declare gigabytes."""

    def read(self, size: int | None = -1, /) -> bytes:
        left = os.fstat(self.fileno()).st_size - self.tell()
        return super().read(-1 if size is None else min(size, max(left, 0)))


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """File with its description read, and its data left where they are."""
    try:
        from nptdms import TdmsFile
        from nptdms.log import log_manager
    except ImportError as error:
        raise missing_library(path, "npTDMS", "tdms") from error
    log_manager.set_level(logging.ERROR)  # what it warns of is refused here, in a sentence
    try:
        # Of a path nptdms would read an index beside the file, which may be another's.
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
    """Refuse a file whose parts repeat so many channels that going through them takes minutes."""
    size = path.stat().st_size
    at = channels = listed = 0
    while at + 32 <= size:
        stream.seek(at)
        lead = stream.read(32)
        if not lead.startswith(b"TDSm"):
            break  # nptdms stops here too
        flags = int.from_bytes(lead[4:8], "little")
        order: Literal["big", "little"] = "big" if flags & 64 else "little"
        if flags & 2:  # the part lists channels: besides those of the part before, or anew
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
    """Refuse a file that declares more samples than it, or this program, can hold."""
    for channel, status in (file.file_status.channel_statuses or {}).items():
        if status.read_length < status.expected_length:
            raise RecordError(
                f"{path} is cut off: its last part declares {status.expected_length:,} samples of "
                f"channel {channel} and holds {status.read_length:,}"
            )
    size = path.stat().st_size
    for group in file.groups():
        for channel in group.channels():
            if len(channel) > min(size, SAMPLES):
                limit = f"the {SAMPLES:,} that are read" if size > SAMPLES else "it can hold"
                raise RecordError(
                    f"{path} declares {len(channel):,} samples of channel {channel.path}, more "
                    f"than {limit}"
                )


def _described(path: Path, channel: Any) -> _Channel:
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
    """Clock of a waveform, or None where the channel has no increment, or not one of time."""
    increment = properties.get("wf_increment", math.nan)
    start = properties.get("wf_start_offset", 0.0)
    unit = bare_unit(str(properties.get("wf_xunit_string", ""))) or "s"
    if not all(isinstance(value, int | float) for value in (increment, start)):
        return None
    if not (0 < increment < math.inf and math.isfinite(start)) or measure(unit) != "time":
        return None
    return _Clock(float(increment), float(start), unit, samples)


def _clocks(channels: Sequence[_Channel]) -> dict[str, _Clock]:
    """Name to clock: one for all, or one for each group that has one of its own."""
    waveforms = [c for c in channels if c.numeric and c.clock is not None]
    ours = {c.clock for c in waveforms if c.clock is not None}
    if len(ours) == 1:
        return {"time": ours.pop()}
    groups = {
        group: {c.clock for c in waveforms if c.group == group and c.clock is not None}
        for group in dict.fromkeys(c.group for c in waveforms)
    }
    return {f"{group}/time": own.pop() for group, own in groups.items() if len(own) == 1}


def _ticks(clock: _Clock) -> Array:
    return clock.start + clock.increment * np.arange(clock.samples, dtype=np.float64)


def _numbers(path: Path, name: str, file: Any, channel: _Channel) -> Array:
    if not channel.numeric:
        held = _KINDS.get(channel.kind, "no numbers")
        raise RecordError(f"channel {name!r} of {path} holds {held}; expected numbers")
    values = np.asarray(file[channel.group][channel.name][:], dtype=np.float64)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise bad_cell(sample(int(bad[0])), path, name, values[bad[0]])
    return values
