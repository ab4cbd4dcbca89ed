"""Functions of many tests by several processes, and other work beside them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import islice
from typing import Any, Generic, Protocol, TypeVar

from mfd_bayes.jobs.processes import context, follow_parent, started_alike

T = TypeVar("T")
Given = TypeVar("Given")
Found = TypeVar("Found")

Evaluate = Callable[[Iterable[tuple[int, Given]]], Iterator[Found]]
"""Values of tests' functions, as of their log likelihoods, of pairs of a test's number and what its
function is given.
"""

FEWEST = 4
"""With fewer tests, one process is faster than several."""

MOST = 16
"""Largest number of tests that are sent together."""

_FUNCTIONS: ContextVar[Sequence[Callable[[Any], Any]]] = ContextVar("_FUNCTIONS")
"""In a worker process: the functions that it was started with."""


def in_turn(functions: Sequence[Callable[[Given], Found]]) -> Evaluate[Given, Found]:
    """Function that computes values in this process, one after the other."""
    return lambda points: (functions[j](x) for j, x in points)


@contextmanager
def several_processes(
    functions: Sequence[Callable[[Given], Found]], jobs: int
) -> Iterator[Evaluate[Given, Found] | None]:
    """Function that computes values in several processes; None where one would be faster.

    The figures are those of this process, bit for bit. Where a process is lost, this one goes on
    alone.

    Parameters
    ----------
    functions : sequence of callable
        Of each test, such as its log likelihood, (n, D) coordinates to (n,); each process gets a
        copy of all.
    jobs : int
        Number of processes.
    """
    if jobs < 2 or len(functions) < FEWEST:
        yield None
        return
    pool = ProcessPoolExecutor(jobs, context(), initializer=_start, initargs=(functions,))
    try:
        with started_alike():
            for _ in range(jobs):
                pool.submit(_compute, [])
        yield _Pool(pool, functions, jobs).evaluate
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def beside(jobs: int, work: Callable[[], T]) -> Iterator[Callable[[], T]]:
    """Function that waits for the result of work, which another process does meanwhile.

    With one job, or where that process is lost, this process does it when the result is wanted.
    """
    if jobs < 2:
        yield work
        return
    pool = ProcessPoolExecutor(1, context(), initializer=follow_parent)
    try:
        with started_alike():
            future = pool.submit(work)

        def result() -> T:
            try:
                return future.result()
            except BrokenProcessPool:
                return work()

        yield result
    finally:
        pool.shutdown(cancel_futures=True)


class Meanwhile(Protocol):
    """Takes work that may be done meanwhile."""

    def __call__(self, work: Callable[[], T], /) -> Callable[[], T]:
        """Function that waits for the work's result."""
        ...


def when_wanted(work: Callable[[], T], /) -> Callable[[], T]:
    """Work that is done once its result is wanted."""
    return work


@contextmanager
def meanwhile(jobs: int) -> Iterator[Meanwhile]:
    """Let a thread work beside this one; with one job, work is done when its result is wanted.

    What has not begun at the end is left undone.
    """
    if jobs < 2:
        yield when_wanted
        return
    thread = ThreadPoolExecutor(1)
    try:
        yield lambda work: thread.submit(work).result
    finally:
        thread.shutdown(cancel_futures=True)


class _Pool(Generic[Given, Found]):
    """The processes; once one is lost, this process computes instead."""

    def __init__(
        self, pool: ProcessPoolExecutor, functions: Sequence[Callable[[Given], Found]], jobs: int
    ) -> None:
        self.pool, self.functions, self.jobs = pool, functions, jobs
        self.size = max(1, min(MOST, len(functions) // (2 * jobs)))
        self.lost = False

    def evaluate(self, points: Iterable[tuple[int, Given]]) -> Iterator[Found]:
        """Values, in the order of what is given; a few are computed ahead."""
        source = iter(points)
        sent = deque[tuple[list[tuple[int, Given]], Future[list[Found]] | None]]()
        while batch := list(islice(source, self.size)):
            sent.append((batch, self._send(batch)))
            if len(sent) > 2 * self.jobs:
                yield from self._receive(*sent.popleft())
        while sent:
            yield from self._receive(*sent.popleft())

    def _send(self, points: list[tuple[int, Given]]) -> Future[list[Found]] | None:
        if not self.lost:
            try:
                return self.pool.submit(_compute, points)
            except BrokenProcessPool:
                self.lost = True
        return None

    def _receive(
        self, points: list[tuple[int, Given]], future: Future[list[Found]] | None
    ) -> list[Found]:
        if future is not None:
            try:
                return future.result()
            except BrokenProcessPool:
                self.lost = True
        return [self.functions[j](x) for j, x in points]


def _start(functions: Sequence[Callable[[Any], Any]]) -> None:
    _FUNCTIONS.set(functions)
    follow_parent()


def _compute(points: list[tuple[int, Any]]) -> list[Any]:
    functions = _FUNCTIONS.get()
    return [functions[j](x) for j, x in points]
