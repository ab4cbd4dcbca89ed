"""The actuation of each test file, out of its columns, header lines and name."""

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
from mfd_bayes.units import ActuationUnit, actuation_factor

CONSTANT = 0.02
"""An actuation that scatters by less than this share of its mean is a level."""


@dataclass(frozen=True, eq=False)
class Seen:
    """A file that has time, displacement and force, and the actuations it may have.

    Attributes
    ----------
    path : Path
    table : Table
    columns : dict
        Role to guess, without the actuation.
    column : Guess or None
        Of the actuation.
    header : Level or None
    named : tuple of Level
        In the file's name.
    """

    path: Path
    table: Table
    columns: dict[str, Guess]
    column: Guess | None
    header: Level | None
    named: tuple[Level, ...]

    @property
    def levels(self) -> list[Level]:
        """Every level that is stated, the certain ones first."""
        stated = [level for level in (self.header, *self.named) if level is not None]
        return sorted(stated, key=lambda level: bool(level.doubt))


def without_shared_levels(seen: list[Seen]) -> list[Seen]:
    """Names without the levels that all have: of several in a name, those say no more."""
    if len(seen) < 2:
        return seen
    shared = set.intersection(*({level.text for level in one.named} for one in seen))
    return [
        replace(one, named=tuple(lv for lv in one.named if lv.text not in shared) or one.named)
        for one in seen
    ]


def prevailing_unit(seen: Sequence[Seen]) -> ActuationUnit | None:
    """Whether most files have pressures, as on a tie, or tensions; None where none has either."""
    count: Counter[ActuationUnit] = Counter()
    for one in seen:
        certain = [level for level in one.levels if not level.doubt]
        units = {level.unit for level in certain or one.levels}
        if one.column is not None and one.column.unit is not None:
            units.add(actuation_factor(one.column.unit)[1])
        count.update(units)
    if not count:
        return None
    return "ksi" if count["ksi"] >= count["kip"] else "kip"


def actuation_of(
    one: Seen, unit: ActuationUnit | None
) -> tuple[str | Guess | None, str, tuple[str, ...]]:
    """Actuation, what it is taken from, and what is not certain about it.

    What was measured counts before what the header or the name states; None where nothing does.

    Raises
    ------
    RecordError
        When the actuation is zero, or no pressure among pressures or tension among tensions.
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
        if level.value == 0.0:
            raise RecordError("its actuation is zero, and nothing presses the device")
        return level.text, "in the header" if level == one.header else "in the file's name", doubts
    if stated:
        raise RecordError(
            f"its actuation of {stated[0].text} is a "
            f"{'force' if stated[0].unit == 'kip' else 'pressure'}, and those of most files are not"
        )
    return None, _candidates(one), doubts


def _measured(one: Seen, unit: ActuationUnit | None) -> tuple[str | Guess | None, tuple[str, ...]]:
    """Level or history that a column of actuation holds, if there is one to be used."""
    column = one.column
    if column is None:
        return None, ()
    values = numbers_of(one.table, column.name)
    if column.unit is None:
        return None, (f"column {column.name!r} has no unit: name it, if it is the actuation",)
    if values is None or actuation_factor(column.unit)[1] != unit or not np.mean(values) > 0:
        return None, (f"column {column.name!r} holds no actuation that can be used",)
    mean = float(np.mean(values))
    if np.std(values) <= CONSTANT * mean:
        return f"{mean:.4g} {column.unit}", column.doubts
    return Guess(column.name, column.unit), column.doubts


def _agrees(measured: str | Guess, one: Seen, level: Level) -> bool:
    """Whether a stated level is within a tenth of what was measured."""
    column = one.column
    values = None if column is None else numbers_of(one.table, column.name)
    if column is None or column.unit is None or values is None:
        return True
    mean = float(np.mean(values)) * actuation_factor(column.unit)[0]
    return abs(mean - level.value) <= 0.1 * level.value


def _candidates(one: Seen) -> str:
    """Columns that measure a pressure or a force and are used for nothing."""
    used = {guess.name for guess in one.columns.values()}
    found = [n for n in one.table.names if n not in used and unit_of(one.table, n, "actuation")]
    return f"; columns that might: {', '.join(map(repr, found[:4]))}" if found else ""


def _or(texts: Sequence[str]) -> str:
    return " or ".join(dict.fromkeys(texts))
