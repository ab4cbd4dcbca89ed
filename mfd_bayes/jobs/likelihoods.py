"""Likelihoods of many tests by several processes, and other work in a process beside this one."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import islice
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.jobs.processes import context, follow_parent, started_alike

T = TypeVar("T")
Array = NDArray[np.float64]
Likelihood = Callable[[Array], Array]
Points = list[tuple[int, Array]]

Evaluate = Callable[[Iterable[tuple[int, Array]]], Iterator[Array]]
"""Log likelihoods, or others of a test's functions, of pairs of its number and its points."""

FEWEST = 4
"""With fewer tests, one process is faster than several."""

MOST = 16
"""Largest number of tests whose points are sent together."""

_LIKELIHOODS: ContextVar[Sequence[Likelihood]] = ContextVar("_LIKELIHOODS")
"""In a worker process: the likelihoods that it was started with."""


def in_turn(likelihoods: Sequence[Likelihood]) -> Evaluate:
    """Function that computes likelihoods in this process, one after the other."""
    return lambda points: (likelihoods[j](x) for j, x in points)


@contextmanager
def several_processes(likelihoods: Sequence[Likelihood], jobs: int) -> Iterator[Evaluate | None]:
    """Function that computes likelihoods in several processes; None where one would be faster.

    The figures are those of this process, bit for bit. Where a process is lost, this one goes on
    alone.

    Parameters
    ----------
    likelihoods : sequence of callable
        Of each test its log likelihood, (n, D) coordinates to (n,), or another function of them;
        each process gets a copy.
    jobs : int
        Number of processes.
    """
    if jobs < 2 or len(likelihoods) < FEWEST:
        yield None
        return
    pool = ProcessPoolExecutor(jobs, context(), initializer=_start, initargs=(likelihoods,))
    try:
        with started_alike():
            for _ in range(jobs):
                pool.submit(_compute, [])
        yield _Pool(pool, likelihoods, jobs).evaluate
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


class _Pool:
    """The processes; once one is lost, this process computes instead."""

    def __init__(
        self, pool: ProcessPoolExecutor, likelihoods: Sequence[Likelihood], jobs: int
    ) -> None:
        self.pool, self.likelihoods, self.jobs = pool, likelihoods, jobs
        self.size = max(1, min(MOST, len(likelihoods) // (4 * jobs)))
        self.lost = False

    def evaluate(self, points: Iterable[tuple[int, Array]]) -> Iterator[Array]:
        """Log likelihoods of points, in their order; a few are computed ahead."""
        source, sent = iter(points), deque[tuple[Points, Future[list[Array]] | None]]()
        while batch := list(islice(source, self.size)):
            sent.append((batch, self._send(batch)))
            if len(sent) > 2 * self.jobs:
                yield from self._receive(*sent.popleft())
        while sent:
            yield from self._receive(*sent.popleft())

    def _send(self, points: Points) -> Future[list[Array]] | None:
        if not self.lost:
            try:
                return self.pool.submit(_compute, points)
            except BrokenProcessPool:
                self.lost = True
        return None

    def _receive(self, points: Points, future: Future[list[Array]] | None) -> list[Array]:
        if future is not None:
            try:
                return future.result()
            except BrokenProcessPool:
                self.lost = True
        return [self.likelihoods[j](x) for j, x in points]


def _start(likelihoods: Sequence[Likelihood]) -> None:
    _LIKELIHOODS.set(likelihoods)
    follow_parent()


def _compute(points: Points) -> list[Array]:
    likelihoods = _LIKELIHOODS.get()
    return [likelihoods[j](x) for j, x in points]
