"""What the data of one test say about its parameters, and what comes only from the prior."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import effective_size
from mfd_bayes.calibration.posterior import Posterior

Array = NDArray[np.float64]

TRADE_OFF = 0.7  # absolute rank correlation from which two parameters trade off


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


@dataclass(frozen=True, eq=False)
class Identifiability:
    """What the data of a test say about its sampled parameters."""

    directions: Directions
    pairs: tuple[Pair, ...]  # strongest first


def identify(
    posterior: Posterior, values: Mapping[str, Array], prior: Mapping[str, Array]
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
