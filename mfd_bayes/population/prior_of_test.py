"""What a population says of one test before its force is known, as a density.

Each draw of the hyperparameters gives a Gaussian density of the test's shared coordinates and a
density of its start in the gap; the population's prediction is the mixture of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, log_expit

from mfd_bayes.population.along import Along
from mfd_bayes.population.parts import Expected, Parts
from mfd_bayes.population.starts import UNKNOWN, Standing, StartDensity
from mfd_bayes.population.unloaded import Unloaded

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SMOOTH = 0.75
"""Share of the variance of the Gaussians' means that a smoothed prior has in their covariance."""

SOME = 4
"""Other labels among which a point is given a new one at a time."""


@dataclass(frozen=True, eq=False)
class TestPrior:
    """Mixture of N densities of one test, each of which has a label.

    A point is (x, e, t), D numbers: the d shared coordinates x in prior units; the m numbers e of
    its deviations from the laws between the actuations of a history; and the logit t of its start.
    With such a history x leaves out the unknown part of the deviation at the level; e gives it.

    Attributes
    ----------
    index : (N,) int
        Draw of the hyperparameters behind each density, its label.
    around : Along
        Deviations from the laws.
    expected : Expected
        Level and law of each.
    mean : (N, d)
    covariance : (N, d, d)
        Of x. The numbers e are independent, N(0, 1).
    start : StartDensity
        Of each density.
    standing : callable
        Gives, of quantities (n,) by name, what is known of where tests with them begin.
    """

    index: Index
    around: Along
    expected: Expected
    mean: Array
    covariance: Array
    start: StartDensity
    standing: Callable[[Mapping[str, Array]], Standing] = lambda _: UNKNOWN

    __test__ = False  # pytest is not to collect it

    @classmethod
    def of(
        cls,
        around: Along,
        rng: np.random.Generator,
        n: int,
        standing: Callable[[Mapping[str, Array]], Standing] = lambda _: UNKNOWN,
    ) -> TestPrior:
        """Prior of a test under a setting, from n draws of the hyperparameters.

        Parameters
        ----------
        around : Along
            With the population, the setting, and how the test deviates from the laws.
        rng : numpy.random.Generator
        n : int
        standing : callable
            Gives, of quantities (n,) by name, what is known of where tests with them begin.
        """
        population, setting = around.population, around.setting
        index = rng.choice(population.size, size=n, replace=n > population.size)
        expected = population.expected(setting, index)
        root = expected.scatter[:, :, None] * expected.together
        covariance = root @ np.swapaxes(root, 1, 2)
        for name, k, sd in expected.open:
            if name != "level" or not around.size:
                covariance[:, k, k] += sd**2
        mean = expected.level + expected.law
        values = population.values(Parts(mean, np.zeros_like(mean), np.zeros_like(mean)))
        start = population.start_density(rng, n, setting, standing(values))
        return cls(index, around, expected, mean, covariance, start, standing)

    @property
    def size(self) -> int:
        """Number of densities N."""
        return len(self.mean)

    @property
    def middle(self) -> Array:
        """The middle of each density, as points, (N, D)."""
        return np.pad(self.mean, ((0, 0), (0, self.around.size + 1)))

    def smoothed(self) -> TestPrior:
        """The same mean and covariance, with densities that overlap.

        The draws' means are shrunk towards their mean, and what they lose of their covariance is
        given to each density (West, 1993): also a quantity that is the same in all tests, which
        each density knows exactly, can then be moved. Along a history the means are shrunk towards
        what they follow of the laws' trends: a draw whose law is steep keeps the level that belongs
        to it.
        """
        middle = self.mean.mean(axis=0) + self._followed()
        away = self.mean - middle
        between = np.atleast_2d(away.T @ away / (self.size - 1.0))
        mean = middle + np.sqrt(1.0 - SMOOTH) * away
        covariance = self.covariance + SMOOTH * between + 1e-12 * np.eye(self.mean.shape[1])
        return replace(self, mean=mean, covariance=covariance)

    def _followed(self) -> Array:
        """What the means follow of the laws' trends, around their mean, (N, d)."""
        trends = self.around.trends(self.index)
        trends = trends - trends.mean(axis=0)
        if not trends.shape[1]:
            return np.zeros_like(self.mean)
        return np.asarray(trends @ np.linalg.lstsq(trends, self.mean, rcond=1e-6)[0])

    @cached_property
    def root(self) -> Array:
        """Cholesky factors of the covariances, (N, d, d)."""
        return np.asarray(np.linalg.cholesky(self.covariance))

    @cached_property
    def _inverse(self) -> Array:
        return np.asarray(np.linalg.inv(self.root))

    @cached_property
    def _log_scale(self) -> Array:
        diagonal = np.diagonal(self.root, axis1=1, axis2=2)
        return np.asarray(-np.log(diagonal).sum(axis=1) - self.start.log_size)

    def draw(self, labels: Index, rng: np.random.Generator) -> Array:
        """Points of the densities with these labels (n,), (n, D)."""
        standard = rng.standard_normal((len(labels), self.mean.shape[1]))
        x = self.mean[labels] + np.einsum("nij,nj->ni", self.root[labels], standard)
        numbers = rng.standard_normal((len(labels), self.around.size))
        points = np.concatenate([x, numbers, np.zeros((len(labels), 1))], axis=1)
        drawn = self.start.of(labels).draw(rng, lambda: self._unloaded(labels, points))
        start = np.clip(drawn, 1e-12, 1.0 - 1e-12)
        points[:, -1] = np.log(start / (1.0 - start))
        return points

    def log_density(self, labels: Index, points: Array) -> Array:
        """Log density of points (..., D) under their labels' (...), without constants."""
        d = self.mean.shape[1]
        away = points[..., :d] - self.mean[labels]
        standard = (self._inverse[labels] @ away[..., None])[..., 0]
        numbers = points[..., d:-1]
        return np.asarray(
            -0.5 * np.einsum("...i,...i->...", standard, standard)
            - 0.5 * np.einsum("...i,...i->...", numbers, numbers)
            + self._log_scale[labels]
            + self._log_start(labels, points)
        )

    def _log_start(self, labels: Index, points: Array) -> Array:
        """Log density of the starts of points, (...), without what `_log_scale` has."""
        found, those = self.start.log_beta(points[..., -1], labels), self.start.without_load[labels]
        part = self._unloaded(labels[those], points[those]) if np.any(those) else None
        if part is not None:
            t = points[those][:, -1]
            found[those] = part.log_density(expit(t)) + log_expit(t) + log_expit(-t)
        return found

    def _unloaded(self, labels: Index, points: Array) -> Unloaded | None:
        """Where points (n, D) bear no load; their own starts do not matter."""
        return self.standing(self.around.population.values(self.parts(labels, points))).unloaded()

    def relabelled(self, labels: Index, points: Array, rng: np.random.Generator) -> Index:
        """Labels of points (n, D), drawn anew among `SOME` by their densities, (n,).

        It leaves the mixture as it is, since all labels are equally probable.
        """
        others = rng.integers(self.size, size=(len(labels), SOME))
        among = np.concatenate([labels[:, None], others], axis=1)
        density = self.log_density(
            among, np.broadcast_to(points[:, None], (*among.shape, points.shape[1]))
        )
        gumbel = density + rng.gumbel(size=density.shape)
        return np.asarray(among[np.arange(len(labels)), np.argmax(gumbel, axis=1)])

    def deviation(self, points: Array) -> tuple[Along, Array]:
        """How points deviate from the laws, with the numbers e of each, (n, m)."""
        return self.around, points[:, -1 - self.around.size : -1]

    def parts(self, labels: Index, points: Array) -> Parts:
        """What points are made of: all that differs from level and law counts as scatter."""
        level, law = self.expected.level[labels], self.expected.law[labels]
        around, numbers = self.deviation(points)
        own = points[:, : -1 - around.size]
        return around.added(Parts(level, law, own - level - law), self.index[labels], numbers)

    @staticmethod
    def starts(points: Array) -> Array:
        """Places in the gap at which points (n, D) begin, (n,)."""
        return np.asarray(expit(points[:, -1]))
