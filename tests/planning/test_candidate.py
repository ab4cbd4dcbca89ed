"""Candidates, limits and goals: in words, as objects, and a campaign's own."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mfd_bayes.applications.next_test.advice import AdviceInWords
from mfd_bayes.campaign.candidate import (
    SETUP,
    Candidate,
    Goal,
    Limits,
    Parts,
    Shown,
    check_session,
    grid_of,
    harmonic_of,
    parse_goal,
    parse_limits,
    parse_tests,
    repeats,
)
from mfd_bayes.errors import CampaignError
from mfd_bayes.records.trace import Harmonic
from mfd_bayes.runs.unit_system import US

TYPICAL = Candidate(1.0, 0.5, 1.0, 3.0)


def test_a_test_in_words_is_read():
    (parsed,) = parse_tests("1350 psi, 0.5 Hz, 25.4 mm, 5 cycles, triangle, 2 h", "ksi")
    candidate = parsed.completed(TYPICAL)
    assert vars(candidate) == pytest.approx(vars(Candidate(1.35, 0.5, 1.0, 5.0, "triangle", 2.0)))
    assert candidate.cost == 2.0


def test_bars_and_semicolons_give_a_grid():
    grid = parse_tests("500|1000 psi, 0.1|0.5|1 Hz, sine|triangle; 2 ksi", "ksi")
    assert len(grid) == 2 * 3 * 2 + 1
    assert {p.actuation for p in grid} == {0.5, 1.0, 2.0}
    assert parse_tests(["500 psi", "1000 psi"], "ksi") == parse_tests("500 psi;1000 psi", "ksi")


def test_what_is_not_given_is_that_of_a_typical_test_but_for_its_cost():
    candidate = Parts(actuation=0.5).completed(replace(TYPICAL, price=9.0))
    assert candidate == Candidate(0.5, 0.5, 1.0, 3.0)
    assert candidate.cost == pytest.approx(SETUP + 6.0 / 3600.0)


def test_limits_are_read_in_any_order_and_kept():
    bounds = parse_limits("50 kN, 254 mm/s, 6 in")
    assert vars(bounds) == pytest.approx(
        {"velocity": 10.0, "stroke": 6.0, "force": 11.24}, rel=1e-3
    )
    assert parse_limits("6 in") == Limits(stroke=6.0)
    limits = Limits(velocity=3.0, stroke=1.9)
    assert limits.forbids(Candidate(1.0, 0.5, 0.96)) == "velocity"  # a sine's speed is 3.016 in/s
    assert not limits.forbids(Candidate(1.0, 0.5, 0.95))
    assert not limits.forbids(Candidate(1.0, 1.5, 0.5, waveform="triangle"))  # 3 in/s
    assert Limits(stroke=1.9).forbids(Candidate(1.0, 0.1, 0.96)) == "stroke"
    assert not Limits().forbids(Candidate(1.0, 100.0, 100.0))


# --- goals


def test_goals_are_read():
    assert parse_goal("band", "ksi") == Goal()
    assert parse_goal("band of new_test", "ksi").kind == "new_test"
    energy = parse_goal("Energy at 1000 psi, 0.5 Hz, 1 in; 1500 psi, 0.5 Hz, 1 in", "ksi")
    assert energy.quantity == "energy"
    assert [point.actuation for point in energy.at] == [1.0, 1.5]
    assert parse_goal("peak force at 2 ksi", "ksi").quantity == "peak"
    assert parse_goal("exponent of Fc_fwd", "ksi").of == "Fc_fwd"


def test_a_goal_is_at_its_tests_or_at_a_motion_at_every_level():
    typical = [Candidate(0.0, 0.5, 2.0), TYPICAL]
    places = parse_goal("energy at 0.2 in", "ksi").places(typical)
    assert places == [Candidate(0.0, 0.5, 0.2), Candidate(1.0, 0.5, 0.2)]
    candidate = Candidate(0.8, 0.5, 1.0)
    for target in (candidate, (candidate,), [candidate]):
        assert Goal("energy", at=target).places(typical) == [candidate]
    assert hash(Goal(at=[candidate])) == hash(Goal(at=(candidate,)))


def test_the_goals_words_name_its_motions():
    tests = (Candidate(0.5, 0.5, 1.0), Candidate(1.5, 0.5, 1.0))
    condition = "0.5 Hz, 0.2 in"
    for text, words in (
        ("band", "the 95 % band over the campaign's range"),
        ("energy at 1 ksi, 0.5 Hz, 1 in", "energy per cycle at 1000 psi, 0.5 Hz, 1 in"),
        ("band at 0.2 in", f"band at 5 places from 500 psi, {condition} to 1500 psi, {condition}"),
    ):
        advice = SimpleNamespace(goal=parse_goal(text, "ksi"), tests=tests)
        assert AdviceInWords(advice, US, "ksi").goal.endswith(words)


# --- a campaign's own grid

METRIC = Shown(6.894757, 25.4)


def test_a_record_is_known_by_its_harmonic_test_rounded_in_the_campaigns_units():
    for amplitude, expected in ((25.0, False), (25.4, True)):
        trace = Harmonic(1.0004 * amplitude / 25.4, 0.5, 4).trace(7.0 / METRIC.actuation)
        harmonic = harmonic_of(trace, METRIC)
        assert (harmonic.frequency, harmonic.cycles) == (0.5, 4.0)
        assert harmonic.actuation * METRIC.actuation == pytest.approx(7.0)
        assert harmonic.amplitude * 25.4 == pytest.approx(amplitude, rel=1e-9)
        rough = harmonic_of(trace).amplitude * 25.4
        assert (rough == pytest.approx(amplitude, rel=1e-9)) is expected  # the control


def test_the_grid_repeats_every_test_and_goes_a_little_beyond_in_round_numbers():
    tests = [Candidate(p, f, 1.0) for p in (0.5, 1.0, 1.5) for f in (0.05, 0.5)]
    grid = grid_of(tests)
    assert sum(repeats(c, tests) for c in grid) == len(tests)
    levels = {c.actuation for c in grid}
    assert {0.5, 0.75, 1.0, 1.5} < levels
    assert 1.5 < max(levels) < 2.0
    assert len(set(grid)) == len(grid) <= 200
    metric = grid_of([Candidate(p / METRIC.actuation, 0.5, 25 / 25.4) for p in (3.5, 7.0)], METRIC)
    levels = sorted({c.actuation * METRIC.actuation for c in metric})
    assert levels == pytest.approx([3.5, 5.2, 7.0, 8.8])
    assert {round(c.amplitude * 25.4, 6) for c in metric} == {25.0, 31.0}


# --- refusals

BARS = "|".join(["1"] * 101)


def read_limits(text, _, of):
    return parse_limits(text, of=of)


@pytest.mark.parametrize(
    ("read", "text", "name"),
    [
        (parse_tests, "", "''"),
        (parse_tests, "500 psi, 600 psi", "actuation"),
        (parse_tests, "500 lbf", "500 lbf"),
        (parse_tests, "0 Hz", "0 Hz"),
        (parse_tests, "1000 cycles", "1000 cycles"),
        (parse_tests, f"{BARS} psi, 1|2|3|4|5|6|7|8|9|10 Hz", "1000"),
        (parse_tests, "9" * 30000, "longer"),
        (parse_goal, "", "''"),
        (parse_goal, "band of observation", "observation"),
        (parse_goal, "exponent", "exponent"),
        (parse_goal, "gap of Fc_fwd", "Fc_fwd"),
        (parse_goal, "energy @ 1000 psi", "@"),
        (read_limits, "", "''"),
        (read_limits, "6 in, 7 in", "stroke"),
        (read_limits, "-1 kip", "force"),
    ],
)
def test_bad_words_end_in_one_sentence_that_names_them(read, text, name):
    with pytest.raises(CampaignError) as caught:
        read(text, "ksi", of="--option")
    sentence = str(caught.value)
    assert sentence.startswith("--option: ")
    assert name in sentence
    assert "\n" not in sentence


@pytest.mark.parametrize(
    ("made", "values", "name"),
    [
        (TYPICAL, {"waveform": "sawtooth"}, "sawtooth"),
        (TYPICAL, {"cycles": 0}, "cycles"),
        (TYPICAL, {"price": -1.0}, "price"),
        (Limits(), {"velocity": np.nan}, "velocity"),
        (Limits(), {"force": 0.0}, "force"),
        (Goal(), {"quantity": None}, "quantity"),
        (Goal(), {"probability": "0.9"}, "probability"),
        (Goal(), {"at": "x"}, "at of a goal"),
    ],
)
def test_what_is_no_test_limit_or_goal_is_refused(made, values, name):
    with pytest.raises(CampaignError, match=name):
        replace(made, **values)


def test_a_goal_is_about_a_session_of_the_tests_or_a_new_one():
    check_session("2023", ["2022", "2023"])
    with pytest.raises(CampaignError, match="'2023'"):
        check_session("2032", ["2022", "2023"])
