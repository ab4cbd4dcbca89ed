"""Proposal densities for independence sampling, learned from draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.least_squares import fit_all

Array = NDArray[np.float64]

DRAWS = 8000
"""Largest number of draws used in a fit."""

WIDE = 0.1
"""Weight of the wide component that keeps a learned proposal's tails above the target's."""

ANCHORED = 0.25
"""Weight of the anchors in a learned proposal."""

BENT = 1.5
"""Bound on the parameters of a coordinate's warp, so that few draws cannot distort it much."""

LOOSE = 0.01
"""Misfit of one quantile, in arcsinh of the normal coordinate, that weighs as much as a parameter
of size 1: small, so that the fit of the quantiles decides."""

SHRINKAGE = 2.0
"""Pseudo-draws per dimension that shrink each component's covariance to the overall one."""


PROBABILITIES = np.array([0.01, 0.025, 0.07, 0.16, 0.31, 0.5, 0.69, 0.84, 0.93, 0.975, 0.99])
"""Probabilities of the quantiles to which each coordinate's warp is fitted."""


class Proposal(Protocol):
    """A density that can be drawn from and evaluated."""

    def log_density(self, q: Array) -> Array:
        """Normalised log density, (n, dim) -> (n,)."""

    def draw(self, random: np.random.RandomState, n: int) -> Array:
        """Independent draws, (n, dim)."""


def log_sum_exp(terms: Array, weights: Array) -> Array:
    """Logarithm of the weighted sum of exponentials over the first axis, (k, n) -> (n,).

    SciPy's `logsumexp` gives the same bits, but looks at its arguments for longer than it
    computes: the sampler needs some such sums of a few hundred terms in every step.

    Parameters
    ----------
    weights : (k,)
        Not negative; where one is zero, its terms do not count.
    """
    weights = weights[:, None]
    if not weights.all():
        terms = np.where(weights > 0.0, terms, -np.inf)
    largest = terms.max(axis=0)
    top = terms == largest
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        at_top = (weights * top).sum(axis=0)
        below = (weights * np.exp(np.where(top, -np.inf, terms) - largest)).sum(axis=0)
        share = np.where(below == 0.0, below, below / at_top)
        total: Array = np.log1p(share) + np.log(at_top) + largest
        if not np.isfinite(total).all():
            plain = np.log((weights * np.exp(terms)).sum(axis=0))
            total = np.where(np.isfinite(total), total, plain)
    return total


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
        return log_sum_exp(parts, self.weights)

    def draw(self, random: np.random.RandomState, n: int) -> Array:
        """Independent draws, (n, dim); from a RandomState, as emcee's moves use."""
        part = random.choice(self.weights.size, size=n, p=self.weights)
        normal = random.standard_normal((n, self.dim))
        normal /= np.sqrt(random.chisquare(self.dof[part]) / self.dof[part])[:, None]
        draws: Array = self.means[part] + np.einsum("nij,nj->ni", self.factors[part], normal)
        return draws


@dataclass(frozen=True, eq=False)
class Warp:
    """Map of each coordinate separately to an approximately standard normal one, (dim,) each.

    z = sinh(tail asinh((q − centre)/scale) − skew), after Jones and Pewsey (2009): smooth,
    one-to-one, with an explicit inverse.
    """

    centre: Array
    scale: Array
    skew: Array
    tail: Array

    @classmethod
    def of(cls, draws: Array) -> Warp:
        """Map fitted so that quantiles of the draws (n, dim) become those of the normal."""
        target = special.ndtri(PROBABILITIES)
        quantiles = np.quantile(draws, PROBABILITIES, axis=0).T
        middle = quantiles[:, quantiles.shape[1] // 2]
        spread = np.maximum(quantiles[:, -1] - quantiles[:, 0], 1e-12) / (target[-1] - target[0])
        places = (quantiles - middle[:, None]) / spread[:, None]

        def misfit(w: Array, coordinates: NDArray[np.intp]) -> Array:
            shift, width, tail, skew = w.T[:, :, None]
            scaled = np.arcsinh((places[coordinates] - shift) * np.exp(-width))
            gap: Array = (np.exp(tail) * scaled - skew - np.arcsinh(target)) / LOOSE
            return gap

        shift, width, tail, skew = fit_all(misfit, np.zeros((len(middle), 4)), BENT).T
        return cls(middle + spread * shift, spread * np.exp(width), skew, np.exp(tail))

    def normal(self, q: Array) -> tuple[Array, Array]:
        """Standard coordinates, (n, dim), and the log of the map's Jacobian, (n,)."""
        y = (q - self.centre) / self.scale
        bent = self.tail * np.arcsinh(y) - self.skew
        slope = np.log(self.tail * np.cosh(bent) / (self.scale * np.hypot(1.0, y)))
        return np.sinh(bent), slope.sum(axis=1)

    def original(self, z: Array) -> Array:
        """The inverse of `normal`, (n, dim)."""
        return self.centre + self.scale * np.sinh((np.arcsinh(z) + self.skew) / self.tail)


@dataclass(frozen=True, eq=False)
class Warped:
    """A mixture in warped coordinates."""

    mixture: Mixture
    warp: Warp

    def log_density(self, q: Array) -> Array:
        """Normalised log density, (n, dim) -> (n,)."""
        z, slope = self.warp.normal(q)
        return self.mixture.log_density(z) + slope

    def draw(self, random: np.random.RandomState, n: int) -> Array:
        """Independent draws, (n, dim)."""
        return self.warp.original(self.mixture.draw(random, n))


@dataclass(frozen=True, eq=False)
class Either:
    """A weighted mixture of several proposals."""

    weights: Array
    parts: Sequence[Proposal]

    def log_density(self, q: Array) -> Array:
        """Normalised log density, (n, dim) -> (n,)."""
        densities = np.stack([part.log_density(q) for part in self.parts])
        return log_sum_exp(densities, self.weights)

    def draw(self, random: np.random.RandomState, n: int) -> Array:
        """Independent draws, (n, dim)."""
        counts = random.multinomial(n, self.weights)
        draws = [part.draw(random, k) for part, k in zip(self.parts, counts, strict=True)]
        return np.concatenate(draws)[random.permutation(n)]


def learn(
    draws: Array, parts: int, rng: np.random.Generator, anchors: Proposal | None = None
) -> Proposal:
    """Proposal that resembles the draws and is somewhat wider.

    Each coordinate is first warped separately to approximate normality. Normal components
    are fitted by expectation–maximization, with covariances shrunk to that of all draws, and
    then given Student-t tails. Some weight goes to a wide component and some to the anchors,
    so that the proposal still reaches regions that the draws have not visited.

    Parameters
    ----------
    draws : (n, dim)
    parts : int
        Number of components, reduced when there are few draws.
    anchors : Proposal, optional
        A proposal that stays part of the result, such as one around the modes.
    """
    if len(draws) > DRAWS:
        draws = draws[rng.choice(len(draws), DRAWS, replace=False)]
    warp = Warp.of(draws)
    z, _ = warp.normal(draws)
    mean = z.mean(axis=0)
    covariance = np.atleast_2d(np.cov(z.T)) + 1e-8 * np.eye(z.shape[1])
    factor = np.linalg.cholesky(covariance)
    standard = np.linalg.solve(factor, (z - mean).T).T
    weights, means, covariances = _expectation_maximization(standard, parts, rng)
    mixture = Mixture.of(
        np.append((1.0 - WIDE) * weights, WIDE),
        np.vstack([mean + means @ factor.T, mean]),
        np.concatenate([1.1 * factor @ covariances @ factor.T, 1.5 * covariance[None]]),
        np.append(np.full(len(weights), 30.0), 8.0),
    )
    found = Warped(mixture, warp)
    return (
        found if anchors is None else Either(np.array([1.0 - ANCHORED, ANCHORED]), (found, anchors))
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
