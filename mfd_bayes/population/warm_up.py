"""Warm-up of the chains that sample a population, and their companions.

Gaussians in place of the likelihoods bring the chains near their places. Surrogates are fitted
there, and chains that sample them go on to where the posterior is, where surrogates are fitted
again, until they are so near the likelihoods that exchanges with them are accepted. Chains that are
lost on the way start again from others. Nothing of this is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from mfd_bayes.calibration.diagnostics import tempering
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.jobs.likelihoods import Evaluate
from mfd_bayes.population.chains import Chains
from mfd_bayes.population.joint import Joint
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.surrogate import surrogates_of
from mfd_bayes.population.sweep import ACCOMPANIED, ALONE, COMPANION, NEAR, Sampler
from mfd_bayes.population.test_likelihood import TestLikelihood

Array = NDArray[np.float64]

WALKERS = 32
"""Chains of each ensemble."""

GAUSSIAN = 20
"""Sweeps with Gaussians in place of the likelihoods, which are cheap. With twice as many no fewer
sweeps are needed later (7 to 500 tests)."""

SETTLE = 5
"""Further sweeps where there are no companions."""

FIRST = 5
"""Sweeps with the likelihoods before surrogates are fitted."""

ROUNDS = 6
"""Most times that surrogates are fitted anew."""

AHEAD = 10
"""Sweeps with surrogates in each round."""

LAST = 4
"""Sweeps with companions before the first that is kept."""

EFFECTIVE = 0.5
"""Share of the chains that is effective, by their weights, where surrogates are near enough."""

MOST_TESTS = 15
"""With more tests companions cost more than they bring: the errors of the tests' surrogates add up,
and fewer exchanges are accepted."""

LEAST_SIZE = 400
"""Effective sample size that must be asked for if companions are to repay their warm-up."""

LOST = 500.0
"""A chain is lost where the log density of all tests is this far below the chains' median. It
would not reach the posterior, and surrogates fitted to it would be wrong for the other chains."""

WORTH = 0.1
"""Share of accepted exchanges below which companions are not worth their time."""


def warm_up(
    layout: Layout,
    tests: Sequence[TestLikelihood],
    effort: Effort,
    rng: np.random.Generator,
    evaluate: Evaluate[Array, Array] | None,
) -> tuple[Sampler, Chains]:
    """A tuned sampler and its chains, with companions where they are worth it."""
    sampler = Sampler(Joint(layout, [test.approximated() for test in tests]), rng, NEAR)
    chains = sampler.start(effort.ensembles * WALKERS, effort.ensembles)
    _sweep(sampler, chains, GAUSSIAN)
    if all(test.gaussian for test in tests):
        sampler.plan = ALONE
        return sampler, chains
    sampler = Sampler(Joint(layout, tests, evaluate), rng)
    sampler.tune(chains)
    sampler.take_over(chains)
    _sweep(sampler, chains, FIRST)
    rescue(chains, rng)
    few = len(tests) <= MOST_TESTS
    if few and effort.ess >= LEAST_SIZE and _accompany(sampler, chains):
        sampler.plan = ACCOMPANIED
        _sweep(sampler, chains, LAST)
        if np.mean(sampler.accepted["exchange"]) > WORTH:
            return sampler, chains
    sampler = Sampler(sampler.joint, rng)
    sampler.tune(chains)
    _sweep(sampler, chains, SETTLE)
    return sampler, chains


def _sweep(sampler: Sampler, chains: Chains, sweeps: int) -> None:
    """Sweeps, with the proposals tuned after each third."""
    for i in range(sweeps):
        if i in (sweeps // 3, 2 * sweeps // 3):
            sampler.tune(chains)
        sampler.sweep(chains)


def _accompany(sampler: Sampler, chains: Chains) -> bool:
    """Give the chains companions, and move them where the companions went; whether there are."""
    joint, rng, states = sampler.joint, sampler.rng, chains.x
    for turn in range(ROUNDS):
        surrogates = surrogates_of(joint.tests, states, rng)
        if surrogates is None:
            return False
        companion = Sampler(Joint(joint.layout, surrogates), rng, COMPANION)
        sampler.tune(chains)
        companion.take_tuning(sampler)
        ahead = deepcopy(chains)
        companion.take_over(ahead)
        sampler.companions = companion, ahead
        visited = []
        for _ in range(AHEAD):
            companion.sweep(ahead)
            visited.append([x.copy() for x in ahead.x])
        true = list(joint.evaluate(enumerate(ahead.x)))
        log_weights = np.sum(true, axis=0) - np.sum(ahead.log_density, axis=0)
        log_weights[np.isnan(log_weights) | _lost(true)] = -np.inf
        if not np.any(np.isfinite(log_weights)):
            return False
        log_weights -= log_weights.max()
        near = tempering(log_weights, EFFECTIVE)
        if near == 1.0 and turn > 0:
            break
        picks = _resampled(near * log_weights, chains.ensemble, rng)
        chains.take(ahead, true, picks)
        late = visited[AHEAD // 2 :]
        states = [np.concatenate([x[j][picks] for x in late]) for j in range(len(joint.tests))]
    return True


def rescue(chains: Chains, rng: np.random.Generator) -> None:
    """Let chains that are lost go on from others, of their own ensemble if it has any."""
    lost = _lost(chains.log_density)
    others = _resampled(np.where(lost, -np.inf, 0.0), chains.ensemble, rng)
    picks = np.where(lost, others, np.arange(lost.size))
    chains.take(chains, chains.log_density, picks)


def _lost(log_density: Sequence[Array]) -> NDArray[np.bool_]:
    """Chains that are lost, by the log density of each test, (n,) each."""
    total = np.sum(log_density, axis=0)
    known = np.where(np.isnan(total), -np.inf, total)
    return np.asarray(~(known > np.median(known) - LOST))


def _resampled(
    log_weights: Array, ensemble: NDArray[np.intp], rng: np.random.Generator
) -> NDArray[np.intp]:
    """Chains drawn by their weights, each from its own ensemble if that has any with a weight."""
    picks = np.arange(len(log_weights))
    for one in np.unique(ensemble):
        those = np.flatnonzero(ensemble == one)
        among = those if np.any(np.isfinite(log_weights[those])) else picks
        chosen = rng.choice(among.size, size=those.size, p=softmax(log_weights[among]))
        picks[those] = among[chosen]
    return picks
