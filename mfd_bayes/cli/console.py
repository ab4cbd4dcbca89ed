"""What a command shows: sentences, and tables of what it found; nothing in it is markup."""

from __future__ import annotations

import math
import re
import shlex
from collections import Counter
from pathlib import Path
from typing import Any

import typer

from mfd_bayes.runs.verdict import Verdict

_ESCAPES = re.compile(
    r"""(?:\x1b\[|\x9b)[0-?]*[ -/]*[@-~]              # colours, movements of the cursor
      | (?:\x1b[]PX^_]|[\x90\x98\x9d-\x9f])[^\x07\x1b\x9c]*(?:\x07|\x1b\\|\x9c)?  # titles, links
      | \x1b[ -/]*[0-~]?""",
    re.VERBOSE,
)

LISTED = 12
"""Tests whose verdicts are listed one by one at the end of a run; of more, those that fail."""


def clean(text: object) -> str:
    """Text from a file as a terminal must get it: one line, no escape sequences or controls."""
    return "".join(c if c.isprintable() else " " for c in _ESCAPES.sub("", str(text)))


def say(sentence: object, *, err: bool = False) -> None:
    """Print a line."""
    typer.echo(clean(sentence), err=err)


def open_console() -> Any:
    """Output that takes every text as it is."""
    from rich.console import Console

    plain: dict[str, Any] = {"highlight": False, "markup": False, "emoji": False}
    console = Console(**plain)
    return console if console.is_terminal else Console(**plain, width=110)


def _table(title: str, *, caption: str = "") -> Any:
    from rich.table import Table

    return Table(title=clean(title), caption=clean(caption) or None)


def _add(table: Any, *cells: object) -> None:
    table.add_row(*map(clean, cells))


def print_truth(view: Any, *, quiet: bool = False) -> None:
    """Print the truth of a synthetic campaign beside its posterior; quiet, what it comes to."""
    if not quiet:
        open_console().print(_truth_table(view))
    known = [row for row in view.truth if row.informed]
    hits = sum(row.inside for row in known)
    say(
        f"truth inside the 95 % interval for {hits} of {len(known)} quantities that the "
        f"data inform ({hits / max(len(known), 1):.1%})"
    )


def _truth_table(view: Any) -> Any:
    table = _table("Truth against posterior (95 % equal-tailed interval)")
    for name in ("test", "quantity", "unit", "truth", "2.5 %", "50 %", "97.5 %", "inside", "data"):
        table.add_column(name, overflow="fold")
    for row in view.truth:
        figures = (f"{x:.4g}" for x in (row.truth, row.lower, row.median, row.upper))
        informed = "informed" if row.informed else "prior only"
        inside = "yes" if row.inside else "NO"
        _add(table, row.subject, row.name, row.unit, *figures, inside, informed)
    return table


def print_derived(rows: Any, probability: float) -> None:
    """Print the derived quantities of a prediction."""
    low, high = (f"{50 * (1 + side * probability):g} %" for side in (-1, 1))
    notes = "; ".join(f"{r.name} {r.note}" for r in rows if r.note)
    table = _table("Derived quantities, of the damper without offset and noise", caption=notes)
    for name in ("quantity", "unit", "mean", "sd", low, "50 %", high, "measured"):
        table.add_column(name, no_wrap=True)
    for r in rows:
        figures = (r.mean, r.sd, r.lower, r.median, r.upper, r.measured)
        shown = ("–" if math.isnan(value) else f"{value:.4g}" for value in figures)
        _add(table, r.name, r.unit, *shown)
    open_console().print(table)


def print_comparison(found: Any, *, quiet: bool = False) -> None:
    """Print how well each model predicts, and which one is favoured; quiet, only that."""
    if not quiet:
        open_console().print(_comparison_table(found))
    say(found.sentence)


def _comparison_table(found: Any) -> Any:
    table = _table("Each cycle predicted from all others (leave-one-cycle-out)")
    table.add_column("test", overflow="fold", min_width=8)
    for name in ("model", "cycles", "elpd ± se", "p_loo", "worst k", "k > 0.7"):
        table.add_column(name, no_wrap=True)
    for name in ("difference ± se", "RRSE"):
        table.add_column(name, no_wrap=True)
    for r in found.rows:
        elpd = f"{r.elpd:.1f} ± {r.elpd_se:.1f}"
        apart = f"{r.difference:.1f} ± {r.difference_se:.1f}"
        k = (f"{r.worst_k:.2f}", f"{r.bad:.0%} → {r.unsettled:.0%}")  # by PSIS → computed anew
        figures = (f"{r.cycles}", elpd, f"{r.p_loo:.1f}", *k, apart, f"{r.rrse:.3f}")
        _add(table, r.subject, r.model, *figures)
    return table


def print_left_out(view: Any, *, quiet: bool = False) -> None:
    """Print how each test was predicted without its part, and what that comes to; quiet, that."""
    if not quiet:
        open_console().print(_left_out_table(view.left_out))
    say(view.left_out.sentence)


def _left_out_table(found: Any) -> Any:
    table = _table(f"Each test predicted without its {found.by}, scores in kip")
    parts = found.by != "test"
    for name in ("test", *(["left out"] if parts else [])):
        table.add_column(name, overflow="fold")
    for name in ("50 %", "90 %", "95 %", "width (fitted)", "×", "interval", "CRPS (fitted)", "×"):
        table.add_column(name, no_wrap=True)
    table.add_column("RRSE", no_wrap=True)
    for r in (*found.rows, found.mean):
        if r is found.mean:
            table.add_section()
        covered = (f"{100 * share:.1f}" for share in (r.coverage_50, r.coverage_90, r.coverage_95))
        width = (f"{r.width_95:.3f} ({r.fitted_width:.3f})", f"{r.width_ratio:.2f}")
        crps = (f"{r.crps:.3f} ({r.fitted_crps:.3f})", f"{r.crps_ratio:.2f}")
        scores = (*width, f"{r.interval_score:.3f}", *crps, f"{r.rrse:.3f}")
        _add(table, r.subject, *([r.part] if parts else []), *covered, *scores)
    return table


def print_checks(view: Any, *, every: bool) -> None:
    """Print what failed, with its limit, and a line for each kind of check; or every check."""
    if not every:
        _print_kinds(view.checks)
    shown = [c for c in view.checks if every or c.verdict == Verdict.FAIL]
    if not shown:
        return
    table = _table("Checks" if every else "Checks that failed")
    for name in ("subject", "check", "target", "value", "limit", "verdict"):
        table.add_column(name, overflow="fold")
    for c in shown:
        _add(table, c.subject, c.name, c.target, f"{c.value:.4g}", c.limit, c.verdict)
    open_console().print(table)


def _print_kinds(checks: Any) -> None:
    """One line for each kind of check: how many passed, were noted, and failed."""
    kinds: dict[str, Counter[str]] = {}
    for check in checks:
        kinds.setdefault(check.name, Counter())[check.verdict] += 1
    table = _table("Checks of every test and of the population (--all shows each)")
    table.add_column("check", overflow="fold")
    for verdict in Verdict:
        table.add_column(verdict, justify="right")
    for name, count in kinds.items():
        _add(table, name, *(str(count[verdict]) for verdict in Verdict))
    open_console().print(table)


def print_end(view: Any, out: Path, *, quiet: bool = False) -> None:
    """Print the verdicts of a run, and where to look next; quiet, the verdict on the whole."""
    if not quiet:
        _print_verdicts(view)
    say(f"{view.verdict.upper()}: {view.sentence}")
    if not quiet:
        command = shlex.join(["mfd-bayes", "check", str(out)])
        say(f"look next at {out / 'report.html'}; every check: {command}")


def _print_verdicts(view: Any) -> None:
    """Print each test's verdict; where there are many, how many pass and which do not."""
    failed = {
        test: Counter(c.name for c in view.checks if (c.subject, c.verdict) == (test, Verdict.FAIL))
        for test in (*(t.id for t in view.tests if t.role == "calibrate"), *view.failures)
    }
    many = len(failed) > LISTED
    if many:
        say(f"{sum(not names for names in failed.values())} of {len(failed)} tests pass all checks")
    width = max(map(len, failed), default=0)
    for test, names in failed.items():
        if names or not many:
            what = ", ".join(f"{name} ({times})" for name, times in names.items())
            say(f"  {test:{width}}  {f'FAIL: {what}' if names else Verdict.PASS}")
