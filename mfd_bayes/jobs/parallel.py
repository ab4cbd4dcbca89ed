"""Functions of many tests in several processes, and work in a thread meanwhile."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import islice
from typing import Any, Protocol, TypeVar

from mfd_bayes.jobs.local import context, follow_parent, started_alike

T = TypeVar("T")
Argument = TypeVar("Argument")
Value = TypeVar("Value")

Evaluate = Callable[[Iterable[tuple[int, Argument]]], Iterator[Value]]
"""Values of tests' functions, as of their log likelihoods, at pairs of a test's number and an
argument.
"""

FEWEST = 4
"""With fewer tests, one process is faster than several."""

MOST = 16
"""Largest number of tests that are sent together."""

_FUNCTIONS: ContextVar[Sequence[Callable[[Any], Any]]] = ContextVar("_FUNCTIONS")
"""In a worker process: the functions that it was started with."""


def in_turn(functions: Sequence[Callable[[Argument], Value]]) -> Evaluate[Argument, Value]:
    """Function that computes values in this process, one after the other."""
    return lambda points: (functions[j](x) for j, x in points)


@contextmanager
def several_processes(
    functions: Sequence[Callable[[Argument], Value]], jobs: int
) -> Iterator[Evaluate[Argument, Value] | None]:
    """Function that computes values in several processes; None where one would be faster.

    The figures are those of this process, bit for bit, and come in the order of the arguments.
    Where a process is lost, this one goes on alone.
    """
    if jobs < 2 or len(functions) < FEWEST:
        yield None
        return
    pool = ProcessPoolExecutor(jobs, context(), initializer=_start, initargs=(functions,))
    size = max(1, min(MOST, len(functions) // (2 * jobs)))

    def send(batch: list[tuple[int, Argument]]) -> Future[list[Value]] | None:
        try:
            return pool.submit(_compute, batch)
        except BrokenProcessPool:
            return None

    def receive(
        batch: list[tuple[int, Argument]], future: Future[list[Value]] | None
    ) -> list[Value]:
        if future is not None:
            try:
                return future.result()
            except BrokenProcessPool:
                pass
        return [functions[j](x) for j, x in batch]

    def evaluate(points: Iterable[tuple[int, Argument]]) -> Iterator[Value]:
        source = iter(points)
        sent = deque[tuple[list[tuple[int, Argument]], Future[list[Value]] | None]]()
        while batch := list(islice(source, size)):
            sent.append((batch, send(batch)))
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
    functions = _FUNCTIONS.get()
    return [functions[j](x) for j, x in batch]


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
