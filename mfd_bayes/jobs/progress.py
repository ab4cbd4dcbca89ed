"""The progress of jobs as it is shown: bars on a terminal, lines elsewhere."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from mfd_bayes.console import clean, open_console, say
from mfd_bayes.jobs.job import JobState, Observe, Progress, Step
from mfd_bayes.jobs.signals import before_end

if TYPE_CHECKING:
    from rich.progress import TaskID

SILENCE = 10.0
"""Seconds without a line after which one says what is at work, where there is no terminal."""

ENDED = (JobState.DONE, JobState.KEPT, JobState.FAILED)
"""Stages of work that has ended."""

ALARMS = (JobState.FAILED, JobState.RESTARTED, JobState.NOTE)
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
            if step.stage in (JobState.WAITING, *ENDED):
                running.pop(step.id, None)
            elif step.stage != JobState.NOTE:
                _, began = running.get(step.id, (step, time.monotonic()))
                running[step.id] = step, began
            if step.stage != JobState.WAITING:
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
        if step.stage in (JobState.WAITING, JobState.KEPT):
            tests.add(step.id)
        if step.stage in (JobState.WAITING, *ENDED) and step.id in rows:
            bars.remove_task(rows.pop(step.id))
        if step.stage in (*ENDED, *ALARMS):
            bars.console.print(clean(line_of(step)))
            done.update({step.id} & tests if step.stage in ENDED else ())
        elif step.stage != JobState.WAITING:
            if step.id not in rows:
                rows[step.id] = bars.add_task(clean(step.id)[:30], total=None, state="")
            progress, state = step.progress, clean(f"{step.stage} {step.message}".strip())
            if progress is None:
                bars.update(rows[step.id], state=state)
            else:
                share = progress.share if progress.share > 0.0 else progress.steps / progress.limit
                state = f"{state}{_reached(progress)}{_missing(progress)}"
                bars.update(rows[step.id], total=1.0, completed=min(share, 1.0), state=state)
        state = f"{len(done)} of {len(tests)} done"
        bars.update(
            every, total=len(tests), completed=len(done), state=state, visible=bool(rows or done)
        )

    with before_end(bars.stop), bars:  # no frame may follow the last words on Ctrl-C
        yield observe


def line_of(step: Step) -> str:
    """A step in a line: with what it has reached, and which targets are missing."""
    progress = step.progress
    if step.stage == JobState.KEPT:
        return f"{step.id}: done before"
    if progress is None:
        return f"{step.id}: {f'{step.stage} {step.message}'.strip()}"
    rate = f"{progress.rate:.{0 if progress.rate >= 10 else 1}f} steps/s"
    text = f"{step.id}: {step.stage}, {progress.steps} steps{_reached(progress)}, {rate}"
    if step.stage == JobState.DONE:
        return text
    left = (progress.limit - progress.steps) / progress.rate
    return f"{text}{_missing(progress)}, at most {left:.0f} s left"


def _reached(progress: Progress) -> str:
    """R̂ and effective sample size, once they are known."""
    return f", R-hat {progress.r_hat:.3f}, ESS {progress.ess:.0f}" if progress.measured else ""


def _missing(progress: Progress | None) -> str:
    """The targets that are not reached yet."""
    return f", needs {progress.missing}" if progress is not None and progress.missing else ""
