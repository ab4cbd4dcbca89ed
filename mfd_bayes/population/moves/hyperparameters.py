"""Moves of scatter, effects' sd and shapes, of the latent and of weights, given the tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.chains import Accepted, Chains
from mfd_bayes.population.joint import Joint
from mfd_bayes.population.layout import WIDER

Array = NDArray[np.float64]


def evolve_hyperparameters(
    joint: Joint, chains: Chains, rng: np.random.Generator, density: Array
) -> Accepted:
    """Differential evolution of h block by block, with levels and effects integrated out.

    The density of each chain's blocks, as `Joint.log_blocks` has it, is brought up to date.
    """
    block, everything = joint.layout.block, joint.given(chains)
    inferred = joint.layout.inferred
    sizes = np.maximum(np.bincount(block[inferred], minlength=len(joint.layout.groups)), 1)
    accepted: Accepted = []
    for half, first, second in chains.partners(rng):
        h = chains.h[half]
        scale = (2.38 / np.sqrt(2 * sizes))[block]
        scale = np.where(rng.random((len(half), 1)) < 0.2, 1.0, scale)
        jump = scale * (chains.h[first] - chains.h[second])
        proposed = h + jump + 1e-3 * inferred * rng.standard_normal(h.shape)
        old, new = density[half], joint.log_blocks(everything.of(half), proposed)
        yes = np.log(rng.random(old.shape)) + old < new  # (n, G)
        chains.h[half] = np.where(yes[:, block], proposed, h)
        density[half] = np.where(yes, new, old)
        accepted.append(("scatter and shapes", yes))
    return accepted


def draw_latent(joint: Joint, chains: Chains, rng: np.random.Generator) -> Accepted:
    """Levels and effects drawn from their Gaussian conditional density."""
    given = joint.latent_posterior(joint.given(chains), chains.h)
    noise = given.solved + rng.standard_normal(given.solved.shape)
    drawn = np.linalg.solve(np.swapaxes(given.factor, -1, -2), noise[..., None])[..., 0]
    chains.latent = np.zeros_like(chains.latent)
    chains.latent[:, joint.columns, np.arange(joint.d)[:, None]] = given.sd * drawn
    return []


def draw_weights(joint: Joint, chains: Chains, rng: np.random.Generator) -> Accepted:
    """Weights of the tests in the scatter, drawn from their conditional probabilities."""
    odd, differ = joint.layout.odd, np.flatnonzero(joint.layout.inferred[: joint.d])
    if odd == 0.0:
        return []
    away = joint.shared(chains) - joint.conditional(chains).means
    standard = (away / joint.layout.scatter(chains.h)[:, None])[..., differ]
    log_odds = np.log(odd / (1.0 - odd) / WIDER) + 0.5 * standard**2 * (1.0 - WIDER**-2.0)
    apart = rng.logistic(size=log_odds.shape) < log_odds
    chains.weight[..., differ] = np.where(apart, WIDER**-2.0, 1.0)
    return []
