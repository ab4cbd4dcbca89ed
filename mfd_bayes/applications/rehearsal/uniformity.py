"""Whether ranks of true values are uniform, with simultaneous bands of their distribution.

After Säilynoja, Bürkner and Vehtari (2022).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]

SIMULATIONS = 100_000
"""Of the statistic's distribution: among hundreds of quantities p-values of 1e-4 are judged."""


class Uniformity:
    """The ECDF test of N ranks from 0 to L, and its band.

    At z = (k + 1)/(L + 1) the number of ranks up to k is binomial. The statistic is the least
    two-sided tail probability over all k, and its distribution is simulated.
    """

    def __init__(self, tests: int, draws: int, simulations: int = SIMULATIONS) -> None:
        self.tests = tests
        self.z = np.arange(1, draws + 1) / (draws + 1)
        counts = np.arange(tests + 1)[:, None]
        lower_tail = stats.binom.cdf(counts, tests, self.z)
        upper_tail = stats.binom.sf(counts - 1, tests, self.z)
        self._tails = 2.0 * np.minimum(lower_tail, upper_tail)  # by count and k
        rng = np.random.default_rng(0)
        bins = rng.multinomial(tests, np.full(draws + 1, 1.0 / (draws + 1)), simulations)
        self._null = np.sort(self._statistic(np.cumsum(bins, axis=1)[:, :-1]))

    def p_value(self, ranks: Sequence[int]) -> float:
        """Probability that uniform ranks deviate at least as far as these."""
        statistic = self._statistic(self.counts(ranks)[None])[0]
        strays = np.searchsorted(self._null, statistic * (1.0 + 1e-9), side="right")
        return float((1 + strays) / (1 + self._null.size))

    def deviation(self, ranks: Sequence[int]) -> Array:
        """ECDF of the ranks less the uniform one, (L,)."""
        return self.counts(ranks) / self.tests - self.z

    def band(self, level: float) -> tuple[Array, Array]:
        """Least and greatest deviation whose p-value is above `level`, (L,) each."""
        rank = int(np.ceil(level * (self._null.size + 1))) - 2
        accepted = self._tails > self._null[max(rank, 0)] * (1.0 - 1e-9)
        smallest = np.argmax(accepted, axis=0)
        greatest = self.tests - np.argmax(accepted[::-1], axis=0)
        return smallest / self.tests - self.z, greatest / self.tests - self.z

    def counts(self, ranks: Sequence[int]) -> NDArray[np.intp]:
        """Number of ranks up to k, for k below L, (L,)."""
        return np.cumsum(np.bincount(ranks, minlength=self.z.size + 1))[:-1]

    def _statistic(self, counts: NDArray[np.intp]) -> Array:
        return np.asarray(self._tails[counts, np.arange(self.z.size)].min(axis=1))
