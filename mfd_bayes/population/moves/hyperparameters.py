"""Moves of scatter, effects' sd and shapes, and of the latent, given the tests' coordinates."""

from __future__ import annotations

import numpy as np

from mfd_bayes.population.chains import Accepted, Chains
from mfd_bayes.population.joint import Joint


def evolve_hyperparameters(joint: Joint, chains: Chains, rng: np.random.Generator) -> Accepted:
    """Differential evolution of h block by block, with levels and effects integrated out."""
    block, x = joint.layout.block, joint.shared(chains)
    sizes = np.bincount(block, minlength=len(joint.layout.groups))
    accepted: Accepted = []
    for half, first, second in chains.partners(rng):
        h = chains.h[half]
        scale = (2.38 / np.sqrt(2 * sizes))[block]
        scale = np.where(rng.random((len(half), 1)) < 0.2, 1.0, scale)
        jump = scale * (chains.h[first] - chains.h[second])
        proposed = h + jump + 1e-3 * rng.standard_normal(h.shape)
        given = chains.choice[half], x[half]
        old, new = joint.log_blocks(h, *given), joint.log_blocks(proposed, *given)
        yes = np.log(rng.random(old.shape)) + old < new  # (n, G)
        chains.h[half] = np.where(yes[:, block], proposed, h)
        accepted.append(("scatter and shapes", yes))
    return accepted


def draw_latent(joint: Joint, chains: Chains, rng: np.random.Generator) -> Accepted:
    """Levels and effects drawn from their Gaussian conditional density."""
    given = joint.latent_posterior(chains.h, chains.choice, joint.shared(chains))
    noise = given.solved + rng.standard_normal(given.solved.shape)
    drawn = np.linalg.solve(np.swapaxes(given.factor, -1, -2), noise[..., None])[..., 0]
    chains.latent = np.swapaxes(given.sd * drawn, 1, 2)
    return []
