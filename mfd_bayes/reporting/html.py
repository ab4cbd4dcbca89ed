"""The report as one page without network."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from jinja2 import Environment, PackageLoader, StrictUndefined

from mfd_bayes.calibration.identifiability import SENSITIVE, TRADE_OFF
from mfd_bayes.reporting import symbols
from mfd_bayes.reporting.views import (
    IDENTIFIABILITY,
    STANDING,
    CampaignView,
    Check,
    DerivedRow,
    Row,
)

UNINFORMED = 0.5
"""Below this contraction the page says that the data do not inform a parameter."""
_SAMPLER = ("r-hat", "bulk", "tail", "ess", "autocorrelation", "acceptance", "modes")
_ELSEWHERE = (*IDENTIFIABILITY, "calibration", STANDING)  # shown in sections of their own
_DETAIL = " (observed "  # what follows it differs from test to test


Grid = dict[tuple[str, str], dict[str, dict[str, tuple[Check, str]]]]
"""Checks by (name, limit), in each by target, and in each by subject, with their details."""


@dataclass(frozen=True)
class Picture:
    """A PNG as the page embeds it; width and height in pixels."""

    uri: str
    width: int
    height: int


@dataclass(frozen=True)
class Convergence:
    """A subject's worst figures, each with the row that has it; None where none is known."""

    subject: str
    r_hat: Row | None
    ess_bulk: Row | None
    ess_tail: Row | None
    verdict: str


def render(view: CampaignView, images: Mapping[str, bytes]) -> str:
    """HTML of the whole report.

    Parameters
    ----------
    view : CampaignView
    images : mapping of str to bytes
        PNGs by the keys of `figures.draw_all`; what is missing is left out.
    """
    template = _environment().get_template("report.html.j2")
    return template.render(
        view=view,
        pictures={key: _picture(png) for key, png in images.items()},
        calibrated=[test for test in view.tests if test.role != "validate"],
        held_out=[test for test in view.tests if test.role == "validate"],
        anchors={test.id: f"test-{at}" for at, test in enumerate(view.tests, start=1)},
        names=list(dict.fromkeys(row.name for test in view.tests for row in test.rows)),
        derived=_derived(view),
        cells={(row.subject, row.name): row for test in view.tests for row in test.rows},
        convergence=_convergence(view),
        judged=[check for check in view.checks if _is_judged(check)],
        fit=_grid(check for check in view.checks if _is_of_fit(check)),
        standing=[check for check in view.checks if check.name == STANDING],
        sampler=_grid(check for check in view.checks if is_of_sampler(check)),
        uninformed=_uninformed(view),
        limit=UNINFORMED,
        trade_off=TRADE_OFF,
        sensitive=SENSITIVE,
    )


def is_of_sampler(check: Check) -> bool:
    """Whether a check is about the sampler's convergence, and not about the model's fit."""
    return check.name.lower().startswith(_SAMPLER)


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("mfd_bayes.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "number": symbols.number,
        "count": symbols.count,
        "percent": symbols.percent,
        "symbol": symbols.in_html,
        "meaning": symbols.meaning,
        "unit": symbols.unit_text,
    }
    environment.tests["weak"] = _is_weak
    environment.tests["known"] = math.isfinite
    return environment


def _picture(png: bytes) -> Picture:
    """Embed a PNG; its size stands in the first chunk."""
    width, height = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))
    code = base64.b64encode(png).decode("ascii")
    return Picture(f"data:image/png;base64,{code}", width, height)


def _convergence(view: CampaignView) -> list[Convergence]:
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
    worst = next((v for v in ("fail", "note", "pass") if v in verdicts), "")
    return Convergence(
        subject=subject,
        r_hat=max(sampled, key=lambda row: row.r_hat, default=None),
        ess_bulk=min(bulk, key=lambda row: row.ess_bulk, default=None),
        ess_tail=min(tail, key=lambda row: row.ess_tail, default=None),
        verdict=worst,
    )


def _is_weak(row: Row) -> bool:
    """Whether a row must not be read as a measurement; a note says why where contraction cannot."""
    unknown = math.isnan(row.contraction)
    return bool(row.note) if unknown else row.contraction < UNINFORMED


def _is_judged(check: Check) -> bool:
    """Whether a check can fail."""
    return check.verdict != "note" and check.name not in IDENTIFIABILITY


def _is_of_fit(check: Check) -> bool:
    return not is_of_sampler(check) and check.name not in _ELSEWHERE


def _grid(checks: Iterable[Check]) -> Grid:
    grid: Grid = {}
    for check in checks:
        target, _, detail = check.target.partition(_DETAIL)
        detail = f"observed {detail.removesuffix(')')}" if detail else ""
        targets = grid.setdefault((check.name, check.limit), {})
        targets.setdefault(target, {})[check.subject] = (check, detail)
    return grid


def _derived(view: CampaignView) -> dict[str, dict[str, DerivedRow]]:
    """Derived quantities by name, and in each by test."""
    found: dict[str, dict[str, DerivedRow]] = {}
    for row in (row for test in view.tests for row in test.derived):
        found.setdefault(row.name, {})[row.subject] = row
    return found


def _uninformed(view: CampaignView) -> dict[str, list[Row]]:
    """Rows whose contraction is below the limit, by parameter."""
    found: dict[str, list[Row]] = {}
    for test in view.tests:
        for row in test.rows:
            if row.contraction < UNINFORMED:
                found.setdefault(row.name, []).append(row)
    return found
