"""What a command shows: progress, and tables of what it found."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer


def _console() -> Any:
    from rich.console import Console

    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=110)


@contextmanager
def watch() -> Iterator[Any]:
    """Show steps as bars on a terminal, as lines elsewhere."""
    console = _console()
    if not console.is_terminal:
        yield lambda step: typer.echo(_line(step))
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[news]}"))
    with Progress(*columns, TimeElapsedColumn(), console=console) as bars:
        shown: dict[str, Any] = {}

        def observe(step: Any) -> None:
            if step.id not in shown:
                shown[step.id] = bars.add_task(step.id, total=1.0, news="")
            done = step.stage == "done"
            share = 0.0 if step.progress is None else step.progress.steps / step.progress.limit
            bars.update(shown[step.id], completed=1.0 if done else share, news=_news(step))

        yield observe


def _news(step: Any) -> str:
    """What a step says, in a line."""
    progress = step.progress
    if progress is None:
        return f"{step.stage} {step.message}".strip()
    rate = progress.steps / max(progress.seconds, 1e-9)
    left = (progress.limit - progress.steps) / rate
    text = f"{step.stage}, {progress.steps} steps, R-hat {progress.r_hat:.3f}, "
    text += f"ESS {progress.ess:.0f}, {rate:.{0 if rate >= 10 else 1}f} steps/s"
    return text if step.stage == "done" else f"{text}, at most {left:.0f} s left"


def _line(step: Any) -> str:
    return f"{step.id}: {_news(step)}"


def print_truth(view: Any) -> None:
    """Print the truth of a synthetic campaign beside its posterior."""
    from rich.table import Table

    table = Table(title="Truth against posterior (95 % equal-tailed interval)")
    for name in ("test", "quantity", "unit", "truth", "2.5 %", "50 %", "97.5 %", "inside", "data"):
        table.add_column(name, overflow="fold")
    for row in view.truth:
        figures = (f"{x:.4g}" for x in (row.truth, row.lower, row.median, row.upper))
        informed = "informed" if row.informed else "prior only"
        inside = "yes" if row.inside else "NO"
        table.add_row(row.subject, row.name, row.unit, *figures, inside, informed)
    _console().print(table)
    known = [row for row in view.truth if row.informed]
    hits = sum(row.inside for row in known)
    typer.echo(
        f"truth inside the 95 % interval for {hits} of {len(known)} quantities that the "
        f"data inform ({hits / max(len(known), 1):.1%})"
    )


def print_derived(rows: Any, probability: float) -> None:
    """Print the derived quantities of a prediction."""
    from rich.table import Table

    low, high = (f"{50 * (1 + side * probability):g} %" for side in (-1, 1))
    notes = "; ".join(f"{r.name} {r.note}" for r in rows if r.note)
    table = Table(title="Derived quantities, of the damper without offset and noise", caption=notes)
    for name in ("quantity", "unit", "mean", "sd", low, "50 %", high, "measured"):
        table.add_column(name, no_wrap=True)
    for r in rows:
        figures = (r.mean, r.sd, r.lower, r.median, r.upper, r.measured)
        shown = ("–" if math.isnan(value) else f"{value:.4g}" for value in figures)
        table.add_row(r.name, r.unit, *shown)
    _console().print(table)


def print_comparison(found: Any) -> None:
    """Print how well each model predicts, and which one is favoured."""
    from rich.table import Table

    table = Table(title="Each cycle predicted from all others (leave-one-cycle-out)")
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
        table.add_row(r.subject, r.model, *figures)
    _console().print(table)
    typer.echo(found.sentence)


def print_left_out(view: Any) -> None:
    """Print how each test was predicted without its part, and what that comes to."""
    from rich.table import Table

    found = view.left_out
    table = Table(title=f"Each test predicted without its {found.by}, scores in kip")
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
        table.add_row(r.subject, *([r.part] if parts else []), *covered, *scores)
    _console().print(table)
    typer.echo(found.sentence)


def print_checks(view: Any) -> None:
    """Print every check with its limit and verdict."""
    from rich.table import Table

    table = Table(title="Checks")
    for name in ("subject", "check", "target", "value", "limit", "verdict"):
        table.add_column(name, overflow="fold")
    for c in view.checks:
        table.add_row(c.subject, c.name, c.target, f"{c.value:.4g}", c.limit, c.verdict)
    _console().print(table)


def print_end(view: Any, out: Path) -> None:
    """Print the verdict of a run, and where to look next."""
    typer.echo(f"{view.verdict.upper()}: {view.sentence}")
    typer.echo(f"look next at {out / 'report.html'}")
