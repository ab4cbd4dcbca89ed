"""Least squares from many starts, beside SciPy's from each."""

import numpy as np
import pytest
from scipy import optimize

from mfd_bayes.calibration import least_squares
from mfd_bayes.calibration.least_squares import fit_all

TIME = np.linspace(0.0, 3.0, 60)


def decay(points, _=None):
    """Misfit of a decaying oscillation, (n, 3) -> (n, 60)."""
    size, rate, pace = np.exp(points).T[:, :, None]
    data = 2.0 * np.exp(-0.7 * TIME) * np.cos(3.0 * TIME)
    return 5.0 * (size * np.exp(-rate * TIME) * np.cos(pace * TIME) - data)


def least(residual, begin, reach):
    """SciPy's result from one start."""
    fit = optimize.least_squares(
        lambda x: np.concatenate([residual(x[None])[0], x]), begin, bounds=(-reach, reach)
    )
    return fit.x


@pytest.fixture(scope="module")
def begin():
    middle = np.log([2.0, 0.7, 3.0])
    return middle + 0.25 * np.random.default_rng(5).standard_normal((12, 3))


def test_the_ends_are_those_of_scipy(begin):
    expected = [least(decay, one, 8.0) for one in begin]
    np.testing.assert_allclose(fit_all(decay, begin, 8.0), expected, atol=2e-4)


def test_a_start_ends_where_it_would_end_alone(begin):
    alone = [fit_all(decay, one[None], 8.0)[0] for one in begin]
    np.testing.assert_allclose(fit_all(decay, begin, 8.0), alone, atol=1e-9)


def test_long_records_are_taken_in_parts(begin, monkeypatch):
    expected = fit_all(decay, begin, 8.0)
    monkeypatch.setattr(least_squares, "MOST", 600)
    np.testing.assert_allclose(fit_all(decay, begin, 8.0), expected, atol=1e-9)


def test_no_coordinate_leaves_its_range(begin):
    found = fit_all(decay, begin, 0.9)
    expected = [least(decay, np.clip(one, -0.89, 0.89), 0.9) for one in begin]
    assert np.max(np.abs(found)) == 0.9
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_a_straight_line_is_fitted_at_once():
    slopes = np.array([[1.0, 2.0], [0.0, 1.0], [3.0, -1.0]])
    exact = np.linalg.solve(slopes.T @ slopes + np.eye(2), slopes.T @ [4.0, 1.0, 2.0])
    begin = np.array([[5.0, -5.0], [0.0, 0.0]])
    found = fit_all(lambda x, _: x @ slopes.T - [4.0, 1.0, 2.0], begin, 8.0)
    np.testing.assert_allclose(found, [exact, exact], atol=1e-5)


def test_a_start_without_a_number_stays_where_it_is():
    def residual(points, _):
        with np.errstate(invalid="ignore"):
            return np.sqrt(points - 1.0)

    found = fit_all(residual, np.array([[0.0], [3.0]]), 8.0)
    assert found[0, 0] == 0.0
    assert 1.0 <= found[1, 0] < 3.0


def test_each_start_may_have_its_own_data():
    data = np.array([[1.0, 2.0, 4.0], [-3.0, 0.5, 0.0]])
    found = fit_all(lambda x, starts: 30.0 * (x - data[starts]), np.zeros((2, 1)), 8.0)
    expected = data.mean(axis=1) / (1.0 + 1.0 / 2700.0)
    np.testing.assert_allclose(found[:, 0], expected, rtol=1e-6)
