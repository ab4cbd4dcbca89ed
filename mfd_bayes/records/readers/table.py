"""The columns of a file, each read when it is asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

from mfd_bayes.errors import RecordError
from mfd_bayes.records.motion import Array
from mfd_bayes.records.readers.bounds import check_names
from mfd_bayes.records.readers.labels import own_name


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of a file; a column that is not used may hold anything."""

    path: Path
    names: tuple[str, ...]  # in the file's order
    load: Callable[[Sequence[str]], dict[str, Array]]  # of names that exist; checks every cell
    place: Callable[[int], str]  # of a row, from 0: "line 17"
    units: Mapping[str, str] = field(default_factory=dict)  # by column, where the file gives one
    numbers: tuple[int, ...] | None = None  # of the columns, from 1; by default in their order
    headed: bool = True  # whether the file has names; without them, they are "column 1", …
    blocks: Mapping[int, str] = field(default_factory=dict)  # row to place of the header above it
    notes: tuple[str, ...] = ()  # sentences on numbers of the file that are not in the table
    doubts: tuple[str, ...] = ()  # the same, of those that probably belong to it
    patchy: Callable[[Sequence[str]], dict[str, Array]] | None = None  # as load, NaN for bad cells

    def __post_init__(self) -> None:
        check_names(self.path, self.names)

    def columns(self, names: Sequence[str]) -> dict[str, Array]:
        """Columns by name, each (T,), in the file's units.

        Raises
        ------
        RecordError
            When a column is missing, named twice, empty, of another length,
            or holds text or a value that is not finite.
        """
        for name in names:
            if self.names.count(name) != 1:
                raise self.no_column(name)
        columns = self.load(names)
        sizes = {name: column.size for name, column in columns.items()}
        if len(set(sizes.values())) > 1:
            lengths = ", ".join(f"{name} {size}" for name, size in sizes.items())
            raise RecordError(f"columns of {self.path} have different lengths: {lengths}")
        if 0 in sizes.values():
            raise RecordError(f"{self.path} has columns but no data")
        return columns

    def part(self, first: int, last: int, doubt: str) -> Table:
        """Table of rows `first` to before `last`; `doubt` says what is left out.

        Raises
        ------
        RecordError
            When the file's reader cannot leave out rows.
        """
        patchy = self.patchy
        if patchy is None:
            raise RecordError(f"{self.path}: no part of it can be read")
        return replace(
            self,
            load=lambda names: {n: column[first:last] for n, column in patchy(names).items()},
            place=lambda row: self.place(row + first),
            blocks={row - first: at for row, at in self.blocks.items() if row > first},
            doubts=(*self.doubts, doubt),
        )

    def number_of(self, name: str) -> int:
        """Number of a column in the file, from 1."""
        at = self.names.index(name)
        return at + 1 if self.numbers is None else self.numbers[at]

    def name_of(self, column: str | int) -> str:
        """Name of a column that is given by its name or its number, from 1.

        Raises
        ------
        RecordError
            When there is no column of that number.
        """
        if isinstance(column, str):
            return column
        numbers = self.numbers or range(1, len(self.names) + 1)
        if column not in numbers:
            raise RecordError(
                f"column {column} of {self.path}: it has columns {min(numbers)} to {max(numbers)}, "
                f"{_listed(self.names)}"
            )
        return self.names[numbers.index(column)]

    def no_column(self, name: str) -> RecordError:
        """Error for a name that no column, or more than one, has."""
        shared = [self.number_of(other) for other in self.names if own_name(other) == name]
        if len(shared) > 1:
            which = " or ".join(f"{{ column = {number} }}" for number in shared)
            return RecordError(
                f"more than one column {name!r} in {self.path}: say which by its number, {which}"
            )
        how = "" if self.headed else "; it has no names: give { column = 1 } or another number"
        return RecordError(
            f"missing column {name!r} in {self.path}; it has {_listed(self.names)}{how}"
        )


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(islice(names, 20))
    return shown if len(names) <= 20 else f"{shown} and {len(names) - 20} more"
