"""The joint log density of a population and all its tests, from the tests' own likelihoods.

    log p(h, latent, w, x_1, …, x_J) = log p(h) + log p(latent | h) + log p(w)
        + Σ_j [log N(x_j; mean_j, scatter² / w_j) + log p(own coordinates of j) + log L_j(x_j)]

The weights w are 1, or 1/`WIDER`² where a quantity of a test stands apart from the others (a
contaminated normal density: Tukey, 1960). It knows nothing of how it is sampled: the moves stand
in `moves`, their order in `sweep`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.jobs.likelihoods import Evaluate, in_turn
from mfd_bayes.population.chains import Chains, Choice, Index
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.test_likelihood import TestLikelihood

Array = NDArray[np.float64]

FAR = 15.0
"""Largest size of a hyperparameter: a scatter of e⁻¹⁹ is beyond double precision."""


class Points(Protocol):
    """Some points of one test, at which its density is wanted."""

    @property
    def j(self) -> int:
        """Number of the test."""

    @property
    def x(self) -> Array:
        """The points, (…, D)."""


T = TypeVar("T", bound=Points)


@dataclass(frozen=True, eq=False)
class Conditional:
    """Gaussian density of the tests' shared coordinates given the population.

    Attributes
    ----------
    means : (n, J, d)
    scatter : (n, J, d)
        Standard deviations, with the tests' weights.
    """

    means: Array
    scatter: Array

    def standard(self, x: Array) -> Array:
        """Standardised deviations of the tests' shared coordinates, (n, J, d) both."""
        return np.asarray((x - self.means) / self.scatter)

    def log_change(self, x: Array, by: Array) -> Array:
        """Change of the log density where x less the means changes by (n, J, d), (n,)."""
        before, change = self.standard(x), by / self.scatter
        # (after² − before²)/2 with after = before + change
        return np.asarray(-np.einsum("njk,njk->n", before + 0.5 * change, change))

    def log_density(self, j: int, x: Array, chains: Index) -> Array:
        """That of test j at coordinates (n, D) of some of the chains (n,), without constants."""
        standard = x[:, : self.means.shape[2]] - self.means[chains, j]
        standard /= self.scatter[chains, j]
        return np.asarray(-0.5 * np.einsum("nk,nk->n", standard, standard))


@dataclass(frozen=True, eq=False)
class LatentPosterior:
    """Gaussian conditional density of the latent given hyperparameters and tests, by quantity.

    With u the latent over its prior sd, u has precision A = factor factorᵀ and mean A⁻¹ b.

    Attributes
    ----------
    log_marginal : (n, d)
        Log density of the tests with the latent integrated out, without constants.
    sd : (n, d, p)
        Prior sd of the latent, in the columns of each quantity.
    factor : (n, d, p, p)
    solved : (n, d, p)
        factor⁻¹ b.
    """

    log_marginal: Array
    sd: Array
    factor: Array
    solved: Array


@dataclass(frozen=True, eq=False)
class Given:
    """What densities of h and of the latent are conditional on.

    Attributes
    ----------
    choice : (n, L) int
    x, weight : (n, J, d)
        Shared coordinates of the tests, and their weights.
    """

    choice: Choice
    x: Array
    weight: Array

    def of(self, chains: Index) -> Given:
        """That of some of the chains."""
        return Given(self.choice[chains], self.x[chains], self.weight[chains])


class Joint:
    """Joint density of a population and its tests.

    Parameters
    ----------
    layout : Layout
    tests : sequence of TestLikelihood
    evaluate : callable, optional
        Computes what is the tests' own (`TestLikelihood.density`), in several processes; without
        it, one after the other.
    """

    def __init__(
        self,
        layout: Layout,
        tests: Sequence[TestLikelihood],
        evaluate: Evaluate[Array, Array] | None = None,
    ) -> None:
        self.layout, self.tests = layout, tests
        self.d = len(layout.names)
        self.evaluate = evaluate or in_turn([test.density(self.d) for test in tests])
        self.design = layout.design()  # (J, m)
        self.columns = layout.columns()  # (d, p)
        parts = np.swapaxes(self.design.T[self.columns], 1, 2)  # (d, J, p)
        self.parts, self.products_of_parts = parts, parts[..., :, None] * parts[..., None, :]

    def with_densities(self, wanted: Iterable[T]) -> Iterator[tuple[T, Array]]:
        """Each of the wanted, in order, with the log densities of its points, (…,)."""
        waiting: deque[T] = deque()

        def points() -> Iterator[tuple[int, Array]]:
            for one in wanted:
                waiting.append(one)
                yield one.j, one.x.reshape(-1, one.x.shape[-1])

        for density in self.evaluate(points()):
            one = waiting.popleft()
            yield one, density.reshape(one.x.shape[:-1])

    def densities(self, x: Iterable[Array]) -> tuple[list[Array], list[Array]]:
        """New coordinates of every test, (n, D), and its log density there, (n,).

        The coordinates may be computed while processes are at work on those before.
        """
        moved: list[Array] = []

        def points() -> Iterator[tuple[int, Array]]:
            for j, one in enumerate(x):
                moved.append(one)
                yield j, one

        found = list(self.evaluate(points()))
        return moved, found

    def shared(self, chains: Chains) -> Array:
        """Shared coordinates of the tests, (n, J, d)."""
        return np.stack([x[:, : self.d] for x in chains.x], axis=1)

    def given(self, chains: Chains) -> Given:
        """What the chains hold of the tests."""
        return Given(chains.choice, self.shared(chains), chains.weight)

    def conditional(self, chains: Chains) -> Conditional:
        """Density of the tests' shared coordinates given the chains' population."""
        means = self.layout.offsets(chains.h, chains.choice) + self.design @ chains.latent
        scatter = self.layout.scatter(chains.h)[:, None] / np.sqrt(chains.weight)
        return Conditional(np.asarray(means), scatter)

    def latent_posterior(self, given: Given, h: Array) -> LatentPosterior:
        """Conditional density of the latent given h and what is given of the tests."""
        d, tests, p = self.parts.shape
        precision = given.weight / self.layout.scatter(h)[:, None] ** 2  # (n, J, d)
        residual = given.x - self.layout.offsets(h, given.choice)
        sds = np.concatenate([np.ones((len(h), 1, d)), self.layout.effect_sd(h)], axis=1)
        sd = sds[:, self.columns, np.arange(d)[:, None]]  # (n, d, p)
        outer = self.products_of_parts.reshape(d, tests, p * p)
        pulled = precision * residual
        by_quantity = np.moveaxis(precision, 2, 0), np.moveaxis(pulled, 2, 0)  # (d, n, J)
        gram = np.swapaxes(by_quantity[0] @ outer, 0, 1).reshape(*sd.shape, p)
        a = sd[..., :, None] * gram * sd[..., None, :]
        a[..., range(p), range(p)] += 1.0
        b = np.swapaxes(by_quantity[1] @ self.parts, 0, 1) * sd
        factor, solved = _factored(a, b)
        log_det = 2.0 * np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
        squares = np.einsum("njk,njk->nk", pulled, residual)
        squares -= np.einsum("nkm,nkm->nk", solved, solved)
        terms = -0.5 * (log_det + squares - np.log(precision).sum(axis=1))
        return LatentPosterior(terms, sd, factor, solved)

    def log_blocks(self, given: Given, h: Array) -> Array:
        """Log density of each block of h given the tests, the latent integrated out, (n, G)."""
        density = self.layout.log_prior(h)
        inside = np.all(np.abs(h) < FAR, axis=1)
        terms = self.latent_posterior(given, np.clip(h, -FAR, FAR)).log_marginal
        for g in range(density.shape[1]):
            density[:, g] += terms[:, self.layout.member == g].sum(axis=1)
        density[~inside] = -np.inf
        return density

    def log_prior_of_quantity(self, k: int, h: Array, log_scatter: Array, level: Array) -> Array:
        """Log prior density of h (n, dim) with quantity k's scatter and level replaced, (n,)."""
        moved = h.copy()
        moved[:, k] = np.clip(log_scatter, -FAR, FAR)
        density = self.layout.log_prior(moved).sum(axis=1) - 0.5 * level**2
        return np.where(np.abs(log_scatter) < FAR, density, -np.inf)

    def products(self, chains: Chains) -> Array:
        """Products of the tests' standardised deviations, summed over tests, (n, d, d)."""
        given = self.conditional(chains)
        deviations = given.standard(self.shared(chains))
        return np.asarray(np.swapaxes(deviations, 1, 2) @ deviations)


def _factored(a: Array, b: Array) -> tuple[Array, Array]:
    """Cholesky factors of matrices (…, m, m) of at least 1, and factor⁻¹ b of vectors (…, m).

    Both are in one factor: that of the matrix with the vector as its last row.
    """
    m = b.shape[-1]
    whole = np.empty((*b.shape[:-1], m + 1, m + 1))
    whole[..., :m, :m], whole[..., m, :m], whole[..., :m, m] = a, b, b
    whole[..., m, m] = 1.0 + 2.0 * np.einsum("...m,...m->...", b, b)  # more than b' A⁻¹ b
    factor = np.linalg.cholesky(whole)
    return factor[..., :m, :m], factor[..., m, :m]
