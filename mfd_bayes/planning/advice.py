"""Which test to make next: a table of candidates, and the best ones together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import NotThereError
from mfd_bayes.planning.candidate import Candidate
from mfd_bayes.planning.gain import Gain
from mfd_bayes.planning.goal import Goal

Array = NDArray[np.float64]

COLUMNS = ("candidate", "reduction", "error", "information", "information_error", "cost")


@dataclass(frozen=True)
class Row:
    """A candidate, and what is expected of it.

    Attributes
    ----------
    candidate : Candidate
    gain : Gain
    repeat : bool
        Whether it is like a test that was made.
    """

    candidate: Candidate
    gain: Gain
    repeat: bool

    @property
    def reduction(self) -> float:
        """Expected reduction of the goal's width, as a share of it."""
        return self.gain.reduction

    @property
    def error(self) -> float:
        """Standard error of the reduction."""
        return self.gain.error

    @property
    def information(self) -> float:
        """Expected information about the goal, nat."""
        return self.gain.information

    @property
    def information_error(self) -> float:
        """Standard error of the information."""
        return self.gain.information_error

    @property
    def cost(self) -> float:
        """What the candidate costs, h of frame time or as the user gave it."""
        return self.candidate.cost

    @property
    def per_hour(self) -> float:
        """Expected reduction by an hour of its cost; infinite where it costs nothing."""
        return self.reduction / self.cost if self.cost > 0.0 else np.inf


@dataclass(frozen=True)
class Together:
    """Tests that are best together, and what is expected of them."""

    candidates: tuple[Candidate, ...]
    gain: Gain


@dataclass(frozen=True, eq=False)
class Advice(Sequence[Row]):
    """A table of candidates, the best first; `advice["reduction"]` is a column.

    Attributes
    ----------
    goal : Goal
    unit : str
        Internal unit of the goal.
    width : float
        Mean width of the goal's bands as it is known now.
    rows : tuple of Row
    together : tuple of Together
        The best one, two and three tests, then one more after another.
    ruled_out : tuple of (Candidate, str)
        Candidates that the limits forbid, and which limit.
    tests : tuple of Candidate
        The tests that were made.
    draws : int
        Draws of the population that all is computed from.
    remarks : tuple of str
        Where candidates that were asked for lie outside what was tested.
    """

    goal: Goal
    unit: str
    width: float
    rows: tuple[Row, ...]
    together: tuple[Together, ...]
    ruled_out: tuple[tuple[Candidate, str], ...]
    tests: tuple[Candidate, ...]
    draws: int
    remarks: tuple[str, ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        return COLUMNS

    @property
    def curve(self) -> Array:
        """Expected width after 0, 1, 2, … further tests, in `unit`."""
        return self.width * np.array([1.0, *(1.0 - t.gain.reduction for t in self.together)])

    def __len__(self) -> int:
        """Number of candidates."""
        return len(self.rows)

    def __iter__(self) -> Iterator[Row]:
        """Rows, the best first."""
        return iter(self.rows)

    @overload
    def __getitem__(self, key: int) -> Row: ...

    @overload
    def __getitem__(self, key: slice) -> tuple[Row, ...]: ...

    @overload
    def __getitem__(self, key: str) -> list[object]: ...

    def __getitem__(self, key: int | slice | str) -> object:
        """A row by its number, some rows, or a column by its name.

        Raises
        ------
        NotThereError
            When there is no such row or column.
        """
        if isinstance(key, str):
            if key not in COLUMNS:
                raise NotThereError(f"no column {key!r}: there are {', '.join(COLUMNS)}")
            return [getattr(row, key) for row in self.rows]
        try:
            return self.rows[key]
        except (IndexError, TypeError) as error:
            raise NotThereError(
                f"no row {key!r}: rows have the numbers 0 to {len(self.rows) - 1}, and columns the "
                f"names {', '.join(COLUMNS)}"
            ) from error
