"""A test in the first fit of all tests together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.strokes import Standardised, strokes_of
from mfd_bayes.population.working import WorkingLikelihood

Array = NDArray[np.float64]


@dataclass
class FittedTest:
    """One test in the first fit of all.

    Attributes
    ----------
    x : (D,)
    functions, basis : (T, K)
        Of the discrepancy: as they are, and times the slip force over the typical one.
    residual, slopes : (T,), (T, D)
        What is left over at x without discrepancy, and slopes of the model's force, kip.
    sd : float, kip
        Of the noise.
    moved : float
        How far x has gone since slopes were taken, in prior units.
    slip_force : float, kip
    """

    likelihood: WorkingLikelihood
    x: Array
    functions: Array
    basis: Array
    residual: Array
    slopes: Array
    sd: float
    moved: float = np.inf
    slip_force: float = 1.0

    def weights(self, log_shape: Array) -> Array:
        """Reciprocal standard deviation of the noise at each sample, 0 where it does not count."""
        weights = np.exp(-self.functions @ log_shape) / self.sd
        weights[: self.likelihood.posterior.first] = 0.0
        return np.asarray(weights)

    def standardised(self, coefficients: Array, log_shape: Array) -> Standardised:
        """What a discrepancy leaves of the samples that count, over the noise's sd."""
        left = (self.residual - self.basis @ coefficients) * self.weights(log_shape)
        trace, kept = self.likelihood.posterior.trace, self.likelihood.kept
        return Standardised(left[kept], self.functions[kept], strokes_of(trace)[kept])
