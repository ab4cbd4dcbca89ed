"""Gaussians near the likelihoods of tests."""

from dataclasses import replace

import numpy as np

from mfd_bayes.population.test_likelihood import without_prior


def exact_draws(mean, covariance, rng, n=200_000):
    """Draws under a N(0, 1) interim prior."""
    precision = np.linalg.inv(covariance)
    spread = np.linalg.inv(precision + np.eye(len(mean)))
    return rng.multivariate_normal(spread @ precision @ mean, spread, size=n)


def test_the_gaussian_is_the_likelihood_without_the_interim_prior():
    rng = np.random.default_rng(5)
    mean = np.array([1.5, -2.0, 0.8, 0.3])
    root = rng.normal(size=(4, 4))
    covariance = 0.05 * root @ root.T + 0.05 * np.eye(4)
    found_mean, found = without_prior(exact_draws(mean, covariance, rng))
    np.testing.assert_allclose(found_mean, mean, atol=0.03)
    np.testing.assert_allclose(found, covariance, rtol=0.05, atol=0.01)
    # the control: the posterior's mean is pulled towards the prior
    pulled = np.linalg.solve(np.eye(4) + covariance, mean)
    assert np.max(np.abs(found_mean - pulled)) > 0.1


def test_a_posterior_that_is_its_prior_says_next_to_nothing():
    draws = np.random.default_rng(6).normal(size=(50_000, 4))
    mean, covariance = without_prior(draws)
    assert np.all(np.isfinite(mean))
    assert np.linalg.eigvalsh(np.linalg.inv(covariance)).max() < 0.05
    # it hardly moves a level, whose prior has precision 1
    assert np.max(np.abs(np.linalg.solve(covariance, mean))) < 0.05


def test_a_posterior_wider_than_its_prior_still_has_a_covariance():
    draws = 1.5 * np.random.default_rng(7).normal(size=(5000, 4))
    assert np.all(np.linalg.eigvalsh(without_prior(draws)[1]) > 0)


def test_an_approximated_test_is_its_gaussian(make_linear):
    test = make_linear((0.5, 0.9), ("Fc_fwd", "offset")).likelihoods()[0]
    assert not test.gaussian
    near = test.approximated()
    assert near.gaussian
    x = np.random.default_rng(2).normal(size=(5, 2))
    away = x - test.mean
    expected = -0.5 * np.sum(away * np.linalg.solve(test.covariance, away.T).T, axis=1)
    np.testing.assert_allclose(near.log_likelihood(x), expected)


def test_the_density_of_a_test_has_the_prior_of_its_own_coordinates_and_of_no_others(make_linear):
    test = make_linear((0.5, 0.9), ("Fc_fwd", "offset")).likelihoods()[0]
    whole = replace(test, log_own_prior=lambda own: -3.0 * own[:, 0] ** 2)
    x = np.random.default_rng(2).normal(size=(5, 2))
    expected = test.log_likelihood(x) - 3.0 * x[:, 1] ** 2
    np.testing.assert_allclose(whole.density(1)(x), expected)
