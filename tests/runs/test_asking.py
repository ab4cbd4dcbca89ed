"""What is asked of a run in Python: a value of another type is refused in one sentence."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mfd_bayes as mb
from mfd_bayes.errors import NotThereError
from mfd_bayes.planning.candidate import Candidate, Limits
from mfd_bayes.population.given import given_part
from mfd_bayes.runs.opening import open_run
from mfd_bayes.runs.response import grounds_of

DATA = Path(__file__).parents[1] / "data" / "run_format_0"


@pytest.fixture(scope="module")
def run():
    return open_run(DATA)


@pytest.fixture(scope="module")
def trace(run):
    return run.tests["p500_f0.5"].trace


@pytest.mark.parametrize("folder", [None, 5, b"out", ["out"], "a\0b"])
def test_a_run_is_opened_by_a_path(folder):
    with pytest.raises(mb.MfdError, match="folder must be a path"):
        mb.open_run(folder)


@pytest.mark.parametrize("wrong", [None, "p500_f0.5", np.zeros(3)])
def test_motions_are_traces(run, wrong):
    for asked in (run.predict, run.departures):
        with pytest.raises(mb.MfdError, match="trace must be a Trace"):
            asked(wrong)


def test_tests_and_sessions_that_are_not_there_are_named(run, trace):
    known = "there are p500_f0.5, p1000_f0.5"
    for asked in (
        lambda: run.tests["zz"],
        lambda: run.session("zz"),
        lambda: run.departures(trace, "zz"),
        lambda: run.order.values("zz"),
    ):
        with pytest.raises(NotThereError, match=f"the run has no .*test 'zz': {known}"):
            asked()
    with pytest.raises(NotThereError, match=r"no held-out test 'zz': there are p800_f0\.5"):
        run.held_out["zz"]
    with pytest.raises(TypeError):
        run.tests["zz"] = run.tests["p500_f0.5"]
    assert list(copy.deepcopy(run).tests) == list(run.tests)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"whole": "no"}, "whole must be True or False, got 'no'"),
        ({"explain": "2"}, "explain must be True or False, got '2'"),
        ({"explain": 5}, "explain must be True or False, got 5"),
        ({"explain": None}, "explain must be True or False, got None"),
        ({"session": ["a"]}, "session must be text"),
        ({"kind": "this_test", "test": ["a"]}, r"test must be text, got \['a'\]"),
        ({"probability": "0.9"}, "probability must be a number between 0 and 1, got '0.9'"),
        (
            {"kind": "this_test", "test": "p500_f0.5", "session": "other"},
            "session 'other' is for a new test: the kind this_test takes that of its test",
        ),
    ],
)
def test_options_of_a_prediction_are_checked(run, trace, options, said):
    with pytest.raises(mb.MfdError, match=said):
        run.predict(trace, draws=20, **options)


@pytest.mark.parametrize(
    "given", ["02", b"\x00\x02", {0.0, 2.0}, {0: 1, 2: 3}, ("0", "2"), (True, 2), 5, None]
)
def test_a_given_part_is_two_times(run, trace, given):
    with pytest.raises(mb.MfdError, match="given must be two times in s"):
        given_part(trace, given, 0.1)
    part, counted = given_part(trace, np.array([0, 2.0]), 0.1)
    assert part.time[counted][-1] == pytest.approx(2.0, abs=0.2)  # the control


def test_true_of_any_kind_explains(run, trace):
    own, numpys = (run.predict(trace, draws=20, explain=yes) for yes in (True, np.True_))
    assert own.explained == numpys.explained
    assert own.explained != {}
    assert run.predict(trace, draws=20, explain=np.False_).explained == {}


def test_refresh_is_a_flag(run):
    with pytest.raises(mb.MfdError, match="refresh must be True or False, got 'no'"):
        run.follow(0.5, refresh="no")


@pytest.mark.parametrize("goal", [5, [], ["band"], True, b"band", {"quantity": "band"}])
def test_a_goal_is_text_or_a_goal(run, goal):
    with pytest.raises(mb.MfdError, match="goal must be text such as 'band', or a Goal"):
        run.next_test(goal)


@pytest.mark.parametrize("candidates", [5, [5], [None], True, b"500 psi", {"a": 1}, Limits(1.0)])
def test_candidates_are_tests(run, candidates):
    with pytest.raises(mb.MfdError, match="candidates must be tests in words or Candidates"):
        run.next_test("band", candidates)


@pytest.mark.parametrize("limits", [5, [], {}, ["10 in/s"], (10, 6, 20), True])
def test_limits_are_text_or_limits(run, limits):
    with pytest.raises(mb.MfdError, match="limits must be text such as '10 in/s"):
        run.next_test("band", limits=limits)


@pytest.mark.parametrize("name", ["goal", "candidates", "limits"])
def test_what_is_not_understood_is_named_as_in_python(run, name):
    with pytest.raises(mb.MfdError, match=f"^{name}: "):
        run.next_test(**{name: "zz zz"})


def test_one_candidate_needs_no_list(run):
    one = Candidate(0.8, 0.5, 1.0)
    alone, listed = (run.next_test("slip", c, draws=200) for c in (one, [one]))
    assert alone["reduction"] == listed["reduction"]
    assert [row.candidate for row in alone] == [one]


@pytest.mark.parametrize("grounds", [None, 5, b"g.txt", {"a": 1}, [None], [5], np.ones(3)])
def test_ground_motions_are_some_or_paths(grounds):
    with pytest.raises(mb.MfdError, match=r"grounds must be a Ground|a ground motion must be a"):
        grounds_of(grounds)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"tolerance": "0.01"}, "tolerance must be a number between 0 and 1"),
        ({"tolerance": None}, "tolerance must be a number between 0 and 1"),
        ({"tolerance": np.array([0.02])}, "tolerance must be a number between 0 and 1"),
        ({"draws": 9}, "draws must be a whole number, 10 or more, got 9"),
        ({"observe": 5}, "observe must be a function"),
    ],
)
def test_options_of_a_response_are_checked(run, options, said):
    with pytest.raises(mb.MfdError, match=said):
        run.respond("none.toml", "none.AT2", **options)


def test_an_option_that_a_response_has_not_is_named(run):
    with pytest.raises(TypeError, match=r"respond\(\) got an unexpected keyword .*'probability'"):
        run.respond("none.toml", "none.AT2", probability=0.9)


@pytest.mark.parametrize("runs", [None, 5, "ab", {"a": 1}, ["out", "other"], [None, None]])
def test_an_average_is_of_runs(runs):
    with pytest.raises(mb.MfdError, match="runs must be two or more runs, as open_run opens them"):
        mb.ModelAverage(runs)


def test_an_average_is_not_of_one_run(run):
    with pytest.raises(mb.MfdError, match=r"runs must be two or more runs.*got Run"):
        mb.ModelAverage(run)
    with pytest.raises(mb.MfdError, match="needs at least two runs, got 1"):
        mb.ModelAverage(one for one in [run])


@pytest.mark.parametrize(
    ("units", "said"),
    [("us", "made at 500 psi, .* nothing of 1000 psi"), ("si", "3.447 MPa, .* of 6.895 MPa")],
)
def test_another_actuation_of_a_test_is_told_in_the_units_asked_for(run, trace, units, said):
    other = replace(trace, actuation=1.0)
    with pytest.raises(mb.MfdError, match=said):
        replace(run, units=units).predict(other, kind="this_test", test="p500_f0.5")
