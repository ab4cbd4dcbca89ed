"""A first fit of all tests together: what they leave over in common, and a Gaussian near each.

Penalised least squares by damped Gauss–Newton steps: quantities whose scatter prior prefers none
are the same in all tests, the others are each test's own. What is left over is a Gaussian process,
the discrepancy, plus noise; their sizes and the shape of the noise are updated by expectation–
maximisation. The discrepancy is kept apart from what the quantities do: it is learned from what the
fit without it leaves over, and that fit is never told of it (a module of its own: Liu, Bayarri and
Berger, 2009), so that the quantities are those of the fit without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.jobs.likelihoods import Evaluate, in_turn
from mfd_bayes.population.fitted_test import FittedTest
from mfd_bayes.population.normal_equations import System, damped_steps
from mfd_bayes.population.residual import Residual, memory_of, slip_force_of
from mfd_bayes.population.strokes import independent_share, learn_levels
from mfd_bayes.population.test_likelihood import TestLikelihood
from mfd_bayes.population.travel import TravelBasis
from mfd_bayes.population.working import WorkingLikelihood

Array = NDArray[np.float64]

STEPS = 40
"""Most Gauss–Newton steps."""

SETTLED = 3
"""The fit ends after so many steps in a row that hardly change anything."""

LITTLE = 1e-3, 1e-4
"""Relative changes of the discrepancy's size and of the objective below which a fit has settled."""

STEP = 1e-3
"""Step of the differences, in prior units."""

STILL = 1e-3
"""A test's slopes are taken anew when its coordinates have moved by more, in prior units."""

LARGEST = 8.0
"""Largest coordinate, in prior units, that a step may reach."""

WEAK = 1e-3
"""Precision, in prior units, that every Gaussian has at least."""

EVEN = 30.0
"""Samples near a knot that the noise's even shape is worth."""


@dataclass(frozen=True, eq=False)
class Pilot:
    """The first fit.

    Attributes
    ----------
    residual : Residual
    tests : tuple of TestLikelihood
        Working likelihoods with the residual's discrepancy and noise.
    """

    residual: Residual
    tests: tuple[TestLikelihood, ...]


def fit_pilot(
    likelihoods: Sequence[WorkingLikelihood],
    starts: Sequence[Array],
    evaluate: Evaluate[Array, Array] | None = None,
) -> Pilot:
    """First fit of tests.

    Parameters
    ----------
    likelihoods : sequence of WorkingLikelihood
        Without discrepancy, with even noise.
    starts : sequence of (D,)
        Coordinates of each test from which to begin, in prior units.
    evaluate : callable, optional
        Computes the likelihoods' residuals, in several processes.
    """
    fit = _Fit(likelihoods, starts, evaluate)
    settled = 0
    for _ in range(STEPS):
        before = fit.figures
        fit.linearise()
        fit.step()
        fit.learn()
        settled = settled + 1 if fit.settled_since(before) else 0
        if settled == SETTLED:
            break
    return fit.pilot()


def _steps(size: int) -> Array:
    """Steps forward, backward and none along each coordinate, (2 size + 1, size)."""
    return STEP * np.concatenate([np.eye(size), -np.eye(size), np.zeros((1, size))])


class _Fit:
    """State of the fit: coordinates of all tests, discrepancy, and sizes."""

    def __init__(
        self,
        likelihoods: Sequence[WorkingLikelihood],
        starts: Sequence[Array],
        evaluate: Evaluate[Array, Array] | None,
    ) -> None:
        self.evaluate = evaluate or in_turn([one.residual for one in likelihoods])
        layout = likelihoods[0].layout
        self.layout, self.d = layout, len(layout.names)
        self.basis = TravelBasis.of([one.posterior.trace for one in likelihoods])
        k = layout.names.index("noise_sd")
        self.common = np.flatnonzero([bool(sparse) for sparse in layout.sparse])
        self.shared = np.setdiff1d(np.arange(self.d), [*self.common, k])
        shared = np.median([x[: self.d] for x in starts], axis=0)
        self.inverse = np.linalg.inv(self.basis.covariance())
        self.coefficients = np.zeros(self.basis.size)
        self.covariance = self.basis.covariance()
        self.log_shape = np.zeros(self.basis.size)
        self.tests = []
        for likelihood, start in zip(likelihoods, starts, strict=True):
            x = start.copy()
            x[self.common] = shared[self.common]
            functions = self.basis.values(likelihood.posterior.trace)
            residual = likelihood.residual(x[None])[0]
            sd = float(residual.std())
            self.tests.append(
                FittedTest(likelihood, x, functions, functions, residual, np.empty((0, 0)), sd)
            )
        self.amplitude = 0.3 * float(np.mean([one.sd for one in self.tests]))
        self.slip_force = 1.0
        self.damping = 0.0
        self.objective = self.typical_move = np.inf

    @property
    def figures(self) -> Array:
        """Size of the discrepancy, and objective before the last step."""
        return np.array([self.amplitude, self.objective])

    def settled_since(self, before: Array) -> bool:
        """Whether figures have hardly changed, and half of the tests have hardly moved."""
        change = np.abs(self.figures / before - 1.0)
        return bool(np.all(change < LITTLE) and self.typical_move < STILL)

    def linearise(self, still: float = STILL) -> None:
        """Residuals, slopes and slip forces at the current coordinates, where tests have moved."""
        moved = [j for j, one in enumerate(self.tests) if one.moved > still]
        around = ((j, self.tests[j].x + _steps(self.tests[j].x.size)) for j in moved)
        for j, residual in zip(moved, self.evaluate(around), strict=True):
            one, size = self.tests[j], self.tests[j].x.size
            one.residual, one.moved = residual[-1], 0.0
            one.slopes = (residual[size : 2 * size] - residual[:size]).T / (2.0 * STEP)
            posterior = one.likelihood.posterior
            values = posterior.values(one.likelihood.points(one.x[None]))
            one.slip_force = max(float(slip_force_of(posterior.model, values)[0]), 1e-12)
        self.slip_force = float(np.exp(np.mean([np.log(one.slip_force) for one in self.tests])))
        for one in self.tests:
            one.basis = one.functions * (one.slip_force / self.slip_force)

    def _free(self, one: FittedTest) -> NDArray[np.intp]:
        """Coordinates of a test that are its own, or differ between tests."""
        return np.concatenate([self.shared, np.arange(self.d, one.x.size)])

    def step(self) -> None:
        """One damped Gauss–Newton step, if one lowers the objective."""
        xs, residuals = [one.x for one in self.tests], [one.residual for one in self.tests]
        before = self.objective = self._objective(xs, residuals)
        systems = [self._system(one) for one in self.tests]
        for _ in range(8):
            xs = self._proposed(systems)
            if max(np.max(np.abs(x)) for x in xs) <= LARGEST:
                left = [r[0] for r in self.evaluate((j, x[None]) for j, x in enumerate(xs))]
                if self._objective(xs, left) <= before:
                    self.damping = 0.0 if self.damping < 1e-3 else self.damping / 10.0
                    self._take(xs, left)
                    return
            self.damping = max(1e-3, 6.0 * self.damping)

    def _take(self, xs: Sequence[Array], residuals: Sequence[Array]) -> None:
        """Go to coordinates of the tests."""
        moves = [np.max(np.abs(x - one.x)) for x, one in zip(xs, self.tests, strict=True)]
        self.typical_move = float(np.median(moves))
        for one, x, residual, moved in zip(self.tests, xs, residuals, moves, strict=True):
            one.x, one.residual, one.moved = x, residual, one.moved + float(moved)

    def _system(self, one: FittedTest) -> System:
        """Normal equations of a test at its current coordinates."""
        weights = one.weights(self.log_shape)
        slopes, left = one.slopes * weights[:, None], one.residual * weights
        free = self._free(one)
        a, b = slopes[:, self.common], slopes[:, free]
        return System(a.T @ a, b.T @ b, a.T @ b, a.T @ left, b.T @ left - one.x[free])

    def _proposed(self, systems: Sequence[System]) -> list[Array]:
        """Coordinates of the tests after a step."""
        common = self.tests[0].x[self.common]
        together, alone = damped_steps(systems, common, self.damping)
        xs = [one.x.copy() for one in self.tests]
        for one, x, own in zip(self.tests, xs, alone, strict=True):
            x[self.common] += together
            x[self._free(one)] += own
        return xs

    def _objective(self, xs: Sequence[Array], residuals: Sequence[Array]) -> float:
        """Half the weighted squares of what is left, plus the priors'."""
        total = 0.5 * float(np.sum(xs[0][self.common] ** 2))
        for one, x, left in zip(self.tests, xs, residuals, strict=True):
            total += 0.5 * float(np.sum((left * one.weights(self.log_shape)) ** 2))
            total += 0.5 * float(np.sum(x[self._free(one)] ** 2))
        return total

    def learn(self) -> None:
        """Discrepancy, its size, noise of each test, and shape of the noise."""
        self._learn_discrepancy()
        squares = self.coefficients @ self.inverse @ self.coefficients
        squares += np.sum(self.inverse * self.covariance)
        self.amplitude = max(float(np.sqrt(squares / self.basis.size)), 1e-9)
        self._learn_noise()

    def _learn_discrepancy(self) -> None:
        """Posterior of the discrepancy's coefficients, given what the quantities leave over."""
        precision, pull = self.inverse / self.amplitude**2, np.zeros(self.basis.size)
        for one in self.tests:
            weights = one.weights(self.log_shape)
            functions = one.basis * weights[:, None]
            precision = precision + functions.T @ functions
            pull = pull + functions.T @ (one.residual * weights)
        self.covariance = np.linalg.inv(precision)
        self.coefficients = self.covariance @ pull

    def _learn_noise(self) -> None:
        """Noise of each test, and shape of the noise."""
        total, count = np.full(self.basis.size, EVEN), np.full(self.basis.size, EVEN)
        for one in self.tests:
            kept = one.likelihood.kept
            left = (one.residual - one.basis @ self.coefficients)[kept]
            shape = np.exp(one.functions @ self.log_shape)[kept]
            one.sd = max(float(np.sqrt(np.mean((left / shape) ** 2))), 1e-12)
            total += one.functions[kept].T @ (left / one.sd) ** 2
            count += one.functions[kept].sum(axis=0)
        self.log_shape = 0.5 * np.log(total / count)

    def pilot(self) -> Pilot:
        """What is kept of the fit."""
        self.linearise(still=0.0)
        standard = [one.standardised(self.coefficients, self.log_shape) for one in self.tests]
        traces = [one.likelihood.posterior.trace for one in self.tests]
        information = independent_share([one.values for one in standard])
        levels, rest = learn_levels(standard)
        rest_information, noise_time = memory_of(rest, traces)
        residual = Residual(
            basis=self.basis,
            mean=self.coefficients,
            covariance=np.asarray(self.covariance / information),
            log_shape=self.log_shape,
            slip_force=self.slip_force,
            levels=levels,
            noise_time=noise_time,
            information=rest_information,
        )
        return Pilot(residual, tuple(self._test(one, information) for one in self.tests))

    def _test(self, one: FittedTest, information: float) -> TestLikelihood:
        """Working likelihood of a test with discrepancy and noise, and a Gaussian near it."""
        likelihood = replace(
            one.likelihood,
            discrepancy=one.basis @ self.coefficients,
            shape=np.exp(one.functions @ self.log_shape),
            information=information,
        )
        k = self.layout.names.index("noise_sd")
        x = one.x.copy()
        prior = one.likelihood.posterior.priors["noise_sd"]
        x[k] = float(prior.coordinate(np.array([one.sd]))[0]) - likelihood.middle[k]
        x[k] /= likelihood.scale[k]
        weights = one.weights(self.log_shape)[:, None]
        slopes = one.slopes * weights
        slopes[:, k] = 0.0
        left = (one.residual - one.basis @ self.coefficients) * weights[:, 0]
        precision = information * (slopes.T @ slopes)
        gradient = information * (slopes.T @ left)
        samples = np.count_nonzero(weights)
        precision[k, k] = 2.0 * information * samples * likelihood.scale[k] ** 2
        precision[range(x.size), range(x.size)] += WEAK
        covariance = np.asarray(np.linalg.inv(precision))
        return TestLikelihood(
            likelihood, likelihood.log_own_prior, x + covariance @ gradient, covariance
        )
