"""Log evidence of a posterior from its draws, by bridge sampling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.diagnostics import measure_draws, psis
from mfd_bayes.calibration.modes import Density
from mfd_bayes.calibration.proposal import PARTS, fit_mixture, learn

Array = NDArray[np.float64]

PROPOSED = 4000  # draws from each of the two proposals
# Pareto k, and standard error in nats, above which a log evidence is not to be trusted. A bridge
# needs draws from the proposal that overlap with the posterior, not light tails: the usual 0.7 is
# the limit of importance weights alone
LARGEST_K, LARGEST_ERROR = 1.0, 0.5


@dataclass(frozen=True)
class Evidence:
    """Log of the integral of likelihood times prior, in nats."""

    value: float  # and its standard error
    error: float
    pareto_k: float  # of the proposal's importance weights: above 1 it misses a part

    @property
    def trusted(self) -> bool:
        """Whether Pareto k and error are small enough."""
        return self.pareto_k <= LARGEST_K and self.error <= LARGEST_ERROR


def log_evidence(
    density: Density, q: Array, log_prob: Array, walkers: int, rng: Generator
) -> Evidence:
    """Log evidence by bridge sampling (Meng and Wong, 1996; Gronau et al., 2017).

    A mixture of Student-t densities is fitted to one half of the chains. The bridge goes from it to
    the draws of the other half, which it has not seen. Then the halves change places, and the mean
    of both counts.
    """
    first, second = slice(0, None, 2), slice(1, None, 2)
    parts = [
        _bridge(density, q[fitted], q[kept], log_prob[kept], walkers, rng)
        for fitted, kept in ((first, second), (second, first))
    ]
    values, errors = np.array([(part.value, part.error) for part in parts]).T
    # the two may differ by more than their errors say, where a mixture misses something
    error = max(0.5 * float(np.hypot(*errors)), 0.5 * float(np.ptp(values)))
    return Evidence(float(values.mean()), error, max(part.pareto_k for part in parts))


def _bridge(
    density: Density, fitted: Array, kept: Array, log_prob: Array, walkers: int, rng: Generator
) -> Evidence:
    """Log evidence from the draws that are kept, with a proposal fitted to the others."""
    dim = fitted.shape[-1]
    flat = fitted.reshape(-1, dim)
    proposal = learn(flat, PARTS, rng, fit_mixture(flat, rng))
    proposed = proposal.draw(rng, PROPOSED)
    above = density(proposed) - proposal.log_density(proposed)
    below = log_prob - proposal.log_density(kept.reshape(-1, dim)).reshape(log_prob.shape)
    k = psis(above)[1]
    sizes = np.array([_size(below, walkers), PROPOSED])
    logs = np.log(sizes / sizes.sum())
    value = float(special.logsumexp(above) - np.log(PROPOSED))
    for _ in range(1000):
        before = value
        top = above - np.logaddexp(logs[0] + above, logs[1] + value)
        bottom = -np.logaddexp(logs[0] + below, logs[1] + value)
        value = float(special.logsumexp(top) - special.logsumexp(bottom))
        value += float(np.log(below.size / PROPOSED))
        if abs(value - before) < 1e-8:
            break
    # relative variances of both means (Frühwirth-Schnatter, 2004)
    top, bottom = np.exp(top - top.max()), np.exp(bottom - bottom.max())
    variance = (top.std() / top.mean()) ** 2 / PROPOSED
    variance += (bottom.std() / bottom.mean()) ** 2 / _size(bottom, walkers)
    return Evidence(value, float(np.sqrt(variance)), k)


def _size(values: Array, walkers: int) -> float:
    """Effective number of draws of a quantity (chain, draw)."""
    return max(float(measure_draws(values, walkers).ess_bulk[0]), 1.0)


def join_evidence(parts: Sequence[Evidence]) -> Evidence:
    """Log evidence of several tests that are fitted separately: the sum."""
    values, errors, k = np.array([(e.value, e.error, e.pareto_k) for e in parts]).T
    return Evidence(float(values.sum()), float(np.linalg.norm(errors)), float(k.max()))
