"""What the force model leaves over in every test of a device: discrepancy and noise.

    y_j = F(θ_j) + F0_j + f_j δ(u) + s_j g(u) ε

u is the travel since the last turn with the direction of motion, f_j the test's slip force over a
typical one. The discrepancy δ repeats in every cycle of every test; g is the shape of the noise's
standard deviation. Neither depends on parameters of the model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.noise import OU
from mfd_bayes.friction.model import Model
from mfd_bayes.population.travel import TravelBasis
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Residual:
    """Discrepancy and noise that the tests of a device have in common.

    Attributes
    ----------
    basis : TravelBasis
    mean, covariance : (K,), (K, K), kip
        Posterior of the discrepancy's coefficients.
    log_shape : (K,)
        Coefficients of log g.
    slip_force : float, kip
        Typical slip force, at which the discrepancy stands as it is.
    noise_time : float, s
        Correlation time of the noise.
    information : float
        Share of independent samples in a record: (1 − φ)/(1 + φ) for neighbours that are
        correlated by φ.
    """

    basis: TravelBasis
    mean: Array
    covariance: Array
    log_shape: Array
    slip_force: float
    noise_time: float
    information: float

    def shape(self, trace: Trace) -> Array:
        """Shape g of the noise's standard deviation, (T,)."""
        return np.asarray(np.exp(self.basis.values(trace) @ self.log_shape))

    def discrepancy(self, trace: Trace, slip_force: Array, coefficients: Array) -> Array:
        """Discrepancy of tests of these slip forces (n,) and coefficients (n, K), (n, T), kip."""
        relative = slip_force / self.slip_force
        return np.asarray(relative[:, None] * (coefficients @ self.basis.values(trace).T))

    def draw_coefficients(self, rng: np.random.Generator, n: int) -> Array:
        """Draws of the discrepancy's coefficients, (n, K), kip."""
        return rng.multivariate_normal(self.mean, self.covariance, size=n, method="eigh")

    def draw_noise(self, rng: np.random.Generator, trace: Trace, sd: Array) -> Array:
        """Draws of the noise for these standard deviations (n,), (n, T), kip."""
        values = {"noise_sd": sd, "noise_time": np.full(len(sd), self.noise_time)}
        return OU().draw(rng, trace.time, values) * self.shape(trace)


def slip_force_of(model: Model, values: Mapping[str, Array]) -> Array:
    """Mean of the forward and backward slip forces, (n,), kip."""
    theta = model.theta(values)
    columns = [model.parameters.index(name) for name in model.slip_forces]
    return np.asarray(theta[:, columns].mean(axis=1))


def memory_of(standard: Sequence[Array], traces: Sequence[Trace]) -> tuple[float, float]:
    """Share of independent samples in standardised residuals (T,), and correlation time, s."""
    independent, samples, times = 0.0, 0, []
    for left, trace in zip(standard, traces, strict=True):
        phi = float(np.clip(left[1:] @ left[:-1] / (left @ left), 1e-3, 0.999))
        independent += left.size * (1.0 - phi) / (1.0 + phi)
        samples += left.size
        times.append(-float(np.median(np.diff(trace.time))) / np.log(phi))
    return independent / samples, float(np.median(times))
