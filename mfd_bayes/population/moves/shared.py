"""Moves of quantities that hardly differ between tests: of all tests at once.

Where scatter is next to none, a test cannot move without the others. `shift` moves the levels of
these quantities and carries every test along, its other coordinates by their regression in the
Gaussian near its likelihood; `rescale` moves their scatter with every test's standardised
deviation as it is (the non-centred parametrisation of Papaspiliopoulos et al., 2007). Half of the
chains make steps of differential evolution with partners among the others. The others' steps depend
on no other chain, so that both halves step at once: shifts are Crank–Nicolson steps around the
Gaussian near the levels, which leave their place in a few steps; scatter has tuned random steps.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.chains import Accepted, Chains, Index
from mfd_bayes.population.joint import FAR, Joint
from mfd_bayes.population.moves.lines import Tuning
from mfd_bayes.population.test_likelihood import TestLikelihood

Array = NDArray[np.float64]

SIZES = (1.0, 0.5)
"""Sizes of steps, over that which is best for a Gaussian."""

AROUND = (1.0, 1.0, 0.7)
"""Sizes of Crank–Nicolson steps; 1 is a proposal that does not depend on the current levels."""


@dataclass(frozen=True, eq=False)
class Slopes:
    """How levels and scatter of the sparse quantities may move, and every test with them.

    Attributes
    ----------
    of_tests : sequence of (sparse, D)
        Changes of each test's coordinates with these levels.
    of_shared : (sparse, J, d)
        Those of the shared ones.
    middle, root : (sparse,), (sparse, sparse)
        Mean of the levels, and the Cholesky factor of their covariance.
    wider : (d,)
        Sds of the logarithms of the scatter.
    """

    of_tests: Sequence[Array]
    of_shared: Array
    middle: Array
    root: Array
    wider: Array

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
    """New state of all chains.

    Attributes
    ----------
    h : (n, dim)
    level : (n, d)
    x : iterable of (n, D)
        Of each test; they may be computed while processes are at work on those before.
    log_ratio : (n,)
        Log density of everything but what is the tests' own, new less old.
    """

    h: Array
    level: Array
    x: Iterable[Array]
    log_ratio: Array


def slopes_of(joint: Joint, tuning: Tuning) -> Slopes:
    """Slopes and levels of the sparse quantities by a tuning."""
    those = np.flatnonzero(joint.layout.sparse)
    covariance = tuning.level_covariance[np.ix_(those, those)] + 1e-10 * np.eye(those.size)
    of_tests = [_slopes(test, tuning.scatter, those).T for test in joint.tests]
    return Slopes(
        of_tests,
        np.stack([slopes[:, : joint.d] for slopes in of_tests], axis=1),
        tuning.level_mean[those],
        np.asarray(np.linalg.cholesky(covariance)),
        tuning.scatter_step,
    )


def shift(joint: Joint, chains: Chains, rng: np.random.Generator, slopes: Slopes) -> Accepted:
    """Levels of the sparse quantities, with all tests by their slopes."""
    those = np.flatnonzero(joint.layout.sparse)
    if those.size == 0:
        return []
    given, level = joint.conditional(chains), chains.latent[:, 0]
    jump, log_ratio = slopes.around(level[:, those], rng)
    half, first, second = chains.partners(rng)[0]
    jump[half] = _size(rng, len(half), those.size) * (level[first] - level[second])[:, those]
    jump[half] += 1e-5 * rng.standard_normal(jump[half].shape)
    log_ratio[half] = 0.0
    new = level.copy()
    new[:, those] += jump
    log_ratio += 0.5 * np.sum(level**2 - new**2, axis=1)
    by = np.tensordot(jump, slopes.of_shared, axes=1)  # (n, J, d)
    by[:, :, those] -= jump[:, None]
    log_ratio += given.log_change(joint.shared(chains), by)
    moved = (x + jump @ slope for x, slope in zip(chains.x, slopes.of_tests, strict=True))
    proposed = _Proposed(chains.h.copy(), new, moved, log_ratio)
    return _by_half("shift", _accept(joint, chains, rng, proposed), half)


def rescale(joint: Joint, chains: Chains, rng: np.random.Generator, slopes: Slopes) -> Accepted:
    """Scatter of the sparse quantities, each test's standardised deviations as they are."""
    those = np.flatnonzero(joint.layout.sparse & joint.layout.inferred[: joint.d])
    if those.size == 0:
        return []
    given, h = joint.conditional(chains), chains.h.copy()
    jump = np.sqrt(2.0) * _size(rng, len(h), those.size) * slopes.wider[those]
    jump *= rng.standard_normal(jump.shape)
    half, first, second = chains.partners(rng)[0]
    jump[half] = _size(rng, len(half), those.size) * (h[first] - h[second])[:, those]
    jump[half] += 1e-3 * rng.standard_normal(jump[half].shape)
    h[:, those] += jump
    # the Jacobian of the tests' coordinates cancels the change of their density
    inside = np.all(np.abs(h) < FAR, axis=1)
    ratio = np.where(inside, joint.layout.log_prior(h).sum(axis=1), -np.inf)
    ratio -= joint.layout.log_prior(chains.h).sum(axis=1)
    means, factor = given.means[:, :, those], np.exp(jump)
    moved = (_scaled(x, those, means[:, j], factor) for j, x in enumerate(chains.x))
    proposed = _Proposed(h, chains.latent[:, 0].copy(), moved, ratio)
    return _by_half("rescale", _accept(joint, chains, rng, proposed), half)


def _by_half(name: str, yes: NDArray[np.bool_], half: Index) -> Accepted:
    """What was accepted of the half that evolves, and of the other."""
    return [(name, yes[half]), (name, np.delete(yes, half))]


def _scaled(x: Array, those: Index, mean: Array, factor: Array) -> Array:
    """Coordinates (n, D) with deviations of some of them from their means times a factor."""
    moved = x.copy()
    moved[:, those] = mean + factor * (x[:, those] - mean)
    return moved


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
    """Accept or reject (Metropolis–Hastings), with the densities of all tests."""
    ratio = proposed.log_ratio.copy()
    moved, found = joint.densities(proposed.x)
    for j, density in enumerate(found):
        ratio += density - chains.log_density[j]
    yes: NDArray[np.bool_] = np.isfinite(ratio) & (np.log(rng.random(len(ratio))) < ratio)
    chains.h[yes], chains.latent[yes, 0] = proposed.h[yes], proposed.level[yes]
    chains.move_tests(yes, moved, found)
    return yes
