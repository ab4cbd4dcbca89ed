"""Joint draws of the population and of every test: warm-up, sweeps and convergence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Convergence, measure
from mfd_bayes.calibration.effort import Effort
from mfd_bayes.calibration.priors import Prior
from mfd_bayes.jobs.likelihoods import Evaluate
from mfd_bayes.population.chains import Chains, TestDraws, ThinnedChains, by_walker
from mfd_bayes.population.laws import LAWS
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.population import Population
from mfd_bayes.population.residual import Residual
from mfd_bayes.population.sweep import Sampler
from mfd_bayes.population.test_likelihood import TestLikelihood
from mfd_bayes.population.warm_up import WALKERS, warm_up

Array = NDArray[np.float64]

KEPT = 1500
"""Least number of draws of each ensemble that are kept, about."""

ALONE = 2.0
"""Number of tests without correlation of their scatter that its prior is worth."""

LATE = (0.1, 0.25, 0.5)
"""Shares of the sweeps that may be dropped as further warm-up."""

SWEEPS = {100.0: 240, 400.0: 2000, 2000.0: 6000}
"""Largest number of sweeps, by the effective sample size that is asked for."""


@dataclass(frozen=True, eq=False)
class JointProblem:
    """A population and its tests, before sampling.

    Attributes
    ----------
    layout : Layout
        Of these tests.
    tests : sequence of TestLikelihood
    priors : mapping of str to Prior
    actuation_unit : str
    residual : Residual, optional
        What the tests' likelihoods take the records to leave over.
    """

    layout: Layout
    tests: Sequence[TestLikelihood]
    priors: Mapping[str, Prior]
    actuation_unit: str
    residual: Residual | None = None


@dataclass(frozen=True, eq=False)
class JointDraws:
    """Draws of a population, and of its tests' coordinates given all tests.

    Attributes
    ----------
    population : Population
    tests : sequence of (chain, draw, D)
        In prior units, as in `TestLikelihood`.
    accepted : mapping of str to float
        Acceptance rates, by kind of proposal.
    sweeps : int
    """

    population: Population
    tests: Sequence[Array]
    accepted: Mapping[str, float]
    sweeps: int


def sample_joint(
    problem: JointProblem,
    effort: Effort,
    rng: np.random.Generator,
    report: Callable[[int, Convergence], None] = lambda _, __: None,
    evaluate: Evaluate[Array, Array] | None = None,
) -> JointDraws:
    """Draws of the population and of every test given all tests.

    Parameters
    ----------
    problem : JointProblem
    effort : Effort
        Its R̂ and effective sample size are asked of everything in h and of the levels.
    rng : numpy.random.Generator
    report : callable, optional
        Called now and then with the number of sweeps and the convergence.
    evaluate : callable, optional
        Computes what is the tests' own, in several processes; see `Joint`.
    """
    run = _Run(problem, effort, *warm_up(problem.layout, problem.tests, effort, rng, evaluate))
    for end in _looks(most_sweeps(effort)):
        run.sweep_until(end)
        dropped, convergence = run.converge()
        report(end, convergence)
        if convergence.reached(effort.r_hat, effort.ess):
            break
    return run.draws(dropped, convergence)


class _Run:
    """The sweeps after warm-up, and what is kept of them."""

    def __init__(
        self, problem: JointProblem, effort: Effort, sampler: Sampler, chains: Chains
    ) -> None:
        self.problem, self.effort, self.sampler, self.chains = problem, effort, sampler, chains
        self.hyper: list[Array] = []
        self.levels: list[Array] = []
        self.sizes = [x.shape[1] for x in chains.x]
        wanted = -(-max(KEPT, int(effort.ess)) // WALKERS)
        self.kept = ThinnedChains(wanted, len(chains.h), sum(self.sizes))

    def sweep_until(self, end: int) -> None:
        """Sweep up to this number of sweeps."""
        chains = self.chains
        for i in range(len(self.hyper), end):
            self.sampler.sweep(chains)
            self.hyper.append(chains.h.copy())
            self.levels.append(chains.latent[:, 0].copy())
            if self.kept.wants(i):
                products = self.sampler.joint.products(chains)
                self.kept.add(i, chains.latent.copy(), products, chains.x)

    def converge(self) -> tuple[int, Convergence]:
        """Sweeps to drop, and convergence of the rest: the first in `LATE` to do, else the best."""
        tried = []
        for share in LATE:
            dropped = int(share * len(self.hyper))
            found = self._measure(dropped)
            if found.reached(self.effort.r_hat, self.effort.ess):
                return dropped, found
            tried.append((dropped, found))
        return min(tried, key=lambda look: look[1].worst_r_hat)

    def _measure(self, dropped: int) -> Convergence:
        hyper, levels = self.hyper[dropped:], self.levels[dropped:]
        everything = np.concatenate([np.stack(hyper), np.stack(levels)], axis=2)
        shaped = everything.reshape(len(hyper), self.effort.ensembles, -1, everything.shape[2])
        return measure(np.swapaxes(shaped, 0, 1)[..., _active(self.problem.layout)])

    def draws(self, dropped: int, convergence: Convergence) -> JointDraws:
        """What is kept after the dropped sweeps."""
        kept, ensembles = self.kept.since(dropped), self.effort.ensembles
        snapshots = list(kept.values())
        h = by_walker([self.hyper[i] for i in kept], ensembles)
        choice = np.repeat(self.chains.choice[:, None], len(snapshots), axis=1)
        population = Population(
            layout=self.problem.layout,
            h=h,
            latent=by_walker([snapshot.latent for snapshot in snapshots], ensembles),
            choice=choice.reshape(*h.shape[:2], -1),
            together=_correlate(by_walker([snap.products for snap in snapshots], ensembles)),
            priors=self.problem.priors,
            actuation_unit=self.problem.actuation_unit,
            walkers=WALKERS,
            convergence=convergence,
            residual=self.problem.residual,
        )
        rates = {name: float(np.mean(r)) for name, r in self.sampler.accepted.items()}
        tests = TestDraws(snapshots, self.sizes, ensembles)
        return JointDraws(population, tests, rates, len(self.hyper))


def _looks(limit: int) -> list[int]:
    """Numbers of sweeps at which convergence is measured, each half as many again as the last."""
    looks = [min(20, limit)]
    while looks[-1] < limit:
        looks.append(min(looks[-1] + looks[-1] // 2, limit))
    return looks


def most_sweeps(effort: Effort) -> int:
    """Largest number of sweeps after warm-up, converged or not."""
    return SWEEPS.get(effort.ess, int(2 * effort.ess))


def _correlate(products: Array) -> Array:
    """Cholesky factors of the correlations of the tests' scatter, (chain, draw, d, d).

    The sds of the scatter are sampled; its correlation is that of the tests of each joint draw,
    shrunk as if `ALONE` more tests had shown none.

    Parameters
    ----------
    products : (chain, draw, d, d)
        Of the standardised deviations, (x − mean)/scatter, summed over tests.
    """
    shrunk = products + ALONE * np.eye(products.shape[-1])
    sd = np.sqrt(np.diagonal(shrunk, axis1=-2, axis2=-1))
    correlation = shrunk / (sd[..., :, None] * sd[..., None, :])
    factors = np.linalg.cholesky(correlation)
    return np.asarray(factors.astype(np.float32), dtype=np.float64)  # as it is stored


def _active(layout: Layout) -> NDArray[np.intp]:
    """Coordinates of h, and levels, that some law of positive weight depends on."""
    begin = len(layout.names) + len(layout.effects)
    idle = [
        begin + i
        for i, (name, shape) in enumerate(layout.shapes)
        if shape in ("share", "exponent")
        and not any(
            weight > 0 and shape in LAWS[law].shapes for law, weight in layout.weights[name].items()
        )
    ]
    idle += np.flatnonzero(~layout.inferred).tolist()
    return np.setdiff1d(np.arange(layout.dim + len(layout.names)), idle)
