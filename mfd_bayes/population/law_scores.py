"""Scores of the laws: how well each predicts levels of actuation that were left out.

Each quantity is scored by itself, with Gaussians in place of the tests' likelihoods. A law has
scatter here, but not the effect of the level that predictions allow it, which would excuse any
law. Scatter and shapes are integrated over their priors by a quasi-random sample, levels in closed
form: no sampler is needed, and the scores are always the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special
from scipy.stats import qmc

from mfd_bayes.population.effects import LEVELS
from mfd_bayes.population.laws import COMPARE, LAWS, draw_shape, ratio, value_of
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.setting import levels_of
from mfd_bayes.population.test_likelihood import TestLikelihood
from mfd_bayes.store.schema import Figure

Array = NDArray[np.float64]

TESTS = 4
"""Fewest tests with which a dependence on speed or stroke is scored."""

COVARIATES = ("velocity", "amplitude")

POINTS = 1 << 13
"""Points of the quasi-random sample."""

AT_ONCE = 1 << 19
"""Points times tests that are computed at once, to bound the memory."""


@dataclass(frozen=True)
class LawScore:
    """Score of one law for one quantity.

    Attributes
    ----------
    quantity, law : str
    elpd : float
        Sum over levels of the log predictive density of the level's tests given the other
        levels, in prior units.
    se : float
        Standard error of the sum, from the spread of its terms.
    weight : float
        Stacking weight among the laws.
    levels : tuple of float
        The terms of the sum.
    """

    quantity: str
    law: str
    elpd: Figure
    se: Figure
    weight: Figure
    levels: tuple[Figure, ...]


@dataclass(frozen=True)
class DependenceScore:
    """Score of one quantity that follows a covariate besides the actuation.

    Attributes
    ----------
    quantity : str
    covariate : str
        "velocity", "amplitude", or "" for neither.
    elpd : float
        Sum over tests of the log predictive density of each from the others, in prior units.
    difference, se : float
        Difference from the score of neither, and its standard error over tests.
    """

    quantity: str
    covariate: str
    elpd: Figure
    difference: Figure
    se: Figure


@dataclass(frozen=True, eq=False)
class _Sample:
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


def compare_laws(layout: Layout, tests: Sequence[TestLikelihood]) -> tuple[LawScore, ...]:
    """Score of every law for each quantity that follows the actuation, by leave-one-level-out.

    Empty where tests are at fewer than `LEVELS` levels.
    """
    folds = levels_of(layout.settings)
    if len(folds) < LEVELS:
        return ()
    scores = []
    for name in layout.laws:
        k = layout.names.index(name)
        terms = {law: _left_out(_samples(layout, tests, k, law), folds) for law in LAWS}
        weights = stack(np.stack(list(terms.values()), axis=1))
        for (law, found), weight in zip(terms.items(), weights, strict=True):
            total, se, levels = float(found.sum()), _error(found), tuple(found.tolist())
            scores.append(LawScore(name, law, total, se, float(weight), levels))
    return tuple(scores)


def compare_dependence(
    layout: Layout, tests: Sequence[TestLikelihood]
) -> tuple[DependenceScore, ...]:
    """Scores of dependences on speed or stroke, by leave-one-test-out.

    For each quantity that follows the actuation, under its own law ("power" where laws are
    compared). Empty where there are fewer than `TESTS` tests, or where no covariate varies.
    """
    if len(tests) < TESTS:
        return ()
    scores = []
    varied = [covariate for covariate in COVARIATES if _varies(layout, covariate)]
    for name, law in layout.laws.items():
        given = layout, tests, layout.names.index(name), "power" if law == COMPARE else law
        terms = {c: _each_left_out(_samples(*given, [c] if c else [])) for c in ("", *varied)}
        for covariate, found in terms.items():
            better = found - terms[""]
            score = float(found.sum()), float(better.sum()), _error(better)
            scores.append(DependenceScore(name, covariate, *score))
    return tuple(scores) if varied else ()


def _error(terms: Array) -> float:
    """Standard error of the sum of terms."""
    return float(np.sqrt(len(terms)) * terms.std(ddof=1))


def _varies(layout: Layout, covariate: str) -> bool:
    values = [setting.covariates.get(covariate, 0.0) for setting in layout.settings]
    return min(values) > 0.0 and max(values) > 1.2 * min(values)


def free_exponents(
    layout: Layout, tests: Sequence[TestLikelihood]
) -> dict[str, tuple[float, float, float]]:
    """Quantiles 2.5, 50 and 97.5 % of each proportional law's exponent, were it a power law.

    Empty where no law is proportional, or the tests are at fewer than `LEVELS` levels.
    """
    if len(levels_of(layout.settings)) < LEVELS:
        return {}
    found = {}
    for name in (name for name, law in layout.laws.items() if law == "proportional"):
        drawn, densities = [], []
        for sample in _samples(layout, tests, layout.names.index(name), "power"):
            drawn.append(sample.exponent)
            densities.append(sample.log_density(sample.sums(slice(None))))
        exponents, weights = np.concatenate(drawn), special.softmax(np.concatenate(densities))
        order = np.argsort(exponents)
        mass = np.cumsum(weights[order])
        low, middle, high = np.interp([0.025, 0.5, 0.975], mass, exponents[order])
        found[name] = (float(low), float(middle), float(high))
    return found


def stack(scores: Array) -> Array:
    """Stacking weights: those of the mixture that predicts best (Yao et al., 2018), (laws,).

    Parameters
    ----------
    scores : (folds, laws)
        Log predictive densities.
    """
    laws = scores.shape[1]
    level = np.exp(scores - scores.max(axis=1, keepdims=True))

    def loss(q: Array) -> float:
        return -float(np.log(level @ special.softmax(q)).sum())

    starts = [np.zeros(laws), *(3.0 * np.eye(laws))]
    best = min((optimize.minimize(loss, start) for start in starts), key=lambda fit: fit.fun)
    weights: Array = special.softmax(best.x)
    kept = np.where(weights < 0.01, 0.0, weights)
    return np.asarray(kept / kept.sum())


def _samples(
    layout: Layout,
    tests: Sequence[TestLikelihood],
    k: int,
    law: str,
    follows: Sequence[str] | None = None,
) -> Iterator[_Sample]:
    """Points of a law for quantity k, which follows its own covariates if none are given.

    They come in parts, so that many tests take no more memory than few.
    """
    effects = [e for e in layout.effects if k in e.members and e.name != "level"]
    follows = layout.dependence.get(layout.names[k], ()) if follows is None else follows
    begin = 1 + len(effects)
    dim = begin + len(LAWS[law].shapes) + len(follows)
    points = qmc.Sobol(dim, scramble=True, rng=np.random.default_rng(0)).random(POINTS)
    points = np.clip(points, 1e-9, 1.0 - 1e-9)
    noise = np.array([test.covariance[k, k] for test in tests])
    data = np.array([test.mean[k] for test in tests])
    rows = [np.ones((len(tests), 1)), *(e.root[list(e.home)] for e in effects)]
    for part in np.array_split(points, -(-POINTS * len(tests) // AT_ONCE)):
        sd = layout.scatter_sd[k] / layout.spread[k] * special.ndtri(0.5 + 0.5 * part)
        sds = [np.ones((len(part), 1))]
        sds += [np.repeat(sd[:, [1 + i]], len(e.cells), axis=1) for i, e in enumerate(effects)]
        means, exponent = _means(layout, k, law, follows, part[:, begin:])
        yield _Sample(
            residuals=data - means,
            variances=noise + sd[:, :1] ** 2,
            rows=np.concatenate(rows, axis=1),
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


def _left_out(samples: Iterable[_Sample], folds: Sequence[Sequence[int]]) -> Array:
    """Log predictive density of the tests of each fold given the others, (folds,)."""
    everything, others = [], []
    for sample in samples:
        whole = sample.sums(slice(None))
        everything.append(sample.log_density(whole))
        parts = [sample.sums(fold) for fold in folds]
        rest = [tuple(a - b for a, b in zip(whole, part, strict=True)) for part in parts]
        others.append([special.logsumexp(sample.log_density(sums)) for sums in rest])  # type: ignore[arg-type]
    found: Array = special.logsumexp(np.concatenate(everything)) - special.logsumexp(others, axis=0)
    return found


def _each_left_out(samples: Iterable[_Sample]) -> Array:
    """Log predictive density of each test given the others, (J,)."""
    everything, others = [], []
    for sample in samples:
        whole = sample.sums(slice(None))
        density = sample.log_density(whole)
        everything.append(density)
        rest = density[:, None] - sample.log_density_of_each(whole)
        others.append(special.logsumexp(rest, axis=0))
    found: Array = special.logsumexp(np.concatenate(everything)) - special.logsumexp(others, axis=0)
    return found
