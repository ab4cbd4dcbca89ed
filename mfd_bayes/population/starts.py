"""Where in the gap tests begin, learned from the calibrated ones.

Tests are often made one after the other with the same or a like motion, and the device is not reset
in between. It then stands where such a motion leaves it. So the place at which a test begins is
near the middle of the gap, or near the place at which its own motion ends; which of the two, and
how near, is learned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaln, log_expit, softmax

from mfd_bayes.population.unloaded import Unloaded

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SHAPES = np.geomspace(1.0, 100.0, 41)
"""Equally probable shapes a of the starts' density: from anywhere (1) to one place."""

SHARP = 1e6
"""Shape a of a start that is known: it is then within a thousandth of one place."""


def _nothing() -> None:
    return None


@dataclass(frozen=True, eq=False)
class Standing:
    """What is known of where n tests begin, before they are made; computed when it is needed.

    Attributes
    ----------
    left : callable
        Gives the place at which the motion leaves the device, `left_by`; None if not known.
    unloaded : callable
        Gives where each test bears no load; None with a model in which that is everywhere.
    luck : (n,), optional
        Uniform numbers from 0 to 1 that decide which tests begin without load. Dampers of one
        building have the same. By default each test has its own.
    """

    left: Callable[[], float | None] = _nothing
    unloaded: Callable[[], Unloaded | None] = _nothing
    luck: Array | None = None


UNKNOWN = Standing()


@dataclass(frozen=True, eq=False)
class StartDensity:
    """Densities of the place w, between 0 and 1, where n tests begin.

    Attributes
    ----------
    a, b : (n,)
        Exponents of Beta densities.
    without_load : (n,) bool
        Which tests have the density of `Standing.unloaded` instead.
    """

    a: Array
    b: Array
    without_load: NDArray[np.bool_]

    def draw(self, rng: np.random.Generator, unloaded: Callable[[], Unloaded | None]) -> Array:
        """A place of each test, (n,)."""
        found = rng.beta(self.a, self.b)
        part = unloaded() if np.any(self.without_load) else None
        if part is not None:
            found[self.without_load] = part.of(self.without_load).draw(rng)
        return np.asarray(found)

    def of(self, chosen: Index) -> StartDensity:
        """Those of some of the tests."""
        return StartDensity(self.a[chosen], self.b[chosen], self.without_load[chosen])

    @cached_property
    def log_size(self) -> Array:
        """Logarithms of the Beta functions that normalise the densities; 0 without load, (n,)."""
        return np.where(self.without_load, 0.0, betaln(self.a, self.b))

    def log_beta(self, t: Array, chosen: Index) -> Array:
        """Log Beta densities of logits t of places of chosen tests, without `log_size`."""
        return np.asarray(self.a[chosen] * log_expit(t) + self.b[chosen] * log_expit(-t))


def learned(
    begun: Array, left: tuple[Array, float] | None, rng: np.random.Generator
) -> StartDensity:
    """Beta densities of the place where n new tests begin.

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
    return _beta_densities(SHAPES[shape], np.array([mode for _, mode in modes])[which])


def fixed(n: int, place: float) -> StartDensity:
    """Densities of n tests that begin at one place."""
    return _beta_densities(np.full(n, SHARP), np.full(n, place))


def anywhere(
    rng: np.random.Generator, n: int, chance: float, luck: Array | None = None
) -> StartDensity:
    """Densities of n tests that begin anywhere, or with this chance without load.

    For `luck` see `Standing`.
    """
    if chance == 0.0:
        without = np.zeros(n, dtype=bool)
    else:
        without = (rng.random(n) if luck is None else luck) < chance
    return StartDensity(np.ones(n), np.ones(n), without)


def _beta_densities(a: Array, mode: Array) -> StartDensity:
    """Beta densities of shapes a with these modes, (n,) each."""
    return StartDensity(*_exponents(a, mode), np.zeros(a.shape, dtype=bool))


def _exponents(a: Array, mode: Array) -> tuple[Array, Array]:
    """Exponents of the Beta densities of shapes a with these modes, and sum 2a, (n,) each."""
    return 1.0 + 2.0 * (a - 1.0) * mode, 1.0 + 2.0 * (a - 1.0) * (1.0 - mode)


def _log_likelihood(begun: Array, places: Array) -> Array:
    """Log likelihood of every shape a for starts (n, J) about these places (J,), (n, A)."""
    alpha, beta = _exponents(SHAPES[:, None], places)
    log = np.log(begun) @ (alpha - 1.0).T + np.log1p(-begun) @ (beta - 1.0).T
    return np.asarray(log - betaln(alpha, beta).sum(axis=1))
