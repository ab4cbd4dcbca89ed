"""Goals in words."""

from types import SimpleNamespace

import pytest

from mfd_bayes.errors import CampaignError
from mfd_bayes.evaluation.next_test import goal_words
from mfd_bayes.planning.candidate import Candidate
from mfd_bayes.planning.goal import Goal, check_session, parse_goal
from mfd_bayes.runs.unit_system import US


def test_goals_are_read():
    assert parse_goal("band", "ksi") == Goal()
    assert parse_goal("band of new_test", "ksi").kind == "new_test"
    energy = parse_goal("Energy at 1000 psi, 0.5 Hz, 1 in; 1500 psi, 0.5 Hz, 1 in", "ksi")
    assert energy.quantity == "energy"
    assert [part.actuation for part in energy.at] == [1.0, 1.5]
    assert parse_goal("peak force at 2 ksi", "ksi").quantity == "peak"
    assert parse_goal("exponent of Fc_fwd", "ksi").of == "Fc_fwd"


def test_a_goal_at_a_motion_alone_is_about_that_motion_at_every_level():
    typical = [Candidate(0.0, 0.5, 1.0), Candidate(1.0, 0.5, 1.0)]
    places = parse_goal("energy at 0.2 in", "ksi").places(typical)
    assert places == [Candidate(0.0, 0.5, 0.2), Candidate(1.0, 0.5, 0.2)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("band", "the 95 % band over the campaign's range"),
        (
            "energy at 1 ksi, 0.5 Hz, 1 in",
            "the 95 % interval of the energy per cycle at 1000 psi, 0.5 Hz, 1 in",
        ),
        (
            "band at 0.2 in",
            "the 95 % band at 5 places from 500 psi, 0.5 Hz, 0.2 in to 1500 psi, 0.5 Hz, 0.2 in",
        ),
    ],
)
def test_the_goals_words_name_its_motions(text, words):
    tests = (Candidate(0.5, 0.5, 1.0), Candidate(1.5, 0.5, 1.0))
    advice = SimpleNamespace(goal=parse_goal(text, "ksi"), tests=tests)
    assert goal_words(advice, US, "ksi") == words


def test_a_goal_is_about_a_session_of_the_tests_or_a_new_one():
    sessions = ["2022", "2023", "2023"]
    check_session("", sessions)
    check_session("2023", sessions)
    with pytest.raises(CampaignError) as caught:
        check_session("2032", sessions, of="goal.session in c.toml")
    assert "did you mean '2023'" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "a goal reads"),
        ("energie", "did you mean 'energy'"),
        ("band of observation", "band is of device or new_test"),
        ("exponent", "exponent needs a quantity that follows the actuation"),
        ("gap of Fc_fwd", "'of Fc_fwd' is for slope, exponent and band alone"),
        ("band at 100 lbf", "is a pressure"),
        ("energy @ 1000 psi", "a goal reads"),
    ],
)
def test_a_bad_goal_ends_in_one_sentence(text, said):
    with pytest.raises(CampaignError) as caught:
        parse_goal(text, "ksi")
    assert said in str(caught.value)
    assert str(caught.value).startswith("--goal: ")


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"quantity": None}, "quantity of a goal must be text, got None"),
        ({"probability": "0.9"}, "probability of a goal must be a number between 0 and 1"),
        ({"probability": 2}, "between 0 and 1, got 2"),
        ({"at": "x"}, "at of a goal must be tests, each a Candidate, got 'x'"),
    ],
)
def test_a_goal_of_other_types_is_refused(wrong, said):
    with pytest.raises(CampaignError, match=said):
        Goal(**wrong)


def test_a_goal_is_at_candidates():
    there = Candidate(0.8, 0.5, 1.0)
    typical = [Candidate(0.5, 0.5, 2.0), Candidate(1.0, 0.5, 2.0)]
    for at in (there, (there,), [there]):
        assert Goal("energy", at=at).places(typical) == [there]
    assert hash(Goal(at=[there])) == hash(Goal(at=(there,)))
