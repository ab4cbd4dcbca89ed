"""Mixtures of Student-t densities: what an independence proposal is drawn from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import special

Array = NDArray[np.float64]

DRAWS = 4000
"""Draws that a fit uses at most."""

WIDE = 0.1
"""Weight of the wide part that keeps a learned proposal's tails above the target's."""

SHRINKAGE = 2.0
"""Draws per dimension that the covariance of all of them counts for in each part's own."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """Weighted Student-t densities in `dim` dimensions.

    Attributes
    ----------
    weights : (k,)
    means : (k, dim)
    factors : (k, dim, dim)
        Lower Cholesky factors of the scale matrices.
    dof : (k,)
        Degrees of freedom.
    """

    weights: Array
    means: Array
    factors: Array
    dof: Array

    @classmethod
    def of(cls, weights: Array, means: Array, covariances: Array, dof: Array) -> Mixture:
        """Mixture with scale matrices (k, dim, dim)."""
        factors: Array = np.asarray(np.linalg.cholesky(covariances), dtype=np.float64)
        return cls(weights, means, factors, dof)

    @property
    def dim(self) -> int:
        """Number of dimensions."""
        return int(self.means.shape[1])

    @cached_property
    def _inverses(self) -> Array:
        inverses = np.asarray(np.linalg.inv(self.factors), dtype=np.float64)
        return inverses.transpose(0, 2, 1)

    @cached_property
    def _constants(self) -> Array:
        log_det = np.log(np.diagonal(self.factors, axis1=1, axis2=2)).sum(axis=1)
        constants: Array = special.gammaln(0.5 * (self.dof + self.dim))
        constants -= special.gammaln(0.5 * self.dof)
        constants -= 0.5 * self.dim * np.log(self.dof * np.pi) + log_det
        return constants

    def log_density(self, q: Array) -> Array:
        """Normalised log density, (n, dim) -> (n,)."""
        standard = (q - self.means[:, None]) @ self._inverses
        squares = np.einsum("kni,kni->kn", standard, standard)
        dof = self.dof[:, None]
        parts = self._constants[:, None] - 0.5 * (dof + self.dim) * np.log1p(squares / dof)
        density: Array = special.logsumexp(parts, axis=0, b=self.weights[:, None])
        return density

    def draw(self, random: np.random.RandomState, n: int) -> Array:
        """Independent draws, (n, dim); emcee's moves draw from a RandomState."""
        part = random.choice(self.weights.size, size=n, p=self.weights)
        normal = random.standard_normal((n, self.dim))
        normal /= np.sqrt(random.chisquare(self.dof[part]) / self.dof[part])[:, None]
        draws: Array = self.means[part] + np.einsum("nij,nj->ni", self.factors[part], normal)
        return draws


def learn(
    draws: Array, parts: int, rng: np.random.Generator, anchors: Mixture | None = None
) -> Mixture:
    """Mixture that resembles draws, somewhat wider than they are.

    Parts are normal while they are fitted, by expectation–maximization with covariances
    shrunk to that of all draws, and given tails after it. A tenth of the weight goes to a
    wide part, and a twentieth to the anchors, so that a proposal goes on reaching places
    that the draws have not seen.

    Parameters
    ----------
    draws : (n, dim)
    parts : int
    rng : numpy.random.Generator
    anchors : Mixture, optional
        Such as the modes' own.
    """
    if len(draws) > DRAWS:
        draws = draws[rng.choice(len(draws), DRAWS, replace=False)]
    mean = draws.mean(axis=0)
    covariance = np.atleast_2d(np.cov(draws.T))
    scale = np.sqrt(np.diag(covariance)) + 1e-12
    covariance += 1e-8 * np.diag(scale**2)
    factor = np.linalg.cholesky(covariance)
    standard = np.linalg.solve(factor, (draws - mean).T).T
    weights, means, covariances = _expectation_maximization(standard, parts, rng)
    found = Mixture.of(
        np.append((1.0 - WIDE) * weights, WIDE),
        np.vstack([mean + means @ factor.T, mean]),
        np.concatenate([1.1 * factor @ covariances @ factor.T, 2.0 * covariance[None]]),
        np.append(np.full(len(weights), 12.0), 4.0),
    )
    if anchors is None:
        return found
    return Mixture(
        np.concatenate([0.95 * found.weights, 0.05 * anchors.weights]),
        np.concatenate([found.means, anchors.means]),
        np.concatenate([found.factors, anchors.factors]),
        np.concatenate([found.dof, anchors.dof]),
    )


def _expectation_maximization(
    standard: Array, parts: int, rng: np.random.Generator, rounds: int = 12
) -> tuple[Array, Array, Array]:
    """Weights, means and covariances of a normal mixture of whitened draws."""
    n, dim = standard.shape
    parts = max(1, min(parts, n // (4 * dim)))
    means = standard[rng.choice(n, parts, replace=False)]
    covariances = np.tile(0.7 * np.eye(dim), (parts, 1, 1))
    weights = np.full(parts, 1.0 / parts)
    for _ in range(rounds if parts > 1 else 1):
        factors = np.linalg.cholesky(covariances)
        inverses = np.linalg.inv(factors).transpose(0, 2, 1)
        away = (standard - means[:, None]) @ inverses
        logs = -0.5 * np.einsum("kni,kni->kn", away, away)
        logs -= np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(axis=1)[:, None]
        shares = special.softmax(logs + np.log(weights)[:, None], axis=0)
        mass = shares.sum(axis=1) + 1e-9
        means = (shares @ standard) / mass[:, None]
        away = (standard - means[:, None]) * np.sqrt(shares)[..., None]
        own = away.transpose(0, 2, 1) @ away
        prior = SHRINKAGE * dim
        shrunk = own + 0.5 * prior * np.eye(dim)
        covariances = shrunk / (mass + prior)[:, None, None]
        weights = mass / mass.sum()
    return weights, means, covariances
