"""What tests cover, and where a motion leaves it."""

import numpy as np
import pytest

from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.settings import TestSettings
from mfd_bayes.runs.systems import SI, US
from mfd_bayes.runs.tested import departures, far_sentences, range_of, reach_of


def sine(amplitude=1.0, frequency=0.5, actuation=1.0, noise=0.0, cycles=4):
    time = np.linspace(0.0, cycles / frequency, 400 * cycles + 1)
    motion = amplitude * np.sin(2.0 * np.pi * frequency * time)
    motion += noise * np.random.default_rng(1).normal(size=time.size)
    return Trace.from_arrays(time, motion, actuation)


RANGE = range_of([sine(0.5, 0.25, 0.5), sine(1.0, 0.5, 1.5)], "ksi")


def left(*motion):
    return {d.asked.name: d for d in departures(RANGE, sine(*motion), "ksi")}


def test_a_motion_has_a_stroke_a_speed_and_a_frequency():
    found = {span.name: span.highest for span in reach_of(sine(1.0, 0.5, 0.7), "ksi")}
    assert found["stroke"] == pytest.approx(2.0)
    assert found["speed"] == pytest.approx(np.pi, rel=0.01)
    assert found["frequency"] == pytest.approx(0.5, rel=0.01)
    assert found["actuation"] == 0.7


def test_noise_of_a_sensor_is_no_speed():
    noisy = {span.name: span.highest for span in reach_of(sine(noise=1e-4), "ksi")}
    assert noisy["speed"] == pytest.approx(np.pi, rel=0.03)


def test_the_range_holds_all_tests():
    spans = {span.name: span for span in RANGE}
    assert list(spans) == ["stroke", "speed", "frequency", "actuation"]
    assert (spans["actuation"].lowest, spans["actuation"].highest) == (0.5, 1.5)
    assert spans["stroke"].words(US) == "1 to 2 in"
    assert spans["stroke"].words(SI) == "25.4 to 50.8 mm"
    assert spans["actuation"].words(US) == "500 to 1500 psi"


def test_what_was_tested_is_no_departure():
    for motion in ((0.5, 0.25, 0.5), (0.75, 0.3, 1.0), (1.04, 0.49, 1.505)):
        assert left(*motion) == {}


@pytest.mark.parametrize(
    ("motion", "name", "far"),
    [
        ((1.5, 0.3, 1.0), "stroke", False),
        ((2.5, 0.25, 1.0), "stroke", True),
        ((0.1, 0.5, 1.0), "stroke", False),
        ((1.0, 0.8, 1.0), "speed", False),
        ((2.0, 1.0, 1.0), "speed", True),  # four times the speed: not a word before
        ((0.5, 1.5, 1.0), "frequency", True),
        ((0.5, 0.1, 1.0), "frequency", False),
        ((1.0, 0.5, 3.0), "actuation", False),
        ((1.0, 0.5, 3.1), "actuation", True),
        ((1.0, 0.5, 0.4), "actuation", False),
        ((1.0, 0.5, 0.2), "actuation", True),
    ],
)
def test_what_lies_outside_is_said(motion, name, far):
    found = left(*motion)
    assert found[name].far is far
    assert f"lies {'far outside' if far else 'outside'} the tested range" in found[name].sentence(
        US
    )


def test_a_slow_motion_is_no_departure_of_speed():
    assert "speed" not in left(0.5, 0.05, 1.0)


def test_a_sentence_says_how_many_times_in_the_units_of_the_tests():
    faster = left(2.0, 1.0, 1.0)["speed"]
    assert "12.6 in/s" in faster.sentence(US)
    assert "4 times the largest" in faster.sentence(US)
    assert "319 mm/s" in faster.sentence(SI)


def test_only_what_is_far_is_a_reason_to_refuse():
    near, far = (departures(RANGE, sine(*m), "ksi") for m in ((1.5, 0.3, 1.0), (2.0, 1.0, 1.0)))
    assert near
    assert far_sentences(near, US) == ""
    assert far_sentences(far, US).count("far outside") == 1 + far_sentences(far, US).count(";")


def test_a_motion_without_a_loop_has_no_frequency():
    time = np.linspace(0.0, 1.0, 50)
    ramp = Trace.from_arrays(time, time, 1.0)
    assert [span.name for span in reach_of(ramp, "ksi")] == ["stroke", "speed", "actuation"]


def test_a_history_reaches_from_its_least_to_its_largest_actuation():
    time = np.linspace(0.0, 4.0, 401)
    history = Trace.from_arrays(time, np.sin(np.pi * time), np.linspace(0.7, 9.0, 401))
    (departure,) = departures(RANGE, history, "ksi")
    assert departure.asked.words(US) == "700 to 9000 psi"
    assert departure.far


def test_a_departure_names_the_end_that_leaves_the_range():
    history = Trace.from_arrays(
        (time := np.linspace(0.0, 8.0, 401)), np.sin(np.pi * time), np.linspace(0.1, 1.505, 401)
    )
    (found,) = [d for d in departures(RANGE, history, "ksi") if d.asked.name == "actuation"]
    assert found.times == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("columns", "unit"),
    [
        ({"actuation": ["p", "bar"]}, "bar"),
        ({"actuation": ["p_bar", None]}, "bar"),
        ({"actuation": {"name": "p", "unit": "bar"}}, "bar"),
    ],
)
def test_the_unit_of_a_measured_actuation_is_known_to_a_run(columns, unit):
    given = TestSettings(columns=columns).given_actuation
    assert given["unit"] == unit
    assert TestSettings(actuation="7 bar", columns=columns).given_actuation == "7 bar"
