"""Where in the gap a device at rest bears no load, as a density of where tests begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, log_expit, logsumexp

Array = NDArray[np.float64]

LEAST, MOST = 1e-3, 0.25
"""Shares of the range between which the length of the soft ends is kept."""

BEFORE = 3.0 / 4.0
"""Probability, before the tests of a run, that all of them begin without load.

All 32 records of the three sessions in shared/data/brfd begin with less than a tenth of the slip
force. With k sessions of k, Laplace's rule gives (k + 1)/(k + 2) to the next one. Here k is 2, so
that none of the three is counted twice when it is calibrated itself.
"""


@dataclass(frozen=True, eq=False)
class Unloaded:
    """Densities of the place w, between 0 and 1, where n tests begin without load.

    Each is even between its ends, and falls off beyond them as a logistic curve whose length is
    half of the edge. What is not finite counts as the whole range.

    Attributes
    ----------
    lower, upper, edge : (n,)
        As `Model.unloaded` has them.
    """

    lower: Array
    upper: Array
    edge: Array

    @classmethod
    def checked(cls, lower: Array, upper: Array, edge: Array) -> Unloaded:
        """One in which the whole range takes the place of what is not finite."""
        fine = np.isfinite(lower) & np.isfinite(upper) & np.isfinite(edge)
        ends = np.where(fine, lower, 0.0), np.where(fine, upper, 1.0)
        return cls(*ends, np.where(fine, edge, 0.0))

    def of(self, chosen: NDArray[np.bool_]) -> Unloaded:
        """Those of some of the tests."""
        return Unloaded(self.lower[chosen], self.upper[chosen], self.edge[chosen])

    def draw(self, rng: np.random.Generator) -> Array:
        """A place of each test, (n,)."""
        found = np.full(self.lower.shape, np.nan)
        while (left := np.flatnonzero(~((found > 0.0) & (found < 1.0)))).size:
            even = rng.uniform(self.lower[left], self.upper[left])
            found[left] = even + self._length[left] * rng.logistic(size=left.size)
        return found

    @cached_property
    def _length(self) -> Array:
        """Length of the logistic curves at the ends, (n,)."""
        return np.clip(0.5 * self.edge, LEAST, MOST)

    def log_density(self, w: Array) -> Array:
        """Log density at a place w of each test, (n,).

        The difference of the logistic curves at both ends is their product times a constant.
        """
        length = self._length
        above, below = (w - self.lower) / length, (self.upper - w) / length
        return np.asarray(log_expit(above) + log_expit(below) - self._log_size)

    @cached_property
    def _log_size(self) -> Array:
        """Log integral of that product over 0 to 1, (n,)."""
        ends = [
            np.logaddexp(0.0, (w - end) / self._length)
            for w in (1.0, 0.0)
            for end in (self.lower, self.upper)
        ]
        inside = self._length * (ends[0] - ends[1] - ends[2] + ends[3])
        both = -np.expm1((self.lower - self.upper) / self._length)
        return np.asarray(np.log(inside / both))


def chance_of(tests: Sequence[tuple[Array, Unloaded]]) -> float:
    """Probability that tests begin without load, as opposed to anywhere; `BEFORE` without tests.

    Parameters
    ----------
    tests : sequence of (n,) and Unloaded
        Draws of each calibrated test: where it began, with all places equally probable before,
        and its density without load.
    """
    log = [logsumexp(part.log_density(w)) - np.log(w.size) for w, part in tests]
    return float(expit(np.sum(log) + np.log(BEFORE / (1.0 - BEFORE))))
