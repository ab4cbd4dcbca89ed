"""What the force model leaves over in every test of a device: discrepancy and noise.

    y_j = F(θ_j) + F0_j + f_j δ(u) + s_j g(u) (h(u) z_i + √(1 − h(u)²) ε)

u is the travel since the last turn with the direction of motion, f_j the test's slip force over a
typical one. The discrepancy δ repeats in every cycle of every test; g is the shape of the noise's
standard deviation, and h the share of it that the samples of a stroke have in common (`strokes`).
None of them depends on parameters of the model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.noise import OU
from mfd_bayes.friction.model import Model
from mfd_bayes.population.strokes import (
    StrokeLevels,
    independent_share,
    neighbours_of,
    strokes_of,
)
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
    levels : StrokeLevels
        What the noise of a stroke has in common.
    noise_time : float, s
        Correlation time of the rest of the noise, ε.
    information : float
        Share of independent samples of ε in a record: (1 − φ)/(1 + φ) for neighbours that are
        correlated by φ.
    """

    basis: TravelBasis
    mean: Array
    covariance: Array
    log_shape: Array
    slip_force: float
    levels: StrokeLevels
    noise_time: float
    information: float

    def shape(self, trace: Trace) -> Array:
        """Shape g of the noise's standard deviation, (T,)."""
        return np.asarray(np.exp(self.basis.values(trace) @ self.log_shape))

    def share(self, trace: Trace) -> Array:
        """Share h of the noise that the samples of a stroke have in common, (T,)."""
        return np.asarray(self.basis.of_any_stroke(trace) @ self.levels.share)

    def discrepancy(self, trace: Trace, slip_force: Array, coefficients: Array) -> Array:
        """Discrepancy of tests of these slip forces (n,) and coefficients (n, K), (n, T), kip."""
        relative = slip_force / self.slip_force
        return np.asarray(relative[:, None] * (coefficients @ self.basis.values(trace).T))

    def draw_coefficients(self, rng: np.random.Generator, n: int) -> Array:
        """Draws of the discrepancy's coefficients, (n, K), kip."""
        return rng.multivariate_normal(self.mean, self.covariance, size=n, method="eigh")

    def draw_noise(
        self, rng: np.random.Generator, trace: Trace, sd: Array, levels: Array | None = None
    ) -> Array:
        """Draws of the noise for these standard deviations (n,), (n, T), kip.

        The levels of the strokes (n, strokes) are drawn too where they are not given.
        """
        return self.draw_rest(rng, trace, sd) + self.draw_levels(rng, trace, sd, levels)

    def draw_rest(self, rng: np.random.Generator, trace: Trace, sd: Array) -> Array:
        """Draws of the noise without the levels of the strokes, (n, T), kip."""
        values = {"noise_sd": sd, "noise_time": np.full(len(sd), self.noise_time)}
        rest = np.sqrt(1.0 - self.share(trace) ** 2)
        return OU().draw(rng, trace.time, values) * (self.shape(trace) * rest)

    def draw_levels(
        self, rng: np.random.Generator, trace: Trace, sd: Array, levels: Array | None = None
    ) -> Array:
        """Draws of that part of the noise that strokes have in common, (n, T), kip."""
        strokes = strokes_of(trace)
        if levels is None:
            levels = self.levels.draw(rng, len(sd), int(strokes[-1]) + 1)
        common = self.shape(trace) * self.share(trace)
        return np.asarray(sd[:, None] * levels[:, strokes] * common)


def slip_force_of(model: Model, values: Mapping[str, Array]) -> Array:
    """Mean of the forward and backward slip forces, (n,), kip."""
    theta = model.theta(values)
    columns = [model.parameters.index(name) for name in model.slip_forces]
    return np.asarray(theta[:, columns].mean(axis=1))


def memory_of(standard: Sequence[Array], traces: Sequence[Trace]) -> tuple[float, float]:
    """Share of independent samples in standardised residuals (T,), and correlation time, s."""
    times = [
        -float(np.median(np.diff(trace.time))) / np.log(neighbours_of(left))
        for left, trace in zip(standard, traces, strict=True)
    ]
    return independent_share(standard), float(np.median(times))
