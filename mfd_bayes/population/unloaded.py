"""Where in the gap a device at rest bears no load, as a density of where tests begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, log_expit, logsumexp

Array = NDArray[np.float64]
Index = NDArray[np.intp]

LEAST, MOST = 1e-3, 0.25
"""Shares of the range between which the length of the ends is kept."""

BEFORE = 5.0 / 6.0
"""Probability before the tests that those of a session all begin without load.

All 32 records of the five sessions in shared/data/brfd rest at less than a tenth of the slip force.
It is Laplace's rule for four of them, so that a fifth is not counted twice when it is calibrated.
"""


@dataclass(frozen=True, eq=False)
class Unloaded:
    """Densities of the place w, between 0 and 1, where n tests begin without load.

    Each is even between its ends. Beyond them it falls off, to an eighth within an edge.

    Attributes
    ----------
    lower, upper, edge : (n,)
        As `Model.unloaded` has them; an edge counts as at least `LEAST` and at most `MOST`.
    """

    lower: Array
    upper: Array
    edge: Array

    def draw(self, rng: np.random.Generator) -> Array:
        """A place of each test, (n,)."""
        found = np.full(self.lower.shape, np.nan)
        while (left := np.flatnonzero(~((found > 0.0) & (found < 1.0)))).size:
            even = rng.uniform(self.lower[left], self.upper[left])
            found[left] = even + self._length[left] * rng.logistic(size=left.size)
        return found

    def log_shape(self, w: Array, chosen: Index | slice = slice(None)) -> Array:
        """Log density at places w of chosen tests, without `log_size`; both of one shape."""
        length = self._length[chosen]
        above, below = (w - self.lower[chosen]) / length, (self.upper[chosen] - w) / length
        return np.asarray(log_expit(above) + log_expit(below))

    @cached_property
    def _length(self) -> Array:
        """Length of the logistic curve at the ends, (n,)."""
        return np.clip(0.5 * self.edge, LEAST, MOST)

    @cached_property
    def log_size(self) -> Array:
        """Log integral of the shape over 0 to 1, (n,).

        The difference of two logistic curves is the product in `log_shape` times a constant.
        """
        ends = [
            np.logaddexp(0.0, (w - end) / self._length)
            for w in (1.0, 0.0)
            for end in (self.lower, self.upper)
        ]
        inside = self._length * (ends[0] - ends[1] - ends[2] + ends[3])
        both = -np.expm1((self.lower - self.upper) / self._length)
        return np.asarray(np.log(inside / both))

    def log_density(self, w: Array) -> Array:
        """Log density at a place w of each test, (n,)."""
        return self.log_shape(w) - self.log_size


def chance_of(tests: Sequence[tuple[Array, Unloaded]]) -> float:
    """Probability that tests begin without load, as opposed to anywhere; `BEFORE` without tests.

    Parameters
    ----------
    tests : sequence of (n,) and Unloaded
        Draws of each calibrated test: where it began, if it may have begun anywhere, and the
        density without load.
    """
    log = [logsumexp(part.log_density(w)) - np.log(w.size) for w, part in tests]
    return float(expit(np.sum(log) + np.log(BEFORE / (1.0 - BEFORE))))
