"""What the data of one test say about its parameters, and what comes only from the prior."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.diagnostics import effective_size
from mfd_bayes.calibration.posterior import Posterior

Array = NDArray[np.float64]

SENSITIVE = 0.05  # power-scaling sensitivity from which a posterior depends on its prior
TRADE_OFF = 0.7  # absolute rank correlation from which two parameters trade off
CONFLICT = "possible prior–data conflict"
PRIOR_LED = "strong prior or weak data"
SCALING = 1.01  # power α to which the prior or likelihood is raised; 1/α is used too


@dataclass(frozen=True, eq=False)
class Directions:
    """Combinations of parameters, ordered by how much the data say about them.

    The curvature of the log likelihood is that along each direction in prior units: the precision
    that the data add, as a multiple of the prior's.
    """

    names: tuple[str, ...]
    curvature: Array  # (dim,), largest first
    axes: Array  # (dim, dim), unit vectors in prior units, one column for each direction
    limit: float = 1.0  # from which a direction is informed; more where there are few draws

    @property
    def informed(self) -> int:
        """Number of directions about which the data say more than the prior."""
        return int(np.sum(self.curvature > self.limit))

    def carriers(self, direction: int) -> tuple[str, ...]:
        """Parameters that contribute most to a direction, strongest first, at most three."""
        share = self.axes[:, direction] ** 2
        return tuple(self.names[i] for i in np.argsort(-share)[:3] if share[i] >= 0.1)


@dataclass(frozen=True)
class Pair:
    """Two parameters that trade off, and the rank correlation of their draws."""

    first: str
    second: str
    correlation: float


@dataclass(frozen=True)
class Sensitivity:
    """How strongly a parameter's posterior depends on the prior and on the likelihood."""

    name: str
    prior: float  # power-scaling sensitivities, with the part due to chance removed
    likelihood: float
    # `SENSITIVE`, or twice what chance gives with this number of draws
    prior_limit: float = SENSITIVE
    likelihood_limit: float = SENSITIVE

    @property
    def diagnosis(self) -> str:
        """`CONFLICT`, `PRIOR_LED` or "", as Kallioinen et al. tell them apart."""
        if self.prior <= self.prior_limit:
            return ""
        return CONFLICT if self.likelihood > self.likelihood_limit else PRIOR_LED


@dataclass(frozen=True, eq=False)
class Identifiability:
    """What the data of a test say about its sampled parameters."""

    directions: Directions
    pairs: tuple[Pair, ...]  # strongest first
    sensitivities: tuple[Sensitivity, ...]  # in the order of the posterior's names


def identify(
    posterior: Posterior,
    values: Mapping[str, Array],
    prior: Mapping[str, Array],
    log_prior: Array,
    log_likelihood: Array,
) -> Identifiability:
    """Identifiability of a test's sampled parameters, from its stored draws.

    Everything is on the scale on which each prior is sampled, the logarithm for most: there
    the priors are independent, and a prior raised to a power widens about its median.
    """
    names = posterior.names
    draws = np.stack([posterior.priors[n].coordinate(values[n]) for n in names])
    width = np.array([posterior.priors[n].coordinate(prior[n]).std() for n in names])
    flat = draws.reshape(len(names), -1).T
    size = np.min(np.nan_to_num([effective_size(coordinate) for coordinate in draws], nan=0.0))
    return Identifiability(
        directions=find_directions(names, width, flat, float(size)),
        pairs=find_pairs(names, flat),
        sensitivities=measure_sensitivity(names, draws, log_prior, log_likelihood),
    )


def find_directions(
    names: tuple[str, ...], prior_sd: Array, draws: Array, size: float = np.inf
) -> Directions:
    """Directions that the data inform, from the covariance of posterior draws.

    With prior covariance C0 = diag(prior_sd²) and posterior covariance C, the likelihood's
    curvature in prior units is H = C0^½ C⁻¹ C0^½ − I, and its eigenvectors are the directions
    that the data inform (Spantini et al., SIAM J. Sci. Comput. 37, 2015; Cui et al., Inverse
    Problems 30, 2014). That is exact for a linear model with Gaussian prior and noise.
    Otherwise it holds for the Gaussian with the posterior's covariance: it describes the whole
    posterior, where derivatives at a mode describe one point. A negative eigenvalue means a
    posterior wider than its prior.
    """
    covariance = np.atleast_2d(np.cov(draws / prior_sd, rowvar=False))
    variances, axes = np.linalg.eigh(covariance)  # smallest first: best known first
    curvature = 1.0 / np.maximum(variances, np.finfo(float).tiny) - 1.0
    limit = least_curvature(len(names), min(size, len(draws)))
    return Directions(names, np.asarray(curvature), np.asarray(axes), limit)


def least_curvature(dim: int, size: float) -> float:
    """Curvature that a sample must show before a direction counts as informed.

    The smallest eigenvalue of the covariance of few draws is too small. With γ = dim/n, and a true
    variance of 1 in all directions but one, of λ there, a sample shows λ (1 − γ/(1 − λ)) if λ is
    below 1 − √γ, and cannot tell it from the Marchenko–Pastur edge (1 − √γ)² of the others if not
    (Baik and Silverstein, J. Multivar. Anal. 97, 2006). Here λ = ½, a curvature of 1. Chance
    moves the edge by about n^(−2/3) (Tracy and Widom): twice that is kept clear of it.
    """
    share = dim / max(size, 1e-9)
    if share >= 1.0:
        return np.inf
    edge = (1.0 - np.sqrt(share)) ** 2
    step = (1.0 - np.sqrt(share)) ** (4.0 / 3.0) * share ** (-1.0 / 6.0) * size ** (-2.0 / 3.0)
    clear = max(edge - 2.0 * step, 0.0)
    shown = 0.5 * (1.0 - 2.0 * share) if share < 0.25 else edge
    smallest = min(shown, clear)
    return float(1.0 / smallest - 1.0) if smallest > 0.0 else np.inf


def find_pairs(names: tuple[str, ...], draws: Array) -> tuple[Pair, ...]:
    """Pairs whose posterior draws (n, dim) have a rank correlation of ±0.7 or beyond."""
    from scipy.stats import rankdata  # which takes long to import

    with np.errstate(invalid="ignore"):  # draws that never move have no correlation
        correlation = np.atleast_2d(np.corrcoef(rankdata(draws, axis=0), rowvar=False))
    pairs = [
        Pair(names[i], names[j], float(correlation[i, j]))
        for i, j in itertools.combinations(range(len(names)), 2)
        if abs(correlation[i, j]) >= TRADE_OFF
    ]
    return tuple(sorted(pairs, key=lambda pair: -abs(pair.correlation)))


def measure_sensitivity(
    names: tuple[str, ...], draws: Array, log_prior: Array, log_likelihood: Array
) -> tuple[Sensitivity, ...]:
    """Power-scaling sensitivity of every parameter to the whole prior and the likelihood.

    The prior, or the likelihood, is raised to α = 1.01 and 1/1.01 by weighting the draws with
    p^(α − 1). The sensitivity is the rate at which each marginal posterior changes,
    ½ (d(α) + d(1/α)) / log2 α, with d the cumulative Jensen–Shannon distance (Kallioinen,
    Paananen, Bürkner, Vehtari, Stat. Comput. 34:57, 2024). With α so near
    to 1 the weights differ by a few percent (their Pareto k is about α − 1 where p has
    Gaussian tails) and need no Pareto smoothing.

    By chance d is positive even without any dependence. This part is measured by applying
    the weights of one chain to the draws of another, independent one, and its square is
    subtracted from the squared sensitivity.
    """
    chains = draws.shape[1]
    weights = np.concatenate([_scaled_weights(p) for p in (log_prior, log_likelihood)])
    rolled = [np.roll(weights, shift, axis=1).reshape(4, -1) for shift in range(chains)]
    sensitivities = []
    for name, own in zip(names, draws, strict=True):
        distance = cjs_distance(own.reshape(-1), np.concatenate(rolled))
        speed = distance.reshape(chains, 2, 2).mean(axis=2) / np.log2(SCALING)
        chance = np.mean(speed[1:] ** 2, axis=0)
        prior, likelihood = np.sqrt(np.maximum(speed[0] ** 2 - chance, 0.0))
        limits = np.maximum(SENSITIVE, 2.0 * np.sqrt(chance))
        figures = map(float, (prior, likelihood, *limits))
        sensitivities.append(Sensitivity(name, *figures))
    return tuple(sensitivities)


def _scaled_weights(log_density: Array) -> Array:
    """Weights of draws where a density is raised to α and to 1/α, (2, chain, draw)."""
    powers = np.array([SCALING, 1.0 / SCALING]) - 1.0
    log_weights = powers[:, None, None] * (log_density - log_density.mean())
    weights: Array = np.exp(log_weights - log_weights.max(axis=(1, 2), keepdims=True))
    return weights


def cjs_distance(draws: Array, weights: Array) -> Array:
    """Cumulative Jensen–Shannon distance of weighted draws from the draws themselves.

    With P and Q the two distribution functions, M = (P + Q)/2 and
    D(P‖M) = ∫ P log2(P/M) + (M − P)/ln 2 dx, it is √[(D(P‖M) + D(Q‖M)) / ∫ P + Q dx],
    computed for x and for −x, of which the larger counts (Nguyen and Vreeken, ECML PKDD 2015; as
    Kallioinen et al. and ArviZ use it).
    """
    order = np.argsort(draws)
    width = np.diff(draws[order])
    there = np.arange(1, draws.size) / draws.size
    total = np.cumsum(weights[:, order], axis=1)
    moved = np.clip(total[:, :-1] / total[:, -1:], 0.0, 1.0)
    ways = [_distance(there, moved, width), _distance(1.0 - there, 1.0 - moved, width)]
    return np.asarray(np.maximum(*ways))


def _distance(p: Array, q: Array, width: Array) -> Array:
    middle = 0.5 * (p + q)
    divergence = (special.kl_div(p, middle) + special.kl_div(q, middle)) @ width
    size = (p + q) @ width
    distance: Array = np.sqrt(divergence / (np.log(2.0) * np.maximum(size, np.finfo(float).tiny)))
    return distance
