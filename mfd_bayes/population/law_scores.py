"""Scores of the laws: how well each predicts levels of actuation that were left out.

Each quantity is scored by itself, with Gaussians in place of the tests' likelihoods. A law has
scatter here, but not the effect of the level that predictions allow it, which would excuse any
law. Scatter and shapes are integrated over their priors by a quasi-random sample, levels in closed
form: no sampler is needed, and the scores are always the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

from mfd_bayes.population.effects import LEVELS
from mfd_bayes.population.law_samples import LawSample, samples_of
from mfd_bayes.population.laws import COMPARE, LAWS
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.setting import Setting, levels_of
from mfd_bayes.population.test_likelihood import TestLikelihood
from mfd_bayes.store.schema import Figure

Array = NDArray[np.float64]

TESTS = 4
"""Fewest tests with which a dependence on speed or stroke is scored."""

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


def compare_laws(layout: Layout, tests: Sequence[TestLikelihood]) -> tuple[LawScore, ...]:
    """Score of every law for each quantity that follows the actuation, by leave-one-level-out.

    Empty where tests are at fewer than `LEVELS` levels. With tests at zero actuation, laws that
    have no value there have no weight.
    """
    folds = levels_of(layout.settings)
    if len(folds) < LEVELS:
        return ()
    zero = any(setting.actuation == 0 for setting in layout.settings)
    weighed = [law for law in LAWS if LAWS[law].intercept or not zero]
    scores = []
    for name in layout.laws:
        k = layout.names.index(name)
        terms = {law: _left_out(samples_of(layout, tests, k, law), folds) for law in LAWS}
        stacked = stack(np.stack([terms[law] for law in weighed], axis=1)).tolist()
        weights = dict.fromkeys(LAWS, 0.0) | dict(zip(weighed, stacked, strict=True))
        for law, found in terms.items():
            total, se, levels = float(found.sum()), _error(found), tuple(found.tolist())
            scores.append(LawScore(name, law, total, se, weights[law], levels))
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
    varied = [covariate for covariate in COVARIATES if varies(layout.settings, covariate)]
    for name, law in layout.laws.items():
        given = layout, tests, layout.names.index(name), "power" if law == COMPARE else law
        terms = {c: _each_left_out(samples_of(*given, [c] if c else [])) for c in ("", *varied)}
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

    Empty where no law is proportional, or the tests are at fewer than `LEVELS` levels above zero.
    """
    if len(levels_of([s for s in layout.settings if s.actuation > 0])) < LEVELS:
        return {}
    found = {}
    for name in (name for name, law in layout.laws.items() if law == "proportional"):
        drawn, densities = [], []
        for sample in samples_of(layout, tests, layout.names.index(name), "power"):
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


def _left_out(samples: Iterable[LawSample], folds: Sequence[Sequence[int]]) -> Array:
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


def _each_left_out(samples: Iterable[LawSample]) -> Array:
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
