"""What a page tells of many checks and rows at once: the worst of each, and tables by test."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from mfd_bayes.assessment.views import (
    IDENTIFIABILITY,
    STANDING,
    CampaignView,
    Check,
    DerivedRow,
    Row,
)
from mfd_bayes.runs.verdict import Verdict

UNINFORMED = 0.5
"""Below this contraction the page says that the data do not inform a parameter."""

_SAMPLER = ("r-hat", "bulk", "tail", "ess", "autocorrelation", "acceptance", "modes")
_ELSEWHERE = (*IDENTIFIABILITY, "calibration", STANDING)  # shown in sections of their own
_DETAIL = " (observed "  # what follows it differs from test to test


Grid = dict[tuple[str, str], dict[str, dict[str, tuple[Check, str]]]]
"""Checks by (name, limit), in each by target, and in each by subject, with their details."""


@dataclass(frozen=True)
class Convergence:
    """A subject's worst figures, each with the row that has it; None where none is known."""

    subject: str
    r_hat: Row | None
    ess_bulk: Row | None
    ess_tail: Row | None
    verdict: Verdict | None


def is_of_sampler(check: Check) -> bool:
    """Whether a check is about the sampler's convergence, and not about the model's fit."""
    return check.name.lower().startswith(_SAMPLER)


def convergence_of(view: CampaignView) -> list[Convergence]:
    """Worst figures of every test and of the population."""
    groups = [(test.id, test.rows) for test in view.tests if test.rows]
    if view.law_rows:
        groups.append(("population", view.law_rows))
    return [_worst(subject, rows, view.checks) for subject, rows in groups]


def _worst(subject: str, rows: tuple[Row, ...], checks: Iterable[Check]) -> Convergence:
    # a NaN stands for what was not sampled
    sampled = [row for row in rows if not math.isnan(row.r_hat)]
    bulk = [row for row in rows if not math.isnan(row.ess_bulk)]
    tail = [row for row in rows if not math.isnan(row.ess_tail)]
    verdicts = {c.verdict for c in checks if c.subject == subject and is_of_sampler(c)}
    worst = next((v for v in (Verdict.FAIL, Verdict.NOTE, Verdict.PASS) if v in verdicts), None)
    return Convergence(
        subject=subject,
        r_hat=max(sampled, key=lambda row: row.r_hat, default=None),
        ess_bulk=min(bulk, key=lambda row: row.ess_bulk, default=None),
        ess_tail=min(tail, key=lambda row: row.ess_tail, default=None),
        verdict=worst,
    )


def verdicts_of(view: CampaignView) -> dict[str, Verdict | None]:
    """FAIL of every subject with a check that failed, PASS of other tests, None without checks."""
    found = {test.id: Verdict.PASS if test.checks else None for test in view.tests}
    return found | {c.subject: Verdict.FAIL for c in view.checks if c.verdict == Verdict.FAIL}


def is_weak(row: Row) -> bool:
    """Whether a row must not be read as a measurement; a note says why where contraction cannot."""
    unknown = math.isnan(row.contraction)
    return bool(row.note) if unknown else row.contraction < UNINFORMED


def is_judged(check: Check) -> bool:
    """Whether a check can fail."""
    return check.verdict != Verdict.NOTE and check.name not in IDENTIFIABILITY


def is_of_fit(check: Check) -> bool:
    """Whether a check is about how the model fits a record."""
    return not is_of_sampler(check) and check.name not in _ELSEWHERE


def grid_of(checks: Iterable[Check]) -> Grid:
    """Checks as tables, tests against targets."""
    grid: Grid = {}
    for check in checks:
        target, _, detail = check.target.partition(_DETAIL)
        detail = f"observed {detail.removesuffix(')')}" if detail else ""
        targets = grid.setdefault((check.name, check.limit), {})
        targets.setdefault(target, {})[check.subject] = (check, detail)
    return grid


def derived_of(view: CampaignView) -> dict[str, dict[str, DerivedRow]]:
    """Derived quantities by name, and in each by test."""
    found: dict[str, dict[str, DerivedRow]] = {}
    for row in (row for test in view.tests for row in test.derived):
        found.setdefault(row.name, {})[row.subject] = row
    return found


def uninformed_of(view: CampaignView) -> dict[str, list[Row]]:
    """Rows whose contraction is below the limit, by parameter."""
    found: dict[str, list[Row]] = {}
    for test in view.tests:
        for row in test.rows:
            if row.contraction < UNINFORMED:
                found.setdefault(row.name, []).append(row)
    return found
