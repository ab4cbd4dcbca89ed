"""Scores of the laws: how well each predicts levels of actuation that were left out.

Each quantity is scored by itself, with Gaussians in place of the tests' likelihoods. A law has
scatter here, but not the effect of the level that predictions allow it, which would excuse any
law. Scatter and shapes are integrated by importance sampling with quasi-random points near their
posterior, levels in closed form: the scores are always the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

from mfd_bayes.population.effects import LEVELS
from mfd_bayes.population.law_points import NEAR, LawPoints, draw_points, worst_k
from mfd_bayes.population.law_samples import LawProblem, problem_of
from mfd_bayes.population.laws import COMPARE, LAWS
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.setting import Setting, levels_of
from mfd_bayes.population.test_likelihood import TestLikelihood
from mfd_bayes.store.schema import Figure

Array = NDArray[np.float64]

TESTS = 4
"""Fewest tests with which a dependence on speed or stroke is scored."""

LARGEST_K = 0.7
"""Pareto k above which a score cannot be trusted, and its law is not weighed."""

COVARIATES = ("velocity", "amplitude")


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
        Stacking weight among the laws; 0 where its score cannot be trusted.
    levels : tuple of float
        The terms of the sum.
    pareto_k : float
        Of the importance weights behind the score, the largest; NaN of an earlier version.
    """

    quantity: str
    law: str
    elpd: Figure
    se: Figure
    weight: Figure
    levels: tuple[Figure, ...]
    pareto_k: Figure = np.nan

    @property
    def trusted(self) -> bool:
        """Whether its Pareto k allows to weigh it."""
        return not self.pareto_k > LARGEST_K


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


def compare_laws(
    layout: Layout, tests: Sequence[TestLikelihood], seed: int = 0
) -> tuple[LawScore, ...]:
    """Score of every law for each quantity that follows the actuation, each level left out in turn.

    Empty where tests are at fewer than `LEVELS` levels. A law whose score cannot be trusted has no
    weight; where none can, no law has. With tests at zero actuation, laws that have no value there
    have none either.
    """
    folds = levels_of(layout.settings)
    if len(folds) < LEVELS:
        return ()
    zero = any(setting.actuation == 0 for setting in layout.settings)
    allowed = np.array([LAWS[law].intercept or not zero for law in LAWS])
    scores, layout = [], layout.without("level")
    for name in layout.laws:
        problems = [problem_of(layout, tests, name, law) for law in LAWS]
        terms, k = zip(*(_left_out(p, folds, seed) for p in problems), strict=True)
        weights = _weights(np.stack(terms, axis=1), np.array(k), allowed)
        for law, found, worst, weight in zip(LAWS, terms, k, weights, strict=True):
            total, se, levels = float(found.sum()), _error(found), tuple(found.tolist())
            scores.append(LawScore(name, law, total, se, float(weight), levels, worst))
    return tuple(scores)


def _weights(terms: Array, k: Array, allowed: NDArray[np.bool_]) -> Array:
    """Stacking weights of allowed laws (laws,) with a good Pareto k; terms are (folds, laws)."""
    trusted = allowed & ~(k > LARGEST_K)
    weights = np.zeros(len(k))
    if np.any(trusted):
        weights[trusted] = stack(terms[:, trusted])
    return weights


def compare_dependence(
    layout: Layout, tests: Sequence[TestLikelihood]
) -> tuple[DependenceScore, ...]:
    """Scores of dependences on speed or stroke, by leave-one-test-out.

    For each quantity that follows the actuation, under its own law ("power" where laws are
    compared). Empty where there are fewer than `TESTS` tests, or where no covariate varies.
    """
    if len(tests) < TESTS:
        return ()
    scores, layout = [], layout.without("level")
    varied = [covariate for covariate in COVARIATES if varies(layout.settings, covariate)]
    for name, law in layout.laws.items():
        given = layout, tests, name, "power" if law == COMPARE else law
        terms = {c: _each_left_out(problem_of(*given, [c] if c else [])) for c in ("", *varied)}
        for covariate, found in terms.items():
            better = found - terms[""]
            score = float(found.sum()), float(better.sum()), _error(better)
            scores.append(DependenceScore(name, covariate, *score))
    return tuple(scores) if varied else ()


def _error(terms: Array) -> float:
    """Standard error of the sum of terms."""
    return float(np.sqrt(len(terms)) * terms.std(ddof=1))


def varies(settings: Sequence[Setting], covariate: str) -> bool:
    """Whether a covariate varies between settings by more than a fifth."""
    values = [setting.covariates.get(covariate, 0.0) for setting in settings]
    return min(values) > 0.0 and max(values) > 1.2 * min(values)


def free_exponents(
    layout: Layout, tests: Sequence[TestLikelihood]
) -> dict[str, tuple[float, float, float]]:
    """Quantiles 2.5, 50 and 97.5 % of each proportional law's exponent, were it a power law.

    Levels may deviate from the law as in predictions: the exponent is known no better than the
    number of levels allows, however many tests each has. Empty where no law is proportional, or
    the tests are at fewer than `LEVELS` levels above zero.
    """
    if len(levels_of([s for s in layout.settings if s.actuation > 0])) < LEVELS:
        return {}
    found = {}
    for name in (name for name, law in layout.laws.items() if law == "proportional"):
        problem = problem_of(layout, tests, name, "power")
        drawn, densities = [], []
        for sample, weights in draw_points(problem).parts():
            drawn.append(sample.exponent)
            densities.append(weights + sample.log_density(sample.sums(slice(None))))
        exponents, shares = np.concatenate(drawn), special.softmax(np.concatenate(densities))
        order = np.argsort(exponents)
        mass = np.cumsum(shares[order])
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


def _left_out(
    problem: LawProblem, folds: Sequence[Sequence[int]], seed: int
) -> tuple[Array, float]:
    """Log predictive density of the tests of each fold given the others, (folds,), and Pareto k."""
    every = np.arange(len(problem.data))
    others = [np.setdiff1d(every, fold).tolist() for fold in folds]
    log_weights = _densities(draw_points(problem, others, seed), folds)
    sums: Array = special.logsumexp(log_weights, axis=0)
    return sums[0] - sums[1:], worst_k(log_weights)


def _densities(points: LawPoints, folds: Sequence[Sequence[int]]) -> Array:
    """Log weights of the points by all tests, and by those outside each fold, (n, 1 + folds)."""
    found = []
    for sample, weights in points.parts():
        whole = sample.sums(slice(None))
        columns = [sample.log_density(whole)]
        for fold in folds:
            gram, pull, rest = (a - b for a, b in zip(whole, sample.sums(fold), strict=True))
            columns.append(sample.log_density((gram, pull, rest)))
        found.append(weights[:, None] + np.stack(columns, axis=1))
    return np.concatenate(found)


def _each_left_out(problem: LawProblem) -> Array:
    """Log predictive density of each test given the others, (J,)."""
    everything, others = [], []
    tests = len(problem.data)
    few = [[i for i in range(tests) if i != j] for j in range(tests)] if tests <= NEAR else []
    for sample, weights in draw_points(problem, few).parts():
        whole = sample.sums(slice(None))
        density = weights + sample.log_density(whole)
        everything.append(density)
        rest = density[:, None] - sample.log_density_of_each(whole)
        others.append(special.logsumexp(rest, axis=0))
    found: Array = special.logsumexp(np.concatenate(everything)) - special.logsumexp(others, axis=0)
    return found
