"""A test file, checked and in internal units, and the traces cut from it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import RecordError
from mfd_bayes.records.channels import (
    JITTER,
    ROLES,
    SAMPLES,
    Clock,
    Source,
    check_increasing,
    checked_window,
    clock_of,
    decimate,
    default_rate,
    longest_piece,
    parse_window,
    part_for,
    signals_of,
    sources_of,
    used_columns,
)
from mfd_bayes.records.inputs import hash_file, path_of, real_number
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.trace import Array, Trace, check_trace, mended, smallest_turn, turning_points
from mfd_bayes.units import DAMPER, ActuationUnit, Axes, parse_actuation

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
    clock : Clock
        Its rate, and how even that is.
    derived : dict
        Role to what it is made of, in words, where it is more than a column.
    gap : str
        Which piece of the file this is, where time has a gap.
    fit : (float, float), s, or None
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
    clock: Clock
    derived: dict[str, str] = field(default_factory=dict)
    gap: str = ""
    fit: Window | None = None
    given_actuation: str = ""
    stated_units: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    axes: Axes = DAMPER

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
        check_trace("trace", trace, RecordError)
        if since != -math.inf:
            since = real_number("since, in s,", since, RecordError)
        if self.fit is None:
            return (), ()
        before = (self.time > since) & (self.time < trace.time[0])
        parts = (self.displacement[before], self.displacement[self.time > trace.time[-1]])
        ends = [x[[0, *_turns(x), -1]].tolist() if x.size else [] for x in parts]
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
            In the record's own time; `fit` by default.
        gap : float, in, optional
            Width of the device's gap: without a rate, one that resolves it is taken.
        """
        if gap is not None:
            gap = real_number("gap, in inches,", gap, RecordError, (0.0, math.inf), inside=True)
        if rate is not None:
            rate = real_number("rate, in Hz,", rate, RecordError, (0.0, math.inf), inside=True)
        cut = _slice(self, self.fit if window is None else window)
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
        first, last = np.flatnonzero((grid >= start) & (grid <= end))[[0, -1]].tolist()
        share = 1 / Fraction(min(self.rate / rate, 1e9)).limit_denominator(1000)
        count = (last - first) * share.numerator // share.denominator + 1
        if count < SAMPLES:
            raise RecordError(f"{rate:g} Hz leaves fewer than {SAMPLES} samples of {self.path}")
        time = grid[first] + np.arange(count) / (float(share) * self.rate)
        signals = {role: decimate(v, share, first, last) for role, v in signals.items()}
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
    fit: str | Window | None = None,
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
    fit : str or (float, float), s, optional
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
    window = parse_window(fit, timed=axes.timed) if isinstance(fit, str) else fit
    if window is not None:
        window = checked_window(window)
        table = part_for(table, sources, window)
    signals, names, unit = signals_of(table, sources, axes)
    check_increasing(table, signals["time"])
    piece, gap = longest_piece(signals["time"], table.place, window)
    if piece.stop - piece.start < SAMPLES:
        raise RecordError(f"{gap}: fewer than the {SAMPLES} samples that are needed in {path}")
    signals = {role: signal[piece] for role, signal in signals.items()}
    level: float | Array | None = signals.get("actuation")
    if actuation is not None:
        level, unit = parse_actuation(actuation, of=f"the actuation of {path}")
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
        other_columns=tuple(n for n in table.names if n not in used_columns(table, sources)),
        clock=clock_of(signals["time"]),
        derived={
            role: source.words()
            for role, source in sources.items()
            if not source.plain and source.column is not None
        },
        gap=gap,
        fit=window,
        given_actuation=actuation or "",
        stated_units={r: table.units[n] for r, (n, _) in names.items() if n in table.units},
        notes=table.notes,
        doubts=table.doubts,
        axes=axes,
    )
    displacement = mended(record.displacement[_slice(record, window)])
    where = f"{path}" + (" in the fit window" if window else "")
    if np.ptp(displacement) <= (STILL if axes.of_damper else 0.0):
        raise RecordError(f"{axes.motion.name} in {where} is constant")
    count = _turns(displacement).size
    if count < 2:
        raise RecordError(f"motion in {where} has {count} turning points; at least 2 are needed")
    return record


def _slice(record: Record, window: Window | None) -> slice:
    """Samples of a window, both ends included."""
    if window is None:
        return slice(0, record.time.size)
    start, end = checked_window(window)
    first = int(np.searchsorted(record.time, start, side="left"))
    last = int(np.searchsorted(record.time, end, side="right"))
    if not last - first >= SAMPLES:
        unit = " s" if record.axes.timed else ""
        raise RecordError(
            f"window {start:g}{unit} to {end:g}{unit} holds {max(last - first, 0)} samples of "
            f"{record.path}, which runs from {record.time[0]:g}{unit} to "
            f"{record.time[-1]:g}{unit}; "
            f"at least {SAMPLES} are needed"
        )
    return slice(first, last)


def _turns(displacement: Array) -> NDArray[np.intp]:
    return turning_points(displacement, smallest_turn(displacement))
