"""Draws of a test's posterior by sequential Monte Carlo: the likelihood is let in step by step.

Points of the prior are weighted by a small power of the likelihood, drawn again by their weights,
and moved by Metropolis steps that leave the density at this power as it is; then the power grows
until it is 1 (Neal, 2001; Del Moral, Doucet and Jasra, 2006). Each step of the power keeps half of
the points effective, so that no weight can degenerate however much the data say.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize
from scipy.special import softmax

from mfd_bayes.population.prior_of_test import TestPrior

Array = NDArray[np.float64]
Index = NDArray[np.intp]
LogLikelihood = Callable[[Index, Array], Array]

MOVES = 12
"""Metropolis steps of each point at each power."""

LAST = 48
"""Metropolis steps at the end, where the power is 1."""

USUAL = 16
"""Coordinates of a point for which these steps are enough; with more, they grow in proportion."""

EVERY = 4
"""Metropolis steps for each change of the labels."""

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
    power, powers, more = 0.0, 0, max(cloud.points.shape[1] / USUAL, 1.0)
    while power < 1.0:
        step = _next_step(cloud.log_likelihood, 1.0 - power)
        cloud.resample(softmax(step * cloud.log_likelihood))
        power, powers = power + step, powers + 1
        if power > 1.0 - 1e-12:
            power = 1.0
        for turn in range(round(more * (MOVES if power < 1.0 else LAST))):
            if turn % EVERY == 0:
                cloud.relabel(power, depends)
            cloud.move(power)
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
        self.length, self.accepted = 1.0, 0.0

    def resample(self, weights: Array) -> None:
        """Draw the points again by their weights."""
        chosen = systematic(weights, weights.size, self.rng)
        self.labels, self.points = self.labels[chosen], self.points[chosen]
        self.log_likelihood = self.log_likelihood[chosen]
        self.log_prior = self.log_prior[chosen]
        covariance = np.cov(self.points, rowvar=False)
        covariance += 1e-9 * np.diag(np.diag(covariance)) + 1e-14 * np.eye(len(covariance))
        self.root = np.linalg.cholesky(covariance)

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
        rng, (n, dim) = self.rng, self.points.shape
        length = self.length * 2.38 / np.sqrt(dim) * np.exp(0.7 * rng.standard_normal((n, 1)))
        proposed = self.points + length * (rng.standard_normal((n, dim)) @ self.root.T)
        found = self.density(self.labels, proposed)
        density = self.prior.log_density(self.labels, proposed)
        gain = density - self.log_prior + power * (found - self.log_likelihood)
        yes = np.log(rng.random(n)) < gain
        self.log_prior = np.where(yes, density, self.log_prior)
        self.points = np.where(yes[:, None], proposed, self.points)
        self.log_likelihood = np.where(yes, found, self.log_likelihood)
        self.accepted = float(np.mean(yes))
        self.length = float(np.clip(self.length * np.exp(self.accepted - WANTED), 0.02, 3.0))
