"""The goal of a campaign, and the tests to choose from: the table `[goal]`, read and checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mfd_bayes.campaign.schema import Wish
from mfd_bayes.planning.candidate import Limits, Parts, parse_limits, parse_tests
from mfd_bayes.planning.goal import Goal, check_goal
from mfd_bayes.units import ActuationUnit


@dataclass(frozen=True)
class Wanted:
    """What is to be known better, by which tests, and within which limits.

    Attributes
    ----------
    goal : Goal
    candidates : sequence of Parts
        Empty for the campaign's own grid.
    limits : Limits
    """

    goal: Goal = field(default_factory=Goal)
    candidates: Sequence[Parts] = ()
    limits: Limits = field(default_factory=Limits)


def wanted_of(path: Path, wish: Wish | None, unit: ActuationUnit) -> Wanted:
    """What the table `[goal]` of a campaign file asks for; the default without one.

    Raises
    ------
    CampaignError
        When a text in it is not understood; the sentence names the file and the key.
    """
    if wish is None:
        return Wanted()

    def key(name: str) -> str:
        return f"goal.{name} in {path}"

    at = tuple(parse_tests(wish.at, unit, of=key("at"))) if wish.at else ()
    goal = Goal(wish.quantity, wish.of, wish.kind, at, wish.probability, wish.session)
    check_goal(goal, of=key("quantity"))
    candidates = parse_tests(wish.candidates, unit, of=key("candidates")) if wish.candidates else ()
    limits = parse_limits(wish.limits, of=key("limits")) if wish.limits else Limits()
    return Wanted(goal, candidates, limits)
