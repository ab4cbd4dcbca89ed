"""What a command prints: sentences and tables, in which nothing is markup, and its progress."""

from __future__ import annotations

import math
import re
import shlex
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

import typer

from mfd_bayes.jobs.job import Progress, State, Step
from mfd_bayes.jobs.signals import before_end
from mfd_bayes.units import percent

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from rich.console import Console
    from rich.progress import TaskID

    from mfd_bayes.evaluation.scores import Rows
    from mfd_bayes.evaluation.views import CampaignView, Check
    from mfd_bayes.pipeline.plan import Plan
    from mfd_bayes.runs.manifest import Comparison, Finding
    from mfd_bayes.runs.unit_system import System


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


def warn(remarks: Iterable[str]) -> None:
    """Print remarks as warnings, each once."""
    for remark in dict.fromkeys(remarks):
        say(f"warning: {remark}", err=True)


def open_console() -> Console:
    """Console that prints every text as it is, 110 columns wide where it is no terminal."""
    from rich.console import Console

    console = Console(highlight=False, markup=False, emoji=False)
    if not console.is_terminal:
        console.width = 110
    return console


def effect_cells(row: Any) -> tuple[str, ...]:
    """Cells of a quantity of a device that is compared with the others."""
    has = math.isfinite(row["effect"])
    return (
        f"{row['effect']:+.1f}" if has else "",
        f"{row['effect_lower']:+.1f} to {row['effect_upper']:+.1f}" if has else "",
        f"±{row['limit']:.3g}" if math.isfinite(row["limit"]) else "",
        f"{row['percentile']:.1f}",
        f"{row['p_value']:.3f}",
        str(row["verdict"]),
    )


def print_rows(
    title: str,
    heads: Sequence[str],
    rows: Iterable[Sequence[object]],
    *,
    folded: int = 1,
    caption: str = "",
    last: Sequence[object] = (),
) -> None:
    """Print a table: its first columns fold long texts, the others keep them on one line.

    `last` is a row below a line.
    """
    from rich.table import Table

    table = Table(title=clean(title), caption=clean(caption) or None)
    for k, head in enumerate(heads):
        if k < folded:
            table.add_column(head, overflow="fold", min_width=min(len(head), 8))
        else:
            table.add_column(head, no_wrap=True)
    for cells in rows:
        table.add_row(*map(clean, cells))
    if last:
        table.add_section()
        table.add_row(*map(clean, last))
    open_console().print(table)


def _figures(values: Iterable[float], digits: int = 4) -> list[str]:
    return ["–" if math.isnan(value) else f"{value:.{digits}g}" for value in values]


def print_warnings(warnings: Iterable[Finding], system: System) -> None:
    """Print what was found that a reader must know, a line each, in the units of a system."""
    for finding in warnings:
        say(f"warning: {finding.subject}: {finding.message.to_text(system)}")


def print_plan(plan: Plan) -> None:
    """Print what a calibration would do, and the warnings about its records."""
    lengths = {task.id: task.trace.samples for task in plan.tasks}
    tests = [f"{name} ({n} sample{'s' if n != 1 else ''})" for name, n in lengths.items()]
    say(f"{plan.campaign.path} is fine: would calibrate {', '.join(tests)}")
    say(f"and predict {', '.join(plan.held_out) or 'nothing'}; nothing was written")
    if order := plan.manifest.settings.order:
        follow = (f"{name} after {other}" for name, other in order.items())
        say(f"without a reset: {', '.join(follow)}")
    print_warnings(plan.manifest.warnings, plan.system)


def print_truth(view: CampaignView, *, quiet: bool = False) -> None:
    """Print the true values of a synthetic campaign beside its posterior; quiet: only a summary."""
    heads = ("test", "quantity", "unit", "truth", "2.5 %", "50 %", "97.5 %", "inside", "data")
    rows = [
        (
            *(row["test"], row["name"], row["unit"]),
            *_figures(row[key] for key in ("truth", "lower", "median", "upper")),
            "yes" if row["inside"] else "NO",
            "informed" if row["informed"] else "prior only",
        )
        for row in view.truth
    ]
    if not quiet:
        title = "Truth against posterior (95 % equal-tailed interval)"
        print_rows(title, heads, rows, folded=2)
    informed = [row for row in view.truth if row["informed"]]
    hits = sum(row["inside"] for row in informed)
    say(
        f"truth inside the 95 % interval for {hits} of {len(informed)} quantities that the "
        f"data inform ({hits / max(len(informed), 1):.1%})"
    )


def print_derived(rows: Rows, probability: float, title: str) -> None:
    """Print the derived quantities of a prediction."""
    low, high = (f"{percent(0.5 * (1 + side * probability))} %" for side in (-1, 1))
    keys = ("mean", "sd", "lower", "median", "upper", "measured")
    print_rows(
        title,
        ("quantity", "unit", "mean", "sd", low, "50 %", high, "measured"),
        [(r["name"], r["unit"], *_figures(r[key] for key in keys)) for r in rows],
        folded=0,
        caption="; ".join(f"{r['name']} {r['note']}" for r in rows if r["note"]),
    )


def print_design(rows: Rows, probability: float) -> None:
    """Print mean and bounding properties with their factors."""
    tail, keys = (
        50.0 * (1.0 - probability),
        ("nominal", "lower", "upper", "lambda_min", "lambda_max"),
    )
    notes = "; ".join(dict.fromkeys(f"{r['of']}, {r['note']}" for r in rows if r["note"]))
    print_rows(
        "Mean and bounding properties",
        ("property", "of", "unit", "nominal", "lower", "upper", "λ min", "λ max"),
        [
            (
                *(r["name"], r["of"], r["unit"]),
                *_figures((r[key] for key in keys), 3),
            )
            for r in rows
            if not r["note"]
        ],
        folded=2,
        caption=f"Each bound is exceeded with a probability of {tail:g} %; λ: bound over nominal "
        f"value. {notes}",
    )


def print_shares(shares: Mapping[str, float], *, quiet: bool = False) -> None:
    """Print what makes a band wide, and what can be done about it; quiet: only the latter."""
    from mfd_bayes.evaluation.scores import width_sentence

    if not quiet:
        ordered = sorted(shares.items(), key=lambda item: -item[1])
        rows = [(name, f"{100 * share:.0f} %") for name, share in ordered]
        print_rows("What makes the band wide", ("source", "share of the variance"), rows)
    say(width_sentence(shares))


def print_comparison(comparison: Comparison, *, quiet: bool = False) -> None:
    """Print how well each model predicts, and which one is favoured; quiet: only the latter."""
    heads = ("model", "cycles", "elpd ± se", "p_loo", "worst k", "k > 0.7", "difference ± se")
    rows = [
        (
            *(r.subject, r.model, r.cycles, f"{r.elpd:.1f} ± {r.elpd_se:.1f}", f"{r.p_loo:.1f}"),
            *(f"{r.worst_k:.2f}", f"{r.bad:.0%} → {r.unsettled:.0%}"),  # by PSIS → computed again
            *(f"{r.difference:.1f} ± {r.difference_se:.1f}", f"{r.rrse:.3f}"),
            f"{r.log_evidence:.2f} ± {r.log_evidence_se:.2f}"
            f"{'' if r.evidence_trusted else ', do not trust'}",
        )
        for r in comparison.rows
    ]
    if not quiet:
        title = "Each cycle predicted from all others (leave-one-cycle-out)"
        print_rows(title, ("test    ", *heads, "RRSE", "log evidence ± se"), rows)
    say(comparison.sentence)


def print_left_out(view: CampaignView, *, quiet: bool = False) -> None:
    """Print how well each part left out was predicted, if it was; quiet: a summary."""
    scores, by = view.left_out, view.system.factor("kip")
    if scores is None:
        return
    parts = ["left out"] if scores.by != "test" else []
    rows = [
        (
            *(r["test"], *([r["part"]] if parts else [])),
            *(f"{100 * r[f'coverage_{share}']:.1f}" for share in (50, 90, 95)),
            *(
                f"{by * r['width_95']:.3f} ({by * r['fitted_width']:.3f})",
                f"{r['width_ratio']:.2f}",
            ),
            f"{by * r['interval_score']:.3f}",
            f"{by * r['crps']:.3f} ({by * r['fitted_crps']:.3f})",
            *(f"{r['crps_ratio']:.2f}", f"{r['rrse']:.3f}"),
        )
        for r in (*scores.rows, scores.mean)
    ]
    if not quiet:
        heads = ["50 %", "90 %", "95 %", "width (fitted)", "×", "interval", "CRPS (fitted)", "×"]
        title = f"Each test predicted without its {scores.by}, scores in {view.system.force}"
        print_rows(title, ["test", *parts, *heads, "RRSE"], rows[:-1], last=rows[-1])
    say(scores.sentence)


def print_checks(view: CampaignView, *, every: bool) -> None:
    """Print what misses, one line each; or a table of every check before."""
    if every:
        heads = ("test", "check", "feature", "observed", "expected", "status")
        rows = [
            (
                *(c.test, c.check, c.feature, _figure(view, c.observed, c.unit)),
                *(_expected(view, c), c.status),
            )
            for c in view.checks
        ]
        print_rows("Checks", heads, rows, folded=len(heads))
    for line in missed_lines(view):
        say(line)


def missed_lines(view: CampaignView) -> list[str]:
    """What misses: warnings, checks that fail or are missed, and tests that are not just usable."""
    from mfd_bayes.runs.manifest import Use, Verdict

    system = view.system
    return [
        *(f"warning: {f.subject}: {f.message.to_text(system)}" for f in view.warnings),
        *(
            f"{c.status}: {c.test}: {c.message.to_text(system)}"
            for c in view.checks
            if c.status in (Verdict.FAIL, Verdict.WARNING)
        ),
        *(
            f"{j.use}: {j.subject}: {j.to_text(system)}"
            for j in view.judgements
            if j.use != Use.USABLE
        ),
    ]


def _figure(view: CampaignView, value: float, unit: str) -> str:
    """A value in the units of a view."""
    if unit in ("1", "dimensionless"):
        return f"{value:.4g}"
    return view.system.words([value], unit)


def _expected(view: CampaignView, check: Check) -> str:
    """What passes a check, with its tolerance where it has one."""
    dimensionless = check.unit in ("1", "dimensionless")
    limit = check.limit if dimensionless else _figure(view, check.expected, check.unit)
    return f"{limit} ({check.tolerance:.0%})" if math.isfinite(check.tolerance) else limit


def print_end(view: CampaignView, out: Path, *, quiet: bool = False) -> None:
    """Print the verdict of a run, what misses, and where to look; quiet: the verdict alone.

    These are at most `LINES` lines of at most `WIDTH` columns; `mfd-bayes check` has the rest.
    """
    system = view.system
    text = " ".join(sentence.to_text(system) for sentence in view.sentences)
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
        say(sentence.to_text(view.system))


Observe = Callable[[Step], None]

SILENCE = 10.0
"""Seconds without a line after which one says what is at work, where there is no terminal."""

ENDED = (State.DONE, State.KEPT, State.FAILED)
"""Stages of work that has ended."""

ALARMS = (State.FAILED, State.RESTARTED, State.NOTE)
"""Stages that are printed even with --quiet."""


@contextmanager
def show_progress(*, quiet: bool = False) -> Iterator[Observe]:
    """Function that shows a step: in bars on a terminal, as a line elsewhere.

    With `quiet`, only failures, restarts and notes are shown.
    """
    if quiet:
        yield lambda step: say(line_of(step), err=True) if step.stage in ALARMS else None
    elif sys.stdout.isatty() and not open_console().is_dumb_terminal:
        with _bars() as observe:
            yield observe
    else:
        with _lines() as observe:
            yield observe


@contextmanager
def _lines() -> Iterator[Observe]:
    """Function that prints a step as a line; what is at work says so after a silence."""
    lock, over = threading.Lock(), threading.Event()
    running: dict[str, tuple[Step, float]] = {}  # its last step, and when it began
    printed = time.monotonic()

    def observe(step: Step) -> None:
        nonlocal printed
        with lock:
            if step.stage in (State.WAITING, *ENDED):
                running.pop(step.id, None)
            elif step.stage != State.NOTE:
                _, began = running.get(step.id, (step, time.monotonic()))
                running[step.id] = step, began
            if step.stage != State.WAITING:
                say(line_of(step))
                printed = time.monotonic()

    def remind() -> None:
        nonlocal printed
        while not over.wait(min(1.0, 0.2 * SILENCE)):
            with lock:
                now = time.monotonic()
                if running and now - printed >= SILENCE:
                    step, began = next(iter(running.values()))
                    missing = _missing(step.progress)
                    with suppress(OSError):  # who prints next says that the output is full
                        say(f"{step.id}: {step.stage}, at work for {now - began:.0f} s{missing}")
                    printed = now

    thread = threading.Thread(target=remind, daemon=True)
    thread.start()
    try:
        yield observe
    finally:
        over.set()
        thread.join()


@contextmanager
def _bars() -> Iterator[Observe]:
    """Function that shows a step: a bar over all tests, one for each at work, a line at the end."""
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars
    from rich.table import Column

    cut = Column(no_wrap=True, overflow="ellipsis", ratio=1)
    bars = Bars(
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True)),
        BarColumn(bar_width=8),
        TextColumn("{task.fields[state]}", markup=False, table_column=cut),
        TimeRemainingColumn(compact=True),
        console=open_console(),
        expand=True,
    )
    every = bars.add_task("all", total=0, state="", visible=False)
    rows: dict[str, TaskID] = {}
    tests: set[str] = set()
    done: set[str] = set()

    def observe(step: Step) -> None:
        if step.stage in (State.WAITING, State.KEPT):
            tests.add(step.id)
        if step.stage in (State.WAITING, *ENDED) and step.id in rows:
            bars.remove_task(rows.pop(step.id))
        if step.stage in (*ENDED, *ALARMS):
            bars.console.print(clean(line_of(step)))
            done.update({step.id} & tests if step.stage in ENDED else ())
        elif step.stage != State.WAITING:
            _show(step)
        state = f"{len(done)} of {len(tests)} done"
        bars.update(
            every, total=len(tests), completed=len(done), state=state, visible=bool(rows or done)
        )

    def _show(step: Step) -> None:
        if step.id not in rows:
            rows[step.id] = bars.add_task(clean(step.id)[:30], total=None, state="")
        progress, state = step.progress, clean(f"{step.stage} {step.message}".strip())
        if progress is None:
            bars.update(rows[step.id], state=state)
        else:
            share = progress.share if progress.share > 0.0 else progress.steps / progress.limit
            state = f"{state}{_reached(progress)}{_missing(progress)}"
            bars.update(rows[step.id], total=1.0, completed=min(share, 1.0), state=state)

    with before_end(bars.stop), bars:  # no frame may follow the last words on Ctrl-C
        yield observe


def line_of(step: Step) -> str:
    """A step in a line: with what it has reached, and which targets are missing."""
    progress = step.progress
    if step.stage == State.KEPT:
        return f"{step.id}: done before"
    if progress is None:
        return f"{step.id}: {f'{step.stage} {step.message}'.strip()}"
    rate = f"{progress.rate:.{0 if progress.rate >= 10 else 1}f} steps/s"
    text = f"{step.id}: {step.stage}, {progress.steps} steps{_reached(progress)}, {rate}"
    if step.stage == State.DONE:
        return text
    left = (progress.limit - progress.steps) / progress.rate
    return f"{text}{_missing(progress)}, at most {left:.0f} s left"


def _reached(progress: Progress) -> str:
    """R̂ and effective sample size, once they are known."""
    return f", R-hat {progress.r_hat:.3f}, ESS {progress.ess:.0f}" if progress.measured else ""


def _missing(progress: Progress | None) -> str:
    """The targets that are not reached yet."""
    return f", needs {progress.missing}" if progress is not None and progress.missing else ""
