"""How long to sample, and to what precision."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

from mfd_bayes.errors import FitError, real_number, whole_number


@dataclass(frozen=True)
class Effort:
    """Length and targets of a sampling.

    The effective sample size alone cannot tell walkers that have not moved from independent draws:
    hence a least number of steps too.
    """

    name: str = field(default="", kw_only=True)
    ess: float  # effective sample size of all bulks, and of the tails that tables show
    limit: int  # largest number of steps of each ensemble
    r_hat: float = 1.01  # largest R̂ across ensembles
    length: float = 5.0  # least number of kept steps, in autocorrelation times
    ensembles: int = 4  # independent ensembles, each a chain
    walkers: int = 48  # walkers of each ensemble; more are used where there are many dimensions
    kept: int = 3000  # approximate number of draws kept from each ensemble
    starts: int = 24  # points from which modes are searched; with few points a minor mode is missed

    def __post_init__(self) -> None:
        for name in ("ess", "r_hat"):
            value = getattr(self, name)
            real_number(f"{name} of an effort", value, FitError, (0.0, inf), exclusive=True)
        real_number("length of an effort", self.length, FitError, (0.0, inf))
        for name in ("limit", "ensembles", "walkers", "kept", "starts"):
            whole_number(f"{name} of an effort", getattr(self, name), 1, FitError)


EFFORTS = {
    "quick": Effort(name="quick", ess=100.0, limit=2400, r_hat=1.03, length=3.0, kept=1200),
    "standard": Effort(name="standard", ess=400.0, limit=8000),
    "thorough": Effort(name="thorough", ess=2000.0, limit=40000, length=50.0, kept=8000, starts=72),
}


def find_effort(effort: str | Effort) -> Effort:
    """Effort of that name."""
    if isinstance(effort, Effort):
        return effort
    if not isinstance(effort, str) or effort not in EFFORTS:
        raise FitError(f"unknown effort {effort!r}: expected one of {', '.join(EFFORTS)}")
    return EFFORTS[effort]
