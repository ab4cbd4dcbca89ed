"""A run in Python: what it holds by name, and one sentence for what cannot be asked of it."""

import copy
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mfd_bayes as mb
from mfd_bayes.errors import NotThereError
from mfd_bayes.planning.candidate import Limits
from mfd_bayes.runs.run import open_run

DATA = Path(__file__).parents[1] / "data" / "run"


@pytest.fixture(scope="module")
def run():
    return open_run(DATA)


@pytest.fixture(scope="module")
def trace(run):
    return run.tests["p500_f0.5"].trace


def test_a_run_opens_and_predicts(run):
    assert sorted(run.tests) == ["p1000_f0.5", "p500_f0.5"]
    slip = [np.median(test.stored.values()["Fc_fwd"]) for _, test in sorted(run.tests.items())]
    assert slip == pytest.approx([1.3, 0.65], rel=0.3)  # in proportion, as it was made
    held_out = run.held_out["p800_f0.5"]
    band = run.predict(held_out, "observation", draws=200)
    inside = (band.lower <= held_out.force) & (held_out.force <= band.upper)
    assert np.mean(inside) > 0.8


def test_a_run_is_opened_by_a_path():
    for folder in [None, b"out", "a\0b"]:
        with pytest.raises(mb.MfdError, match="folder must be a path"):
            mb.open_run(folder)


def test_tests_are_a_mapping_that_cannot_be_changed(run):
    for same in (copy.deepcopy(run), pickle.loads(pickle.dumps(run))):
        assert list(same.tests) == [*run.tests]
        assert same.tests["p500_f0.5"].id == "p500_f0.5"
    assert run.tests.get("zz") is None
    assert "zz" not in run.tests
    assert [test.id for test in run.tests.values()] == [*run.tests]
    with pytest.raises(TypeError):
        run.tests["zz"] = run.tests["p500_f0.5"]
    with pytest.raises(KeyError):  # as with a dict
        run.tests["zz"]


def test_tests_and_sessions_that_are_not_there_are_named(run, trace):
    names = "there are p500_f0.5, p1000_f0.5"
    for ask in (
        lambda: run.tests["zz"],
        lambda: run.session("zz"),
        lambda: run.departures(trace, "zz"),
        lambda: run.sequence.values("zz"),
    ):
        with pytest.raises(NotThereError, match=f"the run has no .*test 'zz': {names}"):
            ask()
    with pytest.raises(NotThereError, match=r"no held-out test 'zz': there are p800_f0\.5"):
        run.held_out["zz"]
    for wrong in (None, 5, ["a"]):
        with pytest.raises(NotThereError):
            run.tests[wrong]


def test_options_of_a_prediction_are_checked(run, trace):
    for options, name in [
        ({"whole": "no"}, "whole"),
        ({"explain": None}, "explain"),
        ({"session": ["a"]}, "session"),
        ({"kind": "this_test", "test": ["a"]}, r"a calibrated test: .* got \['a'\]"),
        ({"kind": "this_test"}, "needs the id of a calibrated test: one of p500_f0.5, p1000"),
        ({"kind": "this_test", "test": "p800_f0.5"}, "held out"),
        ({"kind": "this_test", "test": "zz"}, "a calibrated test: .* got 'zz'"),
        ({"test": "p500_f0.5"}, "for the kind this_test, not for new_test"),
        ({"probability": "0.9"}, "probability must be a number between 0 and 1, got '0.9'"),
        ({"kind": "this_test", "test": "p500_f0.5", "session": "other"}, "session 'other' is for"),
        (
            {"given": (0.0, 1.0), "test": "p500_f0.5"},
            "given cannot be combined with a calibrated test",
        ),
    ]:
        with pytest.raises(mb.MfdError, match=name):
            run.predict(trace, draws=20, **options)


def test_another_actuation_of_a_test_is_refused_in_the_units_asked_for(run, trace):
    for units, words in [
        ("us", "made at 500 psi, .* nothing of 1000 psi"),
        ("si", "3.447 MPa, .* of 6.895 MPa"),
    ]:
        with pytest.raises(mb.MfdError, match=words):
            replace(run, units=units).predict(
                replace(trace, actuation=1.0), kind="this_test", test="p500_f0.5"
            )


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


def test_what_is_asked_about_the_next_test_is_checked(run):
    for options, words in [
        *(({"goal": goal}, "goal must be text") for goal in (5, b"band")),
        *(({"candidates": c}, "candidates must be") for c in ([None], Limits(1.0))),
        *(({"limits": limits}, "limits must be text") for limits in ((10, 6, 20),)),
        *(({name: "zz zz"}, f"^{name}: ") for name in ("goal", "candidates", "limits")),
    ]:
        with pytest.raises(mb.MfdError, match=words):
            run.next_test(**options)


def test_options_of_a_response_are_checked(run):
    for options, words in [
        ({"tolerance": "0.01"}, "tolerance must be a number between 0 and 1"),
        ({"draws": 9}, "draws must be a whole number, 10 or more, got 9"),
        ({"observe": 5}, "observe must be a function"),
    ]:
        with pytest.raises(mb.MfdError, match=words):
            run.respond("none.toml", "none.AT2", **options)
        with pytest.raises(
            TypeError, match=r"respond\(\) got an unexpected keyword .*'probability'"
        ):
            run.respond("none.toml", "none.AT2", probability=0.9)
