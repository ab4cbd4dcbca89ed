"""Joint penalised least squares of all tests, and the Laplace approximation of each near it.

Quantities of the device are the same in all tests; the others are each test's own. The normal
equations are solved with the own ones eliminated (Schur complement), damped as by Levenberg and
Marquardt. Discrepancy and noise are learned first, by expectation-maximisation from what the fit
without a discrepancy leaves over (a module of its own: Liu, Bayarri and Berger, 2009). With these
given, the fit goes on to the posterior mode under the magnitude-adjusted likelihood, in which
samples count as many as are independent (Ribatet, Cooley and Davison, 2012). There the Gaussians
are taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.population.coordinates import Coordinates
from mfd_bayes.population.discrepancy import (
    Residual,
    TravelBasis,
    knot_covariance,
    lag_one_of,
    share_of_strokes,
    slip_force_of,
    strokes_of,
)
from mfd_bayes.population.laws import ratio

Array = NDArray[np.float64]
Evaluate = Callable[[Iterable[tuple[int, "Array"]]], Iterator["Array"]]

STEP = 1e-3
"""Step of the central differences, in prior units."""

EVEN = 30.0
"""Samples near a knot that an even shape of the noise is worth."""

FARTHEST = 8.0
"""Largest coordinate of a fit, in prior units."""

SETTLED = 1e-3
"""Relative change of the objective below which a step counts as settled; three in a row end."""


@dataclass(frozen=True, eq=False)
class TestLikelihood:
    """Likelihood of one test in prior units x (n, D); a process can be sent it.

    Attributes
    ----------
    posterior : Posterior
        Of the test, with independent noise.
    coordinates : Coordinates
        Of the D quantities.
    relative : (T,), or None
        Actuation along the record over its mean, where it changes.
    laws : mapping of str to (str, float, float)
        What follows it then: the quantity whose law that is, and the law's share and exponent where
        the test has none to itself.
    discrepancy, shape : (T,)
        δ along the record, kip, and g.
    information : float
        Share of independent samples.
    """

    posterior: Posterior
    coordinates: Coordinates
    relative: Array | None = None
    laws: Mapping[str, tuple[str, float, float]] = field(default_factory=dict)
    discrepancy: Array | float = 0.0
    shape: Array | float = 1.0
    information: float = 1.0

    __test__ = False  # pytest is not to collect it

    def values(self, x: Array) -> dict[str, Array]:
        """All quantities of the test at x (n, D), by name, (n,) each."""
        names, own = self.coordinates.names, self.coordinates.own(x)
        order = [names.index(name) for name in self.posterior.names]
        return self.posterior.values(self.posterior.from_own(own[:, order]))

    def scales(self, x: Array) -> dict[str, Array]:
        """Factors along the record of what follows a changing actuation, (n, T) each."""
        if self.relative is None:
            return {}
        own, found = self.coordinates.values(x), {}
        for name, (law, *given) in self.laws.items():
            share, exponent = (
                own.get(f"{shape}_{law}", np.array([value]))
                for shape, value in zip(("share", "exponent"), given, strict=True)
            )
            followed = ratio(self.relative, share[:, None], exponent[:, None])
            found[name] = np.broadcast_to(followed, (len(x), self.relative.size))
        return found

    def left_over(self, x: Array) -> Array:
        """Measured less computed force at x (n, D), (n, T), kip; δ is in it."""
        values = self.values(x)
        force = self.posterior.force(values, scales=self.scales(x) or None)
        measured = np.asarray(self.posterior.trace.force)
        left = measured - force - values["offset"][:, None]
        return np.asarray(left[:, self.posterior.first :])

    def linearised(self, x: Array) -> Array:
        """What is left over at x (1, D), and its slopes, (1 + D, T)."""
        step = STEP * np.eye(x.shape[1])
        left = self.left_over(np.concatenate([x, x + step, x - step]))
        up, down = np.split(left[1:], 2)
        return np.concatenate([left[:1], (up - down) / (2.0 * STEP)])

    def log_likelihood(self, x: Array) -> Array:
        """Magnitude-adjusted log likelihood at x (n, D), (n,); -inf where there is none."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            left = (self.left_over(x) - self.discrepancy) / self.shape
            k = self.coordinates.names.index("noise_sd")
            q = self.coordinates.centre[k] + self.coordinates.spread[k] * x[:, k]
            sd = self.coordinates.priors["noise_sd"].value(q)
            squares = np.einsum("nt,nt->n", left, left)
            found = -self.information * (0.5 * squares / sd**2 + left.shape[1] * np.log(sd))
        return np.where(np.isfinite(found), found, -np.inf)


@dataclass(frozen=True, eq=False)
class JointFit:
    """All tests near the mode of their joint posterior.

    Attributes
    ----------
    tests : tuple of TestLikelihood
        With discrepancy and noise.
    mean, precision : (J, D), (J, D, D)
        Gaussian of each test's likelihood, in prior units.
    residual : Residual
    """

    tests: tuple[TestLikelihood, ...]
    mean: Array
    precision: Array
    residual: Residual


def fit_jointly(
    tests: Sequence[TestLikelihood],
    start: Array,
    common: NDArray[np.bool_],
    evaluate: Evaluate | None = None,
) -> JointFit:
    """Fit of all tests together.

    Parameters
    ----------
    tests : sequence of TestLikelihood
        J tests without discrepancy.
    start : (J, D)
        Where each begins.
    common : (D,) bool
        Quantities that are the same in all tests.
    evaluate : callable, optional
        Computes `linearised` of pairs of a test's number and x, in several processes.
    """
    return _Fit(tests, start, common, evaluate).run()


class _Fit:
    """State of the fit."""

    def __init__(
        self,
        tests: Sequence[TestLikelihood],
        start: Array,
        common: NDArray[np.bool_],
        evaluate: Evaluate | None,
    ) -> None:
        self.tests, self.x = list(tests), start.copy()
        self.evaluate = evaluate or (lambda pairs: (tests[j].linearised(x) for j, x in pairs))
        names = tests[0].coordinates.names
        self.k_sd = names.index("noise_sd")
        self.common = np.flatnonzero(common)
        self.free = np.array([k for k in range(len(names)) if not common[k] and k != self.k_sd])
        self.x[:, self.common] = np.median(self.x[:, self.common], axis=0)
        traces = [test.posterior.trace for test in tests]
        strokes = [float(np.ptp(trace.displacement)) for trace in traces]
        self.basis = TravelBasis(min(strokes), max(strokes))
        self.functions = [self.basis(t.posterior.trace)[t.posterior.first :] for t in tests]
        self.given: list[Array | float] = [0.0] * len(tests)
        self.information = 1.0
        self._evaluated(self.x)
        self.sd = np.array([max(float(r.std()), 1e-9) for r in self.left])
        self.log_shape = np.zeros(self.functions[0].shape[1])
        self.inverse, self.amplitude = np.linalg.inv(knot_covariance()), 0.3 * self.sd.mean()

    def run(self) -> JointFit:
        self._iterate(40, learn=True)
        standard = [
            (r - f @ self.knots) * w
            for r, f, w in zip(self.left, self.scaled, self._weights(), strict=True)
        ]
        residual = self._residual(standard)
        self.information = residual.information
        self.given = [f @ self.knots for f in self.scaled]
        self._iterate(20, learn=False)
        gaussians = [self._gaussian(j) for j in range(len(self.tests))]
        found = tuple(
            replace(
                test,
                discrepancy=given,
                shape=np.exp(f @ self.log_shape),
                information=self.information,
            )
            for test, given, f in zip(self.tests, self.given, self.functions, strict=True)
        )
        mean, precision = zip(*gaussians, strict=True)
        return JointFit(found, np.array(mean), np.array(precision), residual)

    def _residual(self, standard: Sequence[Array]) -> Residual:
        """Discrepancy and noise, of standardised noise (T,) of each test."""
        phi = lag_one_of(standard)
        information = (1.0 - phi) / (1.0 + phi)
        traces = [test.posterior.trace for test in self.tests]
        strokes = [strokes_of(t.posterior.trace)[t.posterior.first :] for t in self.tests]
        step = np.median([np.median(np.diff(trace.time)) for trace in traces])
        travel = np.median([np.mean(np.abs(np.diff(trace.displacement))) for trace in traces])
        return Residual(
            basis=self.basis,
            mean=self.knots,
            covariance=self.covariance / information,
            log_shape=self.log_shape,
            slip_force=self.typical,
            stroke_share=share_of_strokes(standard, strokes),
            lag_one=phi,
            noise_time=float(-step / np.log(phi)),
            travel=float(travel),
        )

    def _evaluated(self, x: Array) -> None:
        """Take what is left over and slopes at x (J, D)."""
        found = list(self.evaluate((j, row[None]) for j, row in enumerate(x)))
        self.left, self.slopes = [f[0] for f in found], [-f[1:].T for f in found]

    def _weights(self) -> list[Array]:
        root = np.sqrt(self.information)
        return [
            root * np.exp(-f @ self.log_shape) / s
            for f, s in zip(self.functions, self.sd, strict=True)
        ]

    def _objective(self, weights: Sequence[Array]) -> float:
        squares = np.sum(self.x[0, self.common] ** 2) + np.sum(self.x[:, self.free] ** 2)
        for left, given, w in zip(self.left, self.given, weights, strict=True):
            squares += np.sum(((left - given) * w) ** 2)
        return 0.5 * float(squares)

    def _iterate(self, most: int, *, learn: bool) -> None:
        damping, settled, last = 0.0, 0, np.inf
        if learn:
            self._learn()
        for _ in range(most):
            weights = self._weights()
            before = self._objective(weights)
            damping = self._step(weights, before, damping)
            if learn:
                self._learn()
            settled = settled + 1 if abs(before / last - 1.0) < SETTLED else 0
            last = before
            if settled == 3:
                return

    def _step(self, weights: Sequence[Array], before: float, damping: float) -> float:
        """A damped Gauss-Newton step, if one lowers the objective; gives the next damping."""
        kept = self.x, self.left, self.slopes
        for _ in range(8):
            self.x = self._solved(weights, damping)
            if np.abs(self.x).max() <= FARTHEST:
                self._evaluated(self.x)
                if self._objective(weights) <= before:
                    return damping / 10.0 if damping > 1e-3 else 0.0
            self.x, self.left, self.slopes = kept
            damping = max(1e-3, 6.0 * damping)
        return damping

    def _solved(self, weights: Sequence[Array], damping: float) -> Array:
        """Solution (J, D) of the normal equations; the tests' own quantities are eliminated."""
        common, free = self.common, self.free
        a, b, eliminated = np.eye(common.size), -self.x[0, common], []
        for j, w in enumerate(weights):
            shared, own = (
                self.slopes[j][:, common] * w[:, None],
                self.slopes[j][:, free] * w[:, None],
            )
            left = (self.left[j] - self.given[j]) * w
            h = own.T @ own
            h += np.diag(1.0 + damping * np.diag(h))
            gradient = own.T @ left - self.x[j, free]
            solved = np.linalg.solve(h, np.column_stack([own.T @ shared, gradient]))
            a += shared.T @ shared - (shared.T @ own) @ solved[:, :-1]
            a += damping * np.diag(np.sum(shared**2, axis=0))
            b = b + shared.T @ left - (shared.T @ own) @ solved[:, -1]
            eliminated.append(solved)
        step = np.linalg.solve(a, b)
        new = self.x.copy()
        new[:, common] += step
        for j, solved in enumerate(eliminated):
            new[j, free] += solved[:, -1] - solved[:, :-1] @ step
        return new

    def _learn(self) -> None:
        """Discrepancy and its size, noise of each test, shape of the noise: a step of EM."""
        values = [test.values(x[None]) for test, x in zip(self.tests, self.x, strict=True)]
        model = self.tests[0].posterior.model
        slips = np.array([slip_force_of(model, v)[0] for v in values])
        driven = [t.posterior.trace.reference_actuation > 0 for t in self.tests]
        self.typical = float(np.exp(np.log(np.maximum(slips[driven], 1e-9)).mean()))
        relative = slips / self.typical
        self.scaled = [f * s for f, s in zip(self.functions, relative, strict=True)]
        precision, pull = self.inverse / self.amplitude**2, np.zeros(self.log_shape.size)
        for f, w, left in zip(self.scaled, self._weights(), self.left, strict=True):
            weighted = f * w[:, None]
            precision = precision + weighted.T @ weighted
            pull += weighted.T @ (w * left)
        self.covariance = np.linalg.inv(precision)
        self.knots = self.covariance @ pull
        size = self.knots @ self.inverse @ self.knots + np.sum(self.inverse * self.covariance)
        self.amplitude = max(float(np.sqrt(size / pull.size)), 1e-9)
        squares, count = np.full(pull.size, EVEN), np.full(pull.size, EVEN)
        for j, f in enumerate(self.functions):
            rest = self.left[j] - self.scaled[j] @ self.knots
            even = rest * np.exp(-f @ self.log_shape)
            self.sd[j] = max(float(np.sqrt(np.mean(even**2))), 1e-9)
            squares += f.T @ (rest / self.sd[j]) ** 2
            count += f.sum(axis=0)
        self.log_shape = 0.5 * np.log(squares / count)

    def _gaussian(self, j: int) -> tuple[Array, Array]:
        """Mean (D,) and precision (D, D) of the likelihood of test j."""
        w, k, coordinates = self._weights()[j], self.k_sd, self.tests[j].coordinates
        slopes = self.slopes[j] * w[:, None]
        slopes[:, k] = 0.0
        q = coordinates.priors["noise_sd"].coordinate(self.sd[[j]])[0]
        self.x[j, k] = (q - coordinates.centre[k]) / coordinates.spread[k]
        precision = slopes.T @ slopes
        prior = coordinates.priors["noise_sd"]
        up, down = (prior.value(np.array([q + e])) for e in (STEP, -STEP))
        slope = coordinates.spread[k] * float((np.log(up / down) / (2.0 * STEP))[0])
        precision[k, k] = 2.0 * self.information * w.size * slope**2
        precision[np.diag_indices(len(precision))] += 1e-3
        pull = slopes.T @ ((self.left[j] - self.given[j]) * w)
        return self.x[j] + np.linalg.solve(precision, pull), precision
