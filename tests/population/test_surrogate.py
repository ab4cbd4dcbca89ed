"""Surrogates follow the likelihoods of tests, and their derivatives, where they are fitted."""

from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.population.apart import Joined
from mfd_bayes.population.design import lay_out
from mfd_bayes.population.settings import Setting
from mfd_bayes.population.surrogate import Surrogate, surrogate_of, surrogates_of, terms
from mfd_bayes.population.test_likelihood import TestLikelihood
from mfd_bayes.population.working import working_likelihood
from mfd_bayes.records.trace import Trace

TIME = np.arange(600) / 64.0
WIDTH = 0.02
"""Sd of the states in prior units, about that of a posterior."""


@pytest.fixture(scope="module")
def test(priors):
    """The working likelihood of a synthetic record, near whose truth its posterior is."""
    blank = Trace.from_arrays(TIME, np.sin(2 * np.pi * 0.5 * TIME), 0.8)
    source = Posterior(replace(blank, force=np.zeros(TIME.size)), priors, "iid")
    rng = np.random.default_rng(3)
    truth = source.draw_prior(rng, 1)
    force = source.force(truth) + source.noise.draw(rng, TIME, truth)
    posterior = Posterior(replace(blank, force=force[0]), priors, "iid")
    settings = [Setting(p, "", {"velocity": 1.2}) for p in (0.5, 0.8)]
    layout = lay_out(priors, [n for n in posterior.names if n != "start"], settings)
    likelihood = working_likelihood(layout, posterior, priors)
    shared = layout.coordinates.of(truth)
    own = [posterior.priors[name].coordinate(truth[name])[:, None] for name in likelihood.own]
    q = np.concatenate([shared, *own], axis=1)
    middle = ((q - likelihood.middle) / likelihood.scale)[0]
    return TestLikelihood(
        likelihood, likelihood.log_own_prior, middle, WIDTH**2 * np.eye(middle.size)
    )


@pytest.fixture(scope="module")
def states(test):
    """States like those of a posterior."""
    rng = np.random.default_rng(1)
    return test.mean + WIDTH * rng.standard_normal((400, test.mean.size))


@pytest.fixture(scope="module")
def surrogate(test, states) -> Surrogate:
    return surrogate_of(test, states, np.random.default_rng(2)).log_likelihood


def test_it_follows_the_likelihood(test, states, surrogate):
    rng = np.random.default_rng(9)
    fresh = test.mean + WIDTH * rng.standard_normal((200, test.mean.size))
    true, near = test.log_likelihood(fresh), surrogate(fresh)
    assert true.std() > 5.0  # or nothing would be followed
    assert (true - near).std() < 0.3


def test_a_line_is_followed_exactly_and_needs_few_components(squared, gaussian_test):
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    line = squared(gaussian_test(np.array([0.3, -0.2]), covariance))
    rng = np.random.default_rng(1)
    states = rng.multivariate_normal(line.mean, covariance, size=200)
    found = surrogate_of(line, states, rng).log_likelihood
    np.testing.assert_allclose(found(states), line.log_likelihood(states), atol=0.02)
    assert found.components.shape == (6, 2)
    np.testing.assert_allclose(found.information, line.precision, rtol=0.02)


def test_its_derivatives_are_those_of_differences(states, surrogate):
    slopes = surrogate.slopes(states[:20])
    for k in range(states.shape[1]):
        step = np.zeros(states.shape[1])
        step[k] = 1e-5
        change = (surrogate(states[:20] + step) - surrogate(states[:20] - step)) / 2e-5
        np.testing.assert_allclose(slopes[:, k], change, rtol=1e-4, atol=1e-2)


def test_far_away_it_falls(states, surrogate):
    away = states[:5] - surrogate.centre
    values = [surrogate(surrogate.centre + factor * away) for factor in (10.0, 100.0, 1000.0)]
    assert np.all(values[0] > values[1])
    assert np.all(values[1] > values[2])
    assert np.all(np.isfinite(surrogate.slopes(surrogate.centre + 1000.0 * away)))


def test_the_noise_is_a_coordinate_of_its_own(test, surrogate):
    names = test.log_likelihood.layout.names
    assert [names[k] for k in surrogate.direct] == ["noise_sd"]


def test_there_is_none_without_a_sum_of_squares(test, states, gaussian_test):
    rng = np.random.default_rng(1)
    plain = gaussian_test(np.zeros(2), np.eye(2))
    some = rng.standard_normal((50, 2))
    assert surrogate_of(plain, some, rng) is None
    assert surrogates_of([test, plain], [states, some], rng) is None
    joined = replace(test, log_likelihood=Joined(None, plain.log_likelihood))
    assert surrogate_of(joined, states, rng) is None


def test_there_is_none_where_the_states_are_alike(test, states):
    alike = np.repeat(states[:1], 300, axis=0)
    assert surrogate_of(test, alike, np.random.default_rng(1)) is None


def test_terms_are_all_products_of_up_to_two():
    found = terms(np.array([[2.0, 3.0, 5.0]]))
    assert sorted(found[0]) == sorted([1, 2, 3, 5, 4, 6, 10, 9, 15, 25])
