"""What is asked of a prediction."""

from __future__ import annotations

from dataclasses import dataclass, field

from mfd_bayes.errors import FitError
from mfd_bayes.population.checks import check_flag, check_text
from mfd_bayes.population.kinds import KINDS
from mfd_bayes.population.sequel import Ending
from mfd_bayes.records.numbers import MOST_DRAWS, real_number, whole_number
from mfd_bayes.units import percent

DRAWS = 500
"""Draws of a band where no other number is asked for."""

FEWEST = 10
"""Fewest draws of a band."""


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
        When the kind is unknown, the probability is not between 0 and 1, the draws are fewer than
        `FEWEST`, or a value is of another type than is said here.
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
        real_number("probability", self.probability, FitError, (0.0, 1.0), inside=True)
        whole_number("draws", self.draws, FEWEST, FitError, MOST_DRAWS)
        whole_number("seed", self.seed, 0, FitError)
        check_text("session", self.session)
        check_flag("whole", self.whole)

    @property
    def remarks(self) -> tuple[str, ...]:
        """A remark where the draws are too few for the probability."""
        beyond = 0.5 * (1.0 - self.probability) * self.draws
        if beyond >= 1.0 - 1e-9:
            return ()
        return (
            f"{self.draws} draws are too few for a band of {percent(self.probability)} %: its ends "
            "are about the smallest and the largest draw",
        )
