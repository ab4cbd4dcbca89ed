"""Functions computed by several processes: the same values, also when a process is lost."""

import multiprocessing
import os
import signal
import threading
from functools import partial

import numpy as np
import pytest

from mfd_bayes.jobs.local import meanwhile, several_processes

TESTS = 9


@pytest.fixture
def functions():
    """Linear functions, which can be pickled without this file."""
    rng = np.random.default_rng(2)
    return [partial(np.dot, b=rng.standard_normal(3)) for _ in range(TESTS)]


@pytest.fixture
def points():
    rng = np.random.default_rng(1)
    return [(j, rng.standard_normal((5, 3))) for j in [*range(TESTS), 3, 3, 0]]


def not_here(x):
    raise AssertionError("computed by the process that gathers")


def test_values_are_those_of_one_process_in_the_same_order(functions, points):
    expected = [functions[j](x) for j, x in points]
    with several_processes(functions, 2) as evaluate:
        functions[:] = [not_here] * TESTS
        for _ in range(2):
            np.testing.assert_array_equal(list(evaluate(iter(points))), expected)
        assert len(multiprocessing.active_children()) == 2
        with pytest.raises(ValueError, match="shapes"):
            list(evaluate([(0, np.zeros((5, 2)))]))
    assert not multiprocessing.active_children()


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_where_a_process_is_killed_this_one_goes_on(functions, points):
    expected = [functions[j](x) for j, x in points]
    with several_processes(functions, 2) as evaluate:
        stream = evaluate(iter(points))
        first = next(stream)
        os.kill(multiprocessing.active_children()[0].pid, signal.SIGKILL)
        np.testing.assert_array_equal([first, *stream], expected)
        np.testing.assert_array_equal(list(evaluate(points)), expected)


def test_work_done_meanwhile_has_its_result_or_its_error():
    for jobs in [1, 2]:
        here = threading.get_ident()
        with meanwhile(jobs) as later:
            place, wrong = later(threading.get_ident), later(lambda: 1 // 0)
            assert (place() == here) == (jobs == 1)
            with pytest.raises(ZeroDivisionError):
                wrong()
