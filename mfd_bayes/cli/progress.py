"""What a long command shows while it works: a table on a terminal, lines elsewhere."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mfd_bayes.cli.console import clean, open_console, say
from mfd_bayes.jobs.job import Progress, State, Step
from mfd_bayes.jobs.signals import before_end

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.table import Table

Observe = Callable[[Step], None]

FRAME = 0.25
"""Seconds from one drawing of the table to the next."""

SILENCE = 10.0
"""Seconds without a line after which one says what is at work, where there is no terminal."""

ENDED = (State.DONE, State.KEPT, State.FAILED)
"""Stages of work that has ended."""

ALARMS = (State.FAILED, State.RESTARTED, State.NOTE)
"""Stages that are printed even with --quiet, and above the table on a terminal."""

_STATES = (State.DONE, State.KEPT, State.FAILED, "running", State.WAITING)
_STYLES: dict[str, str] = {State.FAILED: "red", State.WAITING: "dim"}
_STYLES |= {State.DONE: "green", State.KEPT: "green"}
_LAST_FRAME = 1.0  # seconds to wait for a frame that is being drawn
_KEPT = "done before"
_FIGURES = {"steps": 5, "R-hat": 5, "ESS": 5, "steps/s": 7, "time": 7, "left": 7}
_NAME, _STAGE, _LONGEST_STAGE = 8, 14, 36
"""Widths of columns: of the figures; the smallest of a name and of a stage; the largest."""


@contextmanager
def watch(*, quiet: bool = False) -> Iterator[Observe]:
    """Function that shows a step: in a table on a terminal, as a line elsewhere.

    With `quiet`, only failures, restarts and notes are shown.
    """
    if quiet:
        yield lambda step: say(_line(step), err=True) if step.stage in ALARMS else None
    elif sys.stdout.isatty() and not open_console().is_dumb_terminal:
        with _live() as observe:
            yield observe
    else:
        with _lines() as observe:
            yield observe


@contextmanager
def _lines() -> Iterator[Observe]:
    """Function that prints a step as a line; what is at work says so after a silence."""
    lock, over = threading.Lock(), threading.Event()
    running: dict[str, tuple[str, float]] = {}  # stage, and when it began
    said = time.monotonic()

    def observe(step: Step) -> None:
        nonlocal said
        with lock:
            if step.stage in ENDED:
                running.pop(step.id, None)
            elif step.stage not in (State.WAITING, State.NOTE):
                began = running.get(step.id, ("", time.monotonic()))[1]
                running[step.id] = step.stage, began
            if step.stage != State.WAITING:
                say(_line(step))
                said = time.monotonic()

    def remind() -> None:
        nonlocal said
        while not over.wait(min(1.0, 0.2 * SILENCE)):
            with lock:
                now = time.monotonic()
                if running and now - said >= SILENCE:
                    name, (stage, began) = next(iter(running.items()))
                    with suppress(OSError):  # who prints next says that the output is full
                        say(f"{name}: {stage}, at work for {now - began:.0f} s")
                    said = now

    thread = threading.Thread(target=remind, daemon=True)
    thread.start()
    try:
        yield observe
    finally:
        over.set()
        thread.join()


@contextmanager
def _live() -> Iterator[Observe]:
    """Function that takes in a step; a thread draws the table.

    Rich's own thread, `Live(auto_refresh=True)`, cannot be waited for during a limited time. A
    process that ends on Ctrl-C needs that, or a frame may follow its last words.
    """
    from rich.live import Live

    board, drawing, over = Board(), threading.RLock(), threading.Event()
    live = Live(get_renderable=lambda: board, console=open_console(), auto_refresh=False)

    def draw() -> None:
        while not over.wait(FRAME):
            with drawing:
                live.refresh()

    def observe(step: Step) -> None:
        with drawing:
            if step.stage != State.NOTE:
                board.hear(step)
            if step.stage in ALARMS:
                live.console.print(clean(_line(step)))

    def stop_drawing() -> None:
        over.set()
        drawing.acquire(timeout=_LAST_FRAME)  # and keep it: no frame may follow the last words

    thread = threading.Thread(target=draw, daemon=True)
    with before_end(stop_drawing), live:
        thread.start()
        try:
            yield observe
        finally:
            over.set()
            thread.join()
            board.close()


@dataclass
class _Row:
    """A test, or another piece of work, and its last step; times are those of the clock, s."""

    id: str
    counted: bool
    stage: str = State.WAITING
    message: str = ""
    progress: Progress | None = None
    heard: float = math.nan
    began: float = math.nan
    ended: float = math.nan

    @property
    def running(self) -> bool:
        """Whether it has begun and not ended."""
        return self.stage not in (State.WAITING, *ENDED)

    def hear(self, step: Step, now: float) -> None:
        """Take in a step."""
        if not self.running:
            self.began, self.ended, self.progress = now, math.nan, None
        self.stage, self.message, self.heard = step.stage, step.message, now
        self.progress = step.progress or self.progress
        if step.stage in ENDED:
            self.ended = now

    def seconds(self, now: float) -> float:
        """Seconds that it has taken so far."""
        return (now if math.isnan(self.ended) else self.ended) - self.began

    def left(self, now: float) -> float:
        """Estimate of the seconds until it reaches its targets or its limit; NaN if unknown."""
        progress = self.progress
        if progress is None or not self.running:
            return math.nan
        left = (progress.limit - progress.steps) / _rate(progress)
        if progress.share > 0.0:
            left = min(left, progress.seconds * (1.0 / progress.share - 1.0))
        return max(0.0, left - (now - self.heard))


@dataclass
class Board:
    """Every piece of work and its progress; rich draws it as large as the terminal allows."""

    now: Callable[[], float] = time.monotonic
    """A clock, s."""
    _rows: dict[str, _Row] = field(default_factory=dict)
    _began: float = math.nan
    _closed: bool = False

    def hear(self, step: Step) -> None:
        """Take in a step."""
        now = self.now()
        row = self._rows.get(step.id)
        if row is None:  # work that was not announced, such as the report, is not a test
            counted = step.stage in (State.WAITING, State.KEPT)
            row = self._rows[step.id] = _Row(step.id, counted)
        if step.stage == State.WAITING:
            return
        if math.isnan(self._began):
            self._began = now
        row.hear(step, now)

    def close(self) -> None:
        """Stop to estimate the time left: no more steps will come."""
        self._closed = True

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> Iterator[RenderableType]:
        """Draw a line on the whole, and as many rows as there is room for."""
        from rich.text import Text

        rows, now = list(self._rows.values()), self.now()
        if math.isnan(self._began):
            return
        room = max(1, console.size.height - 4)  # without headline, column heads and two lines
        shown, summary = _choose(rows, room)
        yield Text(self._headline(rows, now), style="bold", no_wrap=True, overflow="ellipsis")
        yield _table(shown, now, options.max_width)
        if summary:
            yield Text(summary, style="dim", no_wrap=True, overflow="ellipsis")

    def _headline(self, rows: list[_Row], now: float) -> str:
        """How much is done, and how long the rest will take."""
        tests = [row for row in rows if row.counted]
        done = sum(row.stage in (State.DONE, State.KEPT) for row in tests)
        parts = [f"{done} of {len(tests)} done"] if tests else []
        parts += [*_counts(tests, _STATES[2:]), f"{_clock(now - self._began)} so far"]
        left = math.nan if self._closed else _left(rows, now)
        if not math.isnan(left):
            parts.append(f"about {_clock(left)} left")
        return ", ".join(parts)


def _counts(rows: Iterable[_Row], states: Iterable[str]) -> list[str]:
    """How many rows are in each of some states, as "3 running"; not where none is."""
    counts = Counter("running" if row.running else row.stage for row in rows)
    return [f"{counts[state]} {state}" for state in states if counts[state]]


def _left(rows: list[_Row], now: float) -> float:
    """Estimate of the seconds until all rows are done; NaN if unknown.

    A test of which nothing is known is taken to last as long as the mean of the others.
    """
    running = [row for row in rows if row.running]
    tests = [row for row in running if row.counted]
    lengths = [row.seconds(now) for row in rows if row.counted and row.stage == State.DONE]
    lengths += [row.seconds(now) + row.left(now) for row in tests]
    known = [length for length in lengths if not math.isnan(length)]
    usual = sum(known) / len(known) if known else math.nan
    rest = 0.0
    for row in running:
        left = row.left(now)
        if math.isnan(left) and row.counted:
            left = usual if math.isnan(usual) else max(0.0, usual - row.seconds(now))
        rest += left
    waiting = sum(row.stage == State.WAITING for row in rows)
    rest += waiting * usual if waiting else 0.0
    return rest / max(1, len(running)) if running or waiting else math.nan


def _choose(rows: list[_Row], room: int) -> tuple[list[_Row], str]:
    """Rows to draw, those that run and those that ended last; and a summary of the others."""
    if len(rows) <= room:
        return rows, ""
    room -= 1
    running = [row for row in rows if row.running][:room]
    ended = sorted((row for row in rows if not math.isnan(row.ended)), key=lambda r: r.ended)
    last = ended[-(room - len(running)) :] if len(running) < room else []
    shown = [*last, *running]
    known = {row.id for row in shown}
    return shown, "and " + ", ".join(_counts((r for r in rows if r.id not in known), _STATES))


def _table(rows: Iterable[_Row], now: float, width: int) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    stage = min(_LONGEST_STAGE, max(_STAGE, width // 5))
    name = max(_NAME, width - stage - sum(_FIGURES.values()) - len(_FIGURES) - 2)
    table.add_column("test", no_wrap=True, overflow="ellipsis", max_width=name)
    table.add_column("stage", no_wrap=True, overflow="ellipsis", min_width=_STAGE, max_width=stage)
    for head, digits in _FIGURES.items():
        table.add_column(head, no_wrap=True, justify="right", min_width=digits)
    for row in rows:
        table.add_row(clean(row.id), *_cells(row, now), style=_STYLES.get(row.stage))
    return table


def _cells(row: _Row, now: float) -> tuple[str, ...]:
    """Cells of a row after its name."""
    stage = _KEPT if row.stage == State.KEPT else row.stage
    if row.running:
        stage = clean(f"{stage} {row.message}".strip())
    progress, figures = row.progress, ("", "", "", "")
    if progress is not None:
        r_hat, ess = f"{progress.r_hat:.{3 if progress.r_hat < 10 else 0}f}", f"{progress.ess:.0f}"
        known = (r_hat, ess) if progress.measured else ("", "")
        figures = (f"{progress.steps}", *known, _rate_text(progress))
    left = row.left(now)
    return (
        *(stage, *figures),
        "" if math.isnan(row.began) or row.stage == State.KEPT else _clock(row.seconds(now)),
        "" if math.isnan(left) else _clock(left),
    )


def _clock(seconds: float) -> str:
    """A duration as h:mm:ss, or m:ss where it is short."""
    whole = round(seconds)
    minutes = f"{whole // 60 % 60:02d}:{whole % 60:02d}"
    return f"{whole // 3600}:{minutes}" if whole >= 3600 else minutes.removeprefix("0")


def _rate(progress: Progress) -> float:
    """Steps per second."""
    return max(progress.steps, 1) / max(progress.seconds, 1e-9)


def _rate_text(progress: Progress) -> str:
    return f"{_rate(progress):.{0 if _rate(progress) >= 10 else 1}f}"


def _line(step: Step) -> str:
    """A step in a line."""
    progress = step.progress
    if step.stage == State.KEPT:
        return f"{step.id}: {_KEPT}"
    if progress is None:
        return f"{step.id}: {f'{step.stage} {step.message}'.strip()}"
    text = f"{step.id}: {step.stage}, {progress.steps} steps, "
    text += f"R-hat {progress.r_hat:.3f}, ESS {progress.ess:.0f}, " if progress.measured else ""
    text += f"{_rate_text(progress)} steps/s"
    left = (progress.limit - progress.steps) / _rate(progress)
    if step.stage == State.DONE:
        return text
    missing = f", needs {progress.missing}" if progress.missing else ""
    return f"{text}{missing}, at most {left:.0f} s left"
