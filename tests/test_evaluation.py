"""Likelihoods computed by several processes: the same figures, also when a process is lost."""

import multiprocessing
import os
import signal
from dataclasses import dataclass

import numpy as np
import pytest

from mfd_bayes.evaluation import several_processes

TESTS = 9


@dataclass(frozen=True)
class Quadratic:
    """A log likelihood that can be sent, and that tells where it was computed."""

    centre: float

    def __call__(self, x):
        return np.append(-0.5 * np.sum((x - self.centre) ** 2, axis=1), os.getpid())


@pytest.fixture
def likelihoods():
    return [Quadratic(float(j)) for j in range(TESTS)]


@pytest.fixture
def points():
    rng = np.random.default_rng(1)
    return [(j, rng.standard_normal((5, 3))) for j in [*range(TESTS), 3, 3, 0]]


def check(found, likelihoods, points):
    for (j, x), told in zip(points, found, strict=True):
        np.testing.assert_array_equal(told[:-1], likelihoods[j](x)[:-1])
    return {int(told[-1]) for told in found}


def test_figures_are_those_of_one_process_in_their_order(likelihoods, points):
    with several_processes(likelihoods, 2) as evaluate:
        where = set()
        for _ in range(20):
            where |= check(list(evaluate(iter(points))), likelihoods, points)
    assert os.getpid() not in where
    assert len(where) == 2
    assert not multiprocessing.active_children()


def test_few_tests_and_one_job_need_no_process(likelihoods):
    for those, jobs in ((likelihoods, 1), (likelihoods[:3], 4)):
        with several_processes(those, jobs) as evaluate:
            assert evaluate is None


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_where_a_process_is_killed_this_one_goes_on(likelihoods, points):
    with several_processes(likelihoods, 2) as evaluate:
        check(list(evaluate(points)), likelihoods, points)
        stream = evaluate(iter(points))
        first = next(stream)
        os.kill(multiprocessing.active_children()[0].pid, signal.SIGKILL)
        check([first, *stream], likelihoods, points)
        for child in multiprocessing.active_children():
            child.join(20)
        assert check(list(evaluate(points)), likelihoods, points) == {os.getpid()}


def test_what_fails_in_a_process_fails_here(likelihoods):
    with several_processes(likelihoods, 2) as evaluate, pytest.raises(np.exceptions.AxisError):
        list(evaluate([(0, np.zeros(3))]))
    assert not multiprocessing.active_children()
