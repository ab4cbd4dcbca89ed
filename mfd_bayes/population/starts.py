"""Where in the gap tests begin, learned from the calibrated ones.

Tests are often made one after the other with the same or a like motion, and the device is not reset
in between. It then stands where such a motion leaves it. So the place at which a test begins is
near the middle of the gap, or near the place at which its own motion ends; which of the two, and
how near, is learned.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaln, expit, log_expit, softmax

from mfd_bayes.population.unloaded import Unloaded

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SHAPES = np.geomspace(1.0, 100.0, 41)
"""Equally probable shapes a of the starts' density: from anywhere (1) to one place."""


@dataclass(frozen=True, eq=False)
class Standing:
    """What is known of where tests may begin before they are made.

    Attributes
    ----------
    left : float, optional
        Place at which the motion leaves the device, `left_by`, where the motion is known.
    unloaded : Unloaded, optional
        Where each test bears no load; None with a model in which that is everywhere.
    """

    left: float | None = None
    unloaded: Unloaded | None = None


UNKNOWN = Standing()


@dataclass(frozen=True, eq=False)
class StartDensity:
    """Densities of the place w, between 0 and 1, where n tests begin.

    Attributes
    ----------
    a, b : (n,)
        Exponents of Beta densities.
    unloaded : Unloaded, optional
        Other densities of the same tests,
    instead : (n,) bool, optional
        and which of the tests have these instead.
    """

    a: Array
    b: Array
    unloaded: Unloaded | None = None
    instead: NDArray[np.bool_] | None = None

    def draw(self, rng: np.random.Generator, chosen: Index | slice = slice(None)) -> Array:
        """Places of chosen tests, as many as these."""
        found = rng.beta(self.a[chosen], self.b[chosen])
        if self.unloaded is None or self.instead is None:
            return np.asarray(found)
        part = self.unloaded
        some = Unloaded(part.lower[chosen], part.upper[chosen], part.edge[chosen])
        return np.where(self.instead[chosen], some.draw(rng), found)

    @cached_property
    def log_size(self) -> Array:
        """Logarithm of what `log_shape` has too much, (n,)."""
        size = betaln(self.a, self.b)
        if self.unloaded is None or self.instead is None:
            return np.asarray(size)
        return np.where(self.instead, self.unloaded.log_size, size)

    def log_shape(self, t: Array, chosen: Index) -> Array:
        """Log density of logits t of places of chosen tests, without `log_size`; of one shape."""
        log, other = log_expit(t), log_expit(-t)
        found = self.a[chosen] * log + self.b[chosen] * other
        if self.unloaded is None or self.instead is None:
            return np.asarray(found)
        without = self.unloaded.log_shape(expit(t), chosen) + log + other
        return np.where(self.instead[chosen], without, found)


def start_density(a: Array, mode: Array) -> tuple[Array, Array]:
    """Exponents of the Beta densities of shapes a with these modes, and sum 2a, (n,) each."""
    return 1.0 + 2.0 * (a - 1.0) * mode, 1.0 + 2.0 * (a - 1.0) * (1.0 - mode)


def learned_density(
    begun: Array, left: tuple[Array, float] | None, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Exponents of the Beta densities of the place where n new tests begin, (n,) each.

    Parameters
    ----------
    begun : (n, J)
        Draws of the places where the tests began.
    left : ((J,), float) or None
        Places where their own motions leave the device, and the one where the new motion does;
        None where they are not known: tests then begin about the middle.
    rng : numpy.random.Generator
    """
    sides = np.clip(begun, 1e-6, 1.0 - 1e-6)
    half = np.full(begun.shape[1], 0.5)
    modes = [(half, 0.5)] if left is None else [(half, 0.5), left]
    log = np.concatenate([_log_likelihood(sides, places) for places, _ in modes], axis=1)
    edges = np.cumsum(softmax(log, axis=1), axis=1)
    chosen = np.argmax(rng.random((len(begun), 1)) * edges[:, -1:] < edges, axis=1)
    which, shape = np.divmod(chosen, SHAPES.size)
    return start_density(SHAPES[shape], np.array([mode for _, mode in modes])[which])


def anywhere(rng: np.random.Generator, n: int, chance: float, standing: Standing) -> StartDensity:
    """Densities of n tests that may begin anywhere, but with this chance all without load."""
    part = standing.unloaded
    instead = None if part is None else rng.random(n) < chance
    return StartDensity(np.ones(n), np.ones(n), part, instead)


def _log_likelihood(begun: Array, places: Array) -> Array:
    """Log likelihood of every shape a for starts (n, J) about these places (J,), (n, A)."""
    alpha, beta = start_density(SHAPES[:, None], places)
    log = np.log(begun) @ (alpha - 1.0).T + np.log1p(-begun) @ (beta - 1.0).T
    return np.asarray(log - betaln(alpha, beta).sum(axis=1))
