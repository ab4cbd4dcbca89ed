"""Likelihoods computed by several processes: the same values, also when a process is lost."""

import multiprocessing
import os
import signal
import threading
import time
from functools import partial

import numpy as np
import pytest

from mfd_bayes.jobs.likelihoods import beside, meanwhile, several_processes

TESTS = 9


@pytest.fixture
def likelihoods():
    """Linear likelihoods, which can be pickled without this file."""
    rng = np.random.default_rng(2)
    return [partial(np.dot, b=rng.standard_normal(3)) for _ in range(TESTS)]


@pytest.fixture
def points():
    rng = np.random.default_rng(1)
    return [(j, rng.standard_normal((5, 3))) for j in [*range(TESTS), 3, 3, 0]]


def not_here(x):
    """Likelihood of this process, which must not be called while the others live."""
    raise AssertionError("computed by the process that gathers")


def test_values_are_those_of_one_process_in_the_same_order(likelihoods, points):
    expected = [likelihoods[j](x) for j, x in points]
    with several_processes(likelihoods, 2) as evaluate:
        likelihoods[:] = [not_here] * TESTS
        for _ in range(3):
            np.testing.assert_array_equal(list(evaluate(iter(points))), expected)
        assert len(multiprocessing.active_children()) == 2
    assert not multiprocessing.active_children()


def test_few_tests_and_one_job_need_no_process(likelihoods):
    for those, jobs in ((likelihoods, 1), (likelihoods[:3], 4)):
        with several_processes(those, jobs) as evaluate:
            assert evaluate is None


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_where_a_process_is_killed_this_one_goes_on(likelihoods, points):
    expected = [likelihoods[j](x) for j, x in points]
    asked = []

    def here(j, x):
        asked.append(j)
        return likelihoods[j](x)

    those = list(likelihoods)
    with several_processes(those, 2) as evaluate:
        those[:] = [partial(here, j) for j in range(TESTS)]
        stream = evaluate(iter(points))
        first = next(stream)
        assert not asked
        children = multiprocessing.active_children()
        os.kill(children[0].pid, signal.SIGKILL)
        np.testing.assert_array_equal([first, *stream], expected)
        for child in children:  # the other is ended too, for it may hold what is sent
            child.join(20)
        asked.clear()
        np.testing.assert_array_equal(list(evaluate(points)), expected)
        assert asked == [j for j, _ in points]


def test_an_error_in_a_process_is_raised_here(likelihoods):
    with several_processes(likelihoods, 2) as evaluate, pytest.raises(ValueError, match="shapes"):
        list(evaluate([(0, np.zeros((5, 2)))]))
    assert not multiprocessing.active_children()


def test_work_beside_is_done_in_another_process_where_there_are_two():
    with beside(2, os.getpid) as result:
        assert result() != os.getpid()
    with beside(1, os.getpid) as result:
        assert result() == os.getpid()


def test_work_whose_process_is_lost_is_done_here():
    with beside(2, partial(time.sleep, 0.5)) as result:
        (child,) = multiprocessing.active_children()
        os.kill(child.pid, signal.SIGKILL)
        began = time.perf_counter()
        assert result() is None  # and no error of the lost process
        assert time.perf_counter() - began >= 0.5


@pytest.mark.parametrize("jobs", [1, 2])
def test_work_done_meanwhile_has_its_result_or_its_error(jobs):
    here = threading.get_ident()
    with meanwhile(jobs) as beside:
        place, wrong = beside(threading.get_ident), beside(lambda: 1 // 0)
        assert (place() == here) == (jobs == 1)
        with pytest.raises(ZeroDivisionError):
            wrong()


def test_work_that_has_not_begun_is_left_undone_where_this_thread_ends():
    done, begin = [], threading.Event()

    def first():
        begin.wait(10.0)
        done.append(1)

    def stopped():
        with meanwhile(2) as beside:
            beside(first)
            beside(lambda: done.append(2))
            threading.Timer(0.2, begin.set).start()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert done == [1]
