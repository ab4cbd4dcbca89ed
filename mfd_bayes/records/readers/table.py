"""The columns of a file, each read when it is asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

from mfd_bayes.errors import RecordError
from mfd_bayes.records.motion import Array
from mfd_bayes.records.readers.bounds import check_names


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of a file; a column that is not used may hold anything."""

    path: Path
    names: tuple[str, ...]  # in the file's order
    load: Callable[[Sequence[str]], dict[str, Array]]  # of names that exist; checks every cell
    place: Callable[[int], str]  # of a row, from 0: "line 17"
    units: Mapping[str, str] = field(default_factory=dict)  # by column, where the file gives one

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
                fault = "missing column" if name not in self.names else "more than one column"
                raise RecordError(f"{fault} {name!r} in {self.path}; it has {_listed(self.names)}")
        columns = self.load(names)
        sizes = {name: column.size for name, column in columns.items()}
        if len(set(sizes.values())) > 1:
            lengths = ", ".join(f"{name} {size}" for name, size in sizes.items())
            raise RecordError(f"columns of {self.path} have different lengths: {lengths}")
        if 0 in sizes.values():
            raise RecordError(f"{self.path} has columns but no data")
        return columns


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(islice(names, 20))
    return shown if len(names) <= 20 else f"{shown} and {len(names) - 20} more"
