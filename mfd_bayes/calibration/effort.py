"""Named settings of how long to sample."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

from mfd_bayes.errors import FitError
from mfd_bayes.records.numbers import real_number, whole_number


@dataclass(frozen=True)
class Effort:
    """Length and targets of a sampling; a FitError where one is no number that can be one.

    Attributes
    ----------
    ess : float
        Bulk and tail effective sample size that every quantity must reach.
    limit : int
        Largest number of steps of each ensemble; the report shows targets that were missed.
    r_hat : float
        Largest R̂ across ensembles.
    length : float
        Least number of kept steps, in autocorrelation times: the effective sample size alone
        cannot tell walkers that have not moved from independent draws.
    ensembles : int
        Independent ensembles, each a chain.
    walkers : int
        Walkers of each ensemble; more are used where there are many dimensions.
    kept : int
        Approximate number of draws kept from each ensemble.
    starts : int
        Points from which modes are searched; with few points a minor mode is missed.
    """

    name: str = field(default="", kw_only=True)
    ess: float
    limit: int
    r_hat: float = 1.01
    length: float = 5.0
    ensembles: int = 4
    walkers: int = 48
    kept: int = 3000
    starts: int = 24

    def __post_init__(self) -> None:
        for name in ("ess", "r_hat"):
            value = getattr(self, name)
            real_number(f"{name} of an effort", value, FitError, (0.0, inf), inside=True)
        real_number("length of an effort", self.length, FitError, (0.0, inf))
        for name in ("limit", "ensembles", "walkers", "kept", "starts"):
            whole_number(f"{name} of an effort", getattr(self, name), 1, FitError)


EFFORTS = {
    "quick": Effort(name="quick", ess=100, limit=2400, r_hat=1.03, length=3.0, kept=1200),
    "standard": Effort(name="standard", ess=400, limit=8000),
    "thorough": Effort(name="thorough", ess=2000, limit=40000, length=50.0, kept=8000, starts=72),
}


def find_effort(effort: str | Effort) -> Effort:
    """Effort of that name.

    Raises
    ------
    FitError
        When there is none; the message lists the known names.
    """
    if isinstance(effort, Effort):
        return effort
    if not isinstance(effort, str) or effort not in EFFORTS:
        raise FitError(f"unknown effort {effort!r}: expected one of {', '.join(EFFORTS)}")
    return EFFORTS[effort]
