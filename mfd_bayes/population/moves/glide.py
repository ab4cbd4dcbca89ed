"""Trajectories of all tests and levels at once, where the tests' likelihoods are surrogates.

Hamiltonian dynamics (Duane et al., 1987; Neal, 2011) in coordinates that a Gaussian near each
chain's posterior standardises, so that a few steps make a trajectory that forgets where it began.
The levels come first: when one moves, the tests follow as the Gaussian says, and where a quantity
is the same in all tests they follow exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.chains import Accepted, Chains, Index
from mfd_bayes.population.joint import Conditional, Joint
from mfd_bayes.population.surrogate import Surrogate

Array = NDArray[np.float64]

SIZE = 0.5
"""Step of a trajectory, in standardised coordinates."""

STEPS = 4
"""Steps of a trajectory."""

VARIED = (0.7, 1.3)
"""Least and largest factor of the step, so that no trajectory is a period long."""


@dataclass(frozen=True, eq=False)
class _Point:
    """Where n trajectories are: the levels (n, d), and each test's coordinates (n, D)."""

    level: Array
    x: Sequence[Array]


@dataclass(frozen=True, eq=False)
class _Momentum:
    """Momenta of levels (n, d) and of each test's free coordinates (n, F), or slopes by them."""

    level: Array
    free: Sequence[Array]

    def kicked(self, slopes: _Momentum, size: Array) -> _Momentum:
        """After slopes have acted for some time (n, 1)."""
        free = [m + size * s for m, s in zip(self.free, slopes.free, strict=True)]
        return _Momentum(self.level + size * slopes.level, free)

    @property
    def energy(self) -> Array:
        """Kinetic energy, (n,)."""
        squares = [np.sum(part**2, axis=1) for part in (self.level, *self.free)]
        return np.asarray(0.5 * np.sum(squares, axis=0))


@dataclass(frozen=True, eq=False)
class _Block:
    """What standardises the free coordinates of a test, those that are not the same in all.

    Attributes
    ----------
    surrogate : Surrogate
    free : (F,) int
        The shared ones first.
    prior : (n, F)
        Precision given the population.
    root : (n, F, F)
        Of the covariance: rootᵀ root, given the levels.
    carry : (n, F, d)
        What a change of the levels takes away from the free coordinates.
    """

    surrogate: Surrogate
    free: Index
    prior: Array
    root: Array
    carry: Array


class _Frame:
    """Standardised coordinates of n chains, and the density that trajectories follow in them."""

    def __init__(self, joint: Joint, given: Conditional, level: Array) -> None:
        self.joint, self.given, self.start = joint, given, level
        d = level.shape[1]
        self.common: Index = np.flatnonzero(joint.layout.common)
        self.shared: Index = np.setdiff1d(np.arange(d), self.common)
        precision = np.repeat(np.eye(d)[None], len(level), axis=0)
        self.blocks = [self._block(j, precision) for j in range(len(joint.tests))]
        self.root = np.linalg.inv(np.linalg.cholesky(precision))

    def _block(self, j: int, precision: Array) -> _Block:
        """That of a test, whose part in the precision of the levels (n, d, d) is added."""
        surrogate = self.joint.tests[j].log_likelihood
        assert isinstance(surrogate, Surrogate)
        information, n = surrogate.information, len(precision)
        common, shared, some = self.common, self.shared, np.arange(self.shared.size)
        free = np.setdiff1d(np.arange(len(information)), common)
        prior = np.ones((n, free.size))
        prior[:, some] = self.given.scatter[:, j, shared] ** -2.0
        own = np.repeat(information[np.ix_(free, free)][None], n, axis=0)
        own[:, range(free.size), range(free.size)] += prior
        root = np.linalg.inv(np.linalg.cholesky(own))
        cross = np.zeros((n, free.size, precision.shape[1]))
        cross[:, :, common] = information[np.ix_(free, common)]
        cross[:, some, shared] = -prior[:, some]
        turned = root @ cross
        precision -= np.swapaxes(turned, 1, 2) @ turned
        precision[:, common[:, None], common] += information[np.ix_(common, common)]
        precision[:, shared, shared] += prior[:, some]
        return _Block(surrogate, free, prior, root, np.swapaxes(root, 1, 2) @ turned)

    def draw(self, rng: np.random.Generator) -> _Momentum:
        """Standard normal momenta."""
        level = rng.standard_normal(self.start.shape)
        return _Momentum(level, [rng.standard_normal(block.prior.shape) for block in self.blocks])

    def moved(self, at: _Point, momentum: _Momentum, size: Array) -> _Point:
        """After some time, (n, 1), with these momenta."""
        shift, found = size * _times(self.root, momentum.level, turned=True), []
        for block, x, free in zip(self.blocks, at.x, momentum.free, strict=True):
            new = x.copy()
            new[:, block.free] += size * _times(block.root, free, turned=True)
            new[:, block.free] -= _times(block.carry, shift)
            new[:, self.common] += shift[:, self.common]
            found.append(new)
        return _Point(at.level + shift, found)

    def slopes(self, at: _Point) -> _Momentum:
        """Derivatives of the log density by the standardised coordinates.

        Priors of a test's own coordinates are taken as N(0, 1); the density itself is exact.
        """
        level, free = -at.level, []
        for j, (block, x) in enumerate(zip(self.blocks, at.x, strict=True)):
            slope = block.surrogate.slopes(x)
            pulled = block.prior * self._away(j, at)
            own = slope[:, block.free] - pulled
            level[:, self.common] += slope[:, self.common]
            level[:, self.shared] += pulled[:, : self.shared.size]
            level -= _times(block.carry, own, turned=True)
            free.append(_times(block.root, own))
        return _Momentum(_times(self.root, level), free)

    def log_prior(self, at: _Point) -> Array:
        """Log density of levels and shared coordinates given the population, (n,)."""
        total, some = -0.5 * np.sum(at.level**2, axis=1), slice(self.shared.size)
        for j, block in enumerate(self.blocks):
            total -= 0.5 * np.sum((block.prior * self._away(j, at) ** 2)[:, some], axis=1)
        return np.asarray(total)

    def _away(self, j: int, at: _Point) -> Array:
        """Deviations of a test's free coordinates from their means, (n, F)."""
        away = at.x[j][:, self.blocks[j].free]
        away[:, : self.shared.size] -= self.given.means[:, j, self.shared]
        away[:, : self.shared.size] -= (at.level - self.start)[:, self.shared]
        return away


def glide(joint: Joint, chains: Chains, rng: np.random.Generator) -> Accepted:
    """Move levels and all tests along a trajectory, in place.

    The tests' likelihoods must be surrogates.
    """
    level = chains.latent[:, 0].copy()
    frame = _Frame(joint, joint.conditional(chains), level)
    at, momentum = _Point(level, chains.x), frame.draw(rng)
    size = SIZE * rng.uniform(*VARIED, size=(len(level), 1))
    gain = momentum.energy - frame.log_prior(at)
    with np.errstate(over="ignore", invalid="ignore"):
        momentum = momentum.kicked(frame.slopes(at), 0.5 * size)
        for step in range(STEPS):
            at = frame.moved(at, momentum, size)
            momentum = momentum.kicked(frame.slopes(at), size if step < STEPS - 1 else 0.5 * size)
        gain += frame.log_prior(at) - momentum.energy
    found = list(joint.evaluate(enumerate(at.x)))
    for density, before in zip(found, chains.log_density, strict=True):
        gain += density - before
    yes = np.isfinite(gain) & (np.log(rng.random(len(gain))) < gain)
    chains.latent[yes, 0] = at.level[yes]
    chains.move_tests(yes, at.x, found)
    return [("glide", yes)]


def _times(matrix: Array, vector: Array, *, turned: bool = False) -> Array:
    """Products of matrices (n, a, b), or of their transposes, and vectors."""
    if turned:
        return np.asarray(np.matmul(vector[:, None], matrix)[:, 0])
    return np.asarray(np.matmul(matrix, vector[..., None])[..., 0])
