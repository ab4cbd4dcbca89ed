"""What is asked of a run about its next test: goal, candidates and limits, given or its own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from mfd_bayes.calibration.result import TestResult
from mfd_bayes.campaign.content import read_content
from mfd_bayes.campaign.goal import Wanted, wanted_of
from mfd_bayes.errors import CampaignError
from mfd_bayes.planning.candidate import (
    MOST,
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
from mfd_bayes.population.population import Population
from mfd_bayes.runs.folder import CAMPAIGN, check_stored
from mfd_bayes.runs.manifest import Manifest
from mfd_bayes.runs.systems import System
from mfd_bayes.runs.tested import Span, leaving
from mfd_bayes.units import ActuationUnit

Candidates = str | Candidate | Iterable[str | Candidate]
"""Tests in words, or as they are."""


def stored_wish(folder: Path, manifest: Manifest) -> Wanted:
    """The goal of the campaign file that a run has stored; the default where it has none."""
    if not (folder / CAMPAIGN).is_file():
        return Wanted()
    path = check_stored(folder, CAMPAIGN, manifest.files or {})
    return wanted_of(path, read_content(path).goal, manifest.settings.actuation_unit)


def wish_of(
    folder: Path,
    manifest: Manifest,
    goal: str | Goal | None,
    candidates: Candidates | None,
    limits: str | Limits | None,
) -> Wanted:
    """What is given, and for the rest what a run has stored.

    Raises
    ------
    CampaignError
        When one of them is of another type, or a text is not understood.
    """
    wanted, unit = stored_wish(folder, manifest), manifest.settings.actuation_unit
    if isinstance(goal, str):
        goal = replace(parse_goal(goal, unit, of="goal"), session=wanted.goal.session)
    elif isinstance(goal, Goal):
        check_goal(goal, of="goal")
    elif goal is not None:
        raise CampaignError(f"goal must be text such as 'band', or a Goal, got {goal!r}")
    if isinstance(limits, str):
        limits = parse_limits(limits, of="limits")
    elif not isinstance(limits, Limits | None):
        raise CampaignError(
            f"limits must be text such as '10 in/s, 6 in, 20 kip', or Limits, got {limits!r}"
        )
    chosen = wanted.candidates if candidates is None else _parsed(candidates, unit)
    return Wanted(goal or wanted.goal, chosen, limits or wanted.limits)


def _parsed(candidates: Candidates, unit: ActuationUnit) -> list[Parts]:
    if isinstance(candidates, bytes | Mapping) or not isinstance(candidates, Iterable | Candidate):
        raise CampaignError(
            f"candidates must be tests in words or Candidates, one or several, got {candidates!r}"
        )
    found: list[Parts] = []
    for one in [candidates] if isinstance(candidates, str | Candidate) else candidates:
        if isinstance(one, Candidate):
            found.append(Parts(**vars(one)))
        elif isinstance(one, str):
            found += parse_tests(one, unit, of="candidates")
        else:
            raise CampaignError(
                f"candidates must be tests in words or Candidates, and there is {one!r} among them"
            )
    return found or parse_tests("", unit, of="candidates")


def next_test(
    population: Population,
    tests: Mapping[str, TestResult],
    manifest: Manifest,
    wanted: Wanted,
    effort: Effort,
) -> Advice:
    """Table of the wanted candidates, or of a grid from the campaign's range."""
    system = manifest.system_of(test.trace for test in tests.values())
    shown = Shown(system.factor(manifest.settings.actuation_unit), system.factor("in"))
    # an actuation that is next to nothing is zero there
    settings = population.design.settings
    done = tuple(
        replace(harmonic_of(test.trace, shown), actuation=setting.actuation)
        for test, setting in zip(tests.values(), settings, strict=True)
    )
    sessions = tuple(manifest.settings.tests[name].session for name in tests)
    check_session(wanted.goal.session, sessions)
    some = next(iter(tests.values())).posterior
    situation = Situation(population, some.model, some.noise, done, sessions)
    range_ = [one for one in typical_of(done) if one.actuation > 0.0]
    # without an actuation of its own a test is one at each of the campaign's range
    asked = [
        parts.completed(typical)
        for parts in wanted.candidates
        for typical in (range_ if parts.actuation is None else range_[:1])
    ]
    if len(asked) > MOST:
        raise CampaignError(f"more than {MOST} tests, the most of one question")
    candidates = asked or grid_of(done, shown)
    return advise(situation, wanted.goal, candidates, wanted.limits, effort)


def with_remarks(advice: Advice, tested: Sequence[Span], system: System) -> Advice:
    """Advice that says where its candidates lie outside what was tested."""
    candidates = [row.candidate for row in advice]
    asked = []
    for span in tested:
        values = [getattr(candidate, span.name) for candidate in candidates]
        asked.append(Span(span.name, span.unit, min(values), max(values)))
    outside = leaving(tested, asked)
    return replace(advice, remarks=tuple(one.sentence(system) for one in outside))
