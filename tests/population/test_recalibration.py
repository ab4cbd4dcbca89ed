"""Factors of recalibration, against computations by hand."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.population.bands import band_of
from mfd_bayes.population.bands import Forecast
from mfd_bayes.population.recalibration import (
    PROBABILITIES,
    chosen_factor,
    factor_of,
    factors_of,
    promise,
)

DRAWS = np.linspace(-1.0, 1.0, 1001)[:, None] * np.ones(10)
"""Uniform draws: the band of 80 % is ± 0.8 about 0 at each of ten samples."""


def test_a_factor_is_the_one_that_covers_the_asked_share_of_one_test():
    observed = 0.8 * np.array([0.1, -0.2, 0.3, -0.4, 0.5, 0.6, -0.7, 1.5, -2.0, 3.0])
    # 8 of 10 samples are to be inside: the eighth smallest distance is 1.5 half widths
    assert factor_of(DRAWS, observed, 0.8) == pytest.approx(1.5, rel=1e-6)
    assert factor_of(DRAWS, observed, 0.9) == pytest.approx(2.0 * 0.8 / 0.9, rel=1e-6)
    assert factors_of(DRAWS, observed)[PROBABILITIES.index(0.8)] == pytest.approx(1.5, rel=1e-6)


def test_a_skew_band_is_widened_on_either_side_in_proportion():
    skew = np.where(DRAWS > 0, 3 * DRAWS, DRAWS)  # 80 %: −0.8 to 2.4
    above, below = np.full(10, 4.8), np.full(10, -1.6)
    assert factor_of(skew, above, 0.8) == pytest.approx(2.0, rel=1e-6)
    assert factor_of(skew, below, 0.8) == pytest.approx(2.0, rel=1e-6)


def test_a_band_that_is_too_wide_has_a_factor_below_one():
    assert factor_of(DRAWS, np.linspace(-0.4, 0.4, 10), 0.8) < 0.5
    assert factor_of(DRAWS, np.zeros(10), 0.8) == 0.0


def test_a_band_without_width_has_a_finite_factor():
    assert np.isfinite(factor_of(np.zeros((20, 5)), np.ones(5), 0.5))


def test_the_factor_that_is_applied_is_that_of_the_rank():
    scores = [0.9, 1.4, 1.1, 1.3, 1.0, 0.8, 1.2, 1.6, 1.5]  # nine: ranks of ⌈10 p⌉
    assert chosen_factor(scores, 0.5) == (1.2, 0.5)
    assert chosen_factor(scores, 0.8) == (1.5, 0.8)
    assert chosen_factor(scores, 0.9) == (1.6, 0.9)
    assert chosen_factor(scores, 0.95) == (1.6, 0.9)  # nine tests cannot promise more


def test_the_promise_says_how_much_so_many_tests_can_promise():
    said = promise([1.0, 1.3, 1.2], 0.95, "level")
    for words in ("1.3 times", "3 tests", "by level", "95 %", "75 % of tests", "no more"):
        assert words in said
    assert "no more" not in promise([1.0, 1.3, 1.2], 0.5, "test")


def test_recalibrated_bands_cover_new_tests_as_often_as_promised():
    """Tests whose bands are too narrow by a factor of two, unlike from test to test."""
    rng = np.random.default_rng(1)
    covered = {True: [], False: []}
    draws = np.sort(rng.normal(size=(400, 1)), axis=0) * np.ones(50)
    low, high = np.quantile(draws[:, 0], [0.05, 0.95])
    for _ in range(300):
        tests = 2 * np.exp(0.3 * rng.normal(size=(20, 1))) * rng.normal(size=(20, 50))
        scores = [factor_of(draws, test, 0.9) for test in tests[1:]]
        factor, share = chosen_factor(scores, 0.9)
        assert share == 0.9
        for widened, f in ((True, factor), (False, 1.0)):
            inside = np.mean((tests[0] >= f * low) & (tests[0] <= f * high))
            covered[widened].append(inside >= 0.9)
    assert np.mean(covered[True]) == pytest.approx(0.9, abs=0.04)
    assert np.mean(covered[False]) < 0.2  # the control


def test_a_widened_band_stays_inside_that_of_the_whole_history():
    rng = np.random.default_rng(1)
    forecast = Forecast(probability=0.8, whole=True)
    band = band_of(np.arange(3.0), rng.standard_normal((500, 3)), forecast, "a test")
    wide = band.widened(3.0)
    assert np.all(wide.lower < band.whole[0])  # else this shows nothing
    for lower, upper in (wide.whole, replace(wide, whole_lower=None).whole):
        assert np.all(lower <= wide.lower)
        assert np.all(wide.upper <= upper)
    np.testing.assert_array_equal(band.widened(1.01).whole, band.whole)
