"""Which column of a table is time, displacement, force, …, and in which unit."""

from __future__ import annotations

import re
from collections.abc import Mapping

from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers import Table
from mfd_bayes.units import measure, same_unit

ROLES = ("time", "displacement", "force", "velocity", "actuation")
"""What a column can be; time and displacement must be there."""

_EXAMPLES = {"time": "time_s", "displacement": "displacement_in"}
_SUFFIX = r"_((?:[^_\s]+_per_)?[^_\s]+)"
_BRACKETS = r"\s*[\[(]([^\[\]()]+)[\])]"


def header_unit(name: str) -> str | None:
    """Unit that a column's name ends in: ``"kip"`` of ``"force_kip"`` or ``"Force [kip]"``.

    None where it has no ending; what it ends in may be no unit, as of ``"axial_force"``.
    """
    match = re.search(rf"{_BRACKETS}$", name) or re.search(rf"{_SUFFIX}$", name)
    return match[1].strip().replace("_per_", "/") if match else None


def roles_of(
    table: Table,
    columns: Mapping[str, str],
    units: Mapping[str, str],
    *,
    guess_actuation: bool = True,
) -> dict[str, str]:
    """Role to column, as given, or from headers such as ``time_s`` or ``Displacement [mm]``.

    Parameters
    ----------
    table : Table
    columns, units : mapping
        Role (`ROLES`) to column name and to unit, as given.
    guess_actuation : bool
        Whether a column may be taken for the actuation.

    Raises
    ------
    RecordError
        When a role is unknown, no column is for time or displacement, or several could be.
    """
    for role in (*columns, *units):
        if role not in ROLES:
            raise RecordError(f"unknown role {role!r} of a column; expected {', '.join(ROLES)}")
    roles = dict(columns)
    if not {"time", "displacement"} & columns.keys():
        wanted = [r for r in ROLES if r not in roles and (r != "actuation" or guess_actuation)]
        roles |= {role: name for role in wanted if (name := _guess(table, role)) is not None}
    missing = [role for role in ("time", "displacement") if role not in roles]
    if missing:
        raise RecordError(
            f"no column for {missing[0]} in {table.path}: name one, or call it "
            f"{_EXAMPLES[missing[0]]!r}; it has {', '.join(table.names[:20])}"
        )
    return {role: roles[role] for role in ROLES if role in roles}


def unit_of(table: Table, role: str, name: str, units: Mapping[str, str]) -> str:
    """Unit of a role's column: as given, or of its name, or of the file's row of units.

    Raises
    ------
    RecordError
        When there is none, or the name and the file contradict each other.
    """
    if given := units.get(role):
        return given
    ours, theirs = header_unit(name), table.units.get(name)
    if theirs is None:
        if ours is None:
            raise RecordError(
                f"column {name!r} of {table.path} has no unit in its name; give the unit of {role}"
            )
        return ours
    if ours is None or measure(ours) in (None, "ratio"):  # "force" of "axial_force", 1 of "force_1"
        return theirs
    if not same_unit(ours, theirs):
        raise RecordError(
            f"column {name!r} of {table.path} is in {ours!r} by its name and in {theirs!r} by the "
            f"file's own units; give the unit of {role}"
        )
    return ours


def _guess(table: Table, role: str) -> str | None:
    """Column called after the role, with a unit or without."""
    pattern = re.compile(rf"{role}({_SUFFIX}|{_BRACKETS})?", re.IGNORECASE)
    found = [name for name in table.names if pattern.fullmatch(name)]
    if len(found) > 1:
        raise RecordError(
            f"{table.path} has several columns for {role}, {', '.join(found)}; say which"
        )
    return found[0] if found else None
