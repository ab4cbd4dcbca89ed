"""The working likelihood of a test: independent noise with a shape, and a discrepancy."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.population.design import lay_out
from mfd_bayes.population.settings import Setting
from mfd_bayes.population.working import working_likelihood
from mfd_bayes.records.trace import Trace

TIME = np.arange(160) / 32.0


@pytest.fixture(scope="module")
def calibrated(priors):
    """A test as it is calibrated, with noise that has a memory."""
    motion = 0.5 * np.sin(2 * np.pi * 0.4 * TIME)
    blank = Trace.from_arrays(TIME, motion, 0.8)
    source = Posterior(replace(blank, force=np.zeros(TIME.size)), priors)
    rng = np.random.default_rng(3)
    truth = source.draw_prior(rng, 1)
    force = source.force(truth) + source.noise.draw(rng, TIME, truth)
    return Posterior(replace(blank, force=force[0]), priors)


@pytest.fixture(scope="module")
def plain(priors, calibrated):
    """The same test with independent noise."""
    return Posterior(calibrated.trace, priors, "iid")


@pytest.fixture(scope="module")
def shared(priors, calibrated, plain):
    """Working likelihood, some points of it, and their values."""
    settings = [Setting(p, "", {"velocity": 1.2}) for p in (0.5, 0.8)]
    layout = lay_out(priors, plain.names, settings)
    found = working_likelihood(layout, calibrated, priors)
    values = plain.draw_prior(np.random.default_rng(4), 40)
    q = [layout.coordinates.of(values)]
    q += [plain.priors[name].coordinate(values[name])[:, None] for name in found.own]
    x = (np.concatenate(q, axis=1) - found.middle) / found.scale
    return found, x, values


def test_coordinates_are_the_pooled_ones_then_the_test_s_own(plain, shared):
    found, x, values = shared
    assert "noise_time" not in found.posterior.names
    assert found.layout.names == tuple(n for n in plain.names if n != "start")
    assert found.own == ("start",)
    assert x.shape == (40, plain.dim)
    np.testing.assert_allclose(found.points(x), plain.coordinates(values), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.noise_sd(x), values["noise_sd"])


def test_so_far_it_is_the_test_s_own_with_independent_noise(calibrated, plain, shared):
    found, x, values = shared
    expected = plain.log_likelihood(plain.coordinates(values))
    np.testing.assert_allclose(found(x), expected, rtol=1e-9)
    assert np.ptp(expected) > 10
    with_memory = calibrated.log_likelihood(
        calibrated.coordinates(values | {"noise_time": np.full(40, 0.1)})
    )
    assert np.max(np.abs(with_memory - expected)) > 10  # the control


def test_with_the_prior_of_its_own_it_makes_the_test_s_posterior(plain, shared):
    """Up to a constant, from the change of scale."""
    found, x, values = shared
    d = len(found.layout.names)
    density = found(x) + found.log_own_prior(x[:, d:])
    density += found.layout.coordinates.log_prior(found.middle[:d] + found.scale[:d] * x[:, :d])
    expected = plain.log_prob(plain.coordinates(values))
    np.testing.assert_allclose(density - density[0], expected - expected[0], atol=1e-6)


def test_shape_discrepancy_and_information_have_their_places(plain, shared):
    found, x, values = shared
    rng = np.random.default_rng(5)
    shape, discrepancy = np.exp(0.4 * rng.standard_normal((2, TIME.size)))
    changed = replace(found, shape=shape, discrepancy=discrepancy, information=0.3)
    left = plain.residual(plain.coordinates(values)) - discrepancy
    sd = values["noise_sd"][:, None] * shape
    expected = -0.5 * np.sum((left / sd) ** 2 + np.log(2 * np.pi * sd**2), axis=1)
    np.testing.assert_allclose(changed(x), 0.3 * expected, rtol=1e-9)
    assert np.max(np.abs(found(x) - expected)) > 1


def test_what_is_masked_does_not_count(priors, calibrated, shared):
    whole, x, _ = shared
    masked = Posterior(calibrated.trace, priors, start="mask")
    assert masked.first > 0
    found = working_likelihood(whole.layout, masked, priors)
    assert found.own == ()
    shape = np.where(np.arange(TIME.size) < masked.first, 9.0, 1.0)
    elsewhere = np.where(np.arange(TIME.size) < masked.first, 5.0, 0.0)
    changed = replace(found, shape=shape, discrepancy=elsewhere)
    x = x[:, : len(whole.layout.names)]
    assert np.ptp(found(x)) > 10
    np.testing.assert_array_equal(changed(x), found(x))


def test_what_is_beyond_all_range_has_no_likelihood_and_no_nan(shared):
    found, x, _ = shared
    x = x[:4].copy()
    x[0, 0], x[1, 3], x[2, -1] = 1e4, -1e4, np.inf
    density = found(x)
    assert np.all(density[:3] == -np.inf)
    assert np.isfinite(density[3])


def test_a_process_can_be_sent_it(shared):
    found, x, _ = shared
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(found))(x), found(x))
