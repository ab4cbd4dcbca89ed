"""Processes that do jobs: none outlives its parent, and the loss of one is noticed.

`concurrent.futures` gives up all jobs when one process is killed. A queue that all processes share,
for the news of their progress, would stay locked when one is killed while it writes. So each
process has a pipe of its own.
"""

from __future__ import annotations

import os
import signal
from collections import Counter, deque
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from mfd_bayes.errors import FitError, MfdError, StoreError
from mfd_bayes.jobs.job import Job, Outcome, State, Step
from mfd_bayes.jobs.processes import context, follow_parent, started_alike

ATTEMPTS = 3
"""The run gives up when this many processes of one job were killed, as where memory is short."""


_Message = Step | Outcome | MfdError | None
"""What a worker sends: None is that it waits for its first job."""


def run_in_processes(
    jobs: Sequence[Job], out: Path, processes: int, observe: Callable[[Step], None]
) -> Generator[Outcome, None, None]:
    """Outcomes of jobs in the order in which they end.

    All are first said to be waiting. A job whose process is killed begins again in another one,
    from the same seed.

    Raises
    ------
    StoreError
        When a result cannot be written.
    FitError
        When the processes of one job are killed `ATTEMPTS` times, or memory is too short for it.
    """
    for job in jobs:
        observe(Step(job.id, State.WAITING))
    pool = _Pool(out, deque(jobs))
    try:
        while pool.waiting or pool.workers:
            while len(pool.workers) < min(processes, len(pool.waiting) + pool.busy):
                pool.start_worker()
            for connection in wait(list(pool.workers)):
                message = pool.receive(connection)
                if isinstance(message, Step):
                    observe(message)
                elif isinstance(message, MfdError):
                    raise message
                elif isinstance(message, Outcome):
                    yield message
    finally:
        pool.end()


@dataclass(eq=False)
class _Worker:
    """A process and the job that it does."""

    process: BaseProcess
    job: Job | None = None


@dataclass(eq=False)
class _Pool:
    """The workers by the connection to each, the jobs that wait, and losses by job.

    `started` are the processes of all workers, also of those that have ended.
    """

    out: Path
    waiting: deque[Job]
    workers: dict[Any, _Worker] = field(default_factory=dict)
    lost: Counter[str] = field(default_factory=Counter)
    started: list[BaseProcess] = field(default_factory=list)

    @property
    def busy(self) -> int:
        """Number of workers that do a job."""
        return sum(worker.job is not None for worker in self.workers.values())

    def start_worker(self) -> None:
        """Start one more process; it asks for a job when it is ready."""
        kind = context()
        ours, theirs = kind.Pipe()
        process = kind.Process(target=_work, args=(theirs, self.out), daemon=True)
        with started_alike():
            process.start()
        self.started.append(process)
        theirs.close()  # so that the connection ends when the process does
        self.workers[ours] = _Worker(process)

    def end(self) -> None:
        """Kill the processes that were started here; files that they have stored are whole."""
        for process in self.started:
            if process.is_alive():
                process.kill()
        for process in self.started:
            process.join()

    def receive(self, connection: Any) -> _Message:
        """Next message of a worker; one that has no job, or has ended one, gets the next."""
        try:
            message: _Message = connection.recv()
            if message is None or isinstance(message, Outcome):
                self.workers[connection].job = None
                self._send_job(connection)
        except (EOFError, OSError):
            return self._put_back(self.workers.pop(connection))
        return message

    def _send_job(self, connection: Any) -> None:
        """Give a worker the next job, or let it end where none is left."""
        if not self.waiting:
            del self.workers[connection]
            connection.close()
            return
        job = self.workers[connection].job = self.waiting.popleft()
        with suppress(OSError):  # the worker was killed: the next `receive` notices
            connection.send(job)

    def _put_back(self, worker: _Worker) -> Step:
        """Let the job of a lost worker wait again; a step that says so."""
        worker.process.join()
        code = worker.process.exitcode or 0
        name = worker.job.id if worker.job else "the start"
        how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        if code > 0:
            raise RuntimeError(f"the process of {name} failed: see above")
        self.lost[name] += 1
        if self.lost[name] >= ATTEMPTS:
            raise FitError(
                f"the process of {name} was {how}, {ATTEMPTS} times in all: if memory is short, "
                "give fewer --jobs; go on with --resume"
            )
        if worker.job:
            self.waiting.appendleft(worker.job)
        return Step(name, State.RESTARTED, message=f"its process was {how}")


def _work(connection: Connection, out: Path) -> None:
    """In a worker process: do the jobs that come, until the connection ends."""
    follow_parent()

    def send(message: _Message) -> None:
        try:
            connection.send(message)
        except OSError:  # the parent has ended
            os._exit(1)

    send(None)
    with suppress(EOFError, ConnectionError):
        while True:
            job = connection.recv()
            try:
                send(job.run(out, send))
            except StoreError as error:
                send(error)
            except OSError as error:
                place = f" in {error.filename}" if error.filename else ""
                send(StoreError(f"cannot store {job.id}{place}: {error.strerror or error}"))
            except MemoryError as error:
                send(FitError(f"memory is too short for {job.id}{_told(error)}: give fewer --jobs"))


def _told(error: MemoryError) -> str:
    """What an error says beside its kind, in brackets; often nothing."""
    return f" ({error})" if str(error) else ""
