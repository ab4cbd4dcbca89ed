"""Functions of many tests in several processes, and work in a thread meanwhile."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from itertools import islice
from typing import Any, Protocol, TypeVar

from mfd_bayes.jobs.local import context, follow_parent, started_alike

T = TypeVar("T")
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
