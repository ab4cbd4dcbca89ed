"""Moves of quantities that hardly differ between tests: of all tests at once.

Where scatter is next to none, a test cannot move without the others. `shift` moves the levels of
these quantities and carries every test along, its other coordinates by their regression in the
Gaussian near its likelihood; `rescale` moves their scatter with every test's standardised
deviation as it is (the non-centred parametrisation of Papaspiliopoulos et al., 2007). The steps
are those of differential evolution; half of the shifts are Crank–Nicolson steps around the Gaussian
near the levels, which leave their place in a few steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.chains import Accepted, Chains, Index
from mfd_bayes.population.joint import FAR, Joint
from mfd_bayes.population.moves.lines import Tuning
from mfd_bayes.population.test_likelihood import TestLikelihood

Array = NDArray[np.float64]

SIZES = (1.0, 0.5, 0.25)
"""Sizes of steps, over that which is best for a Gaussian."""

AROUND = (1.0, 0.7, 0.4)
"""Sizes of Crank–Nicolson steps; 1 is a proposal that does not depend on the current levels."""


@dataclass(frozen=True, eq=False)
class Slopes:
    """How the levels of the sparse quantities may be shifted, and every test with them.

    Attributes
    ----------
    of_tests : sequence of (D, sparse)
        Changes of each test's coordinates with these levels.
    middle, root : (sparse,), (sparse, sparse)
        Mean of the levels, and the Cholesky factor of their covariance.
    """

    of_tests: Sequence[Array]
    middle: Array
    root: Array

    def around(self, level: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Crank–Nicolson steps from levels (n, sparse), and their log ratio of densities (n,).

        The ratio is that of the Gaussian at the current levels to that at the new ones.
        """
        away = np.linalg.solve(self.root, (level - self.middle).T).T
        size = rng.choice(AROUND, size=(len(level), 1))
        new = np.sqrt(1.0 - size**2) * away + size * rng.standard_normal(away.shape)
        log_ratio = 0.5 * (np.sum(new**2, axis=1) - np.sum(away**2, axis=1))
        return (new - away) @ self.root.T, log_ratio


@dataclass(frozen=True, eq=False)
class _Proposed:
    """New state of some chains.

    Attributes
    ----------
    chains : (n,) int
    h : (n, dim)
    level : (n, d)
    x : sequence of (n, D)
    log_ratio : (n,)
        Log density of everything but the tests' likelihoods, new less old.
    """

    chains: Index
    h: Array
    level: Array
    x: Sequence[Array]
    log_ratio: Array


def slopes_of(joint: Joint, tuning: Tuning) -> Slopes:
    """Slopes and levels of the sparse quantities by a tuning."""
    those = np.flatnonzero(joint.layout.sparse)
    covariance = tuning.level_covariance[np.ix_(those, those)] + 1e-10 * np.eye(those.size)
    return Slopes(
        [_slopes(test, tuning.scatter, those) for test in joint.tests],
        tuning.level_mean[those],
        np.asarray(np.linalg.cholesky(covariance)),
    )


def shift(joint: Joint, chains: Chains, rng: np.random.Generator, slopes: Slopes) -> Accepted:
    """Levels of the sparse quantities, with all tests by their slopes."""
    those = np.flatnonzero(joint.layout.sparse)
    if those.size == 0:
        return []
    accepted: Accepted = []
    for half, first, second in chains.partners(rng):
        given, level = joint.conditional(chains), chains.latent[:, 0]
        jump = _size(rng, len(half), those.size) * (level[first] - level[second])[:, those]
        jump += 1e-5 * rng.standard_normal(jump.shape)
        near, log_ratio = slopes.around(level[half][:, those], rng)
        turned = rng.random(len(half)) < 0.5
        jump[turned] = near[turned]
        new = level[half].copy()
        new[:, those] += jump
        ratio = 0.5 * np.sum(level[half] ** 2 - new**2, axis=1) + np.where(turned, log_ratio, 0.0)
        xs = []
        for j, x in enumerate(chains.x):
            moved = x[half] + jump @ slopes.of_tests[j].T
            mean = given.means[half, j].copy()
            ratio -= joint.log_prior_of_test(j, x[half], mean, given.scatter[half, j])
            mean[:, those] += jump
            ratio += joint.log_prior_of_test(j, moved, mean, given.scatter[half, j])
            xs.append(moved)
        proposed = _Proposed(half, chains.h[half], new, xs, ratio)
        accepted.append(("shift", _accept(joint, chains, rng, proposed)))
    return accepted


def rescale(joint: Joint, chains: Chains, rng: np.random.Generator) -> Accepted:
    """Scatter of the sparse quantities, each test's standardised deviations as they are."""
    those = np.flatnonzero(joint.layout.sparse & joint.layout.inferred[: joint.d])
    if those.size == 0:
        return []
    accepted: Accepted = []
    for half, first, second in chains.partners(rng):
        given = joint.conditional(chains)
        jump = _size(rng, len(half), those.size) * (chains.h[first] - chains.h[second])[:, those]
        jump += 1e-3 * rng.standard_normal(jump.shape)
        h = chains.h[half].copy()
        h[:, those] += jump
        # the Jacobian of the tests' coordinates cancels the change of their density
        inside = np.all(np.abs(h) < FAR, axis=1)
        ratio = np.where(inside, joint.layout.log_prior(h).sum(axis=1), -np.inf)
        ratio -= joint.layout.log_prior(chains.h[half]).sum(axis=1)
        xs = []
        for j, x in enumerate(chains.x):
            moved, mean = x[half].copy(), given.means[half, j][:, those]
            moved[:, those] = mean + np.exp(jump) * (moved[:, those] - mean)
            xs.append(moved)
        proposed = _Proposed(half, h, chains.latent[half, 0], xs, ratio)
        accepted.append(("rescale", _accept(joint, chains, rng, proposed)))
    return accepted


def _size(rng: np.random.Generator, n: int, dim: int) -> Array:
    """Factors of the steps of n chains, (n, 1)."""
    size = 2.38 / np.sqrt(2.0 * dim) * rng.choice(SIZES, size=(n, 1))
    return np.asarray(np.where(rng.random((n, 1)) < 0.1, 1.0, size))


def _slopes(test: TestLikelihood, scatter: Array, those: Index) -> Array:
    """Change of a test's coordinates with those that are shifted, (D, those)."""
    precision = test.precision.copy()
    precision[range(len(precision)), range(len(precision))] += 1.0
    precision[range(len(scatter)), range(len(scatter))] += scatter**-2.0 - 1.0
    rest = np.setdiff1d(np.arange(len(precision)), those)
    slopes = np.zeros((len(precision), those.size))
    slopes[those, range(those.size)] = 1.0
    slopes[rest] = -np.linalg.solve(precision[np.ix_(rest, rest)], precision[np.ix_(rest, those)])
    return slopes


def _accept(
    joint: Joint, chains: Chains, rng: np.random.Generator, proposed: _Proposed
) -> NDArray[np.bool_]:
    """Accept or reject (Metropolis–Hastings), with the likelihoods of all tests."""
    which, ratio = proposed.chains, proposed.log_ratio.copy()
    found = list(joint.evaluate((j, x) for j, x in enumerate(proposed.x)))
    for j, likelihood in enumerate(found):
        ratio += likelihood - chains.log_likelihood[j][which]
    yes: NDArray[np.bool_] = np.isfinite(ratio) & (np.log(rng.random(len(which))) < ratio)
    at = which[yes]
    chains.h[at], chains.latent[at, 0] = proposed.h[yes], proposed.level[yes]
    for j, likelihood in enumerate(found):
        chains.x[j][at] = proposed.x[j][yes]
        chains.log_likelihood[j][at] = likelihood[yes]
    return yes
