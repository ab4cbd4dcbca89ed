"""Moves of the coordinates of one test after the other, given the population."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.chains import Accepted, Chains, Index
from mfd_bayes.population.joint import Conditional, Joint
from mfd_bayes.population.test_likelihood import TestLikelihood

Array = NDArray[np.float64]

STEPS = (1.0, 1.0, 0.8, 0.6)
"""Sizes of Crank–Nicolson steps; 1 is a proposal that does not depend on the current point."""

EVOLVED = 0.25
"""Share of sweeps in which a test is also moved by differential evolution."""


@dataclass(frozen=True, eq=False)
class GaussianConditional:
    """Conditional density of a test's coordinates with a Gaussian in place of its likelihood.

    Attributes
    ----------
    information : (D, D)
        Precision of the Gaussian in place of the likelihood.
    prior : (n, D)
        Diagonal of the precision of the prior given the population.
    mean : (n, D)
    noise : (draws, n, D)
        Draws from the density less its mean.
    """

    information: Array
    prior: Array
    mean: Array
    noise: Array

    @classmethod
    def of(
        cls, test: TestLikelihood, given: tuple[Array, Array], rng: np.random.Generator, draws: int
    ) -> GaussianConditional:
        """Given the population's mean and scatter of the test, (n, d) each, with so many draws."""
        mean, scatter = given
        size, d = len(test.mean), mean.shape[1]
        prior = np.ones((len(mean), size))
        prior[:, :d] = 1.0 / scatter**2
        precision = np.repeat(test.precision[None], len(mean), axis=0)
        precision[:, range(size), range(size)] += prior
        pull = np.repeat((test.precision @ test.mean)[None], len(mean), axis=0)
        pull[:, :d] += prior[:, :d] * mean
        shape = draws, *pull.shape
        swings = rng.standard_normal(shape) @ test.root.T
        swings += np.sqrt(prior) * rng.standard_normal(shape)  # of covariance `precision`
        solved = np.linalg.solve(precision, np.stack([pull, *swings], axis=2))
        mean, *noise = np.moveaxis(solved, 2, 0).copy()
        return cls(test.precision, prior, mean, np.array(noise))

    def square(self, away: Array) -> Array:
        """Squared deviations from the mean (n, D), weighted by the precision, (n,)."""
        total: Array = np.sum((away @ self.information + self.prior * away) * away, axis=1)
        return total


@dataclass(frozen=True, eq=False)
class Proposal:
    """New coordinates of test j for some chains.

    Attributes
    ----------
    j : int
    chains : (n,) int
    x : (n, D)
    log_ratio : (n,) or float
        Log proposal density of the current point less that of the new one.
    log_uniform : (n,)
        Logarithm of the uniform number that decides on acceptance.
    """

    j: int
    chains: Index
    x: Array
    log_ratio: Array | float
    log_uniform: Array


def step_near(
    joint: Joint, chains: Chains, rng: np.random.Generator, given: Conditional, times: int = 1
) -> Accepted:
    """Crank–Nicolson steps around the Gaussian near the conditional density of each test."""
    everyone = np.arange(len(given.scatter))
    known: dict[int, GaussianConditional] = {}  # while it is needed again

    def propose(turn: int) -> Iterator[Proposal]:
        for j, test in enumerate(joint.tests):
            of_test = given.means[:, j], given.scatter[:, j]
            near = known.pop(j, None) or GaussianConditional.of(test, of_test, rng, times)
            if turn + 1 < times:
                known[j] = near
            beta = rng.choice((1.0,) if test.gaussian else STEPS, size=everyone.size)
            away = chains.x[j] - near.mean
            moved = np.sqrt(1.0 - beta**2)[:, None] * away + beta[:, None] * near.noise[turn]
            log_ratio = 0.5 * (near.square(moved) - near.square(away))
            log_uniform = np.log(rng.random(everyone.size))
            yield Proposal(j, everyone, near.mean + moved, log_ratio, log_uniform)

    accepted: Accepted = []
    for turn in range(times):
        accepted += _accept(joint, chains, given, propose(turn), "near")
    return accepted


def evolve_tests(
    joint: Joint, chains: Chains, rng: np.random.Generator, given: Conditional
) -> Accepted:
    """Differential evolution of some of the tests; what is common to all stays where it is."""
    common = np.flatnonzero(joint.layout.common)
    share = rng.random(len(joint.tests))
    evolved = [j for j, t in enumerate(joint.tests) if not t.gaussian and share[j] < EVOLVED]
    accepted: Accepted = []
    for half, first, second in chains.partners(rng):

        def propose(
            half: Index = half, first: Index = first, second: Index = second
        ) -> Iterator[Proposal]:
            for j in evolved:
                x = chains.x[j]
                shorter = rng.choice([1.0, 0.4], size=(len(half), 1))
                jump = 2.38 / np.sqrt(2 * x.shape[1]) * shorter * (x[first] - x[second])
                jump += 1e-4 * rng.standard_normal(jump.shape)
                jump[:, common] = 0.0
                new = x[half] + jump
                yield Proposal(j, half, new, 0.0, np.log(rng.random(len(half))))

        accepted += _accept(joint, chains, given, propose(), "evolution")
    return accepted


def _accept(
    joint: Joint, chains: Chains, given: Conditional, proposals: Iterable[Proposal], name: str
) -> Accepted:
    """Accept or reject proposals of different tests (Metropolis–Hastings)."""
    accepted: Accepted = []
    for proposal, density in joint.with_densities(proposals):
        j, which = proposal.j, proposal.chains
        gain = given.log_density(j, proposal.x, which)
        gain -= given.log_density(j, chains.x[j][which], which)
        threshold = proposal.log_uniform - gain - proposal.log_ratio
        threshold += chains.log_density[j][which]
        yes = np.isfinite(gain) & (threshold < density)
        chains.x[j][which[yes]] = proposal.x[yes]
        chains.log_density[j][which[yes]] = density[yes]
        accepted.append((f"{name} {j}", yes))
    return accepted
