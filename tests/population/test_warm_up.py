"""Chains that are lost in the warm-up start again from others."""

import numpy as np
import pytest

from mfd_bayes.population.chains import Chains
from mfd_bayes.population.warm_up import rescue

ENSEMBLE = np.repeat([0, 1], 8)


def chains_of(log_likelihood):
    """Chains whose states are their numbers, 16 in two ensembles, with two tests."""
    number = np.arange(16.0)
    state = number[:, None]
    half = 0.5 * np.asarray(log_likelihood, dtype=np.float64)
    return Chains(
        h=state.copy(),
        latent=state[..., None].copy(),
        x=[state.copy(), 10.0 * state],
        log_density=[half.copy(), half.copy()],
        choice=np.arange(16)[:, None],
        weight=state[..., None].copy(),
        ensemble=ENSEMBLE,
    )


def rescued(log_likelihood):
    """Number of the chain that each has the state of."""
    chains = chains_of(log_likelihood)
    rescue(chains, np.random.default_rng(0))
    now = chains.h[:, 0]
    np.testing.assert_array_equal(chains.x[1][:, 0], 10.0 * now)
    np.testing.assert_array_equal(chains.latent[:, 0, 0], now)
    np.testing.assert_array_equal(chains.weight[:, 0, 0], now)
    np.testing.assert_array_equal(chains.log_density[0], 0.5 * log_likelihood[now.astype(int)])
    np.testing.assert_array_equal(chains.choice[:, 0], np.arange(16))  # its law stays
    return now.astype(int)


@pytest.mark.parametrize("lost", [-26000.0, -np.inf, np.nan])
def test_a_lost_chain_goes_on_from_another_of_its_ensemble(lost):
    height = np.full(16, 300.0)
    height[11] = lost
    now = rescued(height)
    assert now[11] in set(range(8, 16)) - {11}
    assert now[np.arange(16) != 11].tolist() == [i for i in range(16) if i != 11]


def test_chains_that_are_only_late_stay():
    height = 300.0 - 25.0 * np.arange(16)  # 375 from best to worst
    np.testing.assert_array_equal(rescued(height), np.arange(16))


def test_an_ensemble_that_is_lost_but_for_one_goes_on_from_that():
    height = np.where(np.arange(16) < 9, 300.0, -1e5)
    assert rescued(height).tolist() == [*range(9), *[8] * 7]


def test_an_ensemble_that_is_lost_altogether_goes_on_from_others():
    ensembles = np.repeat([0, 1, 2], [6, 6, 4])
    height = np.where(ensembles == 2, -1e5, 300.0)
    chains = chains_of(height)
    chains.ensemble = ensembles
    rescue(chains, np.random.default_rng(0))
    now = chains.h[:, 0]
    assert now[:12].tolist() == list(range(12))
    assert set(now[12:]) <= set(range(12))
