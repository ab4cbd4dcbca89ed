"""The tests of one quantity under one law, and their density at points of its hyperparameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.population.effects import Effect
from mfd_bayes.population.laws import LAWS, draw_shape, ratio, value_of
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.test_likelihood import TestLikelihood

Array = NDArray[np.float64]

LOST = 1e-4
"""Share of an effect's variance that may be lost by leaving out its least important parts."""

_SMALLEST = 1e-9  # sd over the scale of its prior


@dataclass(frozen=True, eq=False)
class LawSample:
    """Points of a law's hyperparameters, n of them, and the tests' density at each.

    The tests' covariance is a diagonal (error and scatter of each test) plus a matrix of low rank
    (level and effects), so that n points take n·J·m² operations.

    Attributes
    ----------
    residuals : (n, J)
        Tests less the law.
    variances : (n, J)
        The diagonal.
    rows : (J, m)
        Weights of the level and of the effects' independent parts in each test.
    sds : (n, m)
        Of level and parts.
    exponent : (n,)
    """

    residuals: Array
    variances: Array
    rows: Array
    sds: Array
    exponent: Array

    def sums(self, those: Sequence[int] | slice) -> tuple[Array, Array, Array]:
        """Terms of some tests in the log density: gram (n, m, m), pull (n, m), rest (n,)."""
        rows, weights = self.rows[those], 1.0 / self.variances[:, those]
        residuals, m = self.residuals[:, those], self.rows.shape[1]
        products = (rows[:, :, None] * rows[:, None, :]).reshape(len(rows), -1)
        gram = (weights @ products).reshape(-1, m, m)
        gram *= self.sds[:, :, None] * self.sds[:, None, :]
        pull = ((weights * residuals) @ rows) * self.sds
        rest = np.sum(residuals**2 * weights - np.log(weights) + np.log(2 * np.pi), axis=1)
        return gram, pull, rest

    def log_density(self, sums: tuple[Array, Array, Array]) -> Array:
        """Log density of the tests with these sums, (n,)."""
        gram, pull, rest = sums
        factor = np.linalg.cholesky(gram + np.eye(gram.shape[-1]))
        standard = np.linalg.solve(factor, pull[..., None])[..., 0]
        log_det = 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        density: Array = -0.5 * (rest + log_det - np.sum(standard**2, axis=1))
        return density

    def log_density_of_each(self, sums: tuple[Array, Array, Array]) -> Array:
        """Log density of each test given all others, (n, J), from the sums of all."""
        gram, pull, _ = sums
        inverse = np.linalg.inv(gram + np.eye(gram.shape[-1]))
        inverse *= self.sds[:, :, None] * self.sds[:, None, :]
        share = np.einsum("jk,nkl,jl->nj", self.rows, inverse, self.rows, optimize=True)
        precision = (1.0 - share / self.variances) / self.variances
        pulled = np.einsum("nkl,nl->nk", inverse, pull / self.sds) @ self.rows.T
        standing = (self.residuals - pulled) / self.variances
        density: Array = 0.5 * (np.log(precision) - standing**2 / precision - np.log(2 * np.pi))
        return density


@dataclass(frozen=True, eq=False)
class LawProblem:
    """One quantity of all tests under one law, whose hyperparameters z are unknown.

    z holds those of the scatter and the effects' sds, of the law's shapes and of dependences, each
    on a scale on which its prior is N(0, 1): there the posterior is nearly normal, whether the
    tests say much or little.

    Attributes
    ----------
    data, noise : (J,)
        Mean and variance of the tests' likelihoods.
    rows : (J, m)
        Weights of the level and of the effects' independent parts in each test.
    sd_of : (m,) int
        Which sd each part has; 0, in the place of the scatter, for the level, whose sd is 1.
    scales : (sds,)
        Scale of the prior of each sd over that of the scatter, which is the first.
    follows : tuple of str
        Covariates that the quantity follows.
    free : (J,) bool
        Tests whose value has its own prior, N(0, 1): those at zero actuation where the law has no
        value, so that the density is of the same data under every law.
    """

    layout: Layout
    k: int
    law: str
    data: Array
    noise: Array
    rows: Array
    sd_of: NDArray[np.intp]
    scales: Array
    follows: tuple[str, ...]
    free: NDArray[np.bool_]

    @property
    def shapes(self) -> tuple[str, ...]:
        """Shapes of the law, and covariates."""
        return (*LAWS[self.law].shapes, *self.follows)

    @property
    def sds(self) -> int:
        """Number of sds."""
        return len(self.scales)

    @property
    def dim(self) -> int:
        """Number of hyperparameters."""
        return self.sds + len(self.shapes)

    def log_prior(self, z: Array) -> Array:
        """Log prior density, (n, dim) -> (n,)."""
        density: Array = -0.5 * np.sum(z**2 + np.log(2 * np.pi), axis=1)
        return density

    def sample(self, z: Array) -> LawSample:
        """The tests at points z, (n, dim)."""
        unit = self.layout.scatter_sd[self.k] / self.layout.spread[self.k]
        sds = unit * self.scales * np.maximum(_half_normal(z[:, : self.sds]), _SMALLEST)
        of_parts = np.where(self.sd_of > 0, sds[:, self.sd_of], 1.0)
        means, exponent = self._means(z[:, self.sds :])
        residuals = self.data - np.where(self.free, 0.0, means)
        variances = self.noise + np.where(self.free, 1.0, sds[:, :1] ** 2)
        return LawSample(residuals, variances, self.rows, of_parts, exponent)

    def _means(self, z: Array) -> tuple[Array, Array]:
        """Law and dependences at the shapes' part of z, (n, J), and the exponents, (n,)."""
        layout, law = self.layout, LAWS[self.law]
        q = np.zeros_like(z)
        for i, shape in enumerate(self.shapes):
            q[:, i] = _shape(shape, z[:, i])
        share, exponent = (
            value_of(s, q[:, law.shapes.index(s)])
            if s in law.shapes
            else np.full(len(q), getattr(law, s))
            for s in ("share", "exponent")
        )
        relative = np.array([s.actuation for s in layout.settings]) / layout.reference
        followed = ratio(relative, share[:, None], exponent[:, None])
        means = np.log(np.maximum(followed, 1e-300)) / layout.spread[self.k]
        for i, covariate in enumerate(self.follows, start=len(law.shapes)):
            folds = np.log([s.covariates[covariate] for s in layout.settings])
            means = means + q[:, [i]] * (folds - folds.mean()) / layout.spread[self.k]
        return means, exponent


def problem_of(
    layout: Layout,
    tests: Sequence[TestLikelihood],
    name: str,
    law: str,
    follows: Sequence[str] | None = None,
) -> LawProblem:
    """A law's problem for a quantity, which follows its own covariates if none are given.

    It allows for every effect of the layout; `Layout.without` leaves some out.
    """
    k = layout.names.index(name)
    effects = [e for e in layout.effects if k in e.members]
    rows = [np.ones((len(tests), 1)), *(_parts(e)[list(e.home)] for e in effects)]
    zero = np.array([setting.actuation == 0 for setting in layout.settings])
    free = zero & (not LAWS[law].intercept)
    return LawProblem(
        layout=layout,
        k=k,
        law=law,
        data=np.array([test.mean[k] for test in tests]),
        noise=np.array([test.covariance[k, k] for test in tests]),
        rows=np.where(free[:, None], 0.0, np.concatenate(rows, axis=1)),
        sd_of=np.repeat(np.arange(len(rows)), [r.shape[1] for r in rows]),
        scales=np.array([1.0, *(effect.scale for effect in effects)]),
        follows=tuple(layout.dependence.get(name, ()) if follows is None else follows),
        free=free,
    )


def _parts(effect: Effect) -> Array:
    """Weights of independent parts in each cell, (cells, parts), without those of no account.

    A smooth effect of many cells has few parts.
    """
    values, vectors = np.linalg.eigh(effect.root @ effect.root.T)
    lost = np.cumsum(values) / values.sum()
    kept = lost > LOST
    return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))


def _half_normal(z: Array) -> Array:
    """Half-normal quantiles at the probabilities of standard normal z, precise in both tails."""
    return np.asarray(-special.ndtri_exp(special.log_ndtr(-z) - np.log(2.0)))


def _shape(shape: str, z: Array) -> Array:
    """Coordinate of a shape at the probabilities of standard normal z."""
    if shape == "share":  # a uniform share, by its logit
        return np.asarray(special.log_ndtr(z) - special.log_ndtr(-z))
    middle, above = draw_shape(shape, special.ndtr(np.array([0.0, 1.0])))
    return np.asarray(middle + (above - middle) * z)
