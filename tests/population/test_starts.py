"""Where new tests begin: what repeats say holds for repeats alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from mfd_bayes.friction.models import find_model
from mfd_bayes.friction.three_stage import ThreeStage
from mfd_bayes.population.bands import Forecast
from mfd_bayes.population.design import setting_of
from mfd_bayes.population.population import (
    ELSEWHERE,
    SHAPES,
    Ending,
    Starts,
    place_left,
)
from mfd_bayes.records.trace import Trace
from tests.population.made import THREE_STAGE, make_predictor

TIME = np.arange(300) / 50.0
SINE = Trace.from_arrays(TIME, np.sin(np.pi * TIME), 1.0)
DRAWS = 4000


def at_the_end():
    """Starts as learned from many tests that began exactly where their motions end."""
    weights = np.zeros((2, SHAPES.size))
    weights[1, -1] = 1.0
    return Starts(weights)


def drawn(motion, starts):
    tested = [replace(setting_of(SINE), actuation=p) for p in (0.5, 1.0, 2.0)]
    options = {"scatter": 1e-9, "level_sd": 0.0, "starts": starts, "medians": THREE_STAGE}
    predictor = make_predictor("three_stage", tested, **options)
    found = predictor.draw(motion, Forecast(draws=DRAWS), np.random.default_rng(1))
    return found.unshared["start"]


FADING = np.sin(np.pi * TIME) * np.exp(-0.6 * TIME)  # with few full strokes


def test_another_kind_or_stroke_never_begins_as_repeats_did():
    repeated = drawn(SINE, at_the_end())
    assert stats.kstest(repeated, "uniform").pvalue < 1e-20  # the control
    fading = 2.0 * FADING / np.ptp(FADING)
    setting = setting_of(Trace.from_arrays(TIME, fading, 1.0)).covariates
    full = setting_of(SINE).covariates["full_strokes"]
    assert abs(setting["full_strokes"] - full) > 0.25  # it differs in kind alone
    assert setting["amplitude"] == pytest.approx(1.0, rel=0.01)
    sine = np.sin(np.pi * TIME)
    for motion in (1.3 * sine, 0.8 * sine, fading):
        begun = drawn(Trace.from_arrays(TIME, motion, 1.0), at_the_end())
        assert stats.kstest(begun, "uniform").pvalue > 1e-4


def test_a_repeat_begins_where_its_motion_ends_but_for_a_fifth():
    model = ThreeStage()
    values = {n: np.array([v]) for n, v in (THREE_STAGE | {"gamma1": 1.0}).items()}
    left = place_left(model, values, SINE)
    begun = drawn(SINE, at_the_end())
    near = np.abs(begun - left) < 0.15
    width = np.clip(left + 0.15, 0.0, 1.0) - np.clip(left - 0.15, 0.0, 1.0)
    expected = ELSEWHERE * (1.0 - width)
    se = np.sqrt(expected * (1.0 - expected) / DRAWS)
    # at least the fifth that begins anywhere, and what a narrow density leaves in its tails
    assert expected - 4.0 * se < np.mean(~near) < expected + 0.05
    assert ELSEWHERE >= 0.2


def test_starts_that_are_learned_of_are_those_of_the_tests():
    left = np.array([0.2, 0.7, 0.35, 0.6, 0.8, 0.3])
    numbers = np.random.default_rng(2).standard_normal((DRAWS, 2))

    def places(begun, ends):
        starts = Starts.learned(np.tile(begun, (100, 1)), ends, [None] * begun.size)
        found = starts.place(numbers, 0.75, None, repeat=True)
        return np.median(found), np.mean(np.abs(found - 0.75) < 0.15)

    middle, near = places(left + np.array([0.03, -0.02, 0.01, 0.0, -0.03, 0.02]), left)
    assert middle == pytest.approx(0.75, abs=0.06)
    assert near > 0.6
    assert places(np.full(6, 0.5), None)[0] == pytest.approx(0.5, abs=0.03)
    assert places(1.0 - left, left)[1] < 0.4  # the control: they began elsewhere
    assert places(left[:1] + 0.03, left[:1])[1] < near  # one test says less than six


def test_tests_that_began_without_load_make_others_begin_without_load():
    begun = np.tile([0.45, 0.5, 0.55], (200, 1))
    ends = [(np.full(200, 0.4), np.full(200, 0.6))] * 3
    learned = Starts.learned(begun, None, ends)
    assert 0.75 < learned.unloaded <= 0.95
    loaded = Starts.learned(np.tile([0.1, 0.9, 0.05], (200, 1)), None, ends)
    assert loaded.unloaded < 0.05
    numbers = np.random.default_rng(4).standard_normal((DRAWS, 2))
    ends = np.full(DRAWS, 0.4), np.full(DRAWS, 0.6)
    found = learned.place(numbers, None, ends, repeat=False)
    inside = np.mean((found >= 0.4) & (found <= 0.6))
    expected = learned.unloaded + 0.2 * (1.0 - learned.unloaded)
    assert abs(inside - expected) < 4.0 * np.sqrt(expected * (1.0 - expected) / DRAWS)


@pytest.mark.parametrize("name", ["three_stage", "backlash"])
def test_a_test_that_follows_begins_where_the_one_before_ended(priors, name):
    model = find_model(name)
    typical = {
        q.name: np.full(50, priors.parameters[q.name].typical)
        for q in model.quantities
        if q.name in priors.parameters
    }
    values = {"gamma1": np.ones(50), **typical, "start": np.linspace(0.05, 0.95, 50)}
    ending = Ending.of(model, "a", SINE, values)
    again = ending.starts(model, model.theta(values), SINE, seed=1)
    assert np.ptp(again) < 0.05  # full strokes forget where they began
    assert "test a ended" in ending.words
    moved = ending.moved(model, [0.0, 0.6, -0.6]).starts(model, model.theta(values), SINE, seed=1)
    assert np.abs(np.median(moved) - np.median(again)) > 0.02  # the control
