"""Tests that do not begin where the one before ended, by posteriors that are made up."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mfd_bayes.calibration.result import TestResult
from mfd_bayes.evaluation.checks import contradicted_order
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.run import open_run
from tests.run_folders import write_run

TIME = np.arange(201) / 50


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made") / "out"
    write_run(folder)
    run = open_run(folder)
    settings = run.manifest.settings
    after = {"b": {"after": "a"}}
    tests = tuple(t.model_copy(update=after.get(t.id, {})) for t in settings.test)
    settings = settings.model_copy(update={"test": tests})
    return replace(run, manifest=run.manifest.changed(settings=settings))


class Stub(TestResult):
    """A test whose draws are made up."""

    __test__ = False

    @property
    def stored(self):
        return SimpleNamespace(values=lambda: self.extras)


def with_start(run, start, first=1.0, sampled=True):
    """The run whose test a ends in slip forward, and b begins at a place with some spread."""
    test = run.tests["a"]
    values = test.stored.values()
    spread = 0.02 * np.random.default_rng(0).normal(size=len(values["start"]))
    ended = Trace.from_arrays(TIME, 5.0 - 5.0 * np.cos(0.25 * np.pi * TIME))  # to 10 in
    begun = Trace.from_arrays(TIME, 10.0 + first * np.sin(np.pi * TIME))
    names = test.posterior.names if sampled else ("Fc_fwd",)
    stubs = {
        name: Stub(
            name,
            SimpleNamespace(model=test.posterior.model, names=names, noise=None, trace=trace),
            test.path,
            extras={**values, "start": w0},
        )
        for name, trace, w0 in (
            ("a", ended, values["start"]),
            ("b", begun, np.clip(start + spread, 0.0, 1.0)),
        )
    }
    return replace(run, tests=stubs)


@pytest.mark.parametrize(("start", "first"), [(0.2, 1.0), (0.8, -1.0)])
def test_a_start_far_from_the_end_of_the_test_before_is_a_question(run, start, first):
    (found,) = contradicted_order(with_start(run, start, first))
    assert (found.subject, found.name, found.stage) == ("b", "start in the gap", "results")
    assert str(found.message).startswith("the test begins at 0.20 [0.1")
    assert "test a ended at 1.00 [1.00, 1.00]: check whether the device was" in str(found.message)
    assert not found.spoils


def test_a_start_where_the_test_before_ended_or_that_was_not_sampled_is_none(run):
    for start, first in ((1.0, 1.0), (0.0, -1.0), (0.88, 1.0)):
        assert contradicted_order(with_start(run, start, first)) == []
    assert contradicted_order(with_start(run, 0.2, sampled=False)) == []
    settings = run.manifest.settings
    tests = tuple(test.model_copy(update={"after": ""}) for test in settings.test)
    free = run.manifest.changed(settings=settings.model_copy(update={"test": tests}))
    assert contradicted_order(replace(with_start(run, 0.2), manifest=free)) == []
