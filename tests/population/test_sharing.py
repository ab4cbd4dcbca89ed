"""Quantities are the same in all tests unless the tests speak for scatter."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate
from scipy.stats import multivariate_normal

from mfd_bayes.population import sharing
from mfd_bayes.population.joint import Joint
from mfd_bayes.population.design import NONE
from mfd_bayes.population.sharing import draw_common, share
from mfd_bayes.population.sweep import Sampler

NAMES = ("offset", "k3", "ell")


@pytest.fixture
def campaign(make_linear):
    """Eight tests that know k3 and ell to half of the scatter that their prior expects."""

    def make(scatter, seed=1):
        linear = make_linear((1.0,) * 8, NAMES, noise=1.0, seed=seed)
        rng = np.random.default_rng(seed)
        unit = linear.layout.scatter_sd / linear.layout.spread
        covariances = np.array([np.diag((0.5 * unit) ** 2)] * 8)
        y = 0.3 + unit * [0.5, scatter, 0.0] * rng.standard_normal((8, 3))
        y += 0.5 * unit * rng.standard_normal((8, 3))
        return replace(linear, y=y, covariances=covariances)

    return make


def test_what_does_not_scatter_is_the_same_in_all_tests(campaign):
    shared = [share(c.layout, c.likelihoods()).common for c in map(campaign, (0.0,) * 3, (1, 2, 3))]
    assert shared == [(False, True, True)] * 3


def test_what_scatters_differs(campaign):
    linear = campaign(4.0)
    assert share(linear.layout, linear.likelihoods()).common == (False, False, True)


def test_a_quantity_with_a_law_or_a_dependence_differs(make_linear):
    linear = make_linear((0.5, 1.0, 1.0, 2.0), ("Fc_fwd", "k3"))
    followed = replace(linear.layout, dependence={"k3": ("velocity",)})
    assert share(linear.layout, linear.likelihoods()).common == (False, True)
    assert not any(share(followed, linear.likelihoods()).common)


def test_the_evidence_is_that_of_the_marginal_densities(campaign):
    """By brute force: the tests' values of k3 and ell, jointly Gaussian given the scatter."""
    linear = campaign(1.0)
    tests, those = linear.likelihoods(), np.array([1, 2])
    reduced = sharing._reduce(tests, those)
    found = reduced.log_marginal({0: 0.3, 1: 0.2}) - reduced.log_marginal({})

    def density(*scatter):
        each = np.diag(np.square(scatter)) + linear.covariances[0][1:, 1:]
        whole = np.kron(np.eye(8), each) + np.kron(np.ones((8, 8)), np.eye(2))
        return multivariate_normal(cov=whole).logpdf(linear.y[:, 1:].ravel())

    assert found == pytest.approx(density(0.3, 0.2) - density(0.0, 0.0), rel=1e-9)


def test_the_evidence_without_a_test_is_that_of_the_others(campaign):
    tests, those = campaign(1.0).likelihoods(), np.array([1, 2])
    found = sharing._reduce(tests, those).evidence_without({0: 0.3}, 1, 0.2)
    others = [sharing._reduce([t for t in tests if t is not one], those) for one in tests]
    expected = [reduced.evidence({0: 0.3}, 1, 0.2)[0] for reduced in others]
    assert found == pytest.approx(np.array(expected), abs=1e-9)


def test_one_test_that_stands_apart_is_no_scatter(campaign):
    linear = campaign(0.0)
    y = linear.y.copy()
    y[3, 1] += 10.0 * linear.layout.scatter_sd[1] / linear.layout.spread[1]
    odd = replace(linear, y=y)
    reduced = sharing._reduce(odd.likelihoods(), np.array([1]))
    unit = float((linear.layout.scatter_sd / linear.layout.spread)[1])
    assert reduced.evidence({}, 0, unit)[0] > np.log(sharing.EVIDENCE)
    assert share(odd.layout, odd.likelihoods()).common == (False, True, True)


def test_gains_that_only_the_gaussians_promise_do_not_count(campaign):
    """Likelihoods that are flat where their Gaussians have slopes: no test says anything."""
    linear = campaign(4.0)
    flat = [replace(t, log_likelihood=lambda x: np.zeros(len(x))) for t in linear.likelihoods()]
    assert share(linear.layout, flat).common == (False, True, True)


def test_draws_of_what_is_common_are_those_of_all_tests_together(campaign):
    linear = campaign(0.0)
    layout, tests = replace(linear.layout, common=(False, True, True)), linear.likelihoods()
    drawn = draw_common(layout, tests, np.random.default_rng(2), 20_000)
    variance = linear.covariances[0][1, 1]
    precision = 1.0 + 8.0 / variance
    mean = linear.y[:, 1].sum() / variance / precision
    assert drawn[:, 0].mean() == pytest.approx(mean, abs=5.0 / np.sqrt(20_000 * precision))
    assert drawn[:, 0].std() == pytest.approx(precision**-0.5, rel=0.03)


def test_a_common_quantity_is_sampled_as_one_value_of_all_tests(campaign):
    """Against the closed form for k3 with the other quantities independent of it."""
    linear = campaign(0.0)
    layout, tests = replace(linear.layout, common=(False, True, True)), linear.likelihoods()
    sampler = Sampler(Joint(layout, tests), np.random.default_rng(3))
    chains = sampler.start(384, 12)
    level = []
    for i in range(45):
        if i == 10:
            sampler.tune(chains)
        sampler.sweep(chains)
        level += [chains.latent[:, 0, 1].copy()] * (i >= 20)
    x = np.stack([x[:, 1] for x in chains.x], axis=1)
    assert np.max(np.abs(x - chains.latent[:, 0, 1, None])) < 10 * NONE
    assert np.all(chains.h[:, 1] == np.log(NONE * layout.spread[1]))
    variance = linear.covariances[0][1, 1]
    precision = 1.0 + 8.0 / variance
    mean = linear.y[:, 1].sum() / variance / precision
    assert np.mean(level) == pytest.approx(mean, abs=0.1 * precision**-0.5)
    assert np.std(level) == pytest.approx(precision**-0.5, rel=0.07)


def test_evidence_is_integrated_over_the_prior_of_the_scatter(campaign):
    linear = campaign(1.0)
    reduced = sharing._reduce(linear.likelihoods(), np.array([1]))
    unit = float((linear.layout.scatter_sd / linear.layout.spread)[1])
    base = reduced.log_marginal({})

    def integrand(r):
        return np.exp(reduced.log_marginal({0: unit * max(r, 1e-9)}) - base - r)

    exact = np.log(integrate.quad(integrand, 0.0, 40.0)[0])
    assert reduced.evidence({}, 0, unit)[0] == pytest.approx(exact, abs=0.1)
