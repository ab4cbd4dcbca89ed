"""Which law the tests support: each one's prediction of levels of actuation that were left out.

One quantity at a time, its tests' likelihoods as Gaussians. A law stands alone here, with scatter
but without the smooth deviation that predictions allow it, which would excuse any law. Scatter
and shapes are integrated over their priors by a quasi-random sample, levels in closed form, so
that the scores need no sampler and are always the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special
from scipy.stats import qmc

from mfd_bayes.population.evidence import Evidence
from mfd_bayes.population.laws import COMPARE, LAWS, draw_shape, ratio, value_of
from mfd_bayes.population.pooling import LEVELS, Pooling, levels_of

Array = NDArray[np.float64]

TESTS = 4
"""Fewest tests from which a dependence on speed or stroke is scored."""

COVARIATES = ("velocity", "amplitude")

POINTS = 1 << 13
"""Points of the quasi-random sample."""


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
    """Points of a law's hyperparameters with the tests' means (n, J) and covariances (n, J, J)."""

    means: Array
    covariances: Array
    shape: Array


def compare_laws(pooling: Pooling, tests: Sequence[Evidence]) -> tuple[LawScore, ...]:
    """Every law's score for each quantity that follows the actuation, by leave-one-level-out.

    Empty where tests are at fewer than `LEVELS` levels.
    """
    folds = levels_of(pooling.settings)
    if len(folds) < LEVELS:
        return ()
    scores = []
    for name in pooling.laws:
        k = pooling.names.index(name)
        data = np.array([test.mean[k] for test in tests])
        terms = {}
        for law in LAWS:
            sample = _sample(pooling, tests, k, law)
            terms[law] = np.array([_left_out(sample, data, fold) for fold in folds])
        weights = stack(np.stack(list(terms.values()), axis=1))
        for (law, found), weight in zip(terms.items(), weights, strict=True):
            se = float(np.sqrt(len(found)) * found.std(ddof=1))
            scores.append(
                LawScore(name, law, float(found.sum()), se, float(weight), tuple(found.tolist()))
            )
    return tuple(scores)


def compare_dependence(pooling: Pooling, tests: Sequence[Evidence]) -> tuple[DependenceScore, ...]:
    """Scores of what follows speed or stroke, by leaving out one test after another.

    For each quantity that follows the actuation, under its own law ("power" where laws are
    compared). Empty where there are fewer than `TESTS` tests, or a covariate hardly varies.
    """
    if len(tests) < TESTS:
        return ()
    scores = []
    for name, law in pooling.laws.items():
        k = pooling.names.index(name)
        data = np.array([test.mean[k] for test in tests])
        terms = {}
        for covariate in ("", *COVARIATES):
            if covariate and not _varies(pooling, covariate):
                continue
            follows = (covariate,) if covariate else ()
            sample = _sample(pooling, tests, k, "power" if law == COMPARE else law, follows)
            terms[covariate] = np.array([_left_out(sample, data, [j]) for j in range(len(data))])
        for covariate, found in terms.items():
            better = found - terms[""]
            se = float(np.sqrt(len(found)) * better.std(ddof=1))
            score = float(found.sum()), float(better.sum()), se
            scores.append(DependenceScore(name, covariate, *score))
    return tuple(scores) if len(scores) > len(pooling.laws) else ()


def _varies(pooling: Pooling, covariate: str) -> bool:
    values = [setting.covariates.get(covariate, 0.0) for setting in pooling.settings]
    return min(values) > 0.0 and max(values) > 1.2 * min(values)


def free_exponents(
    pooling: Pooling, tests: Sequence[Evidence]
) -> dict[str, tuple[float, float, float]]:
    """Quantiles 2.5, 50 and 97.5 % of each proportional law's exponent, were it a power law.

    Empty where no law is proportional, or the tests are at fewer than `LEVELS` levels.
    """
    if len(levels_of(pooling.settings)) < LEVELS:
        return {}
    found = {}
    for name, law in pooling.laws.items():
        if law != "proportional":
            continue
        k = pooling.names.index(name)
        data = np.array([test.mean[k] for test in tests])
        sample = _sample(pooling, tests, k, "power")
        density = _log_normal(data - sample.means, sample.covariances)
        order = np.argsort(sample.shape)
        mass = np.cumsum(special.softmax(density)[order])
        low, middle, high = np.interp([0.025, 0.5, 0.975], mass, sample.shape[order])
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


def _sample(
    pooling: Pooling,
    tests: Sequence[Evidence],
    k: int,
    law: str,
    follows: Sequence[str] | None = None,
) -> _Sample:
    """Points of a law for one quantity, which follows its own covariates if not others."""
    name = pooling.names[k]
    shapes = LAWS[law].shapes
    effects = [e for e in pooling.effects if k in e.members and e.name != "level"]
    follows = pooling.dependence.get(name, ()) if follows is None else follows
    dim = 1 + len(effects) + len(shapes) + len(follows)
    points = qmc.Sobol(dim, scramble=True, rng=np.random.default_rng(0)).random(POINTS)
    points = np.clip(points, 1e-9, 1.0 - 1e-9)
    sd = pooling.scatter_sd[k] / pooling.spread[k] * special.ndtri(0.5 + 0.5 * points)
    noise = np.array([test.covariance[k, k] for test in tests])
    count = len(tests)
    covariances = np.ones((POINTS, count, count))
    covariances[:, range(count), range(count)] += noise + sd[:, :1] ** 2
    for i, effect in enumerate(effects):
        rows = effect.root[list(effect.home)]
        covariances += sd[:, 1 + i, None, None] ** 2 * (rows @ rows.T)
    begin = 1 + len(effects)
    free = {s: value_of(s, draw_shape(s, points[:, begin + i])) for i, s in enumerate(shapes)}
    given: Mapping[str, float | None] = {
        "share": LAWS[law].share,
        "exponent": LAWS[law].exponent,
    }
    share, exponent = (
        free[s] if s in free else np.full(POINTS, given[s]) for s in ("share", "exponent")
    )
    relative = np.array([s.actuation for s in pooling.settings]) / pooling.reference
    followed = ratio(relative, share[:, None], exponent[:, None])
    means = np.log(np.maximum(followed, 1e-300)) / pooling.spread[k]
    for i, covariate in enumerate(follows):
        folds = np.log([s.covariates[covariate] for s in pooling.settings])
        slope = draw_shape(covariate, points[:, begin + len(shapes) + i])
        means = means + slope[:, None] * (folds - folds.mean()) / pooling.spread[k]
    return _Sample(means, covariances, exponent)


def _left_out(sample: _Sample, data: Array, fold: Sequence[int]) -> float:
    """Log predictive density of some tests given the others."""
    kept = np.setdiff1d(np.arange(len(data)), fold)
    residual = data - sample.means
    inside = sample.covariances[:, kept[:, None], kept]
    weights = _log_normal(residual[:, kept], inside)
    everything = _log_normal(residual, sample.covariances)
    return float(special.logsumexp(everything) - special.logsumexp(weights))


def _log_normal(residual: Array, covariances: Array) -> Array:
    factor = np.linalg.cholesky(covariances)
    standard = np.linalg.solve(factor, residual[..., None])[..., 0]
    log_det = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
    size = residual.shape[1]
    density: Array = -0.5 * np.sum(standard**2, axis=1) - log_det - 0.5 * size * np.log(2 * np.pi)
    return density
