"""Which test to make next with the device of a run."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from mfd_bayes.applications.next_test.study import Advice, advise
from mfd_bayes.campaign.campaign import GoalSettings, goal_settings
from mfd_bayes.campaign.candidate import (
    MOST,
    NEW_DEVICE,
    Candidate,
    Goal,
    Limits,
    Parts,
    Shown,
    check_goal,
    check_session,
    grid_of,
    harmonic_of,
    parse_goal,
    parse_limits,
    parse_tests,
    typical_of,
)
from mfd_bayes.errors import CampaignError
from mfd_bayes.runs.folder import CAMPAIGN
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.tested_range import extrapolations

Candidates = str | Candidate | Iterable[str | Candidate]
"""Tests in words, or as they are."""


def next_test(
    run: Run,
    goal: str | Goal | None = None,
    candidates: Candidates | None = None,
    *,
    limits: str | Limits | None = None,
    draws: int = 2000,
    seed: int = 0,
) -> Advice:
    """Table of tests that could be made next, and of what each is expected to tell.

    Parameters
    ----------
    run : Run
    goal : str or Goal, optional
        "energy at 1000 psi, 0.5 Hz, 1 in"; by default the campaign file's, or "band".
    candidates : str or Candidate, or several, optional
        "500|1350 psi, 0.5 Hz, 1 in"; by default a grid from the campaign's range.
    limits : str or Limits, optional
        Of the actuator, "10 in/s, 6 in, 20 kip".

    Raises
    ------
    CampaignError
        When an option is of another type or not understood, or the limits leave no candidate.
    """
    settings = _goal_settings(run, goal, candidates, limits)
    axes, design = run.system.axes, run.population.design
    display = Shown(
        run.system.factor(run.actuation_unit),
        run.system.factor("in"),
        actuated=axes.actuated,
        timed=axes.timed,
    )
    # an actuation that is next to nothing is zero in the population
    past_tests = tuple(
        replace(harmonic_of(test.trace, display), actuation=setting.actuation)
        for test, setting in zip(run.tests.values(), design.settings, strict=True)
    )
    check_session(settings.goal.session, design.sessions)
    typical = [test for test in typical_of(past_tests) if test.actuation > 0.0]
    # without an actuation of its own a test is one at each of the campaign's range
    tests = [
        entry.completed(level)
        for entry in settings.candidates
        for level in (typical if entry.actuation is None else typical[:1])
    ]
    if len(tests) > MOST:
        raise CampaignError(f"more than {MOST} tests, the most of one question")
    tests = tests or grid_of(past_tests, display)
    if run.population.several_devices:  # the one that was tested last, or one more
        devices = NEW_DEVICE, design.settings[-1].device
        tests = [replace(c, device=d) for c in tests for d in ([c.device] if c.device else devices)]
    question = settings.goal, tests, settings.limits
    advice = advise(run.predictor, past_tests, *question, draws=draws, seed=seed)
    if not settings.candidates:
        return advice
    reached = []
    for span in run.tested:
        values = [getattr(row.candidate, span.name) for row in advice]
        reached.append(replace(span, lowest=min(values), highest=max(values)))
    exceedances = extrapolations(run.tested, reached)
    return replace(advice, remarks=tuple(d.sentence(run.system) for d in exceedances))


def _goal_settings(
    run: Run, goal: str | Goal | None, candidates: Candidates | None, limits: str | Limits | None
) -> GoalSettings:
    """What is given, checked, and for the rest what the campaign file says."""
    unit = run.actuation_unit
    table, laws = run.manifest.settings.goal, tuple(run.model.laws)
    stored = (*laws, table.of) if table else laws
    defaults = goal_settings(table, unit, run.folder / CAMPAIGN, stored)
    if isinstance(goal, str):
        goal = replace(parse_goal(goal, unit, of="goal", laws=laws), session=defaults.goal.session)
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
    if candidates is None:
        return GoalSettings(goal or defaults.goal, defaults.candidates, limits or defaults.limits)
    several = [candidates] if isinstance(candidates, str | Candidate) else candidates
    tests: list[Parts] = []
    for test in several if isinstance(several, Iterable) else [several]:
        if isinstance(test, Candidate):
            tests.append(Parts(**vars(test)))
        elif isinstance(test, str):
            tests += parse_tests(test, unit, of="candidates")
        else:
            raise CampaignError(
                f"candidates must be tests in words or Candidates, one or several, got {test!r}"
            )
    tests = tests or parse_tests("", unit, of="candidates")
    return GoalSettings(goal or defaults.goal, tests, limits or defaults.limits)
