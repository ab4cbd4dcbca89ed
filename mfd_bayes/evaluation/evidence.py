"""Evidence (integral of a density) by importance sampling with an adaptive proposal."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.diagnostics import psis, tempering
from mfd_bayes.calibration.proposal import fit_mixture

Array = NDArray[np.float64]

DRAWS = 4000
"""Draws from each proposal."""

ROUNDS = 16
"""Largest number of proposals."""

SHARE = 0.1
"""Effective sample size, as a share of the draws, from which the next proposal is learned."""

ENOUGH = 0.6
"""Pareto k at which the proposal is good enough, with a margin below 0.7."""


def log_evidence(
    density: Callable[[Array], Array],
    draws: Array,
    log_weights: Array,
    rng: np.random.Generator,
) -> tuple[float, float]:
    """Log of the integral of a density, and the Pareto k of its importance weights.

    Population Monte Carlo (Cappé et al., 2004) with tempered weights (Koblents and Míguez,
    2015): a proposal is learned from weighted draws, new draws from it are weighted, and so on
    until k is small. While few draws have all the weight, a power of the weights is used.

    Parameters
    ----------
    density : callable
        Log density, unnormalised, (n, dim) -> (n,).
    draws : (n, dim)
        From a density not too different.
    log_weights : (n,)
        Log of the density over that of the draws, unnormalised.
    """
    best = (-np.inf, np.inf)
    for _ in range(ROUNDS):
        weights = special.softmax(tempering(log_weights, SHARE) * (log_weights - log_weights.max()))
        proposal = fit_mixture(draws, rng, weights)
        draws = proposal.draw(rng, DRAWS)
        log_weights = density(draws) - proposal.log_density(draws)
        if not np.any(np.isfinite(log_weights)):
            break
        k = psis(log_weights)[1]
        if k < best[1]:
            best = float(np.logaddexp.reduce(log_weights)) - np.log(DRAWS), k
        if k <= ENOUGH:
            break
    return best
