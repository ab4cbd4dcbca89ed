"""Lines along which the tests move together with scatter and level of one quantity.

Where each test tells little of a quantity, the tests' values of it and its scatter and level hold
each other in place, the more so the more tests there are: moved in turn, they would hardly move at
all. `transport` moves them together. A test then moves along a line: its value t of
the quantity changes, and its other coordinates follow by their regression on t in the Gaussian near
its likelihood. Lines and Gaussians depend on nothing that a move changes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.chains import Accepted, Chains
from mfd_bayes.population.joint import Conditional, Joint
from mfd_bayes.population.layout import Layout
from mfd_bayes.population.test_likelihood import TestLikelihood

Array = NDArray[np.float64]

SIZES = (2.4, 1.2, 0.5)
"""Sizes of steps of scatter and level, in their sds."""


class ScatterLevel(NamedTuple):
    """Logarithm of the scatter, and level, of one quantity, (n,) each."""

    log_scatter: Array
    level: Array


@dataclass(frozen=True, eq=False)
class Tuning:
    """Figures to which proposals are tuned. They are fixed once chains are kept.

    Attributes
    ----------
    scatter : (d,)
        Typical scatter of each quantity, in prior units.
    scatter_step, level_step : (d,)
        Sds of the logarithm of the scatter, and of the level.
    covariances : sequence of (D, D)
        Of each test's coordinates given a typical scatter.
    level_mean, level_covariance : (d,), (d, d)
        Of the levels.
    """

    scatter: Array
    scatter_step: Array
    level_step: Array
    covariances: Sequence[Array]
    level_mean: Array
    level_covariance: Array

    @classmethod
    def by_prior(cls, layout: Layout, tests: Sequence[TestLikelihood]) -> Tuning:
        """Tuning before there are any draws."""
        d = len(layout.names)
        scatter = 0.5 * layout.scatter_sd / layout.spread
        half, some = np.full(d, 0.5), np.full(d, 0.3)
        about = np.zeros(d), np.diag(some**2)
        return cls(scatter, half, some, _covariances(tests, scatter), *about)

    @classmethod
    def by_chains(cls, layout: Layout, tests: Sequence[TestLikelihood], chains: Chains) -> Tuning:
        """Tuning to the current state of the chains."""
        scatters, levels = layout.scatter(chains.h), chains.latent[:, 0]
        scatter = np.exp(np.log(scatters).mean(axis=0))
        return cls(
            scatter,
            chains.h[:, : len(layout.names)].std(axis=0),
            levels.std(axis=0),
            _covariances(tests, scatter),
            levels.mean(axis=0),
            np.cov(levels, rowvar=False).reshape(levels.shape[1], -1),
        )

    @property
    def missing(self) -> Array:
        """Share of each quantity's scatter variance that a test leaves open, mean over tests."""
        d = len(self.scatter)
        left = np.mean([np.diag(covariance)[:d] for covariance in self.covariances], axis=0)
        return np.asarray(left / self.scatter**2)

    def step(self, k: int, here: ScatterLevel, rng: np.random.Generator) -> ScatterLevel:
        """Random step of scatter, level, or both, of quantity k."""
        n = len(here.level)
        size, what = rng.choice(SIZES, size=n), rng.integers(3, size=n)
        wider = (what != 0) * size * self.scatter_step[k] * rng.standard_normal(n)
        higher = (what != 1) * size * self.level_step[k] * rng.standard_normal(n)
        return ScatterLevel(here.log_scatter + wider, here.level + higher)


def _covariances(tests: Sequence[TestLikelihood], scatter: Array) -> list[Array]:
    """Covariances of the tests' coordinates with their Gaussians and a scatter."""
    found: list[Array] = []
    for test in tests:
        prior = np.ones(len(test.mean))
        prior[: len(scatter)] = scatter**-2.0
        found.append(np.asarray(np.linalg.inv(test.precision + np.diag(prior))))
    return found


@dataclass(frozen=True, eq=False)
class Lines:
    """The tests' lines of quantity k, through the current state of n chains.

    Attributes
    ----------
    joint : Joint
    chains : Chains
    k : int
    slopes : sequence of (D,)
        Change of each test's coordinates as t changes by 1.
    information : (J,)
        Precision of t without its prior given the population.
    pull : (n, J)
        That precision times the mean.
    base : (n, J)
        Mean of t in the population less the level.
    given : Conditional
        Density of the tests given the current population.
    """

    joint: Joint
    chains: Chains
    k: int
    slopes: Sequence[Array]
    information: Array
    pull: Array
    base: Array
    given: Conditional

    @classmethod
    def through(cls, joint: Joint, chains: Chains, tuning: Tuning, k: int) -> Lines:
        """Lines through the current coordinates of the tests."""
        given, slopes, information, pull = joint.conditional(chains), [], [], []
        for j, (test, covariance) in enumerate(zip(joint.tests, tuning.covariances, strict=True)):
            slope = covariance[:, k] / covariance[k, k]
            others = slope[: joint.d] * tuning.scatter**-2.0
            others[k] = 0.0
            slopes.append(slope)
            information.append(1.0 / covariance[k, k] - tuning.scatter[k] ** -2.0)
            pull.append(slope @ (test.precision @ test.mean) + given.means[:, j] @ others)
        return cls(
            joint,
            chains,
            k,
            slopes,
            np.maximum(information, 1e-9),
            np.stack(pull, axis=1),
            given.means[:, :, k] - chains.latent[:, 0, k, None],
            given,
        )

    @property
    def here(self) -> ScatterLevel:
        """Current scatter and level."""
        return ScatterLevel(self.chains.h[:, self.k], self.chains.latent[:, 0, self.k])

    def log_prior(self, at: ScatterLevel) -> Array:
        """Log prior density of scatter and level, the others as they are, (n,)."""
        return self.joint.log_prior_of_quantity(self.k, self.chains.h, *at)

    def gaussian(self, at: ScatterLevel) -> tuple[Array, Array]:
        """Conditional means and sds of t by the Gaussians, (n, J) each."""
        scatter = np.exp(at.log_scatter) / self.joint.layout.spread[self.k]
        prior = self.chains.weight[..., self.k] / scatter[:, None] ** 2
        mean = self.base + at.level[:, None]
        precision = self.information + prior
        centre = (self.pull + prior * mean) / precision
        return centre, precision**-0.5

    def log_population(self, t: Array, at: ScatterLevel) -> Array:
        """Log density of t (n, J) given scatter and level, without constants, (n, J)."""
        log_scale = at.log_scatter - np.log(self.joint.layout.spread[self.k])
        standard = (t - self.base - at.level[:, None]) * np.exp(-log_scale)[:, None]
        weight = self.chains.weight[..., self.k]
        return np.asarray(-0.5 * weight * standard**2 - log_scale[:, None])

    def log_prior_of_others(self, by: Array) -> Array:
        """Change of the log density of all shared coordinates but t where t changes by (n, J)."""
        slopes = np.stack([slope[: self.joint.d] for slope in self.slopes])  # (J, d)
        slopes[:, self.k] = 0.0
        return self.given.log_change(self.joint.shared(self.chains), by[..., None] * slopes)

    def moved(self, by: Array) -> Iterator[Array]:
        """Coordinates of each test, (n, D), where t has changed by (n, J)."""
        for j, x in enumerate(self.chains.x):
            yield x + by[:, j, None] * self.slopes[j]

    def accept(
        self, new: ScatterLevel, t: Array, log_ratio: Array, log_uniform: Array
    ) -> NDArray[np.bool_]:
        """Accept or reject a new scatter and level and new values t (n, J) of the tests, (n,).

        `log_ratio` has the whole log acceptance ratio but the tests' log densities.
        """
        chains, k = self.chains, self.k
        before = chains.values(k)
        ratio = log_ratio + np.sum(self.log_population(t, new), axis=1)
        ratio -= np.sum(self.log_population(before, self.here), axis=1)
        ratio += self.log_prior_of_others(t - before)
        moved, found = self.joint.densities(self.moved(t - before))
        for j, density in enumerate(found):
            ratio += density - chains.log_density[j]
        yes: NDArray[np.bool_] = np.isfinite(ratio) & (log_uniform < ratio)
        chains.h[yes, k], chains.latent[yes, 0, k] = new.log_scatter[yes], new.level[yes]
        chains.move_tests(yes, moved, found)
        return yes


def transport(
    joint: Joint, chains: Chains, rng: np.random.Generator, tuning: Tuning, k: int
) -> Accepted:
    """Random step of quantity k's scatter and level that carries the tests along.

    Every t keeps its quantile in its Gaussian conditional, which the step shifts and widens.
    """
    lines = Lines.through(joint, chains, tuning, k)
    new = tuning.step(k, lines.here, rng)
    ratio = lines.log_prior(new) - lines.log_prior(lines.here)
    before, old_sd = lines.gaussian(lines.here)
    after, new_sd = lines.gaussian(new)
    t = after + new_sd / old_sd * (chains.values(k) - before)
    ratio += np.sum(np.log(new_sd / old_sd), axis=1)
    yes = lines.accept(new, t, ratio, np.log(rng.random(len(ratio))))
    return [(f"transport {joint.layout.names[k]}", yes)]
