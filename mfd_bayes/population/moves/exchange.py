"""Exchange of states between chains and companions, which sample surrogates of the likelihoods.

Each chain has a companion. Companions sample the joint posterior with a surrogate in place of every
test's likelihood, several sweeps in the time of one. Then chain and companion exchange all that
they hold, with the probability at which both keep their densities (Metropolis–Hastings for a pair
of chains, as in parallel tempering: Geyer, 1991). How near the surrogates are changes how often an
exchange is accepted, and nothing else.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.chains import Accepted, Chains
from mfd_bayes.population.joint import Joint

Array = NDArray[np.float64]


def exchange(
    joint: Joint, chains: Chains, beside: Joint, companions: Chains, rng: np.random.Generator
) -> Accepted:
    """Exchange states, each chain with its companion, in place.

    Parameters
    ----------
    joint, beside : Joint
        The density that the chains sample, and that of the companions: they differ by the tests'
        likelihoods alone.
    chains, companions : Chains
        Of the same laws.
    rng : numpy.random.Generator
    """
    true = list(joint.evaluate(enumerate(companions.x)))
    near = list(beside.evaluate(enumerate(chains.x)))
    gain = _gain(true, chains, near, companions)
    yes = np.isfinite(gain) & (np.log(rng.random(len(gain))) < gain)
    pairs = [
        (chains.h, companions.h),
        (chains.latent, companions.latent),
        (chains.weight, companions.weight),
        *zip(chains.x, companions.x, strict=True),
    ]
    for one, other in pairs:
        one[yes], other[yes] = other[yes], one[yes]
    for j, found in enumerate(true):
        chains.log_density[j][yes] = found[yes]
        companions.log_density[j][yes] = near[j][yes]
    return [("exchange", yes)]


def _gain(true: list[Array], chains: Chains, near: list[Array], companions: Chains) -> Array:
    """Log density of both after an exchange less that before, (n,)."""
    after = np.sum(true, axis=0) + np.sum(near, axis=0)
    before = np.sum(chains.log_density, axis=0) + np.sum(companions.log_density, axis=0)
    return np.asarray(after - before)
