"""Surrogates: polynomials in place of the force model, learned where the tests' posteriors are.

What a model's force leaves of a record, over the shape of the noise, is followed by polynomials of
the test's coordinates, one for every sample. Their sum of squares needs a few combinations of them
only, and costs a small part of the force model. A surrogate is never taken for the likelihood: it
proposes, and the likelihood decides (`moves.exchange`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.test_likelihood import LeastSquares, TestLikelihood

Array = NDArray[np.float64]
Index = NDArray[np.intp]

PER_TERM = 5
"""Points for each term of a polynomial."""

SMOOTHED = 0.5
"""Spread of the points about the states that are given, over the states' own."""

REACH = 1.5
"""Squared radius up to which a polynomial is used, over that of the points it was fitted to."""

NEGLIGIBLE = 0.01
"""What may be lost of a log likelihood, in the mean, by leaving out small components."""

STEP = 1e-3
"""Step of differences, in prior units."""


@dataclass(frozen=True, eq=False)
class Surrogate:
    """Log likelihood with polynomials of second degree in place of the force model.

    Attributes
    ----------
    likelihood : LeastSquares
    centre : (D,)
    whiten : (D, D)
        z = (x − centre) whiten are the standardised coordinates.
    components : (1 + D + D (D + 1)/2, r)
        Coefficients of the polynomials, one for each of the r components of the residual.
    rest : float
        Sum of squares that no component holds.
    radius : float
        Squared length of z up to which the polynomials are used. Further out the force is that
        at the radius, and the density falls as a Gaussian's.
    direct : tuple of int
        Coordinates on which the likelihood depends besides the force.
    information : (D, D)
        Expected information of the likelihood over the states that it was fitted to.
    """

    likelihood: LeastSquares
    centre: Array
    whiten: Array
    components: Array
    rest: float
    radius: float
    direct: tuple[int, ...]
    information: Array

    def __call__(self, x: Array) -> Array:
        """Log likelihood at (n, D), (n,)."""
        z, beyond = self.standardised(x)
        with np.errstate(over="ignore", invalid="ignore"):
            density = self.likelihood.by_squares(x, self.squares(z)) - 0.5 * beyond
        return np.where(np.isfinite(density), density, -np.inf)

    def standardised(self, x: Array) -> tuple[Array, Array]:
        """Standardised coordinates within the radius (n, D), and squared length beyond it (n,)."""
        z = (x - self.centre) @ self.whiten
        length = np.einsum("ni,ni->n", z, z)
        within = np.sqrt(np.minimum(1.0, self.radius / np.maximum(length, 1e-300)))
        return z * within[:, None], np.maximum(length - self.radius, 0.0)

    def squares(self, z: Array) -> Array:
        """Sums of squares at standardised coordinates (n, D), (n,)."""
        found = terms(z) @ self.components
        return np.asarray(np.einsum("nr,nr->n", found, found) + self.rest)

    def slopes(self, x: Array) -> Array:
        """Derivatives of the log likelihood at (n, D), (n, D); rough beyond the radius."""
        z, _ = self.standardised(x)
        found = terms(z) @ self.components
        squares = np.einsum("nr,nr->n", found, found) + self.rest
        by_squares = _by_term(2.0 * found @ self.components.T, z) @ self.whiten.T
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            slopes = -self.weight(x)[:, None] * by_squares
            for k in self.direct:
                step = np.zeros(z.shape[1])
                step[k] = STEP
                change = self.likelihood.by_squares(x + step, squares)
                change -= self.likelihood.by_squares(x - step, squares)
                slopes[:, k] += change / (2.0 * STEP)
        return slopes

    def weight(self, x: Array) -> Array:
        """Loss of log likelihood by each unit of the sum of squares, (n,)."""
        unit = np.ones(len(x))
        lost = self.likelihood.by_squares(x, 0.0 * unit) - self.likelihood.by_squares(x, unit)
        return np.asarray(lost)


def surrogate_of(
    test: TestLikelihood, states: Array, rng: np.random.Generator
) -> TestLikelihood | None:
    """The test with a surrogate, which is fitted near states (n, D) of its coordinates.

    None where its likelihood is no sum of squares, or the states are too alike.
    """
    likelihood, dim = test.log_likelihood, states.shape[1]
    if not isinstance(likelihood, LeastSquares):
        return None
    try:
        root = np.linalg.cholesky(np.atleast_2d(np.cov(states, rowvar=False)))
    except np.linalg.LinAlgError:
        return None
    centre, whiten = states.mean(axis=0), np.asarray(np.linalg.inv(root).T)
    n = PER_TERM * (1 + dim + dim * (dim + 1) // 2)
    points = states[rng.integers(len(states), size=n)]
    points = points + SMOOTHED * rng.standard_normal((n, dim)) @ root.T
    with np.errstate(over="ignore", invalid="ignore"):
        residual = likelihood.standard(points)
    good = np.all(np.isfinite(residual), axis=1)
    if np.sum(good) < 2 * n // PER_TERM:
        return None
    z = (points[good] - centre) @ whiten
    surrogate = Surrogate(
        likelihood=likelihood,
        centre=centre,
        whiten=whiten,
        components=np.zeros((0, 0)),
        rest=0.0,
        radius=REACH * float(np.max(np.einsum("ni,ni->n", z, z))),
        direct=(),
        information=np.zeros((dim, dim)),
    )
    weight = float(np.median(surrogate.weight(states)))
    components, rest = _components(z, residual[good], NEGLIGIBLE / weight)
    surrogate = replace(surrogate, components=components, rest=rest)
    return replace(test, log_likelihood=_informed(surrogate, states))


def surrogates_of(
    tests: Sequence[TestLikelihood], states: Sequence[Array], rng: np.random.Generator
) -> list[TestLikelihood] | None:
    """The tests with surrogates near states of each, (n, D); None where one has none."""
    found = []
    for test, those in zip(tests, states, strict=True):
        surrogate = surrogate_of(test, those, rng)
        if surrogate is None:
            return None
        found.append(surrogate)
    return found


def terms(z: Array) -> Array:
    """Products of up to two columns of z (n, D), (n, 1 + D + D (D + 1)/2)."""
    i, j = _pairs(z.shape[1])
    return np.concatenate([np.ones((len(z), 1)), z, z[:, i] * z[:, j]], axis=1)


@cache
def _pairs(dim: int) -> tuple[Index, Index]:
    """Rows and columns of the products of two columns."""
    i, j = np.triu_indices(dim)
    return i, j


def _by_term(slopes: Array, z: Array) -> Array:
    """Derivatives by z (n, D) of what has these derivatives by its terms, (n, D)."""
    n, dim = z.shape
    i, j = _pairs(dim)
    square = np.zeros((n, dim, dim))
    square[:, i, j] = slopes[:, 1 + dim :]
    square += np.swapaxes(square, 1, 2)
    return np.asarray(slopes[:, 1 : 1 + dim] + np.matmul(square, z[:, :, None])[..., 0])


def _components(z: Array, residual: Array, negligible: float) -> tuple[Array, float]:
    """Polynomials (terms, r) of the components of a residual, and the mean squares of the rest.

    Parameters
    ----------
    z : (n, D)
    residual : (n, T)
    negligible : float
        Mean sum of squares that may be left out.
    """
    q, r = np.linalg.qr(terms(z))
    coefficients = q.T @ residual
    values, axes = np.linalg.eigh(coefficients @ coefficients.T)
    values = np.maximum(values, 0.0)
    held = np.cumsum(values) > negligible * len(z)
    found = np.linalg.solve(r, axes[:, held] * np.sqrt(values[held]))
    rest = np.sum(residual**2) - np.sum(values[held])
    return found, float(rest / len(z))


def _informed(surrogate: Surrogate, states: Array) -> Surrogate:
    """The surrogate with its direct coordinates, and its information in the mean over states."""
    z, _ = surrogate.standardised(states)
    squares, dim = surrogate.squares(z), states.shape[1]
    bend, direct = np.zeros(dim), []
    for k in range(dim):
        step = np.zeros(dim)
        step[k] = STEP
        there = [surrogate.likelihood.by_squares(states + s, squares) for s in (-step, 0.0, step)]
        if np.any(there[0] != there[1]):
            direct.append(k)
            bend[k] = max(float(np.mean(2.0 * there[1] - there[0] - there[2])) / STEP**2, 0.0)
    total, weight = np.diag(bend), surrogate.weight(states)[:, None] / len(states)
    for component in surrogate.components.T:
        slope = _by_term(np.broadcast_to(component, (len(z), component.size)), z)
        slope = slope @ surrogate.whiten.T
        total = total + 2.0 * (slope * weight).T @ slope
    return replace(surrogate, direct=tuple(direct), information=total)
