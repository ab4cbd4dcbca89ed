"""Views of many tests, made by several processes."""

import multiprocessing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mfd_bayes.errors import StoreError
from mfd_bayes.evaluation import summary
from mfd_bayes.evaluation.summary import views_of_tests
from mfd_bayes.jobs import local
from mfd_bayes.runs.run import open_run

DATA = Path(__file__).parents[1] / "data" / "run"


@pytest.fixture
def run(monkeypatch):
    monkeypatch.setattr(local, "FEWEST", 2)
    return open_run(DATA)


def same(one, other):
    """Whether two views show the same, number by number."""
    np.testing.assert_array_equal(one.device.median, other.device.median)
    for a, b in zip(one.marginals, other.marginals, strict=True):
        np.testing.assert_array_equal(a.prior, b.prior)
        np.testing.assert_array_equal(a.posterior, b.posterior)
    return repr(one.rows) == repr(other.rows) and repr(one.checks) == repr(other.checks)


def test_several_processes_make_the_views_that_one_makes(run, monkeypatch):
    alone, lost = views_of_tests(run)
    assert lost == {}
    assert [view.id for view in alone] == list(run.manifest.tests)
    monkeypatch.setattr(summary, "in_turn", lambda _: pytest.fail("made by this process"))
    together, lost = views_of_tests(run, 2)
    assert lost == {}
    assert not multiprocessing.active_children()
    for one, other in zip(alone, together, strict=True):
        assert one.id == other.id
        if one.role == "calibrate":
            assert same(one, other)
            assert not same(one, replace(other, checks=other.checks[:-1]))  # the control


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_stored_file_that_is_gone_is_no_fault_of_its_test(run, tmp_path, jobs):
    name, test = next(iter(run.tests.items()))
    tests = {**run.tests, name: replace(test, path=tmp_path / "gone.nc", sha256="")}
    with pytest.raises(StoreError, match=r"gone\.nc"):
        views_of_tests(replace(run, tests=tests), jobs)
