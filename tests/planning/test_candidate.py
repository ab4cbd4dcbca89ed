"""Candidates and limits in words, and mistakes in them in one sentence."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.errors import CampaignError
from mfd_bayes.planning.candidate import (
    MOST,
    SETUP,
    Candidate,
    Limits,
    Parts,
    Shown,
    grid_of,
    harmonic_of,
    parse_limits,
    parse_tests,
    repeats,
    typical_of,
)
from mfd_bayes.records.sine import Harmonic
from mfd_bayes.records.trace import Trace

TYPICAL = Candidate(1.0, 0.5, 1.0, 3.0)


def test_a_test_in_words_is_read():
    (found,) = parse_tests("1350 psi, 0.5 Hz, 25.4 mm, 5 cycles, triangle, 2 h", "ksi")
    expected = Candidate(1.35, 0.5, 1.0, 5.0, "triangle", 2.0)
    whole = found.completed(TYPICAL)
    assert vars(whole) == pytest.approx(vars(expected))
    assert whole.cost == 2.0


def test_bars_and_semicolons_give_a_grid():
    found = parse_tests("500|1000 psi, 0.1|0.5|1 Hz, sine|triangle; 2 ksi", "ksi")
    assert len(found) == 2 * 3 * 2 + 1
    assert {p.actuation for p in found} == {0.5, 1.0, 2.0}
    assert found[-1] == Parts(actuation=2.0)
    assert parse_tests(["500 psi", "1000 psi"], "ksi") == parse_tests("500 psi;1000 psi", "ksi")


def test_what_is_not_given_is_that_of_a_typical_test_but_for_its_cost():
    typical = Candidate(1.0, 0.5, 1.0, 3.0, price=9.0)
    found = Parts(actuation=0.5).completed(typical)
    assert found == Candidate(0.5, 0.5, 1.0, 3.0)
    assert found.cost == pytest.approx(SETUP + 6.0 / 3600.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "got ''"),
        ("fast", "no number with a unit"),
        ("500 psi, 600 psi", "two values of the actuation"),
        ("500 lbf", "is a pressure, '500 lbf' is not"),
        ("0 Hz", "above zero"),
        ("1000 cycles", "1 to 100 cycles"),
        ("1 kg", "measures"),
        ("|".join(["1"] * 101) + " psi, 1|2|3|4|5|6|7|8|9|10 Hz", f"more than {MOST}"),
        ("9" * 30000, "longer"),
    ],
)
def test_a_bad_test_ends_in_one_sentence(text, said):
    with pytest.raises(CampaignError) as caught:
        parse_tests(text, "ksi")
    sentence = str(caught.value)
    assert sentence.startswith("--candidates: ")
    assert said in sentence
    assert "\n" not in sentence


def test_limits_are_read_in_any_order_and_unit():
    found = parse_limits("50 kN, 254 mm/s, 6 in")
    assert vars(found) == pytest.approx({"velocity": 10.0, "stroke": 6.0, "force": 11.24}, rel=1e-3)
    assert parse_limits("6 in") == Limits(stroke=6.0)


def test_limits_are_kept():
    limits = Limits(velocity=3.0, stroke=1.9)
    assert limits.forbids(Candidate(1.0, 0.5, 0.96)) == "velocity"  # a sine's speed is 3.016 in/s
    assert not limits.forbids(Candidate(1.0, 0.5, 0.95))
    assert not limits.forbids(Candidate(1.0, 1.5, 0.5, waveform="triangle"))  # 3 in/s
    assert Limits(stroke=1.9).forbids(Candidate(1.0, 0.1, 0.96)) == "stroke"
    assert not Limits().forbids(Candidate(1.0, 100.0, 100.0))


# --- the campaign's own grid


def test_a_record_is_known_by_its_harmonic_test():
    trace = Harmonic(1.0, 0.5, 4).trace(0.8)
    found = harmonic_of(trace)
    assert (found.actuation, found.frequency, found.amplitude) == (0.8, 0.5, 1.0)


METRIC = Shown(6.894757, 25.4)


@pytest.mark.parametrize("amplitude", [25.0, 25.4])
def test_a_metric_record_is_rounded_in_mm_not_in_inches(amplitude):
    trace = Harmonic(1.0004 * amplitude / 25.4, 0.5, 4).trace(7.0 / METRIC.actuation)
    found = harmonic_of(trace, METRIC)
    assert found.amplitude * 25.4 == pytest.approx(amplitude, rel=1e-9)
    rough = harmonic_of(trace).amplitude * 25.4
    assert (rough == pytest.approx(amplitude, rel=1e-9)) == (amplitude == 25.4)  # the control


def test_new_levels_of_a_metric_campaign_are_round_in_mpa():
    tests = [Candidate(p / METRIC.actuation, 0.5, 25 / 25.4) for p in (3.5, 7.0)]
    grid = grid_of(tests, METRIC)
    levels = sorted({c.actuation * METRIC.actuation for c in grid})
    assert levels == pytest.approx([3.5, 5.2, 7.0, 8.8])
    assert {round(c.amplitude * 25.4, 6) for c in grid} == {25.0, 31.0}


def test_an_irregular_motion_has_the_frequency_of_its_peak_speed():
    time = np.arange(2001) / 100
    rise = np.exp(-(((time - 10) / 3) ** 2)) * np.sin(2 * np.pi * 0.7 * time)
    found = harmonic_of(Trace.from_arrays(time, rise, 0.8))
    assert 0.5 < found.frequency < 0.9


def test_the_grid_repeats_every_test_and_goes_a_little_beyond():
    tests = [Candidate(p, f, 1.0) for p in (0.5, 1.0, 1.5) for f in (0.05, 0.5)]
    grid = grid_of(tests)
    assert sum(repeats(c, tests) for c in grid) == len(tests)
    levels = {c.actuation for c in grid}
    assert {0.5, 0.75, 1.0, 1.5} < levels
    assert 1.5 < max(levels) < 2.0
    assert len(set(grid)) == len(grid) <= 200


def test_the_range_has_its_ends_and_the_median_motion():
    found = typical_of([Candidate(0.5, 0.1, 1.0), Candidate(1.5, 0.5, 1.0)])
    assert [c.actuation for c in found] == [0.5, 0.75, 1.0, 1.25, 1.5]
    assert {c.frequency for c in found} == {0.3}
    assert len(typical_of([Candidate(0.5, 0.1, 1.0)])) == 1


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"waveform": "sawtooth"}, "waveform of a test must be sine or triangle"),
        ({"cycles": 0}, "cycles of a test must be a number from 1 to 100, got 0"),
        ({"frequency": 0.0}, "frequency of a test must be a finite number above 0"),
        ({"price": -1.0}, "price of a test must be a finite number of at least 0"),
    ],
)
def test_what_is_no_test_is_refused(wrong, said):
    with pytest.raises(CampaignError, match=said):
        replace(TYPICAL, **wrong)
    for limit in ({"velocity": np.nan}, {"force": 0.0}, {"stroke": "6"}):
        with pytest.raises(CampaignError, match=next(iter(limit))):
            Limits(**limit)
    for text in ("", "6", "6 in, 7 in", "-1 kip", "3 s"):
        with pytest.raises(CampaignError, match="--limits"):
            parse_limits(text)
