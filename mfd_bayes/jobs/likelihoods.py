"""Likelihoods of many tests at once, computed by several processes."""

from __future__ import annotations

import multiprocessing
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.jobs.workers import deaf, end_with_parent, one_thread

Array = NDArray[np.float64]
Likelihood = Callable[[Array], Array]
Points = list[tuple[int, Array]]

Evaluate = Callable[[Iterable[tuple[int, Array]]], Iterator[Array]]
"""Log likelihoods of points of tests, given by the tests' numbers, in their order."""

FEWEST = 4
"""Tests below which a process more is not worth its start."""

MOST = 16
"""Tests whose points are sent at once."""

_held: Sequence[Likelihood] = ()


@contextmanager
def several_processes(likelihoods: Sequence[Likelihood], jobs: int) -> Iterator[Evaluate | None]:
    """What computes likelihoods in so many processes; None where this one had better do it.

    The figures are those of this process, bit for bit. Where a process is lost, this one goes on
    alone.

    Parameters
    ----------
    likelihoods : sequence of callable
        Log likelihood of each test, of (n, D) coordinates, (n,); they are sent.
    jobs : int
    """
    if jobs < 2 or len(likelihoods) < FEWEST:
        yield None
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, context, initializer=_hold, initargs=(likelihoods,))
    try:
        with one_thread(), deaf():
            for _ in range(jobs):
                pool.submit(_compute, [])
        yield _Crew(pool, likelihoods, jobs).evaluate
    finally:
        pool.shutdown(cancel_futures=True)


class _Crew:
    """The processes, and what to do without them."""

    def __init__(
        self, pool: ProcessPoolExecutor, likelihoods: Sequence[Likelihood], jobs: int
    ) -> None:
        self.pool, self.likelihoods, self.jobs = pool, likelihoods, jobs
        self.size = max(1, min(MOST, len(likelihoods) // (4 * jobs)))
        self.lost = False

    def evaluate(self, points: Iterable[tuple[int, Array]]) -> Iterator[Array]:
        """Log likelihoods of points, in their order; some are computed ahead."""
        source, sent = iter(points), deque[tuple[Points, Future[list[Array]] | None]]()
        while some := list(islice(source, self.size)):
            sent.append((some, self._send(some)))
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


def _hold(likelihoods: Sequence[Likelihood]) -> None:
    global _held
    _held = likelihoods
    threading.Thread(target=end_with_parent, daemon=True).start()


def _compute(points: Points) -> list[Array]:
    return [_held[j](x) for j, x in points]
