"""What a command prints: sentences, and tables of what it found; nothing in it is markup."""

from __future__ import annotations

import math
import re
import shlex
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from mfd_bayes.runs.unit_system import US, System
from mfd_bayes.runs.verdict import Use, Verdict
from mfd_bayes.units import percent

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from mfd_bayes.evaluation.design import DesignRow
    from mfd_bayes.evaluation.views import CampaignView, Check, DerivedRow, LeftOutView
    from mfd_bayes.pipeline.plan import Plan
    from mfd_bayes.runs.scores import Comparison
    from mfd_bayes.runs.verdict import Finding

_ESCAPES = re.compile(
    r"""(?:\x1b\[|\x9b)[0-?]*[ -/]*[@-~]              # colours, movements of the cursor
      | (?:\x1b[]PX^_]|[\x90\x98\x9d-\x9f])[^\x07\x1b\x9c]*(?:\x07|\x1b\\|\x9c)?  # titles, links
      | \x1b[ -/]*[0-~]?""",
    re.VERBOSE,
)

WIDTH, LINES = 100, 10
"""Most columns and lines of the end of a run."""


def clean(text: object) -> str:
    """Text as a terminal may show it: one line, without escape sequences and control characters."""
    return "".join(c if c.isprintable() else " " for c in _ESCAPES.sub("", str(text)))


def say(sentence: object, *, err: bool = False) -> None:
    """Print a line."""
    typer.echo(clean(sentence), err=err)


def in_percent(probability: float) -> str:
    """A probability as "95", with more digits where it needs them."""
    return percent(probability)


def open_console() -> Console:
    """Console that prints every text as it is, 110 columns wide where it is no terminal."""
    from rich.console import Console

    console = Console(highlight=False, markup=False, emoji=False)
    if not console.is_terminal:
        console.width = 110
    return console


def _table(
    title: str, folded: Iterable[str] = (), fixed: Iterable[str] = (), caption: str = ""
) -> Table:
    """Empty table with columns that fold long texts, then others that keep them on one line."""
    from rich.table import Table

    table = Table(title=clean(title), caption=clean(caption) or None)
    for name in folded:
        table.add_column(name, overflow="fold")
    for name in fixed:
        table.add_column(name, no_wrap=True)
    return table


def _add(table: Table, *cells: object) -> None:
    table.add_row(*map(clean, cells))


def print_warnings(warnings: Iterable[Finding], system: System = US) -> None:
    """Print what was found that a reader must know, a line each, in the units of a system."""
    for finding in warnings:
        say(f"warning: {finding.subject}: {finding.message.to_text(system.words)}")


def print_plan(plan: Plan) -> None:
    """Print what a calibration would do, and the warnings about its records."""
    lengths = [task.trace.samples for task in plan.tasks]
    words = [f"{n} sample{'s' if n != 1 else ''}" for n in lengths]
    tests = [f"{task.id} ({said})" for task, said in zip(plan.tasks, words, strict=True)]
    say(f"{plan.campaign.path} is fine: would calibrate {', '.join(tests)}")
    say(f"and predict {', '.join(plan.held_out) or 'nothing'}; nothing was written")
    follow = [f"{name} after {other}" for name, other in plan.manifest.settings.order.items()]
    if follow:
        say(f"without a reset: {', '.join(follow)}")
    print_warnings(plan.manifest.warnings, plan.system)


def print_truth(view: CampaignView, *, quiet: bool = False) -> None:
    """Print the true values of a synthetic campaign beside its posterior; quiet: only a summary."""
    if not quiet:
        open_console().print(_truth_table(view))
    known = [row for row in view.truth if row.informed]
    hits = sum(row.inside for row in known)
    say(
        f"truth inside the 95 % interval for {hits} of {len(known)} quantities that the "
        f"data inform ({hits / max(len(known), 1):.1%})"
    )


def _truth_table(view: CampaignView) -> Table:
    heads = ("test", "quantity", "unit", "truth", "2.5 %", "50 %", "97.5 %", "inside", "data")
    table = _table("Truth against posterior (95 % equal-tailed interval)", heads)
    for row in view.truth:
        figures = (f"{x:.4g}" for x in (row.truth, row.lower, row.median, row.upper))
        informed = "informed" if row.informed else "prior only"
        inside = "yes" if row.inside else "NO"
        _add(table, row.subject, row.name, row.unit, *figures, inside, informed)
    return table


def print_derived(rows: Sequence[DerivedRow], probability: float) -> None:
    """Print the derived quantities of a prediction."""
    low, high = (f"{percent(0.5 * (1 + side * probability))} %" for side in (-1, 1))
    notes = "; ".join(f"{r.name} {r.note}" for r in rows if r.note)
    heads = ("quantity", "unit", "mean", "sd", low, "50 %", high, "measured")
    title = "Derived quantities, of the damper without offset and noise"
    table = _table(title, fixed=heads, caption=notes)
    for r in rows:
        figures = (r.mean, r.sd, r.lower, r.median, r.upper, r.measured)
        shown = ("–" if math.isnan(value) else f"{value:.4g}" for value in figures)
        _add(table, r.name, r.unit, *shown)
    open_console().print(table)


def print_design(rows: Sequence[DesignRow]) -> None:
    """Print mean and bounding properties with their factors."""
    from mfd_bayes.evaluation.design import BASES

    tail = 50.0 * (1.0 - rows[0].probability)
    caption = (
        f"Each bound is exceeded with a probability of {tail:g} %; λ: bound over nominal value"
    )
    notes = "; ".join(dict.fromkeys(f"{BASES[r.basis]}, {r.note}" for r in rows if r.note))
    heads = ("unit", "nominal", "lower", "upper", "λ min", "λ max")
    table = _table("Mean and bounding properties", ["property", "of"], heads, f"{caption}. {notes}")
    for r in (r for r in rows if not r.note):
        figures = (r.nominal, r.lower, r.upper, r.lambda_min, r.lambda_max)
        shown = ("–" if math.isnan(value) else f"{value:.3g}" for value in figures)
        _add(table, r.name, BASES[r.basis], r.unit, *shown)
    open_console().print(table)


def print_rows(title: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print rows of cells, the first of which is a test."""
    table = _table(title, ["test"], heads)
    for cells in rows:
        _add(table, *cells)
    open_console().print(table)


def print_shares(shares: Mapping[str, float], *, quiet: bool = False) -> None:
    """Print what makes a band wide, and what can be done about it; quiet: only the latter."""
    from mfd_bayes.evaluation.width import width_sentence

    if not quiet:
        table = _table("What makes the band wide", ["source"], ["share of the variance"])
        for name, share in sorted(shares.items(), key=lambda item: -item[1]):
            _add(table, name, f"{100 * share:.0f} %")
        open_console().print(table)
    say(width_sentence(shares))


def print_comparison(found: Comparison, *, quiet: bool = False) -> None:
    """Print how well each model predicts, and which one is favoured; quiet: only the latter."""
    if not quiet:
        open_console().print(_comparison_table(found))
    say(found.sentence)


def _comparison_table(found: Comparison) -> Table:
    heads = ("model", "cycles", "elpd ± se", "p_loo", "worst k", "k > 0.7", "difference ± se")
    title = "Each cycle predicted from all others (leave-one-cycle-out)"
    table = _table(title, ["test"], (*heads, "RRSE"))
    table.columns[0].min_width = 8
    for r in found.rows:
        elpd = f"{r.elpd:.1f} ± {r.elpd_se:.1f}"
        difference = f"{r.difference:.1f} ± {r.difference_se:.1f}"
        k = (f"{r.worst_k:.2f}", f"{r.bad:.0%} → {r.unsettled:.0%}")  # by PSIS → computed again
        figures = (f"{r.cycles}", elpd, f"{r.p_loo:.1f}", *k, difference, f"{r.rrse:.3f}")
        _add(table, r.subject, r.model, *figures)
    return table


def print_left_out(found: LeftOutView | None, force: str, *, quiet: bool = False) -> None:
    """Print how well each part left out was predicted, in a unit of force; quiet: a summary."""
    if found is None:
        return
    if not quiet:
        open_console().print(_left_out_table(found, force))
    say(found.sentence)


def _left_out_table(found: LeftOutView, force: str) -> Table:
    parts = found.by != "test"
    heads = [
        "50 %",
        "90 %",
        "95 %",
        "width (fitted)",
        "×",
        "interval",
        "CRPS (fitted)",
        "×",
        "RRSE",
    ]
    title = f"Each test predicted without its {found.by}, scores in {force}"
    table = _table(title, ["test", "left out"] if parts else ["test"], heads)
    for r in (*found.rows, found.mean):
        if r is found.mean:
            table.add_section()
        covered = (f"{100 * share:.1f}" for share in (r.coverage_50, r.coverage_90, r.coverage_95))
        width = (f"{r.width_95:.3f} ({r.fitted_width:.3f})", f"{r.width_ratio:.2f}")
        crps = (f"{r.crps:.3f} ({r.fitted_crps:.3f})", f"{r.crps_ratio:.2f}")
        scores = (*width, f"{r.interval_score:.3f}", *crps, f"{r.rrse:.3f}")
        _add(table, r.subject, *([r.part] if parts else []), *covered, *scores)
    return table


def print_checks(view: CampaignView, *, every: bool) -> None:
    """Print what misses, one line each; or a table of every check before."""
    if every:
        table = _table("Checks", ("test", "check", "feature", "observed", "expected", "status"))
        for c in view.checks:
            values = (_figure(view, c.observed, c.unit), _expected(view, c))
            _add(table, c.test, c.check, c.feature, *values, c.status)
        open_console().print(table)
    for line in missed_lines(view):
        say(line)


def missed_lines(view: CampaignView) -> list[str]:
    """What misses: warnings, checks that fail or are missed, and tests that are not just usable."""
    words = view.systems[view.metric].words
    return [
        *(f"warning: {f.subject}: {f.message.to_text(words)}" for f in view.warnings),
        *(
            f"{c.status}: {c.test}: {c.message.to_text(words)}"
            for c in view.checks
            if c.status in (Verdict.FAIL, Verdict.WARNING)
        ),
        *(
            f"{j.use}: {j.subject}: {j.to_text(words)}"
            for j in view.judgements
            if j.use != Use.USABLE
        ),
    ]


def _figure(view: CampaignView, value: float, unit: str) -> str:
    """A value in the units of a view."""
    if unit in ("1", "dimensionless"):
        return f"{value:.4g}"
    return view.systems[view.metric].words([value], unit)


def _expected(view: CampaignView, check: Check) -> str:
    """What passes a check, with its tolerance where it has one."""
    known = check.unit in ("1", "dimensionless")
    limit = check.limit if known else _figure(view, check.expected, check.unit)
    return f"{limit} ({check.tolerance:.0%})" if math.isfinite(check.tolerance) else limit


def print_end(view: CampaignView, out: Path, *, quiet: bool = False) -> None:
    """Print the verdict of a run, what misses, and where to look; quiet: the verdict alone.

    These are at most `LINES` lines of at most `WIDTH` columns; `mfd-bayes check` has the rest.
    """
    words = view.systems[view.metric].words
    text = " ".join(sentence.to_text(words) for sentence in view.sentences)
    text = clean(f"{view.verdict.upper()}: {text}")
    lines = LINES if quiet else 4
    verdict = textwrap.wrap(text, WIDTH, max_lines=lines, placeholder=" …", break_on_hyphens=False)
    for line in verdict:
        say(line)
    if quiet:
        return
    missed, room = missed_lines(view), LINES - len(verdict) - 2
    for line in missed[:room]:
        say(textwrap.shorten(clean(line), WIDTH, placeholder=" …"))
    more = f"{len(missed) - room} more, and " if len(missed) > room else ""
    say(f"{more}every check: {shlex.join(['mfd-bayes', 'check', str(out)])}")
    say(f"look next at {out / 'report.html'}")


def print_sentences(view: CampaignView) -> None:
    """Print the verdict on a run, a line for each of its sentences, in the units of a view."""
    for sentence in view.sentences:
        say(sentence.to_text(view.systems[view.metric].words))
