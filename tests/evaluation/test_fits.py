"""Rows of one test, of facts as JSON gives them back; tests that were held out."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.evaluation.test_summary import _rows, held_out_view
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.run import open_run
from mfd_bayes.store.netcdf import Group, StoredTest

TRACE = Trace.from_arrays([0.0, 1.0, 2.0], [0.0, 1.0, 0.0], 1.0, [0.0, 1.0, 2.0])


def row_of(name, draws, prior, convergence):
    data = Group({name: (["chain", "draw"], draws, {})}, {})
    stored = StoredTest(data, Group({}, {}), TRACE, {"convergence": {name: convergence}})
    (row,) = _rows("a", stored, {name: prior})
    return row


@pytest.mark.parametrize(
    ("stored", "shown"),
    [
        ([1.0, 500.0, 400.0], (1.0, 500.0, 400.0)),
        ([None, None, None], (np.inf, 0.0, 0.0)),
        ([1.0, None, 400.0], (1.0, 0.0, 400.0)),
    ],
)
def test_infinite_figures_which_json_stores_as_null_fail_their_limits(stored, shown):
    draws = np.random.default_rng(0).lognormal(size=(2, 20))
    row = row_of("Fc_fwd", draws, draws[0], stored)
    assert (row.r_hat, row.ess_bulk, row.ess_tail) == shown


def test_a_fixed_quantity_has_no_contraction():
    row = row_of("start", np.full((2, 20), 0.5), np.full(2000, 0.5), [1.0, 1.0, 1.0])
    assert np.isnan(row.contraction)
    assert row.note == ""


def test_a_test_that_was_held_out_says_where_it_begins(benchmark_module, tmp_path):
    benchmark_module("fuzz.runs").write_run(tmp_path / "out")
    run = open_run(tmp_path / "out")
    free = held_out_view(run, "c", run.held_out["c"])
    settings = run.manifest.settings.with_test("c", after="b")
    run = replace(run, manifest=run.manifest.changed(settings=settings))
    view = held_out_view(run, "c", run.held_out["c"])
    assert free.begun == ""
    assert view.begun == "begun where in its gap test b ended"
    assert not np.array_equal(view.observation.median, free.observation.median)
