"""Scores of laws and covariates: how well each predicts tests that were left out.

Each quantity is scored by itself, with the Gaussians of the tests given the quantities that all
tests share. A law has scatter here, but not the level effects that predictions allow it, which
would excuse any law. Coefficients are integrated in closed form, scatter and shapes by importance
sampling with a fixed seed: the scores are always the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration.diagnostics import psis
from mfd_bayes.population.design import (
    COMPARE,
    LAW_NAMES,
    LAWS,
    LEVELS,
    TESTS,
    Design,
    levels_of,
    varies,
)
from mfd_bayes.population.mixed_model import MixedModel
from mfd_bayes.store.files import Figure

Array = NDArray[np.float64]

POINTS = 1024  # points at which scatter and shapes are integrated
FOLDS = 10  # most parts of the tests that are left out in turn to score a covariate
LARGEST_K = 0.7  # Pareto k above which a score cannot be trusted, and its law is not weighed
COVARIATES = ("velocity", "amplitude")


@dataclass(frozen=True)
class LawScore:
    """Score of one law for one quantity."""

    quantity: str
    law: str
    elpd: Figure  # sum of log predictive densities of levels given the others, in prior units
    se: Figure  # standard error of the sum, from the spread of its terms
    weight: Figure  # stacking weight among the laws; 0 where its score cannot be trusted
    levels: tuple[Figure, ...]  # the terms of the sum
    pareto_k: Figure = np.nan  # of the importance weights

    @property
    def trusted(self) -> bool:
        """Whether its Pareto k allows to weigh it."""
        return not self.pareto_k > LARGEST_K


@dataclass(frozen=True)
class DependenceScore:
    """Score of one quantity that follows a covariate besides the actuation."""

    quantity: str
    covariate: str  # "velocity", "amplitude", or "" for neither
    elpd: Figure  # sum of the log predictive densities of tests that were left out, in prior units
    difference: Figure  # difference from the score of neither, and its standard error
    se: Figure


@dataclass(frozen=True, eq=False)
class TestGaussians:
    """Gaussian likelihoods of the tests' free quantities given the common ones."""

    design: Design
    mean: Array  # (J, d): in prior units; those of common quantities are not used
    variance: Array

    __test__ = False  # pytest is not to collect it

    @classmethod
    def given_common(cls, design: Design, y: Array, precision: Array, mode: Array) -> TestGaussians:
        """From likelihoods (J, d), (J, d, d), with the common quantities at a mode (d,)."""
        free, common = design.free, np.flatnonzero(design.common)
        inner = precision[:, free][:, :, free] + 1e-6 * np.eye(free.size)
        away = (y[:, common] - mode[common])[..., None]
        shift = np.linalg.solve(inner, precision[:, free][:, :, common] @ away)[..., 0]
        mean, variance = y.copy(), np.ones_like(y)
        mean[:, free] += shift
        variance[:, free] = np.diagonal(np.linalg.inv(inner), axis1=1, axis2=2)
        return cls(design, mean, variance)

    def densities(
        self,
        name: str,
        law: str,
        folds: Sequence[Sequence[int]],
        follows: Sequence[str] | None = None,
        *,
        leveled: bool = False,
    ) -> tuple[Array, Array]:
        """Log densities of a quantity's tests, all and without each fold, under a law by itself.

        They are (n, 1 + folds), with log weights that make their points h (n, dim) stand for the
        prior. `follows` are covariates instead of the design's.
        """
        k = [self.design.names.index(name)]
        follows = self.design.dependence.get(name, ()) if follows is None else follows
        design = replace(
            self.design,
            names=(name,),
            spread=self.design.spread[k],
            laws={name: law},
            dependence={name: tuple(follows)} if follows else {},
            scatter_sd=self.design.scatter_sd[k],
            common=np.zeros(1, dtype=bool),
            leveled=leveled,
        )
        y, variance, informs = self.mean[:, k], self.variance[:, k[0]], design.informs[:, 0]
        precision = np.where(informs, 1.0 / variance, 0.0)
        mixed = MixedModel(design, y, precision[:, None, None])
        choice = np.array([LAW_NAMES.index(law)])
        # half of the points are of the prior, and half of Laplace's Gaussian, half as wide again
        mode, root = mixed.laplace(choice)
        root, dim = 1.5 * root, mixed.dim
        from scipy.stats import qmc  # which takes long to import

        u = np.clip(qmc.Sobol(max(dim, 1), seed=0).random(POINTS)[:, :dim], 1e-9, 1.0 - 1e-9)
        g = special.ndtri(u)
        g[POINTS // 2 :] = mode + g[POINTS // 2 :] @ root.T
        near = -0.5 * np.sum(np.linalg.solve(root, (g - mode).T) ** 2, axis=0)
        near -= np.linalg.slogdet(root)[1]
        prior = -0.5 * np.sum(g**2, axis=1)
        h, weight = mixed.of_numbers(g), prior - np.logaddexp(prior, near) + np.log(2.0)
        every = set(range(len(y)))
        kept = [sorted(every - set(fold)) for fold in ((), *folds)]
        log = np.stack([weight + mixed.marginal(h, choice, tests)[0] for tests in kept], axis=1)
        # where the law has no value the quantity has the prior of a test by itself, N(0, 1)
        total = 1.0 + variance
        alone = -0.5 * (y[:, 0] ** 2 / total + np.log(total / variance))
        alone[informs] = 0.0
        return log + np.array([alone[tests].sum() for tests in kept]), h

    def scores(
        self,
        name: str,
        law: str,
        folds: Sequence[Sequence[int]],
        follows: Sequence[str] | None = None,
    ) -> tuple[Array, float]:
        """Log predictive density of each fold given the others, (folds,), and Pareto k."""
        log = self.densities(name, law, folds, follows)[0]
        sums = special.logsumexp(log, axis=0)
        return sums[0] - sums[1:], max(psis(column)[1] for column in log.T)


def compare_laws(tests: TestGaussians) -> tuple[LawScore, ...]:
    """Score of every law for each quantity that follows the actuation, each level left out in turn.

    Empty where tests are at fewer than `LEVELS` levels. With tests at zero actuation, laws that
    have no value there have no weight.
    """
    design = tests.design
    folds = levels_of(design.settings)
    if len(folds) < LEVELS:
        return ()
    found = []
    allowed = [law in design.considered(COMPARE) for law in LAWS]
    for name in design.laws:
        pairs = [tests.scores(name, law, folds) for law in LAWS]
        trusted = np.array([not k > LARGEST_K for _, k in pairs]) & allowed
        weights = np.zeros(len(LAWS))
        if np.any(trusted):
            weights[trusted] = stack(np.array([terms for terms, _ in pairs])[trusted].T)
        for law, (terms, k), weight in zip(LAWS, pairs, weights, strict=True):
            total, se, each = float(terms.sum()), _error(terms), tuple(terms.tolist())
            found.append(LawScore(name, law, total, se, float(weight), each, float(k)))
    return tuple(found)


def extrapolation_weights(tests: TestGaussians, names: Sequence[str], laws: Sequence[str]) -> Array:
    """Weights of laws by how well they predict the lowest and the highest level, (laws,).

    Stacking of the two folds, for some quantities together, with a prior worth one fold: two
    levels do not rule a law out. With fewer than `LEVELS` levels, equal weights.
    """
    above = [j for j, s in enumerate(tests.design.settings) if s.actuation > 0]
    levels = levels_of([tests.design.settings[j] for j in above])
    if len(levels) < LEVELS or not names:
        return np.full(len(laws), 1.0 / len(laws))
    ends = [[above[j] for j in levels[end]] for end in (0, -1)]
    terms = [np.concatenate([tests.scores(n, law, ends)[0] for n in names]) for law in laws]
    return stack(np.array(terms).T, prior=1.0)


def compare_dependence(tests: TestGaussians) -> tuple[DependenceScore, ...]:
    """Scores of dependences on speed or stroke, parts of the tests left out in turn.

    For each quantity that follows the actuation, under its own law ("power" where laws are
    compared). Empty where there are fewer than `TESTS` tests, or where no covariate varies.
    """
    design = tests.design
    varied = [c for c in COVARIATES if varies(design.settings, c)]
    count = len(design.settings)
    if count < TESTS or not varied:
        return ()
    parts = min(count, FOLDS)
    folds = [range(i, count, parts) for i in range(parts)]
    found = []
    for name, law in design.laws.items():
        law = "power" if law == COMPARE else law
        terms = {c: tests.scores(name, law, folds, [c] if c else [])[0] for c in ("", *varied)}
        for c, values in terms.items():
            better = values - terms[""]
            total, difference = float(values.sum()), float(better.sum())
            found.append(DependenceScore(name, c, total, difference, _error(better)))
    return tuple(found)


def free_exponents(tests: TestGaussians) -> dict[str, tuple[float, float, float]]:
    """Quantiles 2.5, 50 and 97.5 % of each proportional law's exponent, were it a power law.

    Levels may deviate from the law as in predictions: the exponent is known no better than the
    number of levels allows. Empty where no law is proportional, or at fewer than `LEVELS` levels
    above zero.
    """
    design = tests.design
    if len(levels_of([s for s in design.settings if s.actuation > 0])) < LEVELS:
        return {}
    found = {}
    for name in (n for n, law in design.laws.items() if law == "proportional"):
        log, h = tests.densities(name, "power", [], leveled=True)
        order = np.argsort(h[:, -1])  # the exponent
        mass = np.cumsum(special.softmax(log[:, 0])[order])
        low, middle, high = np.interp([0.025, 0.5, 0.975], mass, h[order, -1])
        found[name] = (float(low), float(middle), float(high))
    return found


def stack(scores: Array, prior: float = 0.0) -> Array:
    """Stacking weights: those of the mixture that predicts best (Yao et al., 2018), (laws,)."""
    from scipy import optimize  # which takes long to import

    laws = scores.shape[1]
    level = np.exp(scores - scores.max(axis=1, keepdims=True))

    def loss(q: Array) -> float:
        gain = np.log(level @ special.softmax(q)).sum() + prior * special.log_softmax(q).mean()
        return -float(gain)

    starts = [np.zeros(laws), *(3.0 * np.eye(laws))]
    best = min((optimize.minimize(loss, start) for start in starts), key=lambda fit: fit.fun)
    weights = special.softmax(best.x)
    kept = np.where(weights < 0.01, 0.0, weights)
    return np.asarray(kept / kept.sum())


def _error(terms: Array) -> float:
    """Standard error of the sum of terms."""
    return float(np.sqrt(len(terms)) * terms.std(ddof=1)) if len(terms) > 1 else 0.0
