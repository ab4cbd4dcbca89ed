"""The population of tests: levels, laws and test-to-test scatter, from the tests' likelihoods."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Convergence, measure
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.priors import Prior
from mfd_bayes.jobs.likelihoods import Evaluate
from mfd_bayes.population.chains import TestDraws, ThinnedChains, by_walker
from mfd_bayes.population.joint import Joint
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.lines import tune
from mfd_bayes.population.population import Population
from mfd_bayes.population.test_likelihood import TestLikelihood

Array = NDArray[np.float64]

WALKERS = 32
"""Chains of each ensemble."""

WARM_UP = 80
"""Sweeps with Gaussians in place of the likelihoods, which are cheap."""

KEPT = 1500
"""Draws of each ensemble that are kept, about, or the effective sample size that is asked for."""

ALONE = 2.0
"""Tests without any correlation of the scatter that its prior is worth."""

SETTLE = 20
"""Sweeps after that which are not kept."""

LATE = (0.1, 0.25, 0.5)
"""Shares of the sweeps after those that may be left out, as too early."""

SWEEPS = {100.0: 240, 400.0: 2000, 2000.0: 6000}
"""Sweeps at most, by the effective sample size that is asked for."""


@dataclass(frozen=True, eq=False)
class JointDraws:
    """A population, and its tests' coordinates after layout.

    Attributes
    ----------
    population : Population
    tests : sequence of (chain, draw, D)
        In prior units, as in `TestLikelihood`.
    accepted : mapping of str to float
        Share of accepted proposals, by kind.
    sweeps : int
    """

    population: Population
    tests: Sequence[Array]
    accepted: Mapping[str, float]
    sweeps: int


def sample_joint(
    layout: Layout,
    tests: Sequence[TestLikelihood],
    priors: Mapping[str, Prior],
    actuation_unit: str,
    effort: Effort,
    rng: np.random.Generator,
    report: Callable[[int, Convergence], None] = lambda _, __: None,
    evaluate: Evaluate | None = None,
) -> JointDraws:
    """Draws of the population and of every test given all tests.

    Parameters
    ----------
    layout : Layout
        Of these tests.
    tests : sequence of TestLikelihood
    priors : mapping of str to Prior
    actuation_unit : str
    effort : Effort
        Its R̂ and effective sample size are asked of everything in h and of the levels.
    rng : numpy.random.Generator
    report : callable, optional
        Called with the sweeps done and the convergence, now and then.
    evaluate : callable, optional
        Computes the tests' likelihoods, as in several processes.
    """
    n = effort.ensembles * WALKERS
    approximate = Joint(layout, [test.approximated() for test in tests], rng)
    chains = approximate.begin(n, layout.draw_choice(n), effort.ensembles)
    for i in range(WARM_UP):
        if i in (WARM_UP // 3, 2 * WARM_UP // 3):
            approximate.tune(tune(layout, approximate.tests, chains))
        approximate.sweep(chains)
    joint = approximate
    if not all(test.gaussian for test in tests):
        joint = Joint(layout, tests, rng, evaluate)
        joint.tune(tune(layout, approximate.tests, chains))
        joint.resume(chains)
        for i in range(SETTLE):
            if i == SETTLE // 2:
                joint.tune(tune(layout, tests, chains))
            joint.sweep(chains)
        joint.settle()
    hyper: list[Array] = []
    levels: list[Array] = []
    sizes = [x.shape[1] for x in chains.x]
    history = ThinnedChains(-(-max(KEPT, int(effort.ess)) // WALKERS), n, sum(sizes))
    for end in _looks(most_sweeps(effort)):
        for i in range(len(hyper), end):
            joint.sweep(chains)
            hyper.append(chains.h.copy())
            levels.append(chains.latent[:, 0].copy())
            if history.wants(i):
                history.add(i, chains.latent.copy(), joint.products(chains), chains.x)
        late, found = _settled(layout, hyper, levels, effort)
        report(end, found)
        if found.reached(effort.r_hat, effort.ess):
            break
    kept = history.since(late)
    states = list(kept.values())
    h = by_walker([hyper[i] for i in kept], effort.ensembles)
    choice = np.repeat(chains.choice[:, None], len(states), axis=1)
    population = Population(
        layout=layout,
        h=h,
        latent=by_walker([state.latent for state in states], effort.ensembles),
        choice=choice.reshape(*h.shape[:2], -1),
        together=_correlate(by_walker([state.products for state in states], effort.ensembles)),
        priors=priors,
        actuation_unit=actuation_unit,
        walkers=WALKERS,
        convergence=found,
    )
    accepted = {name: float(np.mean(shares)) for name, shares in joint.accepted.items()}
    return JointDraws(population, TestDraws(states, sizes, effort.ensembles), accepted, end)


def _settled(
    layout: Layout, hyper: Sequence[Array], levels: Sequence[Array], effort: Effort
) -> tuple[int, Convergence]:
    """The first share of `LATE` after which all has converged, or else best has, in sweeps."""
    tried = []
    for share in LATE:
        late = int(share * len(hyper))
        found = _measure(layout, hyper[late:], levels[late:], effort.ensembles)
        if found.reached(effort.r_hat, effort.ess):
            return late, found
        tried.append((late, found))
    return min(tried, key=lambda look: look[1].worst_r_hat)


def _looks(limit: int) -> list[int]:
    """Sweeps after which convergence is looked at, each half as many again; the limit last."""
    looks = [min(40, limit)]
    while looks[-1] < limit:
        looks.append(min(looks[-1] + max(20, looks[-1] // 2), limit))
    return looks


def most_sweeps(effort: Effort) -> int:
    """Sweeps after which an inference stops in any case."""
    return SWEEPS.get(effort.ess, int(2 * effort.ess))


def _correlate(products: Array) -> Array:
    """Cholesky factors of the correlations of the tests' places in the scatter.

    Tests differ in several quantities together; the scatter's sds are sampled, how it is
    correlated is read off the tests in each joint draw, as if `ALONE` tests more had shown none.

    Parameters
    ----------
    products : (chain, draw, d, d)
        Of the standardised places, (x − mean)/scatter, summed over the tests.

    Returns
    -------
    (chain, draw, d, d)
    """
    d = products.shape[-1]
    shrunk = products + ALONE * np.eye(d)
    sd = np.sqrt(np.diagonal(shrunk, axis1=-2, axis2=-1))
    correlation = shrunk / (sd[..., :, None] * sd[..., None, :])
    factors = np.linalg.cholesky(correlation)
    return np.asarray(factors.astype(np.float32), dtype=np.float64)  # as it is stored


def _measure(
    layout: Layout, hyper: Sequence[Array], levels: Sequence[Array], ensembles: int
) -> Convergence:
    everything = np.concatenate([np.stack(hyper), np.stack(levels)], axis=2)
    active = _active(layout)
    shaped = everything.reshape(len(hyper), ensembles, -1, everything.shape[2])
    return measure(np.swapaxes(shaped, 0, 1)[..., active])


def _active(layout: Layout) -> NDArray[np.intp]:
    """Coordinates of h, and levels, that some law of weight depends on."""
    from mfd_bayes.population.laws import LAWS

    begin = len(layout.names) + len(layout.effects)
    idle = [
        begin + i
        for i, (name, shape) in enumerate(layout.shapes)
        if shape in ("share", "exponent")
        and not any(
            weight > 0 and shape in LAWS[law].shapes for law, weight in layout.weights[name].items()
        )
    ]
    return np.setdiff1d(np.arange(layout.dim + len(layout.names)), idle)
