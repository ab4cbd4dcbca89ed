"""Jobs and functions in processes of this machine, and how such a process starts.

On Linux processes are forked from a server, which has imported the libraries that they need: each
then starts in some hundredths of a second instead of two or three seconds. Elsewhere each starts
anew, and also where the path of the folder of temporary files is too long for the server's socket.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import tempfile
import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from itertools import islice
from multiprocessing import resource_tracker
from multiprocessing.context import ForkServerContext, SpawnContext
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from mfd_bayes.errors import FitError, StoreError
from mfd_bayes.jobs.job import Job, JobState, Outcome, Step, Workplace

PRELOAD = "mfd_bayes.pipeline.preload"
"""Module that imports what the processes of a run need."""

ATTEMPTS = 3  # so many processes may be killed at one job, as where memory is short
WATCH = 0.1  # s between looks at the news of other processes

LONGEST = 107 - len("/pymp-12345678/listener-12345678")
"""Most bytes of the path of the folder of the server's socket; Linux takes 107 in all."""

_ENVIRONMENT = {
    **dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    "MPLBACKEND": "agg",
    **dict.fromkeys(("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_"), str(2**25)),
}
"""Numpy uses one thread, for the number could change the draws; Matplotlib needs no screen.

glibc is to keep the memory of arrays that are freed: it otherwise gives it back and asks for it
again with every array of some 100 kB, which takes a third of the time.
"""

_TIDIED = "ignore:resource_tracker"
"""Where a signal ends this process, the tracker removes its semaphores; it need not say so."""

# In a worker process: the run folder, and what sends a step to the parent.
_WORKER: ContextVar[tuple[Path, Callable[[Step], Any]]] = ContextVar("_WORKER")


def run_jobs(
    jobs: Sequence[Job], folder: Path, workplace: Workplace, observe: Callable[[Step], None]
) -> Generator[Outcome, None, None]:
    """Outcomes of jobs in the order in which they end; the draws are the same on every machine."""
    if not workplace.scheduler:
        return run_in_processes(jobs, folder, workplace.processes, observe)
    return _cluster().run_on_cluster(jobs, folder, workplace.scheduler, observe)  # type: ignore[no-any-return]


def check_workers(workplace: Workplace) -> None:
    """Refuse a cluster that does not answer or has other versions, before anything is written."""
    if workplace.scheduler:
        if workplace.jobs:
            raise FitError("give either --jobs, for this machine, or --scheduler, for a cluster")
        _cluster().check_cluster(workplace.scheduler)


def _cluster() -> ModuleType:
    """Module that needs dask.distributed, an optional dependency."""
    try:
        from mfd_bayes.jobs import dask_cluster
    except ModuleNotFoundError as error:
        raise FitError(
            f'--scheduler needs {error.name}: pip install "mfd_bayes[cluster]"'
        ) from error
    return dask_cluster


def run_in_processes(
    jobs: Sequence[Job], folder: Path, processes: int, observe: Callable[[Step], None]
) -> Generator[Outcome, None, None]:
    """Outcomes of jobs in the order in which they end.

    All are first said to be waiting. Where a process is killed, the jobs that were at work begin
    again in new processes, from the same seeds.
    """
    for job in jobs:
        observe(Step(job.id, JobState.WAITING))
    waiting, losses = list(jobs), Counter[str]()
    while waiting:
        started: set[str] = set()
        news = context().SimpleQueue()  # of these processes alone: a killed one may have locked it
        size = min(processes, len(waiting))
        pool = ProcessPoolExecutor(size, context(), initializer=_begin, initargs=(folder, news))
        try:
            with started_alike():
                futures = {pool.submit(_work, job): job for job in waiting}
            pending = set(futures)
            while pending:
                finished, pending = wait(pending, WATCH, FIRST_COMPLETED)
                while not news.empty():
                    step = news.get()
                    started.add(step.id)
                    observe(step)
                for future in sorted(finished, key=lambda f: f.exception() is not None):
                    outcome = future.result()
                    waiting.remove(futures[future])
                    yield outcome
        except BrokenProcessPool:
            stopped = [job.id for job in waiting if job.id in started]
            names = ", ".join(stopped) or "the start"
            losses.update(stopped or [names])
            if max(losses.values()) >= ATTEMPTS:
                raise FitError(
                    f"a process was killed {ATTEMPTS} times at {losses.most_common(1)[0][0]}: if "
                    "memory is short, give fewer --jobs; go on with --resume"
                ) from None
            observe(
                Step("processes", JobState.NOTE, message=f"one was killed; begins again: {names}")
            )
            for name in stopped:
                observe(Step(name, JobState.WAITING))
        finally:
            workers = list((pool._processes or {}).values())  # Python 3.14 has `kill_workers`
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in workers:  # files that they have stored are whole
                worker.kill()
            for worker in workers:
                worker.join()


def _begin(folder: Path, news: Any) -> None:
    _WORKER.set((folder, news.put))
    follow_parent()


def _work(job: Job) -> Outcome:
    """In a worker process: do a job; what the machine lacks becomes one sentence."""
    folder, send = _WORKER.get()
    try:
        return job.run(folder, send)
    except OSError as error:
        location = f" in {error.filename}" if error.filename else ""
        raise StoreError(f"cannot store {job.id}{location}: {error.strerror or error}") from None
    except MemoryError as error:
        reason = f" ({error})" if str(error) else ""
        raise FitError(f"memory is too short for {job.id}{reason}: give fewer --jobs") from None


def context() -> ForkServerContext | SpawnContext:
    """What starts processes; they must be started within `started_alike`."""
    if sys.platform == "linux" and len(os.fsencode(tempfile.gettempdir())) <= LONGEST:
        return multiprocessing.get_context("forkserver")
    return multiprocessing.get_context("spawn")


def get_ready(module: str = PRELOAD) -> None:
    """Let the server of processes start and import a module meanwhile, if it is not there yet."""
    kind = context()
    if isinstance(kind, ForkServerContext):
        from multiprocessing import forkserver

        kind.set_forkserver_preload([module])
        with started_alike():
            forkserver.ensure_running()


@contextmanager
def started_alike() -> Iterator[None]:
    """Let processes that are started have one environment, and ignore Ctrl-C.

    This process gets Ctrl-C and ends the others.
    """
    warnings = ",".join(filter(None, (os.environ.get("PYTHONWARNINGS"), _TIDIED)))
    environment = _ENVIRONMENT | {"PYTHONWARNINGS": warnings}
    saved = dict(os.environ)
    os.environ |= environment
    blocks = hasattr(signal, "pthread_sigmask")
    if blocks:
        resource_tracker.ensure_running()  # its start would unblock Ctrl-C again
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if blocks:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name in environment:
            del os.environ[name]
            os.environ |= {name: saved[name]} if name in saved else {}


def follow_parent() -> None:
    """Let this process end when its parent does, however it does: a run may follow."""

    def end_with_parent() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


Argument = TypeVar("Argument")
Value = TypeVar("Value")

Evaluate = Callable[[Iterable[tuple[int, Argument]]], Iterator[Value]]
"""Values of tests' functions at pairs of a test's number and an argument."""

FEWEST = 4  # tests; with fewer, one process is faster than several
MOST = 16  # tests that are sent together

_FUNCTIONS: ContextVar[Sequence[Callable[[Any], Any]]] = ContextVar("_FUNCTIONS")


def in_turn(functions: Sequence[Callable[[Argument], Value]]) -> Evaluate[Argument, Value]:
    """Function that computes values in this process, one after the other."""
    return lambda points: (functions[j](x) for j, x in points)


@contextmanager
def several_processes(
    functions: Sequence[Callable[[Argument], Value]], jobs: int
) -> Iterator[Evaluate[Argument, Value]]:
    """Function that computes values in several processes; in this one where that is faster.

    The figures are those of this process, bit for bit, and come in the order of the arguments.
    Where a process is lost, this one goes on alone.
    """
    if jobs < 2 or len(functions) < FEWEST:
        yield in_turn(functions)
        return
    pool = ProcessPoolExecutor(jobs, context(), initializer=_start, initargs=(functions,))
    size = max(1, min(MOST, len(functions) // (2 * jobs)))

    def receive(batch: list[tuple[int, Argument]], future: Any) -> Iterable[Value]:
        if future is not None:
            with suppress(BrokenProcessPool):
                return future.result()  # type: ignore[no-any-return]
        return in_turn(functions)(batch)

    def evaluate(points: Iterable[tuple[int, Argument]]) -> Iterator[Value]:
        source, sent = iter(points), deque[Any]()
        while batch := list(islice(source, size)):
            future = None
            with suppress(BrokenProcessPool):
                future = pool.submit(_compute, batch)
            sent.append((batch, future))
            if len(sent) > 2 * jobs:  # a few are computed ahead
                yield from receive(*sent.popleft())
        while sent:
            yield from receive(*sent.popleft())

    try:
        with started_alike():
            for _ in range(jobs):
                pool.submit(_compute, [])
        yield evaluate
    finally:
        pool.shutdown(cancel_futures=True)


def _start(functions: Sequence[Callable[[Any], Any]]) -> None:
    _FUNCTIONS.set(functions)
    follow_parent()


def _compute(batch: list[tuple[int, Any]]) -> list[Any]:
    return list(in_turn(_FUNCTIONS.get())(batch))
