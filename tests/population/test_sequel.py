"""A test that follows another one begins where in the gap that one ended."""

import numpy as np
import pytest

from mfd_bayes.calibration.noises import find_noise
from mfd_bayes.friction.lugre import LuGre
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.population.bands import Forecast
from mfd_bayes.population.bands import Predictor
from mfd_bayes.population.starts import Ending, ending_of
from mfd_bayes.records.trace import Trace

TIME = np.arange(401) / 100
SMALL = Trace.from_arrays(TIME, 0.04 * np.sin(np.pi * TIME), 1.0)  # inside a gap of 0.16 in
MODEL = ThreeStage()
THETA = np.array([[30.0, 0.02, 0.015, 1.5, 1.3, 1.8, 1.6, 0.6, 20.0, 0.09, 0.07, 1.0, 0.02, 0.4]])
D = 0.16


@pytest.fixture(scope="module")
def predictor(make_population):
    return Predictor(make_population(), MODEL, find_noise("ou"))


def ending(*places):
    place = np.array(places)
    return Ending("a", np.repeat(THETA, place.size, axis=0), place)


def test_the_start_is_the_place_where_the_other_ended_and_all_else_is_as_before(predictor):
    asked = Forecast("observation", draws=200)
    free = predictor.predict(SMALL, asked)
    before = ending(*np.linspace(0.1, 0.2, 50))
    known = predictor.predict(SMALL, Forecast("observation", draws=200, before=before))
    assert free.source == "population laws with scatter"
    assert known.source == f"{free.source}, begun where in its gap test a ended"
    assert set(known.values) == set(free.values)
    for name in set(known.values) - {"start"}:
        np.testing.assert_array_equal(known.values[name], free.values[name])
    assert np.all((known.values["start"] >= 0.1) & (known.values["start"] <= 0.2))
    assert known.values["start"].std() > 0.02
    assert np.ptp(free.values["start"]) > 0.9  # anywhere: the motion is shorter than all others
    slow = slice(0, 50)
    widths = [np.mean((band.upper - band.lower)[slow]) for band in (free, known)]
    assert widths[1] < 0.7 * widths[0]


def test_the_start_counts_along_the_first_direction(predictor):
    back = Trace.from_arrays(TIME, -SMALL.displacement, 1.0)
    found = predictor.predict(back, Forecast(draws=50, before=ending(0.1, 0.1)))
    np.testing.assert_allclose(found.values["start"], 0.9)


def test_the_same_test_again_may_follow_another_too(predictor):
    drawn = predictor.draw(SMALL, Forecast(draws=100), np.random.default_rng(0))
    asked = Forecast("this_test", draws=40, before=ending(0.3))
    found = predictor.repeat(SMALL, asked, predictor.values(drawn))
    np.testing.assert_allclose(found.values["start"], 0.3)
    assert found.source == "posterior draws of this test, begun where in its gap test a ended"


def test_a_model_without_a_gap_begins_as_ever(predictor):
    plain = Predictor(predictor.population, LuGre(), predictor.noise)
    free = plain.predict(SMALL, Forecast(draws=20))
    known = plain.predict(SMALL, Forecast(draws=20, before=ending(0.1)))
    np.testing.assert_array_equal(free.draws, known.draws)


@pytest.mark.parametrize(
    ("way", "place"),
    [
        ([0.3], 0.5),
        ([0.3, 0.3, 0.3], 0.5),
        ([0.3, 0.3 + 0.25 * D], 0.75),
        ([0.3, 0.3 - 0.25 * D], 0.25),
        ([0.3, 0.3 + 0.7 * D], 1.0),  # it drags the gap along
        ([0.3, 0.3 + 0.7 * D, 0.3 + 0.5 * D], 0.8),
        ([-0.3, 9.0, 8.0], 0.0),
    ],
)
def test_a_motion_in_between_is_straight_from_each_displacement_to_the_next(way, place):
    assert ending(0.5).moved(MODEL, way).place == pytest.approx(place)


def test_a_test_ends_by_its_own_draws_of_parameters_and_start(predictor):
    drawn = predictor.draw(SMALL, Forecast(draws=30), np.random.default_rng(0))
    values = predictor.values(drawn)
    motion = Trace.from_arrays(TIME, 0.02 * TIME, 1.0)  # 0.08 in forward
    found = ending_of(MODEL, "a", motion, values)
    gap = values["d2"] + values["d3"]
    np.testing.assert_allclose(found.place, np.minimum(values["start"] + 0.08 / gap, 1.0))
    np.testing.assert_array_equal(found.theta, MODEL.theta(values))
