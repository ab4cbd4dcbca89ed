"""What is said of a test under way that leaves what was tested."""

import numpy as np
import pytest

import mfd_bayes as mb
from mfd_bayes.population.bands import Band, Forecast
from mfd_bayes.population.settings import Setting
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.following import Following
from mfd_bayes.runs.systems import US
from mfd_bayes.runs.tested import range_of

TIME = np.arange(401) / 100
MOTION = np.sin(2 * np.pi * 0.5 * TIME)
TESTED = range_of([Trace.from_arrays(TIME, MOTION, p) for p in (0.5, 1.0)], "ksi")
BAND = Band.of(TIME, np.random.default_rng(1).standard_normal((20, TIME.size)), Forecast(), "laws")
PLAN = {"amplitude": 1.0, "velocity": 3.1}


def said(displacement=MOTION, actuation=1.0, planned=1.0, **plan):
    """Remarks of a band whose test has this motion."""
    setting = Setting(planned, "", PLAN | plan)
    completes = Following(setting, TESTED, US, "ksi", ("unusable",), "extras")
    time = TIME[: len(displacement)]
    band = completes(BAND, Trace.from_arrays(time, displacement, actuation))
    assert band.extras == "extras"
    assert band.remarks[-1] == "unusable"
    np.testing.assert_array_equal(band.draws, BAND.draws)
    return band.remarks[:-1]


def test_a_test_within_the_range_needs_no_remark():
    assert said() == ()


def test_a_test_that_has_just_begun_has_no_stroke_yet():
    assert said(MOTION[:20]) == ()
    (small,) = said(MOTION[:20], amplitude=0.1)  # as it is planned
    assert small.startswith("the stroke, ")
    assert "is wider" in small


@pytest.mark.parametrize("actuation", [5.0, 0.1])
def test_an_actuation_beyond_the_tests_is_told_as_planned_and_as_measured(actuation):
    for remarks in (said(actuation=actuation), said(planned=actuation)):
        (remark,) = remarks
        assert remark.startswith("the actuation, ")
        assert "far outside the tested range" in remark


def test_a_motion_beyond_the_tests_is_told_and_the_band_is_wider_only_where_it_was_planned():
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
