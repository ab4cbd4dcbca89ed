"""Which test next, asked of a run: goal, candidates and limits, given or the campaign's own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from mfd_bayes.campaign.campaign import GoalSettings, goal_settings
from mfd_bayes.errors import CampaignError
from mfd_bayes.planning.candidate import (
    MOST,
    NEW_DEVICE,
    Candidate,
    Limits,
    Parts,
    Shown,
    grid_of,
    harmonic_of,
    parse_limits,
    parse_tests,
    typical_of,
)
from mfd_bayes.planning.goal import Goal, check_goal, check_session, parse_goal
from mfd_bayes.planning.study import Advice, Effort, Situation, advise
from mfd_bayes.runs.paths import CAMPAIGN
from mfd_bayes.runs.tested_range import Span, departures
from mfd_bayes.units import ActuationUnit

if TYPE_CHECKING:
    from mfd_bayes.runs.run import Run

Candidates = str | Candidate | Iterable[str | Candidate]
"""Tests in words, or as they are."""


def next_test(
    run: Run,
    goal: str | Goal | None,
    candidates: Candidates | None,
    limits: str | Limits | None,
    effort: Effort,
) -> Advice:
    """Table of the candidates, or of a grid from the campaign's range; see `Run.next_test`."""
    settings = _chosen(run, goal, candidates, limits)
    shown = Shown(run.system.factor(run.actuation_unit), run.system.factor("in"))
    shown = replace(shown, actuated=run.system.axes.actuated, timed=run.system.axes.timed)
    # an actuation that is next to nothing is zero in the population
    done = tuple(
        replace(harmonic_of(test.trace, shown), actuation=setting.actuation)
        for test, setting in zip(run.tests.values(), run.population.design.settings, strict=True)
    )
    sessions = tuple(run.session(name) for name in run.tests)
    check_session(settings.goal.session, sessions)
    predictor = run.predictor
    situation = Situation(run.population, predictor.model, predictor.noise, done, sessions)
    typical = [test for test in typical_of(done) if test.actuation > 0.0]
    # without an actuation of its own a test is one at each of the campaign's range
    tests = [
        parts.completed(level)
        for parts in settings.candidates
        for level in (typical if parts.actuation is None else typical[:1])
    ]
    if len(tests) > MOST:
        raise CampaignError(f"more than {MOST} tests, the most of one question")
    chosen = tests or grid_of(done, shown)
    devices = [setting.device for setting in run.population.design.settings]
    if run.population.several_devices:  # the one that was tested last, or one more
        among = NEW_DEVICE, devices[-1]
        chosen = [
            replace(c, device=d) for c in chosen for d in ((c.device,) if c.device else among)
        ]
    advice = advise(situation, settings.goal, chosen, settings.limits, effort)
    if not settings.candidates:
        return advice
    reached = []
    for span in run.tested:
        values = [getattr(row.candidate, span.name) for row in advice]
        reached.append(Span(span.name, span.unit, min(values), max(values)))
    outside = departures(run.tested, reached)
    return replace(advice, remarks=tuple(departure.sentence(run.system) for departure in outside))


def _chosen(
    run: Run, goal: str | Goal | None, candidates: Candidates | None, limits: str | Limits | None
) -> GoalSettings:
    """What is given, checked, and for the rest what the campaign file says."""
    unit = run.actuation_unit
    table, laws = run.manifest.settings.goal, tuple(run.model.laws)
    stored = (*laws, table.of) if table else laws
    own = goal_settings(table, unit, run.folder / CAMPAIGN, stored)
    if isinstance(goal, str):
        goal = replace(parse_goal(goal, unit, of="goal", laws=laws), session=own.goal.session)
    elif isinstance(goal, Goal):
        check_goal(goal, of="goal", laws=laws)
    elif goal is not None:
        raise CampaignError(f"goal must be text such as 'band', or a Goal, got {goal!r}")
    if isinstance(limits, str):
        limits = parse_limits(limits, of="limits")
    elif not isinstance(limits, Limits | None):
        raise CampaignError(
            f"limits must be text such as '10 in/s, 6 in, 20 kip', or Limits, got {limits!r}"
        )
    tests = own.candidates if candidates is None else _parsed(candidates, unit)
    return GoalSettings(goal or own.goal, tests, limits or own.limits)


def _parsed(candidates: Candidates, unit: ActuationUnit) -> list[Parts]:
    if isinstance(candidates, bytes | Mapping) or not isinstance(candidates, Iterable | Candidate):
        raise CampaignError(
            f"candidates must be tests in words or Candidates, one or several, got {candidates!r}"
        )
    parts: list[Parts] = []
    for test in [candidates] if isinstance(candidates, str | Candidate) else candidates:
        if isinstance(test, Candidate):
            parts.append(Parts(**vars(test)))
        elif isinstance(test, str):
            parts += parse_tests(test, unit, of="candidates")
        else:
            raise CampaignError(
                f"candidates must be tests in words or Candidates, and there is {test!r} among them"
            )
    return parts or parse_tests("", unit, of="candidates")
