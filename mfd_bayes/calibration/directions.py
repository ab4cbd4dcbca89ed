"""Combinations of parameters about which the data of a test say something."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LOADED = 0.1  # least share of a direction's squared length for a parameter to carry it
_CARRIERS = 3


@dataclass(frozen=True, eq=False)
class Directions:
    """Combinations of parameters, ordered by how much the data say about them.

    Attributes
    ----------
    curvature : (dim,)
        Curvature of the log likelihood along each direction in prior units: the precision
        that the data add, as a multiple of the prior's; largest first.
    axes : (dim, dim)
        Unit vectors in prior units, one column for each direction.
    limit : float
        Curvature from which a direction is informed: 1, or more where so few draws show more
        than 1 by chance.
    """

    names: tuple[str, ...]
    curvature: Array
    axes: Array
    limit: float = 1.0

    @property
    def informed(self) -> int:
        """Number of directions about which the data say more than the prior."""
        return int(np.sum(self.curvature > self.limit))

    @property
    def narrowing(self) -> Array:
        """Ratio of prior to posterior width along each direction, (dim,)."""
        times: Array = np.sqrt(1.0 + self.curvature)
        return times

    def carriers(self, direction: int) -> tuple[str, ...]:
        """Parameters that contribute most to a direction, strongest first, at most three."""
        share = self.axes[:, direction] ** 2
        order = np.argsort(-share)[:_CARRIERS]
        return tuple(self.names[i] for i in order if share[i] >= _LOADED)


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

    Parameters
    ----------
    prior_sd : (dim,)
        Standard deviations of the coordinates, which are independent under the prior.
    draws : (n, dim)
        Posterior draws of the coordinates.
    size : float
        How many independent draws they are worth, if fewer than n.
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

    Parameters
    ----------
    dim : int
    size : float
        Number n of independent draws that the draws are worth.
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
