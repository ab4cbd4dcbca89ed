"""One prediction by several models."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mfd_bayes as mb

DATA = Path(__file__).parents[1] / "data" / "run"


def copied(folder, change=lambda manifest: None):
    """A copy of the stored run under another noise, with a changed manifest."""
    shutil.copytree(DATA, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["settings"]["campaign"]["noise"] = "student_t"
    change(manifest)
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return mb.open_run(folder)


@pytest.fixture(scope="module")
def run():
    return mb.open_run(DATA)


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    return copied(tmp_path_factory.mktemp("other") / "out")


@pytest.fixture
def trace(run):
    return replace(run.held_out["p800_f0.5"], force=None)


def test_each_model_gives_half_of_the_draws_and_the_band_is_that_of_the_mixture(run, other, trace):
    average = mb.ModelAverage([run, other])
    assert average.models == ("three_stage (ou)", "three_stage (student_t)")
    band = average.predict(trace, "observation", draws=101, seed=3)
    parts = [
        each.predict(trace, "observation", draws=n, seed=3).draws
        for each, n in ((run, 51), (other, 50))
    ]
    np.testing.assert_array_equal(band.draws, np.concatenate(parts))
    lower, upper = np.quantile(np.concatenate(parts), [0.025, 0.975], axis=0)
    np.testing.assert_allclose(band.lower, lower)
    np.testing.assert_allclose(band.upper, upper)
    assert "in equal parts" in band.source


def test_remarks_are_said_once(run, other, trace):
    far = replace(trace, actuation=1.4)
    remarks = mb.ModelAverage([run, other]).predict(far, draws=100).remarks
    (said,) = [remark for remark in remarks if "the actuation" in remark]
    assert said in run.predict(far, draws=100).remarks


def test_runs_that_do_not_belong_together_are_refused(run, other, trace, tmp_path):
    def without_one(manifest):  # whose calibration has failed
        test, *_ = manifest["settings"]["test"]
        manifest["tests"][test["id"]]["status"] = "failed"

    for runs, words in (
        ([run], "needs two or more runs, .*, got Run"),
        ([run, run], "two of the runs have the model three_stage"),
        ([run, copied(tmp_path / "less", without_one)], "is calibrated in .* but not in .*less"),
        ("ab", "two or more runs, .*, got str, str"),
        (5, "got int"),
    ):
        with pytest.raises(mb.MfdError, match=words):
            mb.ModelAverage(runs)
    with pytest.raises(mb.MfdError, match="not the kind this_test"):
        mb.ModelAverage([run, other]).predict(trace, "this_test")
