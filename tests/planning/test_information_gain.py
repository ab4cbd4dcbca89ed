"""Expected remaining variance and information where both have a closed form; sets of tests."""

import numpy as np
import pytest

from mfd_bayes.planning.study import Goals, directions_of, fit_left_out, gain_of, greedy


def linear_gaussian(seed, noise):
    """Draws of goals A u and of summaries B u + noise of standard normal u (6,).

    And the covariance of the goals before and after the summaries are known.
    """
    rng = np.random.default_rng(seed)
    a, b = rng.standard_normal((3, 6)), rng.standard_normal((5, 6))
    sd, u = noise * rng.uniform(0.5, 2.0, 5), rng.standard_normal((6000, 6))
    summaries = u @ b.T + sd * rng.standard_normal((6000, 5))
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
        assert abs(gain.reduction - reduction) < 2.5 * gain.error
        information = 0.5 * (np.linalg.slogdet(before)[1] - np.linalg.slogdet(after)[1])
        assert gain.information == pytest.approx(information, rel=0.03, abs=0.01)
        closed = np.diag(after) / np.diag(before)
        np.testing.assert_allclose(left.var(axis=0) / goals.var(axis=0), closed, rtol=0.06)


def test_a_test_that_tells_nothing_has_no_gain():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        goals = rng.standard_normal((1000, 2))
        gain, _ = judged(goals, rng.standard_normal((1000, 8)))
        assert 0.0 <= gain.reduction < 0.004
        assert 0.0 <= gain.information < 0.01


ROWS = [(2.0, 0.0), (2.0, 0.0), (0.0, 1.5), (0.3, 0.3)]
"""A test, its copy, one about the other goal, and a weak one."""


def test_the_second_best_test_is_not_the_copy_of_the_best():
    rng = np.random.default_rng(0)
    u = rng.standard_normal((4000, 2))
    tests = [(u @ row + rng.standard_normal(4000))[:, None] for row in np.array(ROWS)]
    sets = greedy(Goals(u), [test - test.mean(axis=0) for test in tests], 3)
    assert [len(chosen) for chosen in sets] == [1, 2, 3]
    assert sets[0][0] in (0, 1)
    assert sets[1] == (*sets[0], 2)
    assert set(sets[2]) == {0, 1, 2}
    alone = greedy(Goals(u[:, :1]), [test - test.mean(axis=0) for test in tests], 2)
    assert set(alone[1]) == {0, 1}  # the control: of one goal the copy tells more
