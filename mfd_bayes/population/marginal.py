"""What the tests say of the hyperparameters: Gaussian summaries, and their exact marginal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.laws import LAWS

Array = NDArray[np.float64]

LEAST_INFORMATION = 1e-3
"""Precision, in prior units, below which a test is taken to say nothing about a direction."""


@dataclass(frozen=True, eq=False)
class TestSummary:
    """What one test says of the pooled coordinates, in prior units.

    Its likelihood is taken as Gaussian in the coordinates q, with `mean` (d,) and
    `covariance` (d, d); the interim prior is divided out of the draws' moments.
    """

    __test__ = False  # not a test case of pytest's

    actuation: float
    mean: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class Pooling:
    """What the hyperparameters are, and how they are laid out.

    Attributes
    ----------
    names : tuple of str
        The pooled quantities, d of them.
    centre, spread : (d,)
        Mean and sd of their coordinates under the test prior, which is that of the levels.
    laws : mapping of str to str
        Law of each quantity that follows the actuation.
    groups : tuple of (str, ...)
        Scatter groups.
    member : (d,) int
        Group of each quantity.
    scatter_sd : (G,)
        Half-normal scale of each group's scatter.
    reference : float, ksi or kip
        Actuation p0 to which levels belong.
    """

    names: tuple[str, ...]
    centre: Array
    spread: Array
    laws: Mapping[str, str]
    groups: tuple[str, ...]
    member: NDArray[np.intp]
    scatter_sd: Array
    reference: float

    @property
    def shaped(self) -> tuple[str, ...]:
        """Quantities whose law has a shape."""
        return tuple(n for n in self.names if LAWS[self.laws.get(n, "constant")].shape)


def summarize(pooling: Pooling, actuation: float, coordinates: Array) -> TestSummary:
    """Gaussian summary of one test's likelihood.

    Parameters
    ----------
    pooling : Pooling
    actuation : float
    coordinates : (draws, d)
        Draws of the pooled coordinates from the test's posterior.
    """
    standard = (coordinates - pooling.centre) / pooling.spread
    mean = standard.mean(axis=0)
    covariance = np.atleast_2d(np.cov(standard, rowvar=False))
    variances, axes = np.linalg.eigh(covariance)
    information = 1.0 / variances - 1.0  # the interim prior's precision is 1
    informed = information > LEAST_INFORMATION
    precision = np.where(informed, information, LEAST_INFORMATION)
    along = axes.T @ mean
    centre = np.where(informed, along / variances / precision, along)
    return TestSummary(
        actuation=actuation,
        mean=axes @ centre,
        covariance=(axes / precision) @ axes.T,
    )


class Marginal:
    """Density of scatter and shapes, with tests and levels integrated out in closed form.

    Given the scatter T and the shapes, test j's summary is N(level + o_j, C_j + T) and the
    levels are N(0, 1) in prior units, so that both integrals are Gaussian.
    """

    def __init__(self, pooling: Pooling, tests: Sequence[TestSummary]) -> None:
        self.pooling = pooling
        self.means = np.array([test.mean for test in tests])  # (J, d)
        self.covariances = np.array([test.covariance for test in tests])  # (J, d, d)
        self.ratios = np.array([test.actuation for test in tests]) / pooling.reference

    def log_prob(self, h: Array) -> Array:
        """Log density of h = (log scatter, shapes), (n, G + shapes) -> (n,)."""
        inside = np.all(np.abs(h) < 30.0, axis=1)
        density = np.full(len(h), -np.inf)
        if np.any(inside):
            density[inside] = self.log_prior(h[inside]) + self._integral(h[inside])
        return density

    def log_prior(self, h: Array) -> Array:
        """Half-normal scatter, with the Jacobian of its logarithm, and the laws' shapes."""
        groups = len(self.pooling.groups)
        log_scatter = h[:, :groups]
        density = log_scatter - 0.5 * (np.exp(log_scatter) / self.pooling.scatter_sd) ** 2
        total: Array = density.sum(axis=1)
        for i, name in enumerate(self.pooling.shaped):
            total = total + LAWS[self.pooling.laws[name]].log_prior(h[:, groups + i])
        return total

    def _integral(self, h: Array) -> Array:
        precision, pull, log_terms = self._levels(h)
        mean = np.linalg.solve(precision, pull[..., None])[..., 0]
        log_det = np.linalg.slogdet(precision)[1]
        gain = np.einsum("nd,nd->n", pull, mean)
        total: Array = log_terms + 0.5 * gain - 0.5 * log_det
        return total

    def _levels(self, h: Array) -> tuple[Array, Array, Array]:
        """Precision (n, d, d) and pull (n, d) of the levels, and what is left of the density."""
        scatter = np.exp(h[:, self.pooling.member]) / self.pooling.spread
        d = scatter.shape[1]
        total = np.repeat(self.covariances[None], len(h), axis=0)  # (n, J, d, d)
        total[..., range(d), range(d)] += (scatter**2)[:, None]
        inverse = np.linalg.inv(total)
        log_det = np.linalg.slogdet(total)[1].sum(axis=1)
        residual = self.means - self.offsets(h)
        pulled = np.einsum("njde,nje->njd", inverse, residual)
        square = np.einsum("njd,njd->n", pulled, residual)
        precision = np.eye(d) + inverse.sum(axis=1)
        return precision, pulled.sum(axis=1), -0.5 * (log_det + square)

    def offsets(self, h: Array) -> Array:
        """Laws' log ratios at the tests' actuations, in prior units, (n, J, d)."""
        pooling = self.pooling
        offsets = np.zeros((len(h), len(self.ratios), len(pooling.names)))
        shapes = {n: h[:, len(pooling.groups) + i] for i, n in enumerate(pooling.shaped)}
        for name, law in pooling.laws.items():
            k = pooling.names.index(name)
            shape = shapes.get(name, np.zeros(len(h)))[:, None]
            offsets[..., k] = np.log(LAWS[law].ratio(self.ratios, shape)) / pooling.spread[k]
        return offsets

    def draw_levels(self, h: Array, rng: np.random.Generator) -> Array:
        """One draw of the levels for each h, (n, d), prior units."""
        precision, pull, _ = self._levels(h)
        mean = np.linalg.solve(precision, pull[..., None])[..., 0]
        factor = np.linalg.cholesky(precision)
        noise = rng.standard_normal(mean.shape)
        swing = np.linalg.solve(np.swapaxes(factor, 1, 2), noise[..., None])[..., 0]
        draws: Array = mean + swing
        return draws
