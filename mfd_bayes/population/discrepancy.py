"""What the force model leaves over in every test of a device: discrepancy and noise.

    y_j = F(θ_j) + F0_j + f_j δ(u) + s_j g(u) (h z_i + √(1 - h²) ε)

u is the travel since the last turn, with the direction of motion; f_j is the slip force of test j
over a typical one. The discrepancy δ is a Gaussian process (Matérn 3/2, by its values at knots); it
repeats in every cycle of every test. g is the shape of the noise's standard deviation, h the share
that the samples of a stroke have in common (a random intercept z_i for each stroke), and ε an AR(1)
process. Learned as a module of its own (Liu, Bayarri and Berger, 2009): see `joint_fit`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

from mfd_bayes.friction.model import Model
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]
Index = NDArray[np.intp]

KNOTS = 16  # knots of each direction
FINE = 20.0  # knots are even in log(1 + FINE · travel/stroke): finest after a turn
LENGTH = 0.2  # correlation length of δ, as a share of the range of the knots
FEWEST = 8  # fewest samples of a stroke whose mean counts


def strokes_of(trace: Trace) -> Index:
    """Number of the stroke to which each sample belongs, (T,), from 0."""
    turns = trace.turning_points
    return np.asarray(np.searchsorted(turns, np.arange(trace.samples), side="right"))


@dataclass(frozen=True)
class TravelBasis:
    """Piecewise linear functions of the travel since a turn, for each direction of motion.

    All are zero beyond the longest full stroke, and where the stroke before the turn was less than
    half of the shortest one: what repeats in full cycles says nothing of such motions.
    """

    shortest: float  # in: full strokes of the tests from which functions are learned
    longest: float

    def __call__(self, trace: Trace) -> Array:
        """Values at each sample, (T, 2 · KNOTS)."""
        x, stroke = trace.displacement, strokes_of(trace)
        turns = np.concatenate([[0], trace.turning_points, [trace.samples - 1]])
        length = np.diff(x[turns])
        before = np.concatenate([[0.0], np.abs(length[:-1])])[stroke]
        travel, forward = np.abs(x - x[turns[stroke]]), length[stroke] > 0
        place = np.log1p(FINE * travel / self.longest) / np.log1p(FINE) * (KNOTS - 1)
        hats = np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(KNOTS)))
        hats *= np.clip(4.0 * before / self.shortest - 2.0, 0.0, 1.0)[:, None]
        return np.concatenate([hats * forward[:, None], hats * ~forward[:, None]], axis=1)


def knot_covariance() -> Array:
    """Prior covariance of δ at the knots for unit variance: Matérn 3/2 in each direction."""
    knots = np.linspace(0.0, 1.0, KNOTS)
    r = np.sqrt(3.0) * np.abs(np.subtract.outer(knots, knots)) / LENGTH
    one = (1.0 + r) * np.exp(-r) + 1e-6 * np.eye(KNOTS)
    return np.asarray(block_diag(one, one))


@dataclass(frozen=True, eq=False)
class Residual:
    """Discrepancy and noise that the tests of a device have in common."""

    basis: TravelBasis
    mean: Array  # (K,), (K, K), kip: posterior of δ at the knots
    covariance: Array
    log_shape: Array  # (K,): log g at the knots
    slip_force: float  # kip: typical slip force, at which δ stands as it is
    stroke_share: float  # h
    lag_one: float  # correlation of neighbouring samples of ε in the tests
    # s and in: correlation time of ε, and mean travel between neighbouring samples of the tests
    noise_time: float
    travel: float

    @property
    def information(self) -> float:
        """Share of independent samples in a record, (1 - φ)/(1 + φ)."""
        return (1.0 - self.lag_one) / (1.0 + self.lag_one)

    def shape(self, trace: Trace) -> Array:
        """Shape g of the noise's standard deviation, (T,)."""
        return np.asarray(np.exp(self.basis(trace) @ self.log_shape))

    def draw_knots(self, rng: np.random.Generator, n: int) -> Array:
        """Draws of δ at the knots, (n, K), kip."""
        return rng.multivariate_normal(self.mean, self.covariance, size=n, method="eigh")

    def discrepancy(self, trace: Trace, slip_force: Array, knots: Array) -> Array:
        """Discrepancy f δ(u), (n, T), kip, for slip forces (n,) and values at the knots (n, K)."""
        relative = slip_force / self.slip_force
        return np.asarray(relative[:, None] * (knots @ self.basis(trace).T))

    def draw_noise(
        self,
        rng: np.random.Generator,
        trace: Trace,
        sd: Array,
        rest: ArrayLike = 1.0,
        level: float = 1.0,
    ) -> Array:
        """Draws of the noise for these standard deviations (n,), (n, T), kip.

        ε is multiplied by `rest`, and the levels of the strokes by `level`.
        """
        e = rng.standard_normal((len(sd), trace.samples))
        for t, f in enumerate(np.exp(-np.diff(trace.time) / self.noise_time), start=1):
            e[:, t] = f * e[:, t - 1] + np.sqrt(1.0 - f * f) * e[:, t]
        strokes, h = strokes_of(trace), self.stroke_share
        levels = rng.standard_normal((len(sd), int(strokes[-1]) + 1))
        noise = np.sqrt(1.0 - h * h) * rest * e + h * level * levels[:, strokes]
        return np.asarray(sd[:, None] * self.shape(trace) * noise)

    def counts(self, trace: Trace) -> Array:
        """Independent samples that each sample counts for, (T,).

        What the model leaves over changes with the travel, not with time: neighbours are correlated
        by φ to the power of their travel over that of the tests, and a device at rest shows its
        force once, however long one looks at it. The first sample counts once.
        """
        travel = np.abs(np.diff(trace.displacement)) / self.travel
        phi = self.lag_one**travel
        return np.concatenate([[1.0], (1.0 - phi) / (1.0 + phi)])


def slip_force_of(model: Model, values: Mapping[str, Array]) -> Array:
    """Mean of the forward and backward slip forces, (n,), kip; 1 where the model names none."""
    theta = model.theta(values)
    columns = [model.parameters.index(name) for name in model.slip_forces]
    return np.asarray(theta[:, columns].mean(axis=1)) if columns else np.ones(len(theta))


def lag_one_of(standard: Sequence[Array]) -> float:
    """Correlation of neighbours that gives the share of independent samples of all tests."""
    phi = np.array([np.clip(r[1:] @ r[:-1] / (r @ r), 1e-3, 0.999) for r in standard])
    share = np.average((1.0 - phi) / (1.0 + phi), weights=[r.size for r in standard])
    return float((1.0 - share) / (1.0 + share))


def share_of_strokes(standard: Sequence[Array], strokes: Sequence[Index]) -> float:
    """Share h of a random intercept of each stroke: one-way analysis of variance by moments."""
    between, within = [1e-12], [1e-12]
    for values, stroke in zip(standard, strokes, strict=True):
        for i in np.unique(stroke):
            if np.count_nonzero(group := stroke == i) >= FEWEST:
                between.append(float(values[group].mean()) ** 2)
                within.append(float(values[group].var()))
    total = np.mean(between) + np.mean(within)
    return float(np.sqrt(np.clip(np.mean(between) / total, 0.0, 0.9)))
