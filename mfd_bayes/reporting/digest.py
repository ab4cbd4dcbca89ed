"""Summaries for a page: the worst figures of each test, and tables of checks by test."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from mfd_bayes.evaluation.checks import INFORMED
from mfd_bayes.evaluation.views import (
    FREE_EXPONENT,
    IDENTIFIABILITY,
    NOISE,
    PREDICTIVE,
    READING,
    CampaignView,
    Check,
    DerivedRow,
    Row,
)
from mfd_bayes.runs.verdict import Use, Verdict

_SAMPLER = ("r-hat", "bulk", "tail", "ess", "autocorrelation", "acceptance", "modes")
_APART = (*IDENTIFIABILITY, READING, NOISE)
_ELSEWHERE = (*_APART, "calibration", FREE_EXPONENT)  # have sections of their own
_DETAIL = " (observed "  # what follows it differs from test to test


Grid = dict[tuple[str, str], dict[str, dict[str, tuple[Check, str]]]]
"""Checks by (name, limit), then by target, then by subject; each with its details in words."""


@dataclass(frozen=True)
class Convergence:
    """The rows with the worst figures of a test or the population; None where none is known."""

    subject: str
    r_hat: Row | None
    ess_bulk: Row | None
    ess_tail: Row | None
    verdict: Verdict | None


def is_of_sampler(check: Check) -> bool:
    """Whether a check is about the convergence of the sampler."""
    return check.name.lower().startswith(_SAMPLER)


def convergence_of(view: CampaignView) -> list[Convergence]:
    """Worst figures of each test and of the population."""
    groups = [(test.id, test.rows) for test in view.tests if test.rows]
    if view.law_rows:
        groups.append(("population", view.law_rows))
    return [_worst(subject, rows, view.checks) for subject, rows in groups]


def _worst(subject: str, rows: tuple[Row, ...], checks: Iterable[Check]) -> Convergence:
    # NaN: not sampled
    sampled = [row for row in rows if not math.isnan(row.r_hat)]
    bulk = [row for row in rows if not math.isnan(row.ess_bulk)]
    tail = [row for row in rows if not math.isnan(row.ess_tail)]
    verdicts = {c.verdict for c in checks if c.subject == subject and is_of_sampler(c)}
    worst = next(
        (v for v in (Verdict.FAIL, Verdict.CARE, Verdict.NOTE, Verdict.PASS) if v in verdicts), None
    )
    return Convergence(
        subject=subject,
        r_hat=max(sampled, key=lambda row: row.r_hat, default=None),
        ess_bulk=min(bulk, key=lambda row: row.ess_bulk, default=None),
        ess_tail=min(tail, key=lambda row: row.ess_tail, default=None),
        verdict=worst,
    )


def verdicts_of(view: CampaignView) -> dict[str, Use | None]:
    """Use of every test; None of tests that were only predicted."""
    found: dict[str, Use | None] = {test.id: None for test in view.tests}
    return found | {judged.subject: judged.use for judged in view.judgements}


def is_weak(row: Row) -> bool:
    """Whether the data do not inform a quantity: its contraction is low, or unknown and noted."""
    unknown = math.isnan(row.contraction)
    return bool(row.note) if unknown else row.contraction < INFORMED


def is_judged(check: Check) -> bool:
    """Whether a check can fail."""
    return check.verdict != Verdict.NOTE and check.name not in _APART


def is_of_fit(check: Check) -> bool:
    """Whether a check is about how the model fits a record."""
    return not is_of_sampler(check) and check.name not in _ELSEWHERE


def grid_of(checks: Iterable[Check]) -> Grid:
    """Checks as tables of tests against targets."""
    grid: Grid = {}
    for check in checks:
        target, detail = _parts(check)
        targets = grid.setdefault((check.name, check.limit), {})
        targets.setdefault(target, {})[check.subject] = (check, detail)
    return grid


def _parts(check: Check) -> tuple[str, str]:
    """Target of a check, and what was observed, in words.

    A p-value has no unit: that of its figure stands with what was observed.
    """
    target, _, detail = check.target.partition(_DETAIL)
    unit = ""
    if check.name == PREDICTIVE and ", " in target:
        target, unit = target.rsplit(", ", 1)
    parts = f"observed {detail.removesuffix(')')}".split(", ") if detail else []
    return target, ", ".join(f"{part} {unit}".rstrip() for part in parts)


def derived_of(view: CampaignView) -> dict[str, dict[str, DerivedRow]]:
    """Derived quantities by name, and in each by test."""
    found: dict[str, dict[str, DerivedRow]] = {}
    for row in (row for test in view.tests for row in test.derived):
        found.setdefault(row.name, {})[row.subject] = row
    return found


def uninformed_of(view: CampaignView) -> dict[str, list[Row]]:
    """Rows with a contraction below `INFORMED`, by parameter."""
    found: dict[str, list[Row]] = {}
    for test in view.tests:
        for row in test.rows:
            if row.contraction < INFORMED:
                found.setdefault(row.name, []).append(row)
    return found


def mean_shares(view: CampaignView) -> dict[str, float]:
    """What makes the bands of predicted tests wide: mean shares over the tests that have them."""
    known = [test.shares for test in view.tests if test.shares]
    names = dict.fromkeys(name for shares in known for name in shares)
    return {name: sum(s.get(name, 0.0) for s in known) / len(known) for name in names}
