"""What tests cover, and where a motion leaves it."""

import numpy as np
import pytest

import mfd_bayes as mb
from mfd_bayes.population.bands import Band, Forecast
from mfd_bayes.population.settings import Setting
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.tested_range import (
    TestUnderWay,
    conditions_of,
    departures,
    far_sentences,
    range_of,
    reach_of,
)
from mfd_bayes.runs.unit_system import SI, US


def sine(amplitude=1.0, frequency=0.5, actuation=1.0, noise=0.0, cycles=4):
    time = np.linspace(0.0, cycles / frequency, 400 * cycles + 1)
    motion = amplitude * np.sin(2.0 * np.pi * frequency * time)
    motion += noise * np.random.default_rng(1).normal(size=time.size)
    return Trace.from_arrays(time, motion, actuation)


TESTS = sine(0.5, 0.25, 0.5), sine(1.0, 0.5, 1.5)
RANGE = range_of(map(conditions_of, TESTS), "ksi")


def left(*motion):
    return {d.reached.name: d for d in departures(RANGE, reach_of(sine(*motion), "ksi"))}


def test_a_motion_has_a_stroke_a_speed_and_a_frequency():
    found = {span.name: span.highest for span in reach_of(sine(1.0, 0.5, 0.7), "ksi")}
    assert found["stroke"] == pytest.approx(2.0)
    assert found["speed"] == pytest.approx(np.pi, rel=0.01)
    assert found["frequency"] == pytest.approx(0.5, rel=0.01)
    assert found["actuation"] == 0.7


def test_the_range_holds_all_tests():
    spans = {span.name: span for span in RANGE}
    assert list(spans) == ["stroke", "speed", "frequency", "actuation"]
    assert (spans["actuation"].lowest, spans["actuation"].highest) == (0.5, 1.5)
    assert spans["stroke"].words(US) == "1 to 2 in"
    assert spans["stroke"].words(SI) == "25.4 to 50.8 mm"
    assert spans["actuation"].words(US) == "500 to 1500 psi"


def test_what_lies_outside_is_said():
    for motion, name, far in [
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
    ]:
        found = left(*motion)
        assert found[name].far is far
        assert f"lies {'far outside' if far else 'outside'} the tested range" in found[
            name
        ].sentence(US)


def test_a_sentence_says_how_many_times_in_the_units_of_the_tests():
    faster = left(2.0, 1.0, 1.0)["speed"]
    assert "12.6 in/s" in faster.sentence(US)
    assert "4 times the largest" in faster.sentence(US)
    assert "319 mm/s" in faster.sentence(SI)


def test_only_what_is_far_is_a_reason_to_refuse():
    near, far = (
        departures(RANGE, reach_of(sine(*m), "ksi")) for m in ((1.5, 0.3, 1.0), (2.0, 1.0, 1.0))
    )
    assert near
    assert far_sentences(near, US) == ""
    assert far_sentences(far, US).count("far outside") == 1 + far_sentences(far, US).count(";")


def test_a_history_reaches_from_its_least_to_its_largest_actuation():
    time = np.linspace(0.0, 4.0, 401)
    history = Trace.from_arrays(time, np.sin(np.pi * time), np.linspace(0.7, 9.0, 401))
    (departure,) = departures(RANGE, reach_of(history, "ksi"))
    assert departure.reached.words(US) == "700 to 9000 psi"
    assert departure.far


def test_a_departure_names_the_end_that_leaves_the_range():
    history = Trace.from_arrays(
        (time := np.linspace(0.0, 8.0, 401)), np.sin(np.pi * time), np.linspace(0.1, 1.505, 401)
    )
    (found,) = [
        d for d in departures(RANGE, reach_of(history, "ksi")) if d.reached.name == "actuation"
    ]
    assert found.times == pytest.approx(0.2)


# --- a test under way

TIME = np.arange(401) / 100
MOTION = np.sin(2 * np.pi * 0.5 * TIME)
FIXED = [Trace.from_arrays(TIME, MOTION, p) for p in (0.5, 1.0)]
TESTED = range_of(map(conditions_of, FIXED), "ksi")
BAND = Band.of(TIME, np.random.default_rng(1).standard_normal((20, TIME.size)), Forecast(), "laws")
PLAN = {"amplitude": 1.0, "velocity": 3.1}


def said(displacement=MOTION, actuation=1.0, planned=1.0, **plan):
    """Remarks of a band whose test has this motion."""
    setting = Setting(planned, "", PLAN | plan)
    completes = TestUnderWay(setting, TESTED, US, "ksi", ("unusable",), "extras")
    time = TIME[: len(displacement)]
    band = completes(BAND, Trace.from_arrays(time, displacement, actuation))
    assert band.extras == "extras"
    assert band.remarks[-1] == "unusable"
    np.testing.assert_array_equal(band.draws, BAND.draws)
    return band.remarks[:-1]


def test_an_actuation_beyond_the_tests_is_said_as_planned_and_as_measured():
    for actuation in [5.0, 0.1]:
        for remarks in (said(actuation=actuation), said(planned=actuation)):
            (remark,) = remarks
            assert remark.startswith("the actuation, ")
            assert "far outside the tested range" in remark


def test_a_motion_beyond_the_tests_is_said_and_the_band_is_wider_only_where_it_was_planned():
    stroke, speed = said(25.0 * MOTION)
    assert stroke.startswith("the stroke, 50")
    assert speed.startswith("the speed, ")
    assert "relies only on the form of the model" in stroke
    stroke, speed = said(25.0 * MOTION, amplitude=25.0, velocity=78.0)
    assert "is wider, by what slip force and gap may do" in stroke
    assert "is wider" in speed


def test_a_band_of_a_test_under_way_is_drawn_and_says_where_it_leaves_the_tests(finished_run):
    run = mb.open_run(finished_run.out)
    trace = next(iter(run.tests.values())).trace
    forecaster = run.follow(1000.0 * trace.reference_actuation, draws=20, refresh=False)
    begun = slice(0, trace.samples // 2)
    forecaster.update(trace.time[begun], trace.displacement[begun], None, trace.force[begun])
    rest = Trace.from_arrays(trace.time[begun.stop :], trace.displacement[begun.stop :])
    band = forecaster.band(rest)
    assert any("the actuation, " in remark for remark in band.remarks)
    assert band.plot().get_lines()[0].get_ydata().size == rest.samples
    assert band.inference_data()["predictions"]["force"].shape == (1, 20, rest.samples)
