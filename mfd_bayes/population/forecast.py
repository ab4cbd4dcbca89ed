"""What is asked of a prediction."""

from __future__ import annotations

from dataclasses import dataclass, field

from mfd_bayes.errors import FitError
from mfd_bayes.population.kinds import KINDS
from mfd_bayes.population.sequel import Ending
from mfd_bayes.records.numbers import whole_number

DRAWS = 500
"""Draws of a band where no other number is asked for."""


@dataclass(frozen=True)
class Forecast:
    """Settings of a prediction.

    Attributes
    ----------
    kind : {"device", "new_test", "observation", "this_test"}
    probability : float
    draws, seed : int
    session : str
        Of the predicted test, where the campaign declares sessions.
    whole : bool
        Whether a band of the whole history is computed too.
    permutations : int
        Orders of sources for `Band.shares`; 0 for none.
    before : Ending, optional
        Of the test that the motion follows without a reset.

    Raises
    ------
    FitError
        When the kind is unknown, or the probability is not between 0 and 1.
    """

    kind: str = "new_test"
    probability: float = 0.95
    draws: int = DRAWS
    seed: int = 0
    session: str = ""
    whole: bool = False
    permutations: int = 0
    before: Ending | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise FitError(f"unknown kind {self.kind!r}: expected one of {', '.join(KINDS)}")
        if not 0.0 < self.probability < 1.0:
            raise FitError(f"probability must lie between 0 and 1, got {self.probability}")
        if whole_number("draws", self.draws, 0, FitError) < 10:
            raise FitError(f"a band needs at least 10 draws, got {self.draws}")
        whole_number("seed", self.seed, 0, FitError)
