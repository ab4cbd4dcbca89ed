"""A mixture of Student-t densities that is fitted to a density: by which draws are proposed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.diagnostics import psis, tempering
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

    def draw(self, rng: np.random.Generator, n: int) -> Array:
        """Independent draws, (n, dim)."""
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

    def add(self, proposal: Mixture) -> None:
        """Draw next from this proposal and the one that was to come."""
        self.proposals[-1] = joined([proposal, self.proposals[-1]], [0.5, 0.5])

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

    def mixture(self) -> Mixture:
        """The later half of the proposals together."""
        late = self.proposals[len(self.proposals) // 2 :]
        return joined(late, [1.0 / len(late)] * len(late))
