"""The joint fit of a set of calibrated tests, and the Gaussian likelihood of each.

The joint fit is penalised least squares of all tests together, with what the force model leaves
over in every test:

    y_j = F(θ_j) + F0_j + f_j δ(u) + s_j g(u) (h z_i + √(1 - h²) ε)

u is the travel since the last turn, with the direction of motion; f_j is the slip force of test j
over a typical one. The discrepancy δ is a Gaussian process (Matérn 3/2, by its values at knots); it
repeats in every cycle of every test. g is the shape of the noise's standard deviation, h the share
that the samples of a stroke have in common (a random intercept z_i for each stroke), and ε an AR(1)
process.

Quantities of the device are the same in all tests; the others are each test's own. The normal
equations are solved with the own ones eliminated (Schur complement), damped as by Levenberg and
Marquardt. Discrepancy and noise are learned first, by expectation-maximisation from what the fit
without a discrepancy leaves over (a module of its own: Liu, Bayarri and Berger, 2009). With these
given, the fit goes on to the posterior mode under the magnitude-adjusted likelihood, in which
samples count as many as are independent (Ribatet, Cooley and Davison, 2012). There the Gaussians
of the tests are taken (Laplace), and how they follow δ: δ is confounded with slip force and
stiffness, which would seem to be known too well if δ were taken as certain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from mfd_bayes.calibration.posterior import Posterior
from mfd_bayes.jobs.local import Evaluate
from mfd_bayes.population.design import Coordinates, ratio
from mfd_bayes.population.population import KNOTS, Residual, TravelBasis, slip_force_of, strokes_of

Array = NDArray[np.float64]
Index = NDArray[np.intp]

# --- joint fit ------------------------------------------------------------------------------------

LENGTH = 0.2  # correlation length of δ, as a share of the range of the knots
FEWEST = 8  # fewest samples of a stroke whose mean counts
STEP = 1e-3  # step of the central differences, in prior units
EVEN = 30.0  # samples near a knot that an even shape of the noise is worth
FARTHEST = 8.0  # largest coordinate of a fit, in prior units
BEYOND = 50.0  # prior units: farther out a likelihood is as there; its quantities stay numbers
SETTLED = 1e-3  # relative change of the objective; three smaller ones in a row end the fit


def knot_covariance() -> Array:
    """Prior covariance of δ at the knots for unit variance: Matérn 3/2 in each direction."""
    knots = np.linspace(0.0, 1.0, KNOTS)
    r = np.sqrt(3.0) * np.abs(np.subtract.outer(knots, knots)) / LENGTH
    block = (1.0 + r) * np.exp(-r) + 1e-6 * np.eye(KNOTS)
    return block_diag(block, block)


def lag_one_of(standard: Sequence[Array]) -> float:
    """Correlation of neighbours that gives the share of independent samples of all tests."""
    phi = np.array([np.clip(r[1:] @ r[:-1] / (r @ r), 1e-3, 0.999) for r in standard])
    share = np.average((1.0 - phi) / (1.0 + phi), weights=[r.size for r in standard])
    return float((1.0 - share) / (1.0 + share))


def share_of_strokes(standard: Sequence[Array], strokes: Sequence[Index]) -> float:
    """Share h of a random intercept of each stroke: one-way analysis of variance by moments."""
    between_strokes, within_strokes = [1e-12], [1e-12]
    for values, stroke in zip(standard, strokes, strict=True):
        for i in np.unique(stroke):
            if np.count_nonzero(group := stroke == i) >= FEWEST:
                between_strokes.append(float(values[group].mean()) ** 2)
                within_strokes.append(float(values[group].var()))
    total = np.mean(between_strokes) + np.mean(within_strokes)
    return float(np.sqrt(np.clip(np.mean(between_strokes) / total, 0.0, 0.9)))


@dataclass(frozen=True, eq=False)
class TestLikelihood:
    """Likelihood of one test in prior units x (n, D); a process can be sent it."""

    posterior: Posterior  # of the test, with independent noise
    coordinates: Coordinates  # of the D quantities
    relative: Array | None  # (T,), actuation over its mean, where it changes
    # what follows it then: whose law, and its share and exponent where the test has none to itself
    laws: Mapping[str, tuple[str, float, float]]
    discrepancy: Array | float = 0.0  # (T,), δ along the record, kip
    shape: Array | float = 1.0  # (T,), g
    information: float = 1.0  # share of independent samples

    __test__ = False  # pytest is not to collect it

    def values(self, x: Array) -> dict[str, Array]:
        """All quantities of the test at x (n, D), by name, (n,) each."""
        names, q = self.coordinates.names, self.coordinates.of_priors(x)
        order = [names.index(name) for name in self.posterior.names]
        return self.posterior.values(q[:, order])

    def scales(self, x: Array) -> dict[str, Array]:
        """Factors along the record of what follows a changing actuation, (n, T) each."""
        if self.relative is None:
            return {}
        values, scales = self.coordinates.values(x), {}
        for name, (law, *shape_names) in self.laws.items():
            share, exponent = (
                values.get(f"{shape}_{law}", np.array([value]))
                for shape, value in zip(("share", "exponent"), shape_names, strict=True)
            )
            followed = ratio(self.relative, share[:, None], exponent[:, None])
            scales[name] = np.broadcast_to(followed, (len(x), self.relative.size))
        return scales

    def residuals(self, x: Array) -> Array:
        """Measured less computed force at x (n, D), (n, T), kip; δ is in it."""
        values = self.values(x)
        force = self.posterior.force(values, scales=self.scales(x) or None)
        measured = np.asarray(self.posterior.trace.force)
        residual = measured - force - values["offset"][:, None]
        return np.asarray(residual[:, self.posterior.first :])

    def linearised(self, x: Array) -> Array:
        """Residuals at x (1, D), and their slopes, (1 + D, T)."""
        step = STEP * np.eye(x.shape[1])
        residuals = self.residuals(np.concatenate([x, x + step, x - step]))
        ahead, back = np.split(residuals[1:], 2)
        return np.concatenate([residuals[:1], (ahead - back) / (2.0 * STEP)])

    def log_likelihood(self, x: Array) -> Array:
        """Magnitude-adjusted log likelihood at x (n, D), (n,); -inf where there is none."""
        x = np.clip(x, -BEYOND, BEYOND)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            residuals = (self.residuals(x) - self.discrepancy) / self.shape
            sd = self.coordinates.value("noise_sd", x)
            squares = np.einsum("nt,nt->n", residuals, residuals)
            log_densities = -self.information * (
                0.5 * squares / sd**2 + residuals.shape[1] * np.log(sd)
            )
        return np.where(np.isfinite(log_densities), log_densities, -np.inf)


@dataclass(frozen=True, eq=False)
class JointFit:
    """All tests near the mode of their joint posterior."""

    tests: tuple[TestLikelihood, ...]  # with discrepancy and noise
    mean: Array  # (J, D), of each test's likelihood, in prior units
    precision: Array  # (J, D, D)
    residual: Residual
    knot_root: Array  # (K, K), kip: root of the covariance of δ at its knots, all else integrated
    response: Array  # (J, D, K), 1/kip: how the means follow δ


def fit_jointly(
    tests: Sequence[TestLikelihood],
    start: Array,
    common: NDArray[np.bool_],
    evaluate: Evaluate[Array, Array],
) -> JointFit:
    """Fit of all tests together."""
    fit = _Fit(tests, start, common, evaluate)
    fit.iterate(40, learn=True)
    residual = fit.residual()
    fit.information, fit.discrepancy = residual.information, [f @ fit.knots for f in fit.scaled]
    fit.iterate(20, learn=False)
    mean, precision = zip(*map(fit.gaussian, range(len(tests))), strict=True)
    columns = zip(tests, fit.discrepancy, fit.shapes(), strict=True)
    likelihoods = [
        replace(t, discrepancy=d, shape=g, information=fit.information) for t, d, g in columns
    ]
    gaussians = np.array(mean), np.array(precision)
    return JointFit(tuple(likelihoods), *gaussians, residual, *fit.of_knots())


class _Fit:
    """State of the fit: coordinates x (J, D); residuals, slopes and noise of each test."""

    def __init__(
        self,
        tests: Sequence[TestLikelihood],
        start: Array,
        common: NDArray[np.bool_],
        evaluate: Evaluate[Array, Array],
    ) -> None:
        self.tests, self.x, self.evaluate = tests, start.copy(), evaluate
        self.k_sd = tests[0].coordinates.names.index("noise_sd")
        free_coordinates = ~common
        free_coordinates[self.k_sd] = False
        self.common, self.free = np.flatnonzero(common), np.flatnonzero(free_coordinates)
        self.x[:, self.common] = np.median(self.x[:, self.common], axis=0)
        self.traces = [test.posterior.trace for test in tests]
        strokes = [float(np.ptp(trace.displacement)) for trace in self.traces]
        self.basis = TravelBasis(min(strokes), max(strokes))
        self.first = [test.posterior.first for test in tests]
        self.functions = [self.basis(t)[k:] for t, k in zip(self.traces, self.first, strict=True)]
        self.discrepancy: list[Array | float] = [0.0] * len(tests)
        self.information = 1.0
        self._linearise()
        self.sd = np.array([max(float(r.std()), 1e-9) for r in self.left])
        self.log_shape = np.zeros(self.functions[0].shape[1])
        self.inverse, self.amplitude = np.linalg.inv(knot_covariance()), 0.3 * self.sd.mean()

    def shapes(self) -> list[Array]:
        """Shape g of the noise of each test, (T,)."""
        return [np.exp(f @ self.log_shape) for f in self.functions]

    def residual(self) -> Residual:
        """Discrepancy and noise that the tests have in common."""
        tests_of_fit = zip(self.left, self.scaled, self.weights(), strict=True)
        standard = [(r - f @ self.knots) * w for r, f, w in tests_of_fit]
        phi = lag_one_of(standard)
        strokes = [strokes_of(t)[k:] for t, k in zip(self.traces, self.first, strict=True)]
        step = np.median([np.median(np.diff(trace.time)) for trace in self.traces])
        travel = np.median([np.mean(np.abs(np.diff(t.displacement))) for t in self.traces])
        return Residual(
            basis=self.basis,
            mean=self.knots,
            log_shape=self.log_shape,
            slip_force=self.median,
            stroke_share=share_of_strokes(standard, strokes),
            lag_one=phi,
            noise_time=float(-step / np.log(phi)),
            travel=float(travel),
        )

    def _linearise(self) -> None:
        """Take the residuals and the slopes of the force at x."""
        linearisations = list(self.evaluate((j, row[None]) for j, row in enumerate(self.x)))
        self.left, self.slopes = [f[0] for f in linearisations], [-f[1:].T for f in linearisations]

    def weights(self) -> list[Array]:
        """Weight of each sample of each test, 1/kip."""
        root, noise_of_tests = np.sqrt(self.information), zip(self.functions, self.sd, strict=True)
        return [root * np.exp(-f @ self.log_shape) / s for f, s in noise_of_tests]

    def _objective(self, weights: Sequence[Array]) -> float:
        squares = np.sum(self.x[0, self.common] ** 2) + np.sum(self.x[:, self.free] ** 2)
        for residuals, discrepancy, w in zip(self.left, self.discrepancy, weights, strict=True):
            squares += np.sum(((residuals - discrepancy) * w) ** 2)
        return 0.5 * float(squares)

    def iterate(self, max_steps: int, *, learn: bool) -> None:
        """Damped Gauss-Newton steps, each followed by a step of EM if asked for."""
        damping, settled, last_objective = 0.0, 0, np.inf
        if learn:
            self.learn()
        for _ in range(max_steps):
            weights, saved = self.weights(), (self.x, self.left, self.slopes)
            objective = self._objective(weights)
            for _ in range(8):
                self.x = self.solved(weights, damping)
                if np.abs(self.x).max() <= FARTHEST:
                    self._linearise()
                    if self._objective(weights) <= objective:
                        damping = damping / 10.0 if damping > 1e-3 else 0.0
                        break
                self.x, self.left, self.slopes = saved
                damping = max(1e-3, 6.0 * damping)
            if learn:
                self.learn()
            settled = settled + 1 if abs(objective / last_objective - 1.0) < SETTLED else 0
            last_objective = objective
            if settled == 3:
                return

    def solved(self, weights: Sequence[Array], damping: float) -> Array:
        """Solution (J, D) of the normal equations."""
        residuals = [(r - d)[:, None] for r, d in zip(self.left, self.discrepancy, strict=True)]
        return self.x + self._step(weights, residuals, -self.x[..., None], damping)[..., 0]

    def _step(
        self, weights: Sequence[Array], targets: Sequence[Array], pull: Array, damping: float = 0.0
    ) -> Array:
        """Steps (J, D, m) to targets (T, m) of the forces, and to that of the prior (J, D, m).

        They solve the normal equations, in which what tests do not share is eliminated.
        """
        common, free_columns = self.common, self.free
        a, b, eliminated = np.eye(common.size), pull[0, common], []
        for j, w in enumerate(weights):
            slopes, target = self.slopes[j] * w[:, None], targets[j] * w[:, None]
            shared, free_slopes = slopes[:, common], slopes[:, free_columns]
            h = free_slopes.T @ free_slopes
            h += np.diag(1.0 + damping * np.diag(h))
            gradient = free_slopes.T @ target + pull[j, free_columns]
            of_shared = np.linalg.solve(h, free_slopes.T @ shared)
            of_target = np.linalg.solve(h, gradient)
            a += shared.T @ shared - (shared.T @ free_slopes) @ of_shared
            a += damping * np.diag(np.sum(shared**2, axis=0))
            b = b + shared.T @ target - (shared.T @ free_slopes) @ of_target
            eliminated.append((of_shared, of_target))
        step, steps = np.linalg.solve(a, b), np.zeros(pull.shape)
        steps[:, common] = step
        for j, (of_shared, of_target) in enumerate(eliminated):
            steps[j, free_columns] = of_target - of_shared @ step
        return steps

    def of_knots(self) -> tuple[Array, Array]:
        """Root of the covariance of δ at the knots, (K, K), and how x follows it, (J, D, K)."""
        weights, size = self.weights(), self.knots.size
        response = self._step(weights, [-f for f in self.scaled], np.zeros((*self.x.shape, size)))
        precision = self.inverse / self.amplitude**2
        for slopes, f, w, steps in zip(self.slopes, self.scaled, weights, response, strict=True):
            weighted = f * w[:, None] ** 2
            precision = precision + weighted.T @ (f + slopes @ steps)
        return np.linalg.cholesky(np.linalg.inv(0.5 * (precision + precision.T))), response

    def learn(self) -> None:
        """Discrepancy and its size, noise of each test, shape of the noise: a step of EM."""
        values = [test.values(x[None]) for test, x in zip(self.tests, self.x, strict=True)]
        model = self.tests[0].posterior.model
        slips = np.array([slip_force_of(model, v)[0] for v in values])
        driven = [trace.reference_actuation > 0 for trace in self.traces]
        self.median = float(np.exp(np.log(np.maximum(slips[driven], 1e-9)).mean()))
        self.scaled = [f * s for f, s in zip(self.functions, slips / self.median, strict=True)]
        precision, pull = self.inverse / self.amplitude**2, np.zeros(self.log_shape.size)
        for f, w, residuals in zip(self.scaled, self.weights(), self.left, strict=True):
            weighted = f * w[:, None]
            precision = precision + weighted.T @ weighted
            pull += weighted.T @ (w * residuals)
        covariance = np.linalg.inv(precision)
        self.knots = covariance @ pull
        size = self.knots @ self.inverse @ self.knots + np.sum(self.inverse * covariance)
        self.amplitude = max(float(np.sqrt(size / pull.size)), 1e-9)
        squares, count = np.full(pull.size, EVEN), np.full(pull.size, EVEN)
        for j, f in enumerate(self.functions):
            remainder = self.left[j] - self.scaled[j] @ self.knots
            scaled_remainder = remainder * np.exp(-f @ self.log_shape)
            self.sd[j] = max(float(np.sqrt(np.mean(scaled_remainder**2))), 1e-9)
            squares += f.T @ (remainder / self.sd[j]) ** 2
            count += f.sum(axis=0)
        self.log_shape = 0.5 * np.log(squares / count)

    def gaussian(self, j: int) -> tuple[Array, Array]:
        """Mean (D,) and precision (D, D) of the likelihood of test j."""
        w, k, coordinates = self.weights()[j], self.k_sd, self.tests[j].coordinates
        slopes = self.slopes[j] * w[:, None]
        slopes[:, k] = 0.0
        prior, spread = coordinates.priors["noise_sd"], coordinates.spread[k]
        q = prior.coordinate(self.sd[[j]])[0]
        self.x[j, k] = (q - coordinates.centre[k]) / spread
        precision = slopes.T @ slopes
        ahead, back = (prior.value(np.array([q + e])) for e in (STEP, -STEP))
        slope = spread * float((np.log(ahead / back) / (2.0 * STEP))[0])
        precision[k, k] = 2.0 * self.information * w.size * slope**2
        precision[np.diag_indices(len(precision))] += 1e-3
        pull = slopes.T @ ((self.left[j] - self.discrepancy[j]) * w)
        return self.x[j] + np.linalg.solve(precision, pull), precision


# --- inference ------------------------------------------------------------------------------------

# sd of an actuation, over its mean, below which slip forces are taken in proportion to it
STEADY = 0.02
