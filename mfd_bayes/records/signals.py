"""The signals of a record, by role and in internal units, out of the columns of a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mfd_bayes.errors import RecordError
from mfd_bayes.records.motion import Array
from mfd_bayes.records.readers import Table
from mfd_bayes.records.roles import check_once, roles_of, unit_of
from mfd_bayes.records.sources import Source, scale_of, step_of, take_off, wanted_of
from mfd_bayes.records.trace import check_size
from mfd_bayes.units import ActuationUnit, actuation_factor

DATE = 1e8  # s: a time that begins later, after three years, is a date, and its first row is 0 s


def sources_of(
    table: Table,
    columns: Mapping[str, str | int | Source] | None,
    units: Mapping[str, str] | None,
    actuation: str | None,
) -> dict[str, Source]:
    """Role to its source, with the column's name and its unit.

    Raises
    ------
    MfdError
        When a column or a unit is missing, or a role may not have what its source takes off.
    """
    columns = _by_role("columns", columns, {"force": "load"})
    units = _by_role("units", units, {"force": "kN"})
    given = {r: c if isinstance(c, Source) else Source(c) for r, c in columns.items()}
    stated = {r: s.unit for r, s in given.items() if s.unit is not None} | dict(units)
    for role, source in given.items():
        source.check(role, table.path)
    named = {r: s.column for r, s in given.items() if s.column is not None}
    rated = "time" in given and bool(given["time"].rate)
    roles = roles_of(table, named, stated, actuation=actuation, timed=not rated)
    found = {"time": given["time"]} if rated else {}
    for role, name in roles.items():
        source = given.get(role, Source(name))
        found[role] = replace(source, column=name, unit=unit_of(table, role, name, stated))
    return found


def _by_role(name: str, given: Any, example: dict[str, str]) -> Mapping[str, Any]:
    """A mapping from roles, checked; an empty one where none is given."""
    if given is not None and not isinstance(given, Mapping):
        raise RecordError(f"{name} must be a mapping such as {example}, got {given!r}")
    return given or {}


def signals_of(
    table: Table, sources: Mapping[str, Source]
) -> tuple[dict[str, Array], dict[str, tuple[str, str]], ActuationUnit | None]:
    """Role to signal, internal units, and to name and unit; unit of a measured actuation.

    Raises
    ------
    MfdError
        When a column cannot be read, or its unit does not measure what its role needs.
    """
    raw = table.columns(wanted_of(table, sources), sources["time"].dates)
    signals: dict[str, Array] = {}
    named: dict[str, tuple[str, str]] = {}
    internal: ActuationUnit | None = None
    for role, source in sources.items():
        name, unit = str(source.column), str(source.unit)
        of = f"column {name!r} of {table.path}"
        if role == "time":
            signals[role] = _times(table, source, raw)
            named[role] = (f"sample number at {source.rate}", "s") if source.rate else (name, unit)
            check_size(of, role, signals[role])
            continue
        if role == "actuation":
            scale, internal = actuation_factor(unit, of=of)
        else:
            scale, unit = scale_of(source, role, unit, of)
        named[role] = name, unit
        with np.errstate(over="ignore"):  # check_magnitude refuses infinity
            signals[role] = raw[name] * scale
        check_size(of, role, signals[role])
    check_once(table, {role: name for role, (name, _) in named.items()})
    for role, source in sources.items():
        if not source.plain and source.column is not None:
            signals[role] = take_off(table, role, source, signals, raw)
            check_size(f"the {role} of {table.path}", role, signals[role])
    _settle(table, signals)
    return signals, named, internal


def _times(table: Table, source: Source, raw: Mapping[str, Array]) -> Array:
    """Times, s: of a rate, or of a column; dates, counted since 1904 or 1970, from the first row.

    NaN where a cell holds none.
    """
    if source.rate:
        rows = next(iter(raw.values())).size
        return step_of(source.rate, f"the rate of {table.path}") * np.arange(rows, dtype=np.float64)
    name, unit = str(source.column), str(source.unit)
    scale, values = scale_of(source, "time", unit, f"column {name!r} of {table.path}")[0], raw[name]
    start = values[np.argmax(np.isfinite(values))]
    with np.errstate(over="ignore", invalid="ignore"):  # check_size refuses infinity
        times: Array = (values - start if start * scale >= DATE else values) * scale
    return times


def part_for(table: Table, sources: Mapping[str, Source], window: tuple[float, float]) -> Table:
    """The table, or the rows about a window, s, where cells outside it hold no numbers.

    Raises
    ------
    MfdError
        When a cell inside the window holds none.
    """
    raw = table.values(wanted_of(table, sources), sources["time"].dates)
    good = np.all([np.isfinite(column) for column in raw.values()], axis=0)
    if good.all():
        return table
    time = _times(table, sources["time"], raw)
    inside = np.flatnonzero((time >= window[0]) & (time <= window[1]))
    if not inside.size or not good[inside[0] : inside[-1] + 1].all():
        return table  # whose columns are refused, with the place of the cell
    bad = np.flatnonzero(~good)
    first = int(np.max(bad[bad < inside[0]], initial=-1)) + 1
    last = int(np.min(bad[bad > inside[-1]], initial=time.size))
    return table.part(
        first,
        last,
        f"cells that hold no numbers, the first at {table.place(int(bad[0]))}, lie outside "
        f"the window fit: {table.place(first)} to {table.place(last - 1)} are read",
    )


def _settle(table: Table, signals: dict[str, Array]) -> None:
    """Check a measured actuation, and make all signals unchangeable."""
    if "actuation" in signals:
        if np.mean(signals["actuation"]) < 0:
            raise RecordError(f"the actuation of {table.path} is negative on average")
        # Single samples below zero are the sensor's noise.
        signals["actuation"] = np.maximum(signals["actuation"], 0.0)
    for signal in signals.values():
        signal.flags.writeable = False


def unused_of(table: Table, sources: Mapping[str, Source]) -> tuple[str, ...]:
    """Names of the columns that no source needs."""
    used = wanted_of(table, sources)
    return tuple(name for name in table.names if name not in used)


def in_words(sources: Mapping[str, Source]) -> dict[str, str]:
    """Role to what it is made of, of those that are more than a column."""
    return {
        role: source.words(str(source.column), str(source.unit))
        for role, source in sources.items()
        if not source.plain and source.column is not None
    }
