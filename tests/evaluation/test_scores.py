import numpy as np
import pytest
from scipy import stats

from mfd_bayes.calibration.diagnostics import COVERAGES
from mfd_bayes.evaluation.scores import crps, rrse, score


def naive_crps(draws, y):
    pairs = np.abs(draws[:, None] - draws[None])
    return np.abs(draws - y).mean(axis=0) - 0.5 * pairs.mean(axis=(0, 1))


@pytest.mark.parametrize("n", [1, 7])
def test_crps_is_that_of_all_pairs(n):
    rng = np.random.default_rng(n)
    draws, y = rng.standard_t(3, size=(n, 9)), rng.normal(size=9)
    np.testing.assert_allclose(crps(draws, y), naive_crps(draws, y), rtol=1e-12, atol=1e-14)


def test_calibrated_draws_cover_as_often_as_they_say():
    rng = np.random.default_rng(5)
    centre = np.sin(np.linspace(0, 20, 4000))
    observed = centre + 0.3 * rng.normal(size=4000)
    calibrated = score(centre + 0.3 * rng.normal(size=(1000, 4000)), observed)
    np.testing.assert_allclose(calibrated.coverage, COVERAGES, atol=0.03)
    assert calibrated.width == pytest.approx(2 * 1.96 * 0.3, rel=0.02)
    narrow = score(centre + 0.1 * rng.normal(size=(1000, 4000)), observed)  # the control
    assert narrow.coverage[-1] < 0.6
    assert narrow.crps > calibrated.crps


def test_the_interval_score_is_least_for_the_true_spread():
    rng = np.random.default_rng(8)
    observed = rng.normal(size=3000)
    scores = [
        score(sd * rng.normal(size=(800, 3000)), observed).interval_score for sd in (0.6, 1.0, 1.7)
    ]
    assert min(scores) == scores[1]
    # of a normal, 2 z + 2 [φ(z) − z (1 − Φ(z))]/0.025 at z = 1.96
    z = stats.norm.ppf(0.975)
    expected = 2 * z + 80 * (stats.norm.pdf(z) - z * 0.025)
    assert scores[1] == pytest.approx(expected, rel=0.05)


def test_rrse_of_the_mean_is_one():
    observed = np.random.default_rng(6).normal(size=100)
    assert rrse(np.full(100, observed.mean()), observed) == pytest.approx(1.0)
    assert rrse(0.5 * (observed + observed.mean()), observed) == pytest.approx(0.5)
    assert rrse(observed - 3 * observed.std(), observed) == pytest.approx(3.0)

    assert np.isnan(rrse(np.zeros(5), np.full(5, 2.0)))
