"""How far a sampling goes, by name."""

from __future__ import annotations

from dataclasses import dataclass

from mfd_bayes.errors import FitError


@dataclass(frozen=True)
class Effort:
    """How far a sampling goes.

    Attributes
    ----------
    ess : float
        Bulk and tail effective sample size that every coordinate must reach.
    r_hat : float
        Largest R̂ across ensembles.
    block : int
        Steps between two looks at the convergence.
    limit : int
        Steps of each ensemble after which it stops in any case, and says what fell short.
    length : float
        Autocorrelation times that are discarded at the start, and as many kept after it, at
        the least: the effective sample size alone cannot tell walkers that have not moved
        from independent draws.
    ensembles : int
        Independent ensembles, each a chain.
    kept : int
        Draws of each ensemble that are kept, about.
    """

    ess: float
    block: int
    limit: int
    r_hat: float = 1.01
    length: float = 4.0
    ensembles: int = 4
    kept: int = 3000


EFFORTS = {
    "quick": Effort(ess=100, block=160, limit=2720, r_hat=1.03, length=2.0, kept=1200),
    "standard": Effort(ess=400, block=400, limit=8000),
    "thorough": Effort(ess=2000, block=1000, limit=40000, kept=8000),
}


def find_effort(effort: str | Effort) -> Effort:
    """Effort of that name.

    Raises
    ------
    FitError
        When there is none; the names that there are are listed.
    """
    if isinstance(effort, Effort):
        return effort
    if effort not in EFFORTS:
        raise FitError(f"unknown effort {effort!r}: expected one of {', '.join(EFFORTS)}")
    return EFFORTS[effort]
