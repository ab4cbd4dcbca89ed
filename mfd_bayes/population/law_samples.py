"""Quasi-random points of a law's hyperparameters, and the tests' density at each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.stats import qmc

from mfd_bayes.population.laws import LAWS, draw_shape, ratio, value_of
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.test_likelihood import TestLikelihood

Array = NDArray[np.float64]

POINTS = 1 << 13
"""Points of the quasi-random sample."""

AT_ONCE = 1 << 19
"""Points times tests that are computed at once, to bound the memory."""


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


def samples_of(
    layout: Layout,
    tests: Sequence[TestLikelihood],
    k: int,
    law: str,
    follows: Sequence[str] | None = None,
) -> Iterator[LawSample]:
    """Points of a law for quantity k, which follows its own covariates if none are given.

    They come in parts, so that many tests take no more memory than few. Where a law has no value,
    at zero actuation, a test's value has its own prior: the density is of the same data under
    every law.
    """
    effects = [e for e in layout.effects if k in e.members and e.name != "level"]
    follows = layout.dependence.get(layout.names[k], ()) if follows is None else follows
    begin = 1 + len(effects)
    dim = begin + len(LAWS[law].shapes) + len(follows)
    points = qmc.Sobol(dim, scramble=True, rng=np.random.default_rng(0)).random(POINTS)
    points = np.clip(points, 1e-9, 1.0 - 1e-9)
    noise = np.array([test.covariance[k, k] for test in tests])
    data = np.array([test.mean[k] for test in tests])
    zero = np.array([setting.actuation == 0 for setting in layout.settings])
    free = zero & (not LAWS[law].intercept)
    parts = [np.ones((len(tests), 1)), *(e.root[list(e.home)] for e in effects)]
    rows = np.where(free[:, None], 0.0, np.concatenate(parts, axis=1))
    for part in np.array_split(points, -(-POINTS * len(tests) // AT_ONCE)):
        sd = layout.scatter_sd[k] / layout.spread[k] * special.ndtri(0.5 + 0.5 * part)
        sds = [np.ones((len(part), 1))]
        sds += [np.repeat(sd[:, [1 + i]], len(e.cells), axis=1) for i, e in enumerate(effects)]
        means, exponent = _means(layout, k, law, follows, part[:, begin:])
        yield LawSample(
            residuals=data - np.where(free, 0.0, means),
            variances=noise + np.where(free, 1.0, sd[:, :1] ** 2),
            rows=rows,
            sds=np.concatenate(sds, axis=1),
            exponent=exponent,
        )


def _means(
    layout: Layout, k: int, law: str, follows: Sequence[str], uniform: Array
) -> tuple[Array, Array]:
    """Law and dependences of quantity k for the tests, (n, J), and the exponents, (n,)."""
    shapes = LAWS[law].shapes
    share, exponent = (
        value_of(s, draw_shape(s, uniform[:, shapes.index(s)]))
        if s in shapes
        else np.full(len(uniform), getattr(LAWS[law], s))
        for s in ("share", "exponent")
    )
    relative = np.array([s.actuation for s in layout.settings]) / layout.reference
    followed = ratio(relative, share[:, None], exponent[:, None])
    means = np.log(np.maximum(followed, 1e-300)) / layout.spread[k]
    for i, covariate in enumerate(follows, start=len(shapes)):
        folds = np.log([s.covariates[covariate] for s in layout.settings])
        slope = draw_shape(covariate, uniform[:, i])
        means = means + slope[:, None] * (folds - folds.mean()) / layout.spread[k]
    return means, exponent
