"""Likelihood of a test in shared coordinates, and its Gaussian approximation."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.population import test_likelihood
from mfd_bayes.population.layout import lay_out
from mfd_bayes.population.setting import Setting
from mfd_bayes.population.test_likelihood import likelihood_of, without_prior
from mfd_bayes.records.trace import Trace


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
    test = make_linear((0.5, 0.9), ("Fc_fwd", "offset")).likelihoods(np.random.default_rng(1))[0]
    assert not test.gaussian
    near = test.approximated()
    assert near.gaussian
    x = np.random.default_rng(2).normal(size=(5, 2))
    away = x - test.mean
    expected = -0.5 * np.sum(away * np.linalg.solve(test.covariance, away.T).T, axis=1)
    np.testing.assert_allclose(near.log_likelihood(x), expected)


TIME = np.arange(160) / 32.0


@pytest.fixture(scope="module")
def posterior(priors):
    motion = 0.5 * np.sin(2 * np.pi * 0.4 * TIME)
    blank = Trace.from_arrays(TIME, motion, 0.8)
    source = Posterior(replace(blank, force=np.zeros(TIME.size)), priors)
    rng = np.random.default_rng(3)
    truth = source.draw_prior(rng, 1)
    force = source.force(truth) + source.noise.draw(rng, TIME, truth)
    return Posterior(replace(blank, force=force[0]), priors)


@pytest.fixture(scope="module")
def shared(priors, posterior):
    settings = [Setting(p, "", {"velocity": 1.2}) for p in (0.5, 0.8)]
    layout = lay_out(priors, posterior.names, settings)
    values = posterior.draw_prior(np.random.default_rng(4), 40)
    return layout, values, likelihood_of(layout, posterior, values)


def test_coordinates_of_a_test_are_the_pooled_ones_then_its_own(posterior, shared):
    layout, values, found = shared
    assert layout.names == tuple(n for n in posterior.names if n != "start")
    d = len(layout.names)
    assert found.draws.shape == (40, posterior.dim) == (40, d + 1)
    expected = (layout.coordinates.of(values) - layout.centre) / layout.spread
    np.testing.assert_allclose(found.draws[:, :d], expected)
    np.testing.assert_allclose(
        np.argsort(found.draws[:, d]), np.argsort(values["start"])
    )  # the own quantity; its scale may differ


def test_the_likelihood_is_the_tests_own(posterior, shared):
    _, values, found = shared
    expected = posterior.log_likelihood(posterior.coordinates(values))
    np.testing.assert_allclose(found.log_likelihood(found.draws), expected, rtol=1e-6)
    assert np.ptp(expected) > 10


def test_likelihood_and_priors_make_the_tests_posterior(posterior, shared):
    """Up to a constant, from the change of scale."""
    layout, values, found = shared
    d = len(layout.names)
    density = found.log_likelihood(found.draws)
    density += found.log_interim_prior(found.draws[:, :d]) + found.log_own_prior(found.draws[:, d:])
    expected = posterior.log_prob(posterior.coordinates(values))
    left = density - expected - (density[0] - expected[0])
    np.testing.assert_array_less(np.abs(left), 1e-5 * np.abs(expected))  # draws are stored rounded


def test_of_many_draws_as_many_are_held_as_there_is_room_for(posterior, shared, monkeypatch):
    layout, values, found = shared
    assert found.draws.dtype == np.float32
    monkeypatch.setattr(test_likelihood, "ROOM", 30 * len(layout.settings) * posterior.dim)
    monkeypatch.setattr(test_likelihood, "FEWEST", 10)
    fewer = likelihood_of(layout, posterior, values)
    np.testing.assert_array_equal(fewer.draws, found.draws[::2])
    np.testing.assert_array_equal(fewer.draws_log_prior, found.draws_log_prior[::2])
    np.testing.assert_array_equal(fewer.mean, found.mean)


def test_the_interim_prior_of_the_draws_is_stored(shared):
    layout, _, found = shared
    expected = found.log_interim_prior(found.draws[:, : len(layout.names)])
    np.testing.assert_array_equal(found.draws_log_prior, expected)


def test_what_is_beyond_all_range_has_no_likelihood_and_no_nan(shared):
    _, _, found = shared
    x = found.draws[:4].copy()
    x[0, 0], x[1, 3], x[2, -1] = 1e4, -1e4, np.inf
    density = found.log_likelihood(x)
    assert np.all(density[:3] == -np.inf)
    assert np.isfinite(density[3])
