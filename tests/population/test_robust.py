"""Tests that stand apart: every move keeps a posterior that is known by other means."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from mfd_bayes.population.chains import Chains
from mfd_bayes.population.joint import Joint
from mfd_bayes.population.design import WIDER
from mfd_bayes.population.moves import hyperparameters, one_test
from mfd_bayes.population.moves.lines import transport
from mfd_bayes.population.sweep import Sampler

CHAINS = 4096
ODD = 0.2
PROPOSED = 400_000
FAR = 5.0


@dataclass(frozen=True, eq=False)
class Exact:
    """Draws of log scatter, level, weights and tests' values (n, J) by weights of prior draws.

    The population has one quantity and no law; one of its tests stands apart.
    """

    linear: object
    log_scatter: np.ndarray
    level: np.ndarray
    weight: np.ndarray
    x: np.ndarray

    @classmethod
    def of(cls, linear):
        rng = np.random.default_rng(5)
        layout, y = linear.layout, linear.y[:, 0]
        variance = linear.covariances[:, 0, 0]
        scatter = layout.scatter_sd[0] * np.abs(rng.standard_normal(PROPOSED))
        weight = np.where(rng.random((PROPOSED, y.size)) < ODD, WIDER**-2.0, 1.0)
        tau = (scatter / layout.spread[0])[:, None] / np.sqrt(weight)
        # level ~ N(0, 1), and the tests' values, in closed form
        told = 1.0 / (tau**2 + variance)
        precision = 1.0 + told.sum(axis=1)
        mean = (told @ y) / precision
        log = 0.5 * (np.log(told).sum(axis=1) - np.log(precision) - told @ y**2)
        log += 0.5 * precision * mean**2
        shares = np.exp(log - log.max())
        assert shares.sum() ** 2 / (shares**2).sum() > 5 * CHAINS
        pick = rng.choice(PROPOSED, CHAINS, p=shares / shares.sum())
        level = mean[pick] + rng.standard_normal(CHAINS) / np.sqrt(precision[pick])
        prior, likelihood = tau[pick] ** -2.0, 1.0 / variance
        middle = (prior * level[:, None] + likelihood * y) / (prior + likelihood)
        x = middle + rng.standard_normal(middle.shape) / np.sqrt(prior + likelihood)
        return cls(linear, np.log(scatter[pick]), level, weight[pick], x)

    def chains(self):
        layout = self.linear.layout
        h = np.zeros((CHAINS, layout.dim))
        h[:, 0] = self.log_scatter
        x = [self.x[:, j, None].copy() for j in range(self.x.shape[1])]
        density = [t.log_likelihood(v) for t, v in zip(self.linear.likelihoods(), x, strict=True)]
        return Chains(
            h,
            self.level[:, None, None].copy(),
            x,
            density,
            layout.draw_choice(CHAINS),
            self.weight[..., None].copy(),
            np.repeat(np.arange(4), CHAINS // 4),
        )


@pytest.fixture(scope="module")
def exact(make_linear):
    linear = make_linear((1.0,) * 5, ("offset",), seed=6)
    y = linear.y.copy()
    y[0, 0] += 6.0 * np.sqrt(linear.covariances[0, 0, 0]) + 0.1
    return Exact.of(replace(linear, layout=replace(linear.layout, odd=ODD), y=y))


def features(chains):
    x = np.concatenate(chains.x, axis=1)
    first = [chains.h[:, :1], chains.latent[:, 0], x, np.log(chains.weight[..., 0])]
    values = np.concatenate(first, axis=1)
    centred = values - values.mean(axis=0)
    return np.concatenate([values, centred**2, centred[:, :1] * centred[:, 1:]], axis=1)


def change(exact, kernel, times=20, layout=None):
    """Largest change of a moment by a kernel, in standard errors."""
    chains = exact.chains()
    before = features(chains)
    joint = Joint(layout or exact.linear.layout, exact.linear.likelihoods())
    sampler = Sampler(joint, np.random.default_rng(8))
    for _ in range(times):
        kernel(sampler, chains)
    after = features(chains)
    error = np.sqrt((before.var(axis=0) + after.var(axis=0)) / CHAINS)
    return float(np.max(np.abs(after.mean(axis=0) - before.mean(axis=0)) / error))


def weights(sampler, chains):
    hyperparameters.draw_weights(sampler.joint, chains, sampler.rng)


def hyper(sampler, chains):
    joint = sampler.joint
    density = joint.log_blocks(joint.given(chains), chains.h)
    hyperparameters.evolve_hyperparameters(joint, chains, sampler.rng, density)
    hyperparameters.draw_latent(sampler.joint, chains, sampler.rng)


def near(sampler, chains):
    one_test.step_near(sampler.joint, chains, sampler.rng, sampler.joint.conditional(chains))


def carried(sampler, chains):
    transport(sampler.joint, chains, sampler.rng, sampler.tuning, 0)


KERNELS = {
    "weights": weights,
    "hyper": hyper,
    "near": near,
    "transport": carried,
    "sweep": lambda sampler, chains: sampler.sweep(chains),
}


@pytest.mark.parametrize("name", KERNELS)
def test_a_move_keeps_tests_that_stand_apart(exact, name):
    assert change(exact, KERNELS[name]) < FAR


@pytest.mark.parametrize("name", ["weights", "sweep"])
def test_another_share_of_them_is_noticed(exact, name):
    layout = replace(exact.linear.layout, odd=0.02)
    assert change(exact, KERNELS[name], layout=layout) > 2 * FAR


def test_a_test_that_stands_apart_widens_the_scatter_less(make_linear):
    """Of eight tests one is 15 scatters away: the others' scatter is found nearly as without it."""
    linear = make_linear((1.0,) * 8, ("offset",), noise=0.1, seed=7)
    y = linear.y.copy()
    y[0, 0] += 15.0 * linear.layout.scatter_sd[0] * 0.5 / linear.layout.spread[0]

    def scatter(share, odd):
        layout = replace(linear.layout, odd=share)
        campaign = replace(linear, layout=layout, y=y if odd else linear.y)
        sampler = Sampler(Joint(layout, campaign.likelihoods()), np.random.default_rng(1))
        chains = sampler.start(128, 4)
        found = []
        for i in range(45):
            sampler.sweep(chains)
            found += [float(np.mean(np.exp(chains.h[:, 0])))] * (i >= 20)
        return np.mean(found)

    assert scatter(0.01, odd=True) < 1.3 * scatter(0.01, odd=False)
    assert scatter(0.0, odd=True) > 3.0 * scatter(0.0, odd=False)
