"""Expected remaining variance and information where both have a closed form; sets of tests."""

import numpy as np
import pytest

from mfd_bayes.planning.study import Goals, directions_of, fit_left_out, gain_of

DRAWS = 20_000


def linear_gaussian(seed, noise):
    """Draws of goals A u and of summaries B u + noise of standard normal u (6,).

    And the covariance of the goals before and after the summaries are known.
    """
    rng = np.random.default_rng(seed)
    a, b = np.linalg.qr(rng.standard_normal((6, 3)))[0].T, rng.standard_normal((5, 6))
    sd, u = noise * rng.uniform(0.5, 2.0, 5), rng.standard_normal((DRAWS, 6))
    summaries = u @ b.T + sd * rng.standard_normal((DRAWS, 5))
    before = a @ a.T
    after = before - a @ b.T @ np.linalg.inv(b @ b.T + np.diag(sd**2)) @ b @ a.T
    return u @ a.T, summaries, before, after


def judged(goals, summaries):
    left = fit_left_out(goals, directions_of(summaries))
    return gain_of(Goals(goals), left, np.random.default_rng(0)), left


@pytest.mark.parametrize("noise", [0.3, 3.0])
def test_a_linear_gaussian_population_gives_its_closed_form(noise):
    for seed in range(3):
        goals, summaries, before, after = linear_gaussian(seed, noise)
        gain, left = judged(goals, summaries)
        reduction = 1.0 - np.sqrt(np.diag(after)).sum() / np.sqrt(np.diag(before)).sum()
        assert abs(gain.reduction - reduction) < 4.0 * gain.error + 0.005  # which a penalty costs
        information = 0.5 * (np.linalg.slogdet(before)[1] - np.linalg.slogdet(after)[1])
        assert abs(gain.information - information) < 4.0 * gain.information_error
        closed = np.diag(after) / np.diag(before)
        share = left.var(axis=0) / goals.var(axis=0)
        np.testing.assert_allclose(share, closed, rtol=4.0 * np.sqrt(4.0 / DRAWS))


def test_a_test_that_tells_nothing_has_no_gain():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        goals = rng.standard_normal((1000, 2))
        gain, _ = judged(goals, rng.standard_normal((1000, 8)))
        assert 0.0 <= gain.reduction < 0.004
        assert 0.0 <= gain.information < 0.01
