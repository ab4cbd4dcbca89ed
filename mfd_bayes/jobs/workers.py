"""Processes that work on tests: none outlives its parent, and none is lost unnoticed."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

from mfd_bayes.errors import FitError, StoreError
from mfd_bayes.jobs.job import Job, Outcome, State, Step
from mfd_bayes.jobs.signals import end_children

ATTEMPTS = 3
"""Processes that a test may lose, as where memory is short, before the run gives up."""

_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def run_tasks(
    tasks: Sequence[Job], out: Path, jobs: int, observe: Callable[[Step], None]
) -> Generator[Outcome, None, None]:
    """Outcomes of tests as they come, so many at a time, each in a process of its own.

    All are first said to be waiting. A test whose process is killed begins again from its
    seed, in another.

    Raises
    ------
    StoreError
        When a posterior cannot be written.
    FitError
        When the processes of a test are killed again and again.
    """
    for task in tasks:
        observe(Step(task.id, State.WAITING))
    crew = _Crew(out, deque(tasks))
    try:
        while crew.waiting or crew.members:
            while len(crew.members) < min(jobs, len(crew.waiting) + crew.busy):
                crew.enlist()
            for line in wait(list(crew.members)):
                news = crew.hear(line)
                if isinstance(news, Step):
                    observe(news)
                elif isinstance(news, StoreError):
                    raise news
                elif isinstance(news, Outcome):
                    yield news
    finally:
        end_children()


@dataclass(eq=False)
class _Member:
    """A process and the test it is at."""

    process: SpawnProcess
    task: Job | None = None


@dataclass(eq=False)
class _Crew:
    """The processes by the line to each, the tests that wait, and how often each was lost."""

    out: Path
    waiting: deque[Job]
    members: dict[Any, _Member] = field(default_factory=dict)
    lost: Counter[str] = field(default_factory=Counter)

    @property
    def busy(self) -> int:
        """Processes that are at a test."""
        return sum(member.task is not None for member in self.members.values())

    def enlist(self) -> None:
        """Start one more process; it asks for a test when it is ready."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_work, args=(theirs, self.out), daemon=True)
        with one_thread(), deaf():
            process.start()
        theirs.close()  # so that the line ends when the process does
        self.members[ours] = _Member(process)

    def hear(self, line: Any) -> Step | Outcome | StoreError | None:
        """What a process says; one that asks or is done is given the next test, or let go."""
        try:
            news: Step | Outcome | StoreError | None = line.recv()
            if news is None or isinstance(news, Outcome):
                self.members[line].task = None
                self._give(line)
        except (EOFError, OSError):
            return self._replace(self.members.pop(line))
        return news

    def _give(self, line: Any) -> None:
        if not self.waiting:
            del self.members[line]
            line.close()
            return
        task = self.members[line].task = self.waiting.popleft()
        with suppress(OSError):  # where it has ended, the line will say so
            line.send(task)

    def _replace(self, member: _Member) -> Step:
        """Put back the test of a process that has ended."""
        member.process.join()
        code = member.process.exitcode or 0
        name = member.task.id if member.task else "the start"
        how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        if code > 0:
            raise RuntimeError(f"the process of {name} failed: see above")
        self.lost[name] += 1
        if self.lost[name] >= ATTEMPTS:
            raise FitError(
                f"the process of {name} was {how}, {ATTEMPTS} times in all: if memory is short, "
                "give fewer --jobs; go on with --resume"
            )
        if member.task:
            self.waiting.appendleft(member.task)
        return Step(name, State.RESTARTED, message=f"its process was {how}")


def _work(line: Connection, out: Path) -> None:
    """Do what comes down the line, until nothing more does."""
    threading.Thread(target=end_with_parent, daemon=True).start()

    def tell(news: Step | Outcome | StoreError | None) -> None:
        try:
            line.send(news)
        except OSError:  # nobody listens any more
            os._exit(1)

    tell(None)
    with suppress(EOFError, ConnectionError):
        while True:
            task = line.recv()
            try:
                tell(task.run(out, tell))
            except StoreError as error:
                tell(error)


def end_with_parent() -> None:
    """Wait for the parent to end, however it does, and end too: another run may follow it."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def one_thread() -> Iterator[None]:
    """Let numpy in a new process use one thread: how many there are must not reach the draws."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ |= dict.fromkeys(_THREADS, "1")
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def deaf() -> Iterator[None]:
    """Hold back Ctrl-C while a process starts, which inherits that: this one is to stop it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # it would let Ctrl-C through when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
