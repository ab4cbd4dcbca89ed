"""Which law the tests support: each one's prediction of levels of actuation that were left out.

One quantity at a time, its tests' likelihoods as Gaussians. A law stands alone here, with scatter
but without the smooth deviation that predictions allow it, which would excuse any law. Scatter
and shapes are integrated over their priors by a quasi-random sample, levels in closed form, so
that the scores need no sampler and are always the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special
from scipy.stats import qmc

from mfd_bayes.population.laws import COMPARE, LAWS, draw_shape, ratio, value_of
from mfd_bayes.population.layout import LEVELS, Layout, levels_of
from mfd_bayes.population.test_likelihood import TestLikelihood

Array = NDArray[np.float64]

TESTS = 4
"""Fewest tests from which a dependence on speed or stroke is scored."""

COVARIATES = ("velocity", "amplitude")

POINTS = 1 << 13
"""Points of the quasi-random sample."""

AT_ONCE = 1 << 19
"""Points times tests that are computed at once."""


@dataclass(frozen=True)
class LawScore:
    """How one law predicts one quantity's levels that were left out.

    Attributes
    ----------
    quantity, law : str
    elpd : float
        Sum over levels of the log predictive density of its tests, in prior units.
    se : float
        Standard error of the sum, from its spread over levels.
    weight : float
        Stacking weight among the laws.
    levels : tuple of float
        The terms of the sum.
    """

    quantity: str
    law: str
    elpd: float
    se: float
    weight: float
    levels: tuple[float, ...]


@dataclass(frozen=True)
class DependenceScore:
    """How well one quantity's tests are predicted if it follows a covariate besides the actuation.

    Attributes
    ----------
    quantity : str
    covariate : str
        "velocity", "amplitude", or "" for neither.
    elpd : float
        Sum over tests of the log predictive density of each from the others, in prior units.
    difference, se : float
        From that of neither, and its standard error over tests.
    """

    quantity: str
    covariate: str
    elpd: float
    difference: float
    se: float


@dataclass(frozen=True, eq=False)
class _Sample:
    """Points of a law's hyperparameters, n of them, and the tests' distribution at each.

    Tests differ by what is their own and by effects that they have in common: their covariance
    is a diagonal and a matrix of low rank, so that n points take n·J·m² operations.

    Attributes
    ----------
    away : (n, J)
        Tests from the law.
    variances : (n, J)
        Of what is a test's own: its error and its scatter.
    rows : (J, m)
        What each test has of the effects' independent parts, the level's first.
    sds : (n, m)
        Of these parts.
    shape : (n,)
        Exponent of the law.
    """

    away: Array
    variances: Array
    rows: Array
    sds: Array
    shape: Array

    def sums(self, those: Sequence[int] | slice) -> tuple[Array, Array, Array]:
        """What some tests add to the normal density: gram (n, m, m), pull (n, m), rest (n,)."""
        rows, weights = self.rows[those], 1.0 / self.variances[:, those]
        away, m = self.away[:, those], self.rows.shape[1]
        products = (rows[:, :, None] * rows[:, None, :]).reshape(len(rows), -1)
        gram = (weights @ products).reshape(-1, m, m)
        gram *= self.sds[:, :, None] * self.sds[:, None, :]
        pull = ((weights * away) @ rows) * self.sds
        rest = np.sum(away**2 * weights - np.log(weights) + np.log(2 * np.pi), axis=1)
        return gram, pull, rest

    def log_density(self, sums: tuple[Array, Array, Array]) -> Array:
        """Log density of the tests whose sums these are, (n,)."""
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
        standing = (self.away - pulled) / self.variances
        density: Array = 0.5 * (np.log(precision) - standing**2 / precision - np.log(2 * np.pi))
        return density


def compare_laws(layout: Layout, tests: Sequence[TestLikelihood]) -> tuple[LawScore, ...]:
    """Every law's score for each quantity that follows the actuation, by leave-one-level-out.

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
            se = float(np.sqrt(len(found)) * found.std(ddof=1))
            scores.append(
                LawScore(name, law, float(found.sum()), se, float(weight), tuple(found.tolist()))
            )
    return tuple(scores)


def compare_dependence(
    layout: Layout, tests: Sequence[TestLikelihood]
) -> tuple[DependenceScore, ...]:
    """Scores of what follows speed or stroke, by leaving out one test after another.

    For each quantity that follows the actuation, under its own law ("power" where laws are
    compared). Empty where there are fewer than `TESTS` tests, or a covariate hardly varies.
    """
    if len(tests) < TESTS:
        return ()
    scores = []
    for name, law in layout.laws.items():
        k = layout.names.index(name)
        terms = {}
        for covariate in ("", *COVARIATES):
            if covariate and not _varies(layout, covariate):
                continue
            follows = (covariate,) if covariate else ()
            samples = _samples(layout, tests, k, "power" if law == COMPARE else law, follows)
            terms[covariate] = _each_left_out(samples)
        for covariate, found in terms.items():
            better = found - terms[""]
            se = float(np.sqrt(len(found)) * better.std(ddof=1))
            score = float(found.sum()), float(better.sum()), se
            scores.append(DependenceScore(name, covariate, *score))
    return tuple(scores) if len(scores) > len(layout.laws) else ()


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
    for name, law in layout.laws.items():
        if law != "proportional":
            continue
        k = layout.names.index(name)
        shapes, densities = [], []
        for sample in _samples(layout, tests, k, "power"):
            shapes.append(sample.shape)
            densities.append(sample.log_density(sample.sums(slice(None))))
        exponents, weights = np.concatenate(shapes), special.softmax(np.concatenate(densities))
        order = np.argsort(exponents)
        mass = np.cumsum(weights[order])
        low, middle, high = np.interp([0.025, 0.5, 0.975], mass, exponents[order])
        found[name] = (float(low), float(middle), float(high))
    return found


def stack(scores: Array) -> Array:
    """Weights that predict best together what was left out (Yao et al., 2018), (laws,).

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
    """Points of a law for one quantity, which follows its own covariates if not others.

    In parts, so that many tests take no more memory than few.
    """
    name = layout.names[k]
    shapes = LAWS[law].shapes
    effects = [e for e in layout.effects if k in e.members and e.name != "level"]
    follows = layout.dependence.get(name, ()) if follows is None else follows
    dim = 1 + len(effects) + len(shapes) + len(follows)
    points = qmc.Sobol(dim, scramble=True, rng=np.random.default_rng(0)).random(POINTS)
    points = np.clip(points, 1e-9, 1.0 - 1e-9)
    noise = np.array([test.covariance[k, k] for test in tests])
    data = np.array([test.mean[k] for test in tests])
    rows = [np.ones((len(tests), 1)), *(e.root[list(e.home)] for e in effects)]
    relative = np.array([s.actuation for s in layout.settings]) / layout.reference
    for part in np.array_split(points, -(-POINTS * len(tests) // AT_ONCE)):
        sd = layout.scatter_sd[k] / layout.spread[k] * special.ndtri(0.5 + 0.5 * part)
        sds = [np.ones((len(part), 1))]
        sds += [np.repeat(sd[:, [1 + i]], len(e.cells), axis=1) for i, e in enumerate(effects)]
        begin = 1 + len(effects)
        free = {s: value_of(s, draw_shape(s, part[:, begin + i])) for i, s in enumerate(shapes)}
        given: Mapping[str, float | None] = {
            "share": LAWS[law].share,
            "exponent": LAWS[law].exponent,
        }
        share, exponent = (
            free[s] if s in free else np.full(len(part), given[s]) for s in ("share", "exponent")
        )
        followed = ratio(relative, share[:, None], exponent[:, None])
        means = np.log(np.maximum(followed, 1e-300)) / layout.spread[k]
        for i, covariate in enumerate(follows):
            folds = np.log([s.covariates[covariate] for s in layout.settings])
            slope = draw_shape(covariate, part[:, begin + len(shapes) + i])
            means = means + slope[:, None] * (folds - folds.mean()) / layout.spread[k]
        yield _Sample(
            away=data - means,
            variances=noise + sd[:, :1] ** 2,
            rows=np.concatenate(rows, axis=1),
            sds=np.concatenate(sds, axis=1),
            shape=exponent,
        )


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
