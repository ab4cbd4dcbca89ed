"""What the noise has in common over a stroke: slip forces differ from one stroke to the next.

A stroke slips at one level of force and the next at another: while the surfaces run in, and as
they warm. Standardised noise is then

    h(u) z_i + √(1 − h(u)²) ε

with the level z_i of the i-th stroke, which is N(0, 1), its share h by the travel u since the turn,
and independent ε. Levels of strokes of one direction are correlated by the memory to the power of
their distance; those of forward and backward strokes are independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]
Index = NDArray[np.intp]

LARGEST = 0.95
"""Largest share h, and largest memory."""

EVEN = 30.0
"""Samples near a knot that a share of 0 is worth."""

ROUNDS = 60
"""Rounds of expectation–maximisation."""


@dataclass(frozen=True, eq=False)
class StrokeLevels:
    """Levels of noise that strokes have.

    Attributes
    ----------
    share : (K,)
        h at the knots of the travel basis.
    memory : float
        Correlation of the levels of a stroke and the next in the same direction.
    """

    share: Array
    memory: float

    def correlation(self, strokes: int) -> Array:
        """Prior covariance of the levels, (strokes, strokes)."""
        apart = np.abs(np.subtract.outer(np.arange(strokes), np.arange(strokes)))
        return np.where(apart % 2 == 0, self.memory ** (apart / 2.0), 0.0)

    def averaged(self, strokes: float) -> float:
        """Variance of the mean level of so many strokes of one direction."""
        count = max(round(strokes), 1)
        apart = np.arange(1, count)
        return float(count + 2.0 * np.sum((count - apart) * self.memory**apart)) / count**2

    def draw(self, rng: np.random.Generator, n: int, strokes: int) -> Array:
        """Levels of n tests of which nothing is known, (n, strokes)."""
        root = np.linalg.cholesky(self.correlation(strokes))
        return np.asarray(rng.standard_normal((n, strokes)) @ root.T)

    def known(self, weight: Array) -> Array:
        """Covariance of levels of which samples of these weights (S,) are known, (S, S)."""
        prior = self.correlation(weight.size)
        root = np.sqrt(weight)
        inner = np.eye(weight.size) + root[:, None] * prior * root
        return np.asarray(prior - (prior * root) @ np.linalg.solve(inner, root[:, None] * prior))


def no_levels(size: int) -> StrokeLevels:
    """Strokes that have nothing in common, for a basis of so many functions."""
    return StrokeLevels(np.zeros(size), 0.0)


def strokes_of(trace: Trace) -> Index:
    """Number of the stroke to which each sample belongs, (T,), from 0."""
    turns = trace.turning_points
    return np.asarray(np.searchsorted(turns, np.arange(trace.samples), side="right"))


@dataclass(frozen=True, eq=False)
class Standardised:
    """Noise of a test over its standard deviation, at the samples that count.

    Attributes
    ----------
    values : (T,)
    functions : (T, K)
        Of the travel.
    strokes : (T,) int
    """

    values: Array
    functions: Array
    strokes: Index


@dataclass(frozen=True, eq=False)
class _Expected:
    """Levels of a test's strokes, given its noise."""

    mean: Array
    covariance: Array

    @property
    def squares(self) -> Array:
        return np.asarray(self.mean**2 + np.diag(self.covariance))

    @property
    def neighbours(self) -> Array:
        """Expected products with the next stroke of the same direction."""
        return np.asarray(self.mean[:-2] * self.mean[2:] + np.diag(self.covariance, 2))


def learn_levels(tests: Sequence[Standardised]) -> tuple[StrokeLevels, list[Array]]:
    """Levels by expectation–maximisation, and the noise that they leave of each test.

    Samples count as many as are independent of what the levels leave.

    Returns
    -------
    StrokeLevels
    list of (T,)
        ε of each test.
    """
    found = StrokeLevels(np.full(tests[0].functions.shape[1], 0.3), 0.3)
    rest = [one.values for one in tests]
    for _ in range(ROUNDS):
        counted = independent_share(rest)
        expected = [_expect(one, found, counted) for one in tests]
        found = _maximise(tests, expected)
        rest = [_rest(one, e, found) for one, e in zip(tests, expected, strict=True)]
    return found, rest


def independent_share(standard: Sequence[Array]) -> float:
    """Share of independent samples in standardised residuals (T,)."""
    independent, samples = 0.0, 0
    for left in standard:
        phi = neighbours_of(left)
        independent += left.size * (1.0 - phi) / (1.0 + phi)
        samples += left.size
    return independent / samples


def neighbours_of(left: Array) -> float:
    """Correlation of neighbours."""
    return float(np.clip(left[1:] @ left[:-1] / (left @ left), 1e-3, 0.999))


def _expect(one: Standardised, levels: StrokeLevels, counted: float) -> _Expected:
    share = one.functions @ levels.share
    precision = counted / (1.0 - share**2)
    count = int(one.strokes[-1]) + 1
    weight = np.zeros(count)
    pull = np.zeros(count)
    np.add.at(weight, one.strokes, precision * share**2)
    np.add.at(pull, one.strokes, precision * share * one.values)
    covariance = levels.known(weight)
    return _Expected(covariance @ pull, covariance)


def _maximise(tests: Sequence[Standardised], expected: Sequence[_Expected]) -> StrokeLevels:
    """Share and memory by the levels that are expected.

    Where these have another variance than 1, the share takes it up: otherwise share and levels
    would find their scales very slowly (Liu, Rubin and Wu, 1998).
    """
    size = tests[0].functions.shape[1]
    pull, weight = np.zeros(size), np.full(size, EVEN)
    products, squares, variance, strokes = 0.0, 1e-9, 0.0, 0
    for one, e in zip(tests, expected, strict=True):
        pull = pull + one.functions.T @ (one.values * e.mean[one.strokes])
        weight = weight + one.functions.T @ e.squares[one.strokes]
        variance += float(e.squares.sum())
        strokes += e.mean.size
        products += float(e.neighbours.sum())
        squares += 0.5 * float(e.squares[:-2].sum() + e.squares[2:].sum())
    share = np.clip(pull / weight * np.sqrt(variance / strokes), 0.0, LARGEST)
    return StrokeLevels(share, float(np.clip(products / squares, 0.0, LARGEST)))


def _rest(one: Standardised, expected: _Expected, levels: StrokeLevels) -> Array:
    share = one.functions @ levels.share
    left = one.values - share * expected.mean[one.strokes]
    return np.asarray(left / np.sqrt(1.0 - share**2))
