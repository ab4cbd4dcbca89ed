"""The likelihood of a record's first part, for a test that follows the population.

It is the population's own: samples have the shape of the noise, and each counts as a share of an
independent one (`pace`), but for what strokes have in common (`strokes`). The discrepancy's
coefficients and the strokes' levels, which are Gaussian, are integrated out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.noise import LOG_2PI
from mfd_bayes.population.pace import Counted
from mfd_bayes.population.residual import Residual

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sums:
    """All that the likelihood of n tests needs of the residuals r over some samples.

    r is what force, offset and the mean discrepancy leave over. Sums of several stretches of
    samples add up. Variances are those of the noise without the levels of the strokes.

    Attributes
    ----------
    squares : (n,)
        Σ ω r²/g², with the shares ω.
    pulls : (n, K)
        Σ ω r/g² times each function.
    gram : (K, K)
        Products of the functions, times ω/g².
    log_shape : float
        Σ ω log g.
    samples : float
        Σ ω, the number of independent samples.
    strokes : Strokes
        The same for the levels of the S strokes so far.
    """

    squares: Array
    pulls: Array
    gram: Array
    log_shape: float
    samples: float
    strokes: Strokes

    @classmethod
    def of(cls, residuals: Array, counted: Counted) -> Sums:
        """Those of residuals (n, T) at counted samples."""
        shape = counted.shape * np.sqrt(1.0 - counted.common**2)
        weight = np.sqrt(counted.share) / shape
        scaled, standard = counted.functions * weight[:, None], residuals * weight
        common = weight * counted.shape * counted.common
        return cls(
            np.einsum("nt,nt->n", standard, standard),
            standard @ scaled,
            scaled.T @ scaled,
            float(counted.share @ np.log(shape)),
            float(counted.share.sum()),
            Strokes.of(standard, scaled, common, counted.strokes),
        )

    def __add__(self, other: Sums) -> Sums:
        return Sums(
            self.squares + other.squares,
            self.pulls + other.pulls,
            self.gram + other.gram,
            self.log_shape + other.log_shape,
            self.samples + other.samples,
            self.strokes + other.strokes,
        )

    def of_tests(self, chosen: NDArray[np.intp]) -> Sums:
        """Those of some of the tests."""
        strokes = replace(self.strokes, pulls=self.strokes.pulls[chosen])
        return replace(
            self, squares=self.squares[chosen], pulls=self.pulls[chosen], strokes=strokes
        )

    def beside(self, others: list[Sums]) -> Sums:
        """Those of these tests and of others with the same samples."""
        every = [self, *others]
        pulls = np.concatenate([one.strokes.pulls for one in every])
        return replace(
            self,
            squares=np.concatenate([one.squares for one in every]),
            pulls=np.concatenate([one.pulls for one in every]),
            strokes=replace(self.strokes, pulls=pulls),
        )


@dataclass(frozen=True, eq=False)
class Strokes:
    """Sums over the samples of each of S strokes.

    Attributes
    ----------
    pulls : (n, S)
        Of the residuals times h.
    functions : (S, K)
        Of the functions times h.
    weight : (S,)
        Of h².
    """

    pulls: Array
    functions: Array
    weight: Array

    @classmethod
    def of(
        cls, standard: Array, scaled: Array, common: Array, strokes: NDArray[np.intp]
    ) -> Strokes:
        """Those of scaled residuals (n, T), functions (T, K) and h (T,)."""
        first = np.flatnonzero(np.diff(strokes, prepend=-1))  # samples are in the order of time
        size, there = int(strokes[-1]) + 1, strokes[first]
        pulls, weight = np.zeros((len(standard), size)), np.zeros(size)
        functions = np.zeros((size, scaled.shape[1]))
        pulls[:, there] = np.add.reduceat(standard * common, first, axis=1)
        functions[there] = np.add.reduceat(scaled * common[:, None], first, axis=0)
        weight[there] = np.add.reduceat(common**2, first)
        return cls(pulls, functions, weight)

    def __add__(self, other: Strokes) -> Strokes:
        size = max(self.weight.size, other.weight.size)
        one, two = self.padded(size), other.padded(size)
        return Strokes(
            one.pulls + two.pulls, one.functions + two.functions, one.weight + two.weight
        )

    def padded(self, size: int) -> Strokes:
        """With strokes of which nothing is known, up to so many."""
        more = max(size - self.weight.size, 0)
        return Strokes(
            np.pad(self.pulls, ((0, 0), (0, more))),
            np.pad(self.functions, ((0, more), (0, 0))),
            np.pad(self.weight, (0, more)),
        )


@dataclass(frozen=True, eq=False)
class GivenLikelihood:
    """Log likelihood of tests from their sums.

    Attributes
    ----------
    residual : Residual
    """

    residual: Residual

    def __call__(self, sums: Sums, slip: Array, sd: Array) -> Array:
        """Log likelihood of tests of these slip forces and noise sds (n,), (n,).

        With the discrepancy f B (m + L η), η ~ N(0, 1), in the axes U of Lᵀ BᵀB/g² L, each axis
        has its own Gaussian integral.
        """
        sums = self._without_levels(sums)
        axes, sizes = self._axes(sums.gram)
        pulls, precision = self._conditional(sums, axes, sizes, slip, sd)
        log = -0.5 * sums.squares / sd**2 - sums.log_shape
        log -= sums.samples * (np.log(sd) + 0.5 * LOG_2PI)
        log -= 0.5 * np.log(precision).sum(axis=1)
        return np.asarray(log + 0.5 * np.sum(pulls**2 / precision, axis=1))

    def draw_coefficients(
        self, sums: Sums, slip: Array, sd: Array, rng: np.random.Generator
    ) -> Array:
        """Draws of the discrepancy's coefficients of each test, (n, K), kip."""
        sums = self._without_levels(sums)
        axes, sizes = self._axes(sums.gram)
        pulls, precision = self._conditional(sums, axes, sizes, slip, sd)
        eta = pulls / precision + rng.standard_normal(pulls.shape) / np.sqrt(precision)
        return np.asarray(self.residual.mean + eta @ axes.T)

    def draw_levels(
        self,
        sums: Sums,
        coefficients: Array,
        tests: tuple[Array, Array],
        count: int,
        rng: np.random.Generator,
    ) -> Array:
        """Draws of the levels of all strokes, `count` of them or more, of each test, (n, S).

        Parameters
        ----------
        sums : Sums
        coefficients : (n, K), kip
            Of the tests' discrepancies.
        tests : (n,), (n,), kip
            Slip forces and noise sds.
        count : int
        rng : numpy.random.Generator
        """
        (slip, sd), strokes = tests, sums.strokes.padded(count)
        f = (slip / self.residual.slip_force)[:, None]
        left = strokes.pulls - f * ((coefficients - self.residual.mean) @ strokes.functions.T)
        covariance = self.residual.levels.known(strokes.weight)
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        chance = rng.standard_normal(left.shape) @ root.T
        return np.asarray((left / sd[:, None]) @ covariance + chance)

    def _without_levels(self, sums: Sums) -> Sums:
        """Sums in which the levels of the strokes are integrated out."""
        strokes = sums.strokes
        if not np.any(strokes.weight):
            return sums
        levels = self.residual.levels
        covariance = levels.known(strokes.weight)
        known = strokes.pulls @ covariance
        prior = levels.correlation(strokes.weight.size)
        log_size = np.linalg.slogdet(np.eye(len(prior)) + prior * strokes.weight)[1]
        return replace(
            sums,
            squares=sums.squares - np.einsum("ns,ns->n", known, strokes.pulls),
            pulls=sums.pulls - known @ strokes.functions,
            gram=sums.gram - strokes.functions.T @ covariance @ strokes.functions,
            log_shape=sums.log_shape + 0.5 * float(log_size),
        )

    @cached_property
    def _root(self) -> Array:
        values, vectors = np.linalg.eigh(self.residual.covariance)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))

    def _axes(self, gram: Array) -> tuple[Array, Array]:
        """L U, (K, K), and the sizes of the axes, (K,)."""
        sizes, vectors = np.linalg.eigh(self._root.T @ gram @ self._root)
        return self._root @ vectors, np.maximum(sizes, 0.0)

    def _conditional(
        self, sums: Sums, axes: Array, sizes: Array, slip: Array, sd: Array
    ) -> tuple[Array, Array]:
        """Pull on each axis and its precision, (n, K) each."""
        f = (slip / self.residual.slip_force)[:, None]
        weight = 1.0 / sd[:, None] ** 2
        return weight * f * (sums.pulls @ axes), 1.0 + weight * f**2 * sizes
