"""What is drawn of a building's dampers."""

from __future__ import annotations

from dataclasses import dataclass

from mfd_bayes.errors import BuildingError
from mfd_bayes.records.numbers import MOST_DRAWS, whole_number

KINDS = ("new_test", "device")
"""With each damper's own scatter from test to test, or the mean property alone."""

FEWEST = 10
"""Fewest draws of a response."""


@dataclass(frozen=True)
class Choice:
    """What is drawn.

    Attributes
    ----------
    kind : {"new_test", "device"}
    draws, seed : int
    session : str
    scatter : float
        Factor of the scatter from test to test: 1, or another to see what it does.
    """

    kind: str = "new_test"
    draws: int = 300
    seed: int = 1
    session: str = ""
    scatter: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise BuildingError(f"unknown kind {self.kind!r}: expected one of {', '.join(KINDS)}")
        whole_number("draws", self.draws, FEWEST, BuildingError, MOST_DRAWS)
        whole_number("seed", self.seed, 0, BuildingError)
