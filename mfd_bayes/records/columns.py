"""Which column of a table is time, displacement, force, …, and in which unit."""

from __future__ import annotations

import re
from collections.abc import Mapping
from unicodedata import normalize

from mfd_bayes.axes import DAMPER, Axes
from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers import Table
from mfd_bayes.records.readers.table import bare_unit, own_name
from mfd_bayes.units import UNREAD, measure, same_unit

ROLES = ("time", "displacement", "force", "velocity", "actuation")
"""What a column can be; a record needs a time and a displacement."""

_EXAMPLES = {"time": "time_s", "displacement": "displacement_mm"}
_NO_TIME = '; where it has none, give its rate: rate = "100 Hz"'
_SUFFIX = r"_((?:[^_\s]+_per_)?[^_\s]+)"
_BRACKETS = r"\s*[\[(]([^\[\]()]+)[\])]"
_REMARKS = frozenset(
    {
        *("raw", "measured", "meas", "corrected", "corr", "filtered", "filt", "smoothed"),
        *("average", "avg", "mean", "abs", "max", "min", "rms", "total", "net", "main"),
        *("left", "right", "top", "bottom", "bot", "upper", "lower", "north", "south"),
        *("east", "west", "front", "rear", "back", "lvdt", "sensor", "cell", "loadcell"),
        *("actuator", "machine", "ch", "channel", "x", "y", "z", "axial", "lateral"),
        *("vertical", "horizontal", "relative", "absolute", "calibrated", "zeroed"),
        *("command", "cmd", "feedback", "fbk", "analog", "digital", "signal", "data"),
        *("scaled", "elapsed", "test", "local", "utc", "fwd", "bwd", "forward", "backward"),
    }
)
"""Words that people put in brackets behind a name, and that are no units."""


def header_unit(name: str) -> str | None:
    """Last part of a column's name: ``"kip"`` of ``"force_kip"`` or ``"Force [kip]"``.

    None where the name has one part. The last part may be no unit: ``"force"`` of
    ``"axial_force"``.
    """
    name = normalize("NFKC", name)  # as the brackets of a Japanese keyboard, and ㎜
    match = re.search(rf"{_BRACKETS}$", name) or re.search(rf"{_SUFFIX}$", name)
    if match is None or match[1].strip(" :,;0123456789") == "" != match[1].strip():  # "log(:,1)"
        return None
    return match[1].strip().replace("_per_", "/")


def stated_unit(name: str, row: str = "") -> str | None:
    """What a file says to be the unit of a column, whether known or not; None where it says none.

    In brackets, as a last word that is known to be one ("load_tonf"), or in its row of units.
    """
    if bare_unit(row):
        return bare_unit(row)
    name = normalize("NFKC", name)
    for square, round_, angle in re.findall(r"\[([^\]]+)\]|\(([^()]+)\)|[<{]([^<>{}]+)[>}]", name):
        text = bare_unit(square or round_ or angle)
        if not re.search(r"[^\W\d_]|[%°]", text) or text.lower() in _REMARKS:
            continue
        words = re.findall(r"[^\W\d_]+", text)
        is_remark = re.search(r"[\s,;:=]|^[^\W\d_]+[ _.-]?\d+$", text)  # "as wired", "ch2"
        if measure(text) or not is_remark or any(len(w) > 1 and measure(w) for w in words):
            return text
    last = re.search(r"(?:_|[\s,/:]+)([^\W\d_]{2,})\s*$", name)
    return last[1] if last and last[1].lower() in UNREAD else None


def roles_of(
    table: Table,
    columns: Mapping[str, str | int],
    units: Mapping[str, str],
    *,
    actuation: str | None = None,
    timed: bool = True,
    axes: Axes = DAMPER,
) -> dict[str, str]:
    """Role to column name, as given or from headers such as ``time_s``, ``Displacement [mm]``.

    A column is given by its name, or by its number from 1. One for the actuation is looked for
    only where `actuation`, a constant, is not given; one for the time only where the file is
    `timed`.
    """
    for role in (*columns, *units):
        if role not in ROLES:
            names = ", ".join(map(axes.name, ROLES))
            raise RecordError(f"unknown role {role!r} of a column; expected {names}")
    roles = {role: table.name_of(column) for role, column in columns.items()}
    chosen = bool({"time", "displacement"} & columns.keys())  # then what is not named is not used
    used: tuple[str, ...] = ("time", "displacement") if chosen else ROLES
    unnamed = [r for r in used if r not in roles and (r != "actuation" or actuation is None)]
    if not timed:
        unnamed = [role for role in unnamed if role != "time"]
    roles |= {
        role: name for role in unnamed if (name := _guess(table, axes.name(role))) is not None
    }
    if actuation is not None and "actuation" in roles:
        raise RecordError(f"actuation of {table.path} is given as {actuation!r} and as a column")
    needed = ("time", "displacement") if timed else ("displacement",)
    missing = [role for role in needed if role not in roles]
    if missing and not table.headed:
        raise RecordError(
            f"{table.path} has no names, only {', '.join(table.names[:20])}: say in a campaign "
            'which is which, as time = { column = 1, unit = "ms" }; mfd-bayes init guesses it'
        )
    if missing:
        name = axes.name(missing[0])
        example = _EXAMPLES[missing[0]] if name in _EXAMPLES else f"{name}_{axes.motion.unit}"
        raise RecordError(
            f"no column for {name} in {table.path}, which has {', '.join(table.names[:20])}: "
            f"rename it in the file, as {example}, or name it in [columns] of a "
            "campaign, or in Python by columns" + (_NO_TIME if missing[0] == "time" else "")
        )
    return {role: roles[role] for role in ROLES if role in roles}


def unit_of(
    table: Table, role: str, name: str, units: Mapping[str, str], axes: Axes = DAMPER
) -> str:
    """Unit of a column: as given, or from its name, or from the file's row of units."""
    word = axes.name(role)
    if given := units.get(role):
        return given
    ours, theirs = header_unit(own_name(name)), table.units.get(name)
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


def _guess(table: Table, role: str) -> str | None:
    """Name of the column that is called like the role, with or without a unit."""
    pattern = re.compile(rf"{role}({_SUFFIX}|{_BRACKETS})?", re.IGNORECASE)
    matches = [name for name in table.names if pattern.fullmatch(own_name(name))]
    if len(matches) > 1:
        raise RecordError(
            f"{table.path} has several columns for {role}, {', '.join(matches)}; say which, as "
            f"{role} = {{ column = {table.number_of(matches[0])} }}"
        )
    return matches[0] if matches else None
