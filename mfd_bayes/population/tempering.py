"""Draws of a test's posterior by sequential Monte Carlo: the likelihood is let in step by step.

Points of the prior are weighted by a small power of the likelihood, drawn again by their weights,
and moved by Metropolis steps that leave the density at this power as it is. They are moved until
they have forgotten where they were, or at most a given number of times; then the power grows until
it is 1 (Neal, 2001; Del Moral, Doucet and Jasra, 2006). Each step of the power keeps half of the
points effective, so that no weight can degenerate however much the data say.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize
from scipy.special import softmax

from mfd_bayes.population.prior_of_test import TestPrior

Array = NDArray[np.float64]
Index = NDArray[np.intp]
LogLikelihood = Callable[[Index, Array], Array]

FORGOTTEN = 0.3
"""Correlation of each coordinate with what it was when the points were drawn, below which the power
grows."""

INDEPENDENT = 0.15
"""The same at the end, where the power is 1. Of a thousand points chance alone gives 0.03."""

MOST = 40
"""Metropolis steps of each point at each power, at most."""

MOST_LAST = 160
"""The same at the end, where the power is 1."""

EVERY = 4
"""Metropolis steps for each change of the labels."""

TAILS = 10.0
"""Degrees of freedom of the Student-t density near the points."""

LONGEST = 0.99
"""Length of a step, at most; 1 is a proposal that does not depend on where the point is."""

KEPT = 0.5
"""Effective share of the points after each step of the power."""

WANTED = 0.25
"""Share of the steps that are to be accepted; their length follows."""


@dataclass(frozen=True, eq=False)
class Tempered:
    """Points of a posterior, equally probable.

    Attributes
    ----------
    labels : (n,) int
    points : (n, D)
    powers : int
        Steps of the power.
    accepted : float
        Share of the last Metropolis steps that were accepted.
    """

    labels: Index
    points: Array
    powers: int
    accepted: float


def temper(
    prior: TestPrior,
    log_likelihood: LogLikelihood,
    rng: np.random.Generator,
    n: int,
    *,
    depends: bool = False,
) -> Tempered:
    """Draws of the posterior of a test, n of them.

    Parameters
    ----------
    prior : TestPrior
        Smoothed, so that its densities overlap.
    log_likelihood : callable
        Of labels (n,) and points (n, D), (n,).
    rng : numpy.random.Generator
    n : int
    depends : bool
        Whether the likelihood depends on labels too, not on points alone.
    """
    cloud = _Cloud(prior, log_likelihood, rng, n)
    power, powers = 0.0, 0
    while power < 1.0:
        step = _next_step(cloud.log_likelihood, 1.0 - power)
        cloud.resample(softmax(step * cloud.log_likelihood))
        power, powers = power + step, powers + 1
        if power > 1.0 - 1e-12:
            power = 1.0
        last = power == 1.0
        for _ in range((MOST_LAST if last else MOST) // EVERY):
            cloud.relabel(power, depends)
            for _ in range(EVERY):
                cloud.move(power)
            if cloud.remembered() < (INDEPENDENT if last else FORGOTTEN):
                break
    return Tempered(cloud.labels, cloud.points, powers, cloud.accepted)


def _next_step(log_likelihood: Array, most: float) -> float:
    """Step of the power, up to `most`, that leaves `KEPT` of the points effective."""

    def spare(step: float) -> float:
        weights = softmax(step * log_likelihood)
        return float(1.0 / np.sum(weights**2) - KEPT * weights.size)

    if spare(most) >= 0.0:
        return most
    least = most
    while spare(least) < 0.0:
        least *= 0.1
    return float(optimize.brentq(spare, least, most, rtol=1e-3))


def systematic(weights: Array, n: int, rng: np.random.Generator) -> Index:
    """Numbers (n,) drawn by weights that sum to 1, evenly, and in a random order."""
    edges = np.cumsum(weights)
    picks = np.searchsorted(edges / edges[-1], (rng.random() + np.arange(n)) / n)
    return np.asarray(rng.permutation(np.minimum(picks, weights.size - 1)))


@dataclass(frozen=True, eq=False)
class _Near:
    """Student-t density near some points.

    Attributes
    ----------
    mean : (D,)
    root : (D, D)
        Cholesky factor of the scale matrix.
    """

    mean: Array
    root: Array

    @classmethod
    def of(cls, points: Array) -> _Near:
        """The density with the mean of points (n, D), and their covariance as scale matrix."""
        scale = np.cov(points, rowvar=False)
        scale += 1e-9 * np.diag(np.diag(scale)) + 1e-14 * np.eye(len(scale))
        return cls(points.mean(axis=0), np.asarray(np.linalg.cholesky(scale)))

    def step(self, points: Array, length: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Crank–Nicolson steps of points (n, D) with lengths (n, 1) up to 1.

        They leave the density as it is. Where the posterior is like it, long steps are accepted,
        however many coordinates there are; those of a random walk are as short as 2.4/√D (Grumitt,
        Karamanis and Seljak, 2024).

        Returns
        -------
        proposed : (n, D)
        log_ratio : (n,)
            Of the densities before and after, to be added to the gain of the target's logarithm.
        """
        n, dim = points.shape
        away = linalg.solve_triangular(self.root, (points - self.mean).T, lower=True).T
        before, shape = TAILS + np.sum(away**2, axis=1), 0.5 * (TAILS + dim)
        spread = np.sqrt(0.5 * before / rng.standard_gamma(shape, n))[:, None]
        new = np.sqrt(1.0 - length**2) * away
        new += length * spread * rng.standard_normal((n, dim))
        log_ratio = shape * (np.log(TAILS + np.sum(new**2, axis=1)) - np.log(before))
        return self.mean + new @ self.root.T, log_ratio


class _Cloud:
    """Points that are moved together."""

    def __init__(
        self,
        prior: TestPrior,
        log_likelihood: LogLikelihood,
        rng: np.random.Generator,
        n: int,
    ) -> None:
        self.prior, self.density, self.rng = prior, log_likelihood, rng
        self.labels = rng.integers(prior.size, size=n)
        self.points = prior.draw(self.labels, rng)
        self.log_likelihood = log_likelihood(self.labels, self.points)
        self.log_prior = prior.log_density(self.labels, self.points)
        self.length, self.accepted = 0.5, 0.0

    def resample(self, weights: Array) -> None:
        """Draw the points again by their weights."""
        chosen = systematic(weights, weights.size, self.rng)
        self.labels, self.points = self.labels[chosen], self.points[chosen]
        self.log_likelihood = self.log_likelihood[chosen]
        self.log_prior = self.log_prior[chosen]
        self.drawn, self.near = self.points, _Near.of(self.points)

    def remembered(self) -> float:
        """Largest correlation of a coordinate with what it was when the points were drawn."""
        now, then = (x - x.mean(axis=0) for x in (self.points, self.drawn))
        size = np.sqrt(np.sum(now**2, axis=0) * np.sum(then**2, axis=0))
        return float(np.max(np.sum(now * then, axis=0) / np.maximum(size, 1e-300)))

    def relabel(self, power: float, depends: bool) -> None:
        """New labels of the points by the prior, and by a likelihood that depends on them."""
        labels = self.prior.relabelled(self.labels, self.points, self.rng)
        if depends:
            found = self.density(labels, self.points)
            gain = power * (found - self.log_likelihood)
            yes = np.log(self.rng.random(len(labels))) < gain
            labels = np.where(yes, labels, self.labels)
            self.log_likelihood = np.where(yes, found, self.log_likelihood)
        self.labels = labels
        self.log_prior = self.prior.log_density(labels, self.points)

    def move(self, power: float) -> None:
        """A Metropolis step of each point, at a power of the likelihood."""
        rng, n = self.rng, len(self.points)
        length = np.minimum(self.length * np.exp(0.4 * rng.standard_normal((n, 1))), LONGEST)
        proposed, log_ratio = self.near.step(self.points, length, rng)
        found = self.density(self.labels, proposed)
        density = self.prior.log_density(self.labels, proposed)
        gain = density - self.log_prior + power * (found - self.log_likelihood)
        yes = np.log(rng.random(n)) < gain + log_ratio
        self.log_prior = np.where(yes, density, self.log_prior)
        self.points = np.where(yes[:, None], proposed, self.points)
        self.log_likelihood = np.where(yes, found, self.log_likelihood)
        self.accepted = float(np.mean(yes))
        self.length = float(np.clip(self.length * np.exp(self.accepted - WANTED), 0.02, LONGEST))
