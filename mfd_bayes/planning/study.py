"""Candidates simulated, and judged one by one and together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.noise import Noise
from mfd_bayes.errors import CampaignError, FitError
from mfd_bayes.friction.model import Model
from mfd_bayes.planning.advice import Advice, Row, Together
from mfd_bayes.planning.asked import draw_goals, unit_of
from mfd_bayes.planning.candidate import Candidate, Limits
from mfd_bayes.planning.choice import Pool, choose, greedy
from mfd_bayes.planning.devices import Devices
from mfd_bayes.planning.gain import Gain, Goals, gain_of
from mfd_bayes.planning.goal import Goal
from mfd_bayes.planning.grid import repeats, typical_of
from mfd_bayes.planning.loop import loop_of
from mfd_bayes.planning.regression import Fit, directions_of, fit_left_out
from mfd_bayes.planning.summaries import summarise
from mfd_bayes.population.population import Population
from mfd_bayes.population.setting import setting_of
from mfd_bayes.records.numbers import MOST_DRAWS, whole_number

Array = NDArray[np.float64]

TOGETHER = 3
"""Largest set of tests that is optimised by exchange."""

CURVE = 6
"""Number of further tests up to which the expected width is given."""

SHORTLIST = 12
"""Candidates, the best first, that are simulated again, so that a second copy can be chosen."""

COPIES = 2
"""Further copies of each of them."""

AFRESH = 3
"""Times that each of the best sets is simulated again, to judge it."""

TOO_STRONG = 0.025
"""A candidate may pass the limit of the force with this probability."""

FEWEST = 200
"""Fewest draws."""

NO_GAP = 0.1
"""Length that stands for the gap of a model without one, in."""

NEXT = "(the session of the next test)"
"""Session of candidates, where tests were made in several."""


@dataclass(frozen=True)
class Situation:
    """What a campaign knows.

    Attributes
    ----------
    population : Population
    model : Model
    noise : Noise
    tests : tuple of Candidate
        The tests that were made.
    sessions : tuple of str
        Their sessions.
    """

    population: Population
    model: Model
    noise: Noise
    tests: tuple[Candidate, ...]
    sessions: tuple[str, ...]


@dataclass(frozen=True)
class Effort:
    """How much is simulated."""

    draws: int = 2000
    seed: int = 0

    def __post_init__(self) -> None:
        whole_number("draws", self.draws, FEWEST, FitError, MOST_DRAWS)
        whole_number("seed", self.seed, 0, FitError)


def advise(
    situation: Situation,
    goal: Goal,
    candidates: Sequence[Candidate],
    limits: Limits,
    effort: Effort,
) -> Advice:
    """Candidates with what each is expected to tell of a goal, the best first.

    Raises
    ------
    CampaignError
        When the limits leave no candidate, or the goal cannot be known better by any.
    """
    study = _Study(situation, goal, _allowed(candidates, limits), effort)
    judged = [study.judge(number, 0) for number in range(len(study.candidates))]
    strong = {number for number, found in enumerate(judged) if found.force > _force(limits)}
    if len(strong) == len(judged):
        raise CampaignError(
            f"the limit of the force, {limits.force:.4g} kip, forbids every candidate: give "
            "candidates of less actuation, or check its unit"
        )
    fine = [number for number in range(len(judged)) if number not in strong]
    order = sorted(fine, key=lambda number: -judged[number].gain.reduction)
    copies = [(n, study.judge(n, k)) for n in order[:SHORTLIST] for k in range(1, COPIES + 1)]
    # the first copy has put a candidate on the list: it must not judge it too
    rows = [_row(study, n, [c for m, c in copies if m == n] or [judged[n]]) for n in order]
    named = [*((n, judged[n]) for n in order), *copies]
    return Advice(
        goal=goal,
        unit=unit_of(goal, situation.population.actuation_unit),
        width=study.goals.width,
        rows=tuple(sorted(rows, key=lambda row: -row.reduction)),
        together=study.together(named),
        ruled_out=_ruled_out(candidates, limits, [study.candidates[n] for n in sorted(strong)]),
        tests=situation.tests,
        draws=study.devices.index.size,
    )


def goals_of(situation: Situation, goal: Goal, effort: Effort) -> Goals:
    """Draws of a goal as a campaign knows it now."""
    return _Study(situation, goal, (), effort).goals


@dataclass(frozen=True, eq=False)
class _Judged:
    """A simulated test: its gain, directions of its summaries, a high quantile of its peak."""

    gain: Gain
    directions: Array
    force: float


@dataclass(frozen=True, eq=False)
class _Study:
    """One question about a campaign."""

    situation: Situation
    goal: Goal
    candidates: Sequence[Candidate]
    effort: Effort

    @cached_property
    def gap(self) -> float:
        """About the width of the gap, in."""
        population, layout = self.situation.population, self.situation.population.layout
        values = layout.coordinates.values(population.levels.reshape(population.size, -1))
        found = self.situation.model.gap(values)
        return NO_GAP if found is None else float(np.median(found))

    @cached_property
    def places(self) -> list[Candidate]:
        """Motions and actuations that the goal is about."""
        return self.goal.places(typical_of(self.situation.tests))

    @cached_property
    def sessions(self) -> tuple[str, str]:
        """Session that the goal is about, and session of the candidates."""
        known = dict.fromkeys(self.situation.sessions)
        if len(known) == 1:
            return (next(iter(known)),) * 2
        return self.goal.session, NEXT

    @cached_property
    def devices(self) -> Devices:
        """Draws of the population for everything that is asked."""
        now, then = self.sessions
        asked = [
            setting_of(loop_of(candidate, self.gap).trace, session)
            for session, those in ((now, self.places), (then, self.candidates))
            for candidate in those
        ]
        rng = np.random.default_rng([self.effort.seed, 0])
        kinds = self.situation.model, self.situation.noise
        return Devices.draw(self.situation.population, kinds, asked, self.effort.draws, rng)

    @cached_property
    def goals(self) -> Goals:
        """Draws of the goal."""
        return draw_goals(self.goal, self.places, self.devices, self.gap, self.sessions[0])

    def judge(self, number: int, copy: int) -> _Judged:
        """One copy of a candidate, simulated and judged."""
        force, directions = self._simulated(number, copy)
        fit = fit_left_out(self.goals.values, directions)
        peaks = np.abs(force).max(axis=1)
        return _Judged(self._gain(fit), directions, float(np.quantile(peaks, 1 - TOO_STRONG)))

    def _simulated(self, number: int, copy: int) -> tuple[Array, Array]:
        """Forces of a copy of a candidate, (n, T), kip, and directions of its summaries, (n, k)."""
        candidate = self.candidates[number]
        loop = loop_of(candidate, self.gap)
        seed = (self.effort.seed, 1, number, copy)
        force = self.devices.measured(loop, self.sessions[1], candidate.cycles, seed)
        return force, directions_of(summarise(loop, force, self.gap))

    def together(self, named: Sequence[tuple[int, _Judged]]) -> tuple[Together, ...]:
        """The best sets of simulated tests, named by their candidates."""
        pool = Pool(self.goals, [judged.directions for _, judged in named])
        sets = choose(len(named), pool.reduction, TOGETHER)
        sets += greedy(sets[-1], len(named), pool.reduction, CURVE)
        numbers = [tuple(named[k][0] for k in chosen) for chosen in sets]
        afresh = cache(lambda number, copy: self._simulated(number, copy)[1])
        return tuple(
            Together(tuple(self.candidates[n] for n in chosen), self._gain_of_set(chosen, afresh))
            for chosen in numbers
        )

    def _gain_of_set(self, chosen: Sequence[int], afresh: Callable[[int, int], Array]) -> Gain:
        """Gain of a set by new copies of its tests.

        Of many sets the best owes part of its worth to the chance in its copies, so that these
        copies must not judge it too.
        """
        gains = []
        for again in range(AFRESH):
            first = COPIES + 1 + again * CURVE
            columns = [afresh(number, first + place) for place, number in enumerate(chosen)]
            together = np.concatenate(columns, axis=1)
            gains.append(self._gain(fit_left_out(self.goals.values, together, curved=False)))
        return _mean(gains)

    def _gain(self, fit: Fit) -> Gain:
        return gain_of(self.goals, fit, np.random.default_rng([self.effort.seed, 2]))


def _mean(gains: Sequence[Gain]) -> Gain:
    """Mean of gains, and of their errors: each is that of one copy."""
    return Gain(
        **{f.name: float(np.mean([getattr(g, f.name) for g in gains])) for f in fields(Gain)}
    )


def _row(study: _Study, number: int, copies: Sequence[_Judged]) -> Row:
    """Row of a candidate: the mean over its copies."""
    candidate, gain = study.candidates[number], _mean([copy.gain for copy in copies])
    return Row(candidate, gain, repeats(candidate, study.situation.tests))


def _force(limits: Limits) -> float:
    return np.inf if limits.force is None else limits.force


def _allowed(candidates: Sequence[Candidate], limits: Limits) -> list[Candidate]:
    found = [candidate for candidate in dict.fromkeys(candidates) if limits.allow(candidate)]
    if not found:
        raise CampaignError(
            "the limits of velocity and stroke forbid every candidate: give other candidates, or "
            "check the limits' units"
        )
    return found


def _ruled_out(
    candidates: Sequence[Candidate], limits: Limits, strong: Sequence[Candidate]
) -> tuple[tuple[Candidate, str], ...]:
    """Candidates that the limits forbid, each with the limit that does."""
    found: list[tuple[Candidate, str]] = []
    for candidate in dict.fromkeys(candidates):
        if candidate in strong:
            found.append((candidate, "force"))
        elif not limits.allow(candidate):
            slow = limits.velocity is None or candidate.speed <= limits.velocity
            found.append((candidate, "stroke" if slow else "velocity"))
    return tuple(found)
