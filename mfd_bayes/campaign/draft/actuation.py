"""The actuation of each test file: from its columns, its header lines or its name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mfd_bayes.campaign.draft.columns import Guess, numbers_of, unit_of
from mfd_bayes.campaign.draft.levels import Level
from mfd_bayes.errors import RecordError
from mfd_bayes.records.readers import Table
from mfd_bayes.units import ActuationUnit, actuation_factor, actuation_kind

CONSTANT = 0.02
"""An actuation is constant when its standard deviation is below this share of its mean."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A file with time, displacement and force, and everything that may be its actuation."""

    path: Path
    table: Table
    columns: dict[str, Guess]
    """Role to column, without the actuation."""
    column: Guess | None
    """The column that may hold the actuation."""
    header: Level | None
    """Level in the header lines."""
    named: tuple[Level, ...]
    """Levels in the file's name."""

    @property
    def levels(self) -> list[Level]:
        """Every level in the header or the name, the certain ones first."""
        stated = [level for level in (self.header, *self.named) if level is not None]
        return sorted(stated, key=lambda level: bool(level.doubt))


def without_shared_levels(files: list[Candidate]) -> list[Candidate]:
    """Files without the levels that stand in every name, where a name has others as well."""
    if len(files) < 2:
        return files
    shared = set.intersection(*({level.text for level in one.named} for one in files))
    return [
        replace(one, named=tuple(lv for lv in one.named if lv.text not in shared) or one.named)
        for one in files
    ]


def prevailing_unit(files: Sequence[Candidate]) -> ActuationUnit | None:
    """Unit of most files, on a tie "ksi" (pressures) or "kip" (tensions); None if unknown."""
    count: Counter[ActuationUnit] = Counter()
    for one in files:
        certain = [level for level in one.levels if not level.doubt]
        units = {level.unit for level in certain or one.levels}
        if one.column is not None and one.column.unit is not None:
            units.add(actuation_factor(one.column.unit)[1])
        count.update(units)
    if not count:
        return None
    return max(count, key=lambda unit: (count[unit], unit == "ksi", unit == "kip"))


IDLE = "no actuation: only laws with an intercept learn from it, affine and residual_power"
"""Doubt about a test at zero actuation."""


def actuation_of(
    one: Candidate, unit: ActuationUnit | None
) -> tuple[str | Guess | None, str, tuple[str, ...]]:
    """Actuation, where it was found, and what is not certain about it.

    A measured actuation counts before the header, the header before the name; None where none has
    it.

    Raises
    ------
    RecordError
        When the actuation is a pressure where most files have tensions or the reverse.
    """
    stated = one.levels
    levels = [level for level in stated if level.unit == unit]
    measured, doubts = _measured(one, unit)
    if measured is not None:
        shown = measured if isinstance(measured, str) else "a history"
        others = [lv.text for lv in levels if not _agrees(measured, one, lv)]
        if others:
            doubts += (f"{_or(others)} in the name or header, {shown} in the column",)
        name = one.column.name if one.column else ""
        return measured, f"of column {name!r}", doubts
    if levels:
        level = levels[0]
        others = [lv.text for lv in stated if lv.text != level.text]
        doubts += (level.doubt,) if level.doubt else ()
        doubts += (f"it could also be {_or(others)}",) if others else ()
        doubts += (IDLE,) if level.value == 0.0 else ()
        return level.text, "in the header" if level == one.header else "in the file's name", doubts
    if stated:
        raise RecordError(
            f"its actuation of {stated[0].text} is {actuation_kind(stated[0].unit)}, and those of "
            "most files are not"
        )
    return None, _candidates(one), doubts


def _measured(
    one: Candidate, unit: ActuationUnit | None
) -> tuple[str | Guess | None, tuple[str, ...]]:
    """Level or history in the column of the actuation, and doubts; None where it has no use."""
    column = one.column
    if column is None:
        return None, ()
    values = numbers_of(one.table, column.name)
    if column.unit is None and column.lacking:
        return None, (
            f"column {column.name!r} holds no actuation that can be used: {column.lacking}",
        )
    if column.unit is None:
        return None, (f"column {column.name!r} has no unit: name it, if it is the actuation",)
    if values is None or actuation_factor(column.unit)[1] != unit or not np.mean(values) > 0:
        return None, (f"column {column.name!r} holds no actuation that can be used",)
    mean = float(np.mean(values))
    if np.std(values) <= CONSTANT * mean:
        return f"{mean:.4g} {column.unit}", column.doubts
    return replace(column, doubts=()), column.doubts


def _agrees(measured: str | Guess, one: Candidate, level: Level) -> bool:
    """Whether a level of the name or header is within a tenth of the measured actuation."""
    column = one.column
    values = None if column is None else numbers_of(one.table, column.name)
    if column is None or column.unit is None or values is None:
        return True
    mean = float(np.mean(values)) * actuation_factor(column.unit)[0]
    return abs(mean - level.value) <= 0.1 * level.value


def _candidates(one: Candidate) -> str:
    """Sentence part: unused columns that measure a pressure or a force."""
    used = {guess.name for guess in one.columns.values()}
    found = [n for n in one.table.names if n not in used and unit_of(one.table, n, "actuation")]
    return f"; columns that might: {', '.join(map(repr, found[:4]))}" if found else ""


def _or(texts: Sequence[str]) -> str:
    return " or ".join(dict.fromkeys(texts))
