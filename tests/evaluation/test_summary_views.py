"""Views of many tests, made by several processes."""

import multiprocessing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mfd_bayes.errors import StoreError
from mfd_bayes.evaluation.summary import views_of_tests
from mfd_bayes.jobs import local
from mfd_bayes.runs.run import open_run

DATA = Path(__file__).parents[1] / "data" / "run"


def test_several_processes_make_the_views_that_one_makes(monkeypatch):
    monkeypatch.setattr(local, "FEWEST", 2)
    run, views = open_run(DATA), []
    for jobs in (1, 2):
        made, lost = views_of_tests(run, jobs)
        assert lost == {}
        assert [view.id for view in made] == list(run.manifest.tests)
        views.append(made)
    assert not multiprocessing.active_children()
    for one, other in zip(*views, strict=True):
        np.testing.assert_array_equal(one.observation.median, other.observation.median)
        for a, b in zip(one.marginals, other.marginals, strict=True):
            np.testing.assert_array_equal(a.prior, b.prior)
            np.testing.assert_array_equal(a.posterior, b.posterior)
        assert repr((one.rows, one.checks)) == repr((other.rows, other.checks))


def test_a_stored_file_that_is_gone_is_no_fault_of_its_test(tmp_path):
    run = open_run(DATA)
    name, test = next(iter(run.tests.items()))
    tests = {**run.tests, name: replace(test, path=tmp_path / "gone.nc", sha256="")}
    with pytest.raises(StoreError, match=r"gone\.nc"):
        views_of_tests(replace(run, tests=tests))
