"""The report's tables as CSV texts."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence

from mfd_bayes.reporting.views import Check, Row, ScoreRow

_DIGITS = 6
_FORMULA = ("=", "+", "-", "@")

_QUANTILES = ("mean", "sd", "q2.5", "q50", "q97.5", "ess_bulk", "ess_tail", "r_hat", "contraction")


def parameters_csv(rows: Iterable[Row]) -> str:
    """Table I of the paper with uncertainty: one line per test and parameter.

    Quantiles are those of the equal-tailed 95 % interval; empty cells are values that are
    not defined.
    """
    return _csv(("test", "parameter", "unit", *_QUANTILES, "note"), map(_cells, rows))


def laws_csv(rows: Iterable[Row]) -> str:
    """Table II of the paper with uncertainty: slopes, shapes and the scatter of each group."""
    return _csv(("group", "constant", "unit", *_QUANTILES, "note"), map(_cells, rows))


def checks_csv(checks: Iterable[Check]) -> str:
    """Every check: what was found, what it may be, and the verdict."""
    head = ("subject", "check", "target", "value", "limit", "verdict")
    return _csv(head, ((c.subject, c.name, c.target, c.value, c.limit, c.verdict) for c in checks))


def scores_csv(scores: Iterable[ScoreRow]) -> str:
    """How each record's observation bands met its force."""
    head = (
        *("test", "role", "coverage_50", "coverage_90", "coverage_95"),
        *("width_95_kip", "crps_kip", "rrse"),
    )
    lines = (
        (s.subject, s.role, s.coverage_50, s.coverage_90, s.coverage_95, s.width_95, s.crps, s.rrse)
        for s in scores
    )
    return _csv(head, lines)


def _cells(row: Row) -> tuple[str | float, ...]:
    spread = (row.mean, row.sd, row.lower, row.median, row.upper)
    sampler = (row.ess_bulk, row.ess_tail, row.r_hat, row.contraction)
    return (row.subject, row.name, row.unit, *spread, *sampler, row.note)


def _csv(head: Sequence[str], lines: Iterable[Sequence[str | float]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([_cell(value) for value in line] for line in lines)
    return text.getvalue()


def _cell(value: str | float) -> str:
    """A number with six digits, or a text that no spreadsheet takes for a formula."""
    if isinstance(value, str):
        text = value.replace("\r", " ")
        return f"'{text}" if text.lstrip().startswith(_FORMULA) else text
    return "" if math.isnan(value) else f"{value:.{_DIGITS}g}"
