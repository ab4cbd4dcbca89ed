"""Bands that hold whole curves as often as they say."""

import numpy as np
import pytest

from mfd_bayes.population.bands import holds_whole, whole_band

TIME = np.linspace(0.0, 4.0, 300)


def curves(n, rng):
    """Loops with an uncertain amplitude, a phase that makes them skew, and correlated noise."""
    size, late = 1 + 0.1 * rng.normal(size=(n, 1)), 0.1 * rng.normal(size=(n, 1))
    ripple = np.zeros((n, TIME.size))
    for k in range(1, TIME.size):
        ripple[:, k] = 0.9 * ripple[:, k - 1] + 0.02 * rng.normal(size=n)
    return size * np.tanh(3 * np.sin(2 * np.pi * TIME + late)) + ripple


@pytest.mark.parametrize("probability", [0.5, 0.95])
def test_whole_curves_are_inside_as_often_as_promised(probability):
    rng = np.random.default_rng(3)
    lower, upper = whole_band(curves(2000, rng), probability)
    fresh = curves(2000, rng)
    inside = np.mean(np.all((fresh >= lower) & (fresh <= upper), axis=1))
    assert inside == pytest.approx(probability, abs=0.035)


def test_a_band_of_single_samples_holds_whole_curves_far_too_seldom():
    """The control: what the band of whole curves is for."""
    rng = np.random.default_rng(3)
    lower, upper = np.quantile(curves(2000, rng), [0.025, 0.975], axis=0)
    fresh = curves(2000, rng)
    assert np.mean((fresh >= lower) & (fresh <= upper)) == pytest.approx(0.95, abs=0.01)
    assert np.mean(np.all((fresh >= lower) & (fresh <= upper), axis=1)) < 0.75


def test_the_band_of_whole_curves_is_nowhere_inside_that_of_single_samples():
    rng = np.random.default_rng(4)
    draws = curves(400, rng)
    draws[:, 50:60] = np.exp(3 * rng.normal(size=(400, 1)))  # very skew
    lower, upper = whole_band(draws, 0.9)
    low, high = np.quantile(draws, [0.05, 0.95], axis=0)
    assert np.all(lower <= low)
    assert np.all(upper >= high)
    assert np.mean(upper - lower) > 1.2 * np.mean(high - low)


def test_where_all_draws_agree_the_band_has_no_width():
    draws = curves(200, np.random.default_rng(5))
    draws[:, 10] = 0.1 + 0.2 + 1e-17 * np.arange(200)  # rounding
    lower, upper = whole_band(draws, 0.95)
    assert np.all(np.isfinite(lower))
    assert upper[10] - lower[10] < 1e-9
    assert np.median(upper - lower) > 0.3
    same = np.ones((20, 7))
    np.testing.assert_array_equal(whole_band(same, 0.95), np.ones((2, 7)))


def test_one_sample_outside_puts_the_whole_curve_outside():
    draws = curves(500, np.random.default_rng(6))
    curve = np.median(draws, axis=0)
    assert holds_whole(draws, curve)
    curve[70] += 2.0
    assert not holds_whole(draws, curve)
