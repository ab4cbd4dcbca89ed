"""A mixture of Student-t densities that is fitted to a density: by which draws are proposed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.diagnostics import psis, tempering
from mfd_bayes.calibration.least_squares import least_squares
from mfd_bayes.errors import FitError

Array = NDArray[np.float64]
Density = Callable[[Array], Array]

DOF = 5.0
"""Degrees of freedom of a fitted component: few, or the tails of a bent density are missed."""

WIDE = 0.2
"""Weight of the component that is wider than all draws, so that no tail is left out."""

SHRINKAGE = 2.0
"""Draws for each dimension that shrink a component's covariance to that of all components."""

PARTS = 12
"""Largest number of components of a fit, besides the wide one."""

SHARE = 0.1
"""Effective number of draws, as a share of all, from which a proposal is fitted at least."""


FIRST = 0.05
"""Weight of the first proposal in all others."""

ANCHORED = 0.25
"""Weight of the anchors in a learned proposal."""

TAIL = 0.1
"""Weight of the wide component of a learned proposal."""

LEARNED = 8000
"""Largest number of draws from which a proposal is learned."""

BENT = 1.5
"""Bound on the parameters of a coordinate's warp, so that few draws cannot distort it much."""

LOOSE = 0.01
"""Misfit of one quantile, in arcsinh of the normal coordinate, that weighs as much as a parameter
of size 1: small, so that the fit of the quantiles decides."""

PROBABILITIES = np.array([0.01, 0.025, 0.07, 0.16, 0.31, 0.5, 0.69, 0.84, 0.93, 0.975, 0.99])
"""Probabilities of the quantiles to which each coordinate's warp is fitted."""


class Proposal(Protocol):
    """A density that can be drawn from and evaluated."""

    def log_density(self, q: Array) -> Array:
        """Normalised log density, (n, dim) -> (n,)."""

    def draw(self, rng: Any, n: int) -> Array:
        """Independent draws, (n, dim), of a Generator or a RandomState."""


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

    @cached_property
    def _whitening(self) -> tuple[Array, Array, Array]:
        """What makes all components standard at once: (dim, k dim), (k dim,); log constants."""
        dim = self.means.shape[1]
        inverses: Array = np.asarray(np.linalg.inv(self.factors), dtype=np.float64)
        places = np.einsum("kij,kj->ki", inverses, self.means).reshape(-1)
        constants = special.gammaln(0.5 * (self.dof + dim)) - special.gammaln(0.5 * self.dof)
        constants -= 0.5 * dim * np.log(self.dof * np.pi)
        constants += np.log(np.diagonal(inverses, axis1=1, axis2=2)).sum(axis=1)
        return inverses.reshape(-1, dim).T, places, constants + np.log(self.weights)

    def log_parts(self, q: Array) -> Array:
        """Log density of every component, with its weight, at points (n, dim), (k, n)."""
        whitening, places, constants = self._whitening
        standard = (q @ whitening - places).reshape(len(q), *self.means.shape)
        squares = np.einsum("nki,nki->kn", standard, standard)
        dof, dim = self.dof[:, None], self.means.shape[1]
        parts: Array = constants[:, None] - 0.5 * (dof + dim) * np.log1p(squares / dof)
        return parts

    def log_density(self, q: Array) -> Array:
        """Normalised log density, (n, dim) -> (n,)."""
        return np.asarray(special.logsumexp(self.log_parts(q), axis=0))

    def draw(self, rng: Any, n: int) -> Array:
        """Independent draws, (n, dim), of a Generator or a RandomState."""
        part = rng.choice(self.weights.size, size=n, p=self.weights)
        normal = rng.standard_normal((n, self.means.shape[1]))
        normal /= np.sqrt(rng.chisquare(self.dof[part]) / self.dof[part])[:, None]
        draws: Array = self.means[part] + np.einsum("nij,nj->ni", self.factors[part], normal)
        return draws


def joined(mixtures: Sequence[Mixture], shares: Sequence[float]) -> Mixture:
    """Mixture of several mixtures, of which each has a share; the shares sum to 1."""
    weights = [share * m.weights for share, m in zip(shares, mixtures, strict=True)]
    fields = ("means", "factors", "dof")
    rest = ([getattr(m, name) for m in mixtures] for name in fields)
    return Mixture(np.concatenate(weights), *map(np.concatenate, rest))


def fit_mixture(
    draws: Array, rng: np.random.Generator, weights: Array | None = None, rounds: int = 10
) -> Mixture:
    """Mixture that resembles draws and is somewhat wider, by expectation-maximisation.

    Each covariance is shrunk to the mean one of all components: so a narrow component is not made
    wide by the distance of others, and few draws do not make one too narrow.

    Parameters
    ----------
    draws : (n, dim)
    weights : (n,), optional
        Of the draws; they sum to 1.
    """
    shares = np.full(len(draws), 1.0 / len(draws)) if weights is None else weights
    heavy = shares > 1e-2 / len(draws)  # the rest weighs less than 1 % together
    draws, shares = draws[heavy], shares[heavy] / shares[heavy].sum()
    n, dim = draws.shape
    size = 1.0 / float(np.sum(shares**2))
    middle = shares @ draws
    away = (draws - middle) * np.sqrt(shares)[:, None]
    overall = away.T @ away
    overall += np.diag(1e-9 * np.diag(overall) + 1e-20)
    factor = np.linalg.cholesky(overall)
    standard = np.linalg.solve(factor, (draws - middle).T).T
    parts = int(np.clip(size // (4 * dim), 1, PARTS))
    found = Mixture(
        np.full(parts, 1.0 / parts),
        standard[rng.choice(n, parts, replace=False, p=shares)],
        np.tile(np.sqrt(0.7) * np.eye(dim), (parts, 1, 1)),
        np.full(parts, DOF),
    )
    for _ in range(rounds if parts > 1 else 1):
        members = special.softmax(found.log_parts(standard), axis=0) * (shares * size)
        mass = members.sum(axis=1) + 1e-9
        means = (members @ standard) / mass[:, None]
        away = (standard - means[:, None]) * np.sqrt(members)[..., None]
        scatter = away.transpose(0, 2, 1) @ away
        prior = SHRINKAGE * dim
        covariances = scatter + prior / size * scatter.sum(axis=0) + 1e-9 * np.eye(dim)
        factors = np.linalg.cholesky(covariances / (mass + prior)[:, None, None])
        found = Mixture(mass / mass.sum(), means, factors, found.dof)
    return Mixture(
        np.append((1.0 - WIDE) * found.weights, WIDE),
        np.vstack([middle + found.means @ factor.T, middle]),
        np.concatenate([np.sqrt(1.1) * factor @ found.factors, np.sqrt(1.5) * factor[None]]),
        np.append(found.dof, 8.0),
    )


class Adaptive:
    """Weighted draws of a density from proposals, each fitted to the draws of those before it.

    Adaptive multiple importance sampling (Cornuet, Marin, Mira and Robert, 2012): each draw is
    weighted by the density over the mean of all proposals. The next proposal is fitted with
    tempered weights (Koblents and Míguez, 2015), so that few draws do not decide it.

    Attributes
    ----------
    q : (n, dim)
    log_prob : (n,)
    weights : (n,)
        They sum to 1.
    k, size : float
        Pareto k of the weights, and the effective number of draws.
    proposals : list of Mixture
        A little of the first one stays in all others. The last has no draws yet.
    """

    def __init__(
        self, density: Density, first: Mixture, rng: np.random.Generator, draws: int
    ) -> None:
        self._density, self._rng, self._draws = density, rng, draws
        self.proposals = [first]
        self.q, self.log_prob = np.empty((0, first.means.shape[1])), np.empty(0)
        self._densities = np.empty((0, 0))  # of each proposal at each draw

    def run(self) -> Adaptive:
        """Draw from the last proposal, weigh all draws anew, and fit the next one to them."""
        newest = self.proposals[-1]
        fresh = newest.draw(self._rng, self._draws)
        self._densities = np.hstack(
            [
                np.vstack([self._densities, newest.log_density(self.q)[None]]),
                np.stack([proposal.log_density(fresh) for proposal in self.proposals]),
            ]
        )
        self.q = np.concatenate([self.q, fresh])
        self.log_prob = np.append(self.log_prob, self._density(fresh))
        ratios = self.log_prob - special.logsumexp(self._densities, axis=0)
        if not np.any(np.isfinite(ratios)):
            raise FitError("no density around the modes")
        smooth, self.k = psis(ratios)
        self.weights = special.softmax(smooth)
        self.size = float(1.0 / np.sum(self.weights**2))
        tempered = special.softmax(tempering(ratios, SHARE) * (ratios - ratios.max()))
        following = fit_mixture(self.q, self._rng, tempered)
        self.proposals.append(joined([following, self.proposals[0]], [1.0 - FIRST, FIRST]))
        return self


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

        shift, width, tail, skew = least_squares(misfit, np.zeros((len(middle), 4)), BENT).T
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

    def draw(self, random: Any, n: int) -> Array:
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
        parts = densities + np.log(self.weights)[:, None]
        return np.asarray(special.logsumexp(parts, axis=0))

    def draw(self, random: Any, n: int) -> Array:
        """Independent draws, (n, dim)."""
        counts = random.multinomial(n, self.weights)
        draws = [part.draw(random, k) for part, k in zip(self.parts, counts, strict=True)]
        order: NDArray[np.intp] = random.permutation(n)
        return np.concatenate(draws)[order]


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
    if len(draws) > LEARNED:
        draws = draws[rng.choice(len(draws), LEARNED, replace=False)]
    warp = Warp.of(draws)
    z, _ = warp.normal(draws)
    mean = z.mean(axis=0)
    covariance = np.atleast_2d(np.cov(z.T)) + 1e-8 * np.eye(z.shape[1])
    factor = np.linalg.cholesky(covariance)
    standard = np.linalg.solve(factor, (z - mean).T).T
    weights, means, covariances = _expectation_maximization(standard, parts, rng)
    spreads = np.concatenate([1.1 * factor @ covariances @ factor.T, 1.5 * covariance[None]])
    mixture = Mixture(
        np.append((1.0 - TAIL) * weights, TAIL),
        np.vstack([mean + means @ factor.T, mean]),
        np.linalg.cholesky(spreads),
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
