"""A run in Python: what it holds by name, and one sentence for what cannot be asked of it."""

import json
import pickle
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import mfd_bayes as mb
from mfd_bayes.errors import NotThereError
from mfd_bayes.runs.run import open_run, sequence_of

DATA = Path(__file__).parents[1] / "data" / "run"


@pytest.fixture(scope="module")
def run():
    return open_run(DATA)


@pytest.fixture(scope="module")
def trace(run):
    return run.tests["p500_f0.5"].trace


def test_tests_are_a_mapping_that_cannot_be_changed(run):
    restored = pickle.loads(pickle.dumps(run))
    assert list(restored.tests) == [*run.tests]
    assert run.tests.get("zz") is None
    with pytest.raises(TypeError):
        run.tests["zz"] = run.tests["p500_f0.5"]
    with pytest.raises(KeyError):  # as with a dict
        run.tests["zz"]


@pytest.mark.parametrize("name", ["zz", None, 5, ["a"]])
def test_what_is_said_of_a_test_that_is_not_there_is_a_sentence(run, trace, name):
    for function in (run.session, lambda name: run.extrapolations(trace, name or "zz")):
        with pytest.raises(NotThereError, match=r"the run has no test .*: there are"):
            function(name)


def test_runs_and_tests_that_are_not_there_are_named(run):
    for folder in (None, b"out", "a\0b"):
        with pytest.raises(mb.MfdError, match="folder must be a path"):
            mb.open_run(folder)
    for wrong in ("zz", None, 5, ["a"]):
        with pytest.raises(NotThereError, match=r"no .*test .*: there are p500_f0.5, p1000_f0.5"):
            run.tests[wrong]
    with pytest.raises(NotThereError, match=r"no .*test 'zz': there are p500_f0.5, p1000_f0.5"):
        sequence_of(run).values("zz")
    with pytest.raises(NotThereError, match=r"no held-out test 'zz': there are p800_f0\.5"):
        run.held_out["zz"]


THIS = {"kind": "this_test", "test": "p500_f0.5"}


@pytest.mark.parametrize(
    ("act", "options", "words"),
    [
        ("predict", {"simultaneous": "no"}, "simultaneous"),
        ("predict", THIS | {"test": "zz"}, "p1000.*, got 'zz'"),
        ("predict", THIS | {"test": "p800_f0.5"}, "got 'p800_f0.5', which was held out"),
        ("predict", THIS | {"kind": "new_test"}, "for the kind this_test, not for new_test"),
        (
            "predict",
            THIS | {"condition_on": (0.0, 1.0)},
            "condition_on cannot .* a calibrated test",
        ),
        ("predict", THIS | {"session": "other"}, "session 'other' is for"),
        ("predict", {"probability": "0.9"}, "probability must be a finite number .*, got '0.9'"),
        ("next_test", {"goal": 5}, "goal must be text"),
        ("next_test", {"candidates": [None]}, "candidates must"),
        *(("next_test", {key: "zz zz"}, f"^{key}: ") for key in ("goal", "candidates", "limits")),
        ("respond", {"draws": 9}, "draws must be a whole number, 10 or more, got 9"),
    ],
)
def test_options_are_checked(run, trace, act, options, words):
    arguments = {"predict": (trace,), "respond": ("none.toml", "none.AT2")}.get(act, ())
    function = run.predict if act == "predict" else partial(getattr(mb, act), run)
    with pytest.raises(mb.MfdError, match=words):
        function(*arguments, **options)


def test_another_actuation_of_a_test_is_refused_in_the_units_asked_for(run, trace):
    for units, words in (("us", "500 psi, .* nothing of 1000 psi"), ("si", "of 6.895 MPa")):
        with pytest.raises(mb.MfdError, match=words):
            replace(run, units=units).predict(replace(trace, actuation=1.0), **THIS)


def test_a_session_that_no_test_has_is_said(run, trace):
    motion = replace(trace, force=None)
    assert run.predict(motion, draws=100).remarks == ()
    (remark,) = run.predict(motion, draws=100, session="spring").remarks
    assert remark.startswith("session 'spring' is taken for a new one")
    assert remark.endswith("the campaign declares no sessions")
    settings = run.manifest.settings.with_test("p500_f0.5", session="autumn")
    named = replace(run, manifest=run.manifest.changed(settings=settings))
    assert "the run has 'autumn'" in named.predict(motion, draws=100, session="spring").remarks[0]


def test_a_run_that_cannot_be_used_is_said(run, trace):
    verdicts = {"campaign": "not usable", "sentence": "It is wrong."}
    bad = replace(run, manifest=run.manifest.changed(verdicts=verdicts))
    (remark,) = bad.predict(replace(trace, force=None), draws=100).remarks
    assert remark == "the run is not usable as it is: It is wrong."
    assert bad.caution == "the run of this device is not usable: It is wrong."
    assert run.caution == ""


# --- one prediction by several models


def copied(folder, change=lambda manifest: None):
    """A copy of the stored run under another noise, with a changed manifest."""
    shutil.copytree(DATA, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["settings"]["campaign"]["noise"] = "student_t"
    change(manifest)
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return mb.open_run(folder)


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    return copied(tmp_path_factory.mktemp("other") / "out")


@pytest.fixture(scope="module")
def motion(run):
    return replace(run.held_out["p800_f0.5"], force=None)


def test_each_model_gives_half_of_the_draws_and_the_band_is_that_of_the_mixture(run, other, motion):
    average = mb.ModelAverage([run, other])
    assert average.models == ("three_stage (ou)", "three_stage (student_t)")
    band = average.predict(motion, "observation", draws=101, seed=3)
    draws = [
        source.predict(motion, "observation", draws=n, seed=3).draws
        for source, n in ((run, 51), (other, 50))
    ]
    np.testing.assert_array_equal(band.draws, np.concatenate(draws))
    expected = np.quantile(np.concatenate(draws), [0.025, 0.975], axis=0)
    np.testing.assert_allclose([band.lower, band.upper], expected)
    assert "in equal parts" in band.source
    far = replace(motion, actuation=1.4)  # a remark of both is said once
    (remark,) = [r for r in average.predict(far, draws=100).remarks if "the actuation" in r]
    assert remark in run.predict(far, draws=100).remarks


def test_runs_that_do_not_belong_together_are_refused(run, other, motion, tmp_path):
    def without_one(manifest):  # whose calibration has failed
        test, *_ = manifest["settings"]["test"]
        manifest["tests"][test["id"]]["status"] = "failed"

    for runs, words in (
        ([run], "needs two or more runs, .*, got Run"),
        ([run, run], "two of the runs have the model three_stage"),
        (
            [run, copied(tmp_path / "less", without_one)],
            "p500_f0.5' is calibrated in only one of .*less",
        ),
        (5, "got int"),
    ):
        with pytest.raises(mb.MfdError, match=words):
            mb.ModelAverage(runs)
    with pytest.raises(mb.MfdError, match="not the kind this_test"):
        mb.ModelAverage([run, other]).predict(motion, "this_test")
