"""The population of a set of calibrated tests: their joint fit, and their joint posterior.

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
of the tests are taken (Laplace).

Laws are weighed by how well they predict levels that are left out, and the exact joint posterior of
population and tests is sampled under them. Under the Gaussian likelihoods of the tests the
population's h has known draws, and given h the coefficients z and the tests' own coordinates are
affine in standard normal numbers e. A sweep of the sampler has three moves:

1. the numbers of each test, each accepted by its own likelihood;
2. the numbers of z, with another h from its draws, accepted by all tests;
3. given all tests, which needs no force: each coordinate of h by random-walk Metropolis, then z
   from its Gaussian (Gibbs).

The first two change the numbers by the preconditioned Crank-Nicolson step e' = √(1 - β²) e + β ξ,
which leaves the approximation as it is, and are accepted by the exact over the approximate
likelihoods (Rudolf and Sprungk, 2018). The second is the non-centred and the third the centred
form of one hierarchy: where one mixes slowly the other does not (Yu and Meng, 2011).

While warming up the Gaussian likelihoods are fitted anew, by least squares, to the exact ones of
what was proposed, each weighted by the probability of its acceptance (waste recycling: Frenkel,
2004). With Gaussian likelihoods every move of the first two kinds is accepted.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from threadpoolctl import threadpool_limits

from mfd_bayes.calibration.diagnostics import (
    Convergence,
    Effort,
    find_effort,
    intervals_of,
    measure,
)
from mfd_bayes.calibration.posterior import Posterior, Prior, PriorFile
from mfd_bayes.calibration.result import TestResult
from mfd_bayes.friction.model import Model
from mfd_bayes.jobs.job import Progress
from mfd_bayes.jobs.local import Evaluate, in_turn, several_processes
from mfd_bayes.population.design import (
    COMPARE,
    CONDITIONS,
    LAW_NAMES,
    LEVELS,
    TESTS,
    Coordinates,
    Design,
    Setting,
    design_of,
    levels_of,
    ratio,
    setting_of,
    usual_shapes,
    varies,
)
from mfd_bayes.population.mixed_model import (
    LARGEST,
    DependenceScore,
    LawScore,
    MixedModel,
    TestGaussians,
    backward,
    compare_dependence,
    compare_laws,
    extrapolation_weights,
    forward,
    free_exponents,
)
from mfd_bayes.population.population import (
    KNOTS,
    LawDraws,
    Population,
    Residual,
    Starts,
    TravelBasis,
    place_left,
    slip_force_of,
    strokes_of,
    without_load,
)
from mfd_bayes.records.trace import Trace

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
    one = (1.0 + r) * np.exp(-r) + 1e-6 * np.eye(KNOTS)
    return block_diag(one, one)


def lag_one_of(standard: Sequence[Array]) -> float:
    """Correlation of neighbours that gives the share of independent samples of all tests."""
    phi = np.array([np.clip(r[1:] @ r[:-1] / (r @ r), 1e-3, 0.999) for r in standard])
    share = np.average((1.0 - phi) / (1.0 + phi), weights=[r.size for r in standard])
    return float((1.0 - share) / (1.0 + share))


def share_of_strokes(standard: Sequence[Array], strokes: Sequence[Index]) -> float:
    """Share h of a random intercept of each stroke: one-way analysis of variance by moments."""
    between, within = [1e-12], [1e-12]
    for values, stroke in zip(standard, strokes, strict=True):
        for i in np.unique(stroke):
            if np.count_nonzero(group := stroke == i) >= FEWEST:
                between.append(float(values[group].mean()) ** 2)
                within.append(float(values[group].var()))
    total = np.mean(between) + np.mean(within)
    return float(np.sqrt(np.clip(np.mean(between) / total, 0.0, 0.9)))


@dataclass(frozen=True, eq=False)
class TestLikelihood:
    """Likelihood of one test in prior units x (n, D); a process can be sent it."""

    posterior: Posterior  # of the test, with independent noise
    coordinates: Coordinates  # of the D quantities
    relative: Array | None = None  # (T,), actuation over its mean, where it changes
    # what follows it then: whose law, and its share and exponent where the test has none to itself
    laws: Mapping[str, tuple[str, float, float]] = field(default_factory=dict)
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
        values, found = self.coordinates.values(x), {}
        for name, (law, *given) in self.laws.items():
            share, exponent = (
                values.get(f"{shape}_{law}", np.array([value]))
                for shape, value in zip(("share", "exponent"), given, strict=True)
            )
            followed = ratio(self.relative, share[:, None], exponent[:, None])
            found[name] = np.broadcast_to(followed, (len(x), self.relative.size))
        return found

    def residuals(self, x: Array) -> Array:
        """Measured less computed force at x (n, D), (n, T), kip; δ is in it."""
        values = self.values(x)
        force = self.posterior.force(values, scales=self.scales(x) or None)
        measured = np.asarray(self.posterior.trace.force)
        left = measured - force - values["offset"][:, None]
        return left[:, self.posterior.first :]

    def linearised(self, x: Array) -> Array:
        """Residuals at x (1, D), and their slopes, (1 + D, T)."""
        step = STEP * np.eye(x.shape[1])
        left = self.residuals(np.concatenate([x, x + step, x - step]))
        up, down = np.split(left[1:], 2)
        return np.concatenate([left[:1], (up - down) / (2.0 * STEP)])

    def log_likelihood(self, x: Array) -> Array:
        """Magnitude-adjusted log likelihood at x (n, D), (n,); -inf where there is none."""
        x = np.clip(x, -BEYOND, BEYOND)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            left = (self.residuals(x) - self.discrepancy) / self.shape
            sd = self.coordinates.value("noise_sd", x)
            squares = np.einsum("nt,nt->n", left, left)
            found = -self.information * (0.5 * squares / sd**2 + left.shape[1] * np.log(sd))
        return np.where(np.isfinite(found), found, -np.inf)


@dataclass(frozen=True, eq=False)
class JointFit:
    """All tests near the mode of their joint posterior."""

    tests: tuple[TestLikelihood, ...]  # with discrepancy and noise
    mean: Array  # (J, D), of each test's likelihood, in prior units
    precision: Array  # (J, D, D)
    residual: Residual


def fit_jointly(
    tests: Sequence[TestLikelihood],
    start: Array,
    common: NDArray[np.bool_],
    evaluate: Evaluate[Array, Array] | None = None,
) -> JointFit:
    """Fit of all tests together."""
    fit = _Fit(tests, start, common, evaluate)
    fit.iterate(40, learn=True)
    residual = fit.residual()
    fit.information, fit.discrepancy = residual.information, [f @ fit.knots for f in fit.scaled]
    fit.iterate(20, learn=False)
    mean, precision = zip(*map(fit.gaussian, range(len(tests))), strict=True)
    parts = zip(tests, fit.discrepancy, fit.shapes(), strict=True)
    found = [replace(t, discrepancy=d, shape=g, information=fit.information) for t, d, g in parts]
    return JointFit(tuple(found), np.array(mean), np.array(precision), residual)


class _Fit:
    """State of the fit: coordinates x (J, D); residuals, slopes and noise of each test."""

    def __init__(
        self,
        tests: Sequence[TestLikelihood],
        start: Array,
        common: NDArray[np.bool_],
        evaluate: Evaluate[Array, Array] | None,
    ) -> None:
        self.tests, self.x = tests, start.copy()
        self.evaluate = evaluate or in_turn([test.linearised for test in tests])
        self.k_sd = tests[0].coordinates.names.index("noise_sd")
        free = ~common
        free[self.k_sd] = False
        self.common, self.free = np.flatnonzero(common), np.flatnonzero(free)
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
        each = zip(self.left, self.scaled, self.weights(), strict=True)
        standard = [(r - f @ self.knots) * w for r, f, w in each]
        phi = lag_one_of(standard)
        strokes = [strokes_of(t)[k:] for t, k in zip(self.traces, self.first, strict=True)]
        step = np.median([np.median(np.diff(trace.time)) for trace in self.traces])
        travel = np.median([np.mean(np.abs(np.diff(t.displacement))) for t in self.traces])
        return Residual(
            basis=self.basis,
            mean=self.knots,
            covariance=self.covariance / ((1.0 - phi) / (1.0 + phi)),
            log_shape=self.log_shape,
            slip_force=self.typical,
            stroke_share=share_of_strokes(standard, strokes),
            lag_one=phi,
            noise_time=float(-step / np.log(phi)),
            travel=float(travel),
        )

    def _linearise(self) -> None:
        """Take the residuals and the slopes of the force at x."""
        found = list(self.evaluate((j, row[None]) for j, row in enumerate(self.x)))
        self.left, self.slopes = [f[0] for f in found], [-f[1:].T for f in found]

    def weights(self) -> list[Array]:
        """Weight of each sample of each test, 1/kip."""
        root, each = np.sqrt(self.information), zip(self.functions, self.sd, strict=True)
        return [root * np.exp(-f @ self.log_shape) / s for f, s in each]

    def _objective(self, weights: Sequence[Array]) -> float:
        squares = np.sum(self.x[0, self.common] ** 2) + np.sum(self.x[:, self.free] ** 2)
        for left, discrepancy, w in zip(self.left, self.discrepancy, weights, strict=True):
            squares += np.sum(((left - discrepancy) * w) ** 2)
        return 0.5 * float(squares)

    def iterate(self, most: int, *, learn: bool) -> None:
        """Damped Gauss-Newton steps, each followed by a step of EM if asked for."""
        damping, settled, last = 0.0, 0, np.inf
        if learn:
            self.learn()
        for _ in range(most):
            weights, kept = self.weights(), (self.x, self.left, self.slopes)
            before = self._objective(weights)
            for _ in range(8):
                self.x = self.solved(weights, damping)
                if np.abs(self.x).max() <= FARTHEST:
                    self._linearise()
                    if self._objective(weights) <= before:
                        damping = damping / 10.0 if damping > 1e-3 else 0.0
                        break
                self.x, self.left, self.slopes = kept
                damping = max(1e-3, 6.0 * damping)
            if learn:
                self.learn()
            settled = settled + 1 if abs(before / last - 1.0) < SETTLED else 0
            last = before
            if settled == 3:
                return

    def solved(self, weights: Sequence[Array], damping: float) -> Array:
        """Solution (J, D) of the normal equations; the tests' own quantities are eliminated."""
        common, free = self.common, self.free
        a, b, eliminated = np.eye(common.size), -self.x[0, common], []
        for j, w in enumerate(weights):
            slopes, left = self.slopes[j] * w[:, None], (self.left[j] - self.discrepancy[j]) * w
            shared, own = slopes[:, common], slopes[:, free]
            h = own.T @ own
            h += np.diag(1.0 + damping * np.diag(h))
            gradient = own.T @ left - self.x[j, free]
            solved = np.linalg.solve(h, np.column_stack([own.T @ shared, gradient]))
            a += shared.T @ shared - (shared.T @ own) @ solved[:, :-1]
            a += damping * np.diag(np.sum(shared**2, axis=0))
            b = b + shared.T @ left - (shared.T @ own) @ solved[:, -1]
            eliminated.append(solved)
        step, new = np.linalg.solve(a, b), self.x.copy()
        new[:, common] += step
        for j, solved in enumerate(eliminated):
            new[j, free] += solved[:, -1] - solved[:, :-1] @ step
        return new

    def learn(self) -> None:
        """Discrepancy and its size, noise of each test, shape of the noise: a step of EM."""
        values = [test.values(x[None]) for test, x in zip(self.tests, self.x, strict=True)]
        model = self.tests[0].posterior.model
        slips = np.array([slip_force_of(model, v)[0] for v in values])
        driven = [trace.reference_actuation > 0 for trace in self.traces]
        self.typical = float(np.exp(np.log(np.maximum(slips[driven], 1e-9)).mean()))
        self.scaled = [f * s for f, s in zip(self.functions, slips / self.typical, strict=True)]
        precision, pull = self.inverse / self.amplitude**2, np.zeros(self.log_shape.size)
        for f, w, left in zip(self.scaled, self.weights(), self.left, strict=True):
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

    def gaussian(self, j: int) -> tuple[Array, Array]:
        """Mean (D,) and precision (D, D) of the likelihood of test j."""
        w, k, coordinates = self.weights()[j], self.k_sd, self.tests[j].coordinates
        slopes = self.slopes[j] * w[:, None]
        slopes[:, k] = 0.0
        prior, spread = coordinates.priors["noise_sd"], coordinates.spread[k]
        q = prior.coordinate(self.sd[[j]])[0]
        self.x[j, k] = (q - coordinates.centre[k]) / spread
        precision = slopes.T @ slopes
        up, down = (prior.value(np.array([q + e])) for e in (STEP, -STEP))
        slope = spread * float((np.log(up / down) / (2.0 * STEP))[0])
        precision[k, k] = 2.0 * self.information * w.size * slope**2
        precision[np.diag_indices(len(precision))] += 1e-3
        pull = slopes.T @ ((self.left[j] - self.discrepancy[j]) * w)
        return self.x[j] + np.linalg.solve(precision, pull), precision


# --- inference ------------------------------------------------------------------------------------

# sd of an actuation, over its mean, below which slip forces are taken in proportion to it
STEADY = 0.02
ALTERNATIVES = 400  # draws under all laws together, for actuations beyond the tested levels
POOL = 4000  # draws of the variance parameters
# largest number of sweeps of the exact sampler
SWEEPS = {"quick": 400, "standard": 2000, "thorough": 10000}
# with more tests than this there are fewer chains: laws and variances are then known well
MANY = 60
WALKERS, FEW_WALKERS = 16, 4  # chains of each group, and with many tests
_PRIMES = (2, 3, 5, 7, 11, 13, 17, 19)
CHAINS = 4  # groups of independent chains; R̂ is taken across groups
STORED = 2**26  # most numbers of the tests' coordinates that are held
# how often the Gaussians are fitted anew, sweeps before each and after the last, of which the first
# quarter is forgotten, and sweeps between looks at the convergence
REFITS, WARM_UP, BLOCK = 3, 20, 40
RIDGE = 3.0  # of the least squares, for the few draws of a large campaign
LEAST = 1e-3  # least precision of a test over that of its posterior, in any direction
ACCEPT = 0.3  # share of moves of the tests that is to be accepted
ACCEPT_Z = 0.2  # the same of z
RANDOM_WALK = 0.6  # sd of the random walk of the coordinates of h


@dataclass(frozen=True)
class InferenceSettings:
    """How a population is inferred."""

    laws: Mapping[str, str]  # of each quantity that follows the actuation, or "compare"
    actuation_unit: str
    effort: str | Effort
    seed: Sequence[int]
    dependence: Mapping[str, Sequence[str]] = field(default_factory=dict)  # covariates
    sessions: Mapping[str, str] = field(default_factory=dict)  # of each test; none if missing
    jobs: int = 1  # processes that compute the tests' likelihoods; the draws are the same
    devices: Mapping[str, str] = field(default_factory=dict)  # likewise
    # date, count of cycles and temperature of each test, where they are known
    conditions: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def setting(self, name: str, trace: Trace) -> Setting:
        """Setting of a test."""
        session, device = self.sessions.get(name, ""), self.devices.get(name, "")
        return setting_of(trace, session, device, self.conditions.get(name, {}))


@dataclass(frozen=True, eq=False)
class Inference:
    """What is inferred from a set of tests."""

    population: Population
    tests: Array  # (chain, draw, J, D): coordinates of the tests
    scores: tuple[LawScore, ...]  # of every law, for each quantity that follows the actuation
    # quantiles of each proportional law's exponent, estimated as in a power law
    exponents: Mapping[str, tuple[float, float, float]]
    dependence: tuple[DependenceScore, ...]
    sweeps: int
    accepted: tuple[float, float]  # shares of accepted moves of tests and of the population

    def values(self, j: int) -> dict[str, Array]:
        """Quantities of test j with the others, by name, (chain, draw)."""
        x = self.tests[:, :, j]
        found = self.population.design.coordinates.values(x.reshape(-1, x.shape[-1]))
        return {name: value.reshape(x.shape[:2]) for name, value in found.items()}


def infer_population(
    tests: Mapping[str, TestResult],
    priors: PriorFile,
    settings: InferenceSettings,
    report: Callable[[Progress], None] = lambda _: None,
) -> Inference:
    """Population of calibrated tests; `report` gets the progress of the sampling."""
    # BLAS adds up in another order with several threads, which small matrices do not need
    with threadpool_limits(1, user_api="blas"):
        return _inferred(tests, priors, settings, report)


def _inferred(
    tests: Mapping[str, TestResult],
    priors: PriorFile,
    settings: InferenceSettings,
    report: Callable[[Progress], None],
) -> Inference:
    rng, effort = np.random.default_rng(list(settings.seed)), find_effort(settings.effort)
    design, likelihoods = _likelihoods(tests, priors, settings)
    coordinates, d = design.coordinates, len(design.names)

    # Gaussians of the tests near the joint mode; what a test has to itself is integrated out
    medians = [test.intervals or intervals_of(test.stored.values()) for test in tests.values()]
    start = [coordinates.of({k: np.array([v[0]]) for k, v in each.items()}) for each in medians]
    unpooled = np.ones((len(likelihoods), len(coordinates.names)), dtype=bool)
    unpooled[:, :d] = ~design.informs
    common = np.zeros(len(coordinates.names), dtype=bool)
    common[:d] = design.common
    with several_processes([one.linearised for one in likelihoods], settings.jobs) as evaluate:
        begin = np.clip(np.concatenate(start), -6.0, 6.0)
        fit = fit_jointly(likelihoods, begin, common, evaluate)
    mixed = MixedModel(design, *gaussians_of(fit, unpooled, d))

    # weights of the laws, by levels that are left out
    levels = np.median(fit.mean, axis=0)[:d]
    gaussians = TestGaussians.given_common(design, mixed.y, mixed.p, levels)
    scores = compare_laws(gaussians)
    weights = {name: _weights(design, name, scores) for name in design.laws}

    # chains of the exact posterior, each under laws drawn by their weights
    walkers = WALKERS if len(likelihoods) <= MANY else FEW_WALKERS
    choice = _choices(design, weights, CHAINS * walkers)
    mixed.find_outliers(choice[0])
    kinds, kind = np.unique(choice, axis=0, return_inverse=True)

    def approximate(fit: JointFit) -> tuple[MixedModel, list[Array]]:
        under = MixedModel(design, *gaussians_of(fit, unpooled, d), mixed.weight)
        under.adapted = mixed.adapted  # the next fit is near the last one
        pools = [under.sample(one, rng, POOL) for one in kinds]
        return under, [pools[k] for k in kind.ravel()]

    began, limit = time.perf_counter(), SWEEPS.get(effort.name, 2000)

    def tell(sweeps: int, found: Convergence) -> None:
        seconds = time.perf_counter() - began
        share = found.share(effort.r_hat, effort.ess)
        worst = found.worst_r_hat, found.worst_ess
        report(Progress(sweeps, max(limit, sweeps), *worst, seconds, share))

    with several_processes([one.log_likelihood for one in fit.tests], settings.jobs) as evaluate:
        sampler = ExactSampler(fit, approximate, unpooled, choice, rng, evaluate)
        draws = sampler.run(effort.r_hat, effort.ess, limit, effort.kept // 4, tell)

    # the population
    shape, v = draws.h.shape[:2], mixed.f + mixed.e
    chosen = np.repeat(choice.reshape(CHAINS, walkers, -1), shape[1] // walkers, axis=1)
    drawn = mixed.shapes(
        draws.h.reshape(-1, mixed.dim), chosen.reshape(draws.h[..., 0].size, len(design.laws))
    )
    share, exponent = (part.reshape(chosen.shape) for part in drawn)
    posterior = likelihoods[0].posterior
    slips = [n for n in design.laws if n not in {"sigma0"} & posterior.model.standard_names]
    alternatives, alternative_weight = _alternatives(mixed, slips, weights, gaussians, rng)
    prior_of = dict(posterior.priors)
    if posterior.model.has_gap and "start" in priors.parameters:
        prior_of.setdefault("start", priors.parameters["start"])
    population = Population(
        design=design,
        draws=LawDraws(draws.h[..., :v], draws.z, share, exponent),
        choice=chosen,
        law_weights=weights,
        alternatives=alternatives,
        alternative_weight=alternative_weight,
        residual=fit.residual,
        starts=_starts(prior_of.get("start"), likelihoods, draws.x),
        priors=prior_of,
        actuation_unit=settings.actuation_unit,
        walkers=walkers,
        convergence=draws.convergence,
    )
    exponents, dependence = free_exponents(gaussians), compare_dependence(gaussians)
    return Inference(
        population, draws.x, scores, exponents, dependence, draws.sweeps, draws.accepted
    )


def _likelihoods(
    tests: Mapping[str, TestResult], priors: PriorFile, settings: InferenceSettings
) -> tuple[Design, list[TestLikelihood]]:
    """Design of the population, and likelihoods of the tests without discrepancy."""
    some = next(iter(tests.values())).posterior
    model = some.model
    under = [settings.setting(name, test.trace) for name, test in tests.items()]
    noise = set(some.noise.parameters) - {"noise_sd"}
    names = [name for name in some.names if name not in noise]
    slips = [name for name in model.slip_forces if name in names]
    # slip forces follow the stroke, if it varies: no friction model here knows of it
    stroke = len(under) >= TESTS and varies(under, "amplitude")
    dependence: dict[str, Sequence[str]] = dict.fromkeys(slips, ("amplitude",)) if stroke else {}
    for name, those in settings.dependence.items():
        usual = () if {*those} - {*CONDITIONS} else dependence.get(name, ())
        dependence[name] = (*usual, *those)
    design = design_of(priors, names, under, settings.laws, dependence, model)
    changing = [swings(design, model, test.trace) for test in tests.values()]
    if any(changing):
        # a test need not follow the law that others tell: it has shapes to itself
        shapes = [f"{s}_{n}" for n in slips for s in ("share", "exponent")]
        every = [*names, *shapes]
        design = design_of(priors, every, under, settings.laws, dependence, model)
    followed = {n: n for n in design.laws if n in model.parameters}
    followed |= {n: o for n, o in model.tied_laws.items() if o in followed}
    laws = {n: (o, *usual_shapes(design.laws[o])) for n, o in followed.items()}
    found = []
    for test, changes in zip(tests.values(), changing, strict=True):
        start, trace = "mask" if test.posterior.first else "sample", test.trace
        posterior = Posterior(trace, priors, "iid", model, start=start)
        relative = np.asarray(trace.actuation) / trace.reference_actuation if changes else None
        found.append(TestLikelihood(posterior, design.coordinates, relative, laws))
    return design, found


def swings(design: Design, model: Model, trace: Trace) -> bool:
    """Whether a test's actuation changes, and its law is not strictly proportional."""
    mean = trace.reference_actuation
    if not trace.varying or not mean > 0 or np.std(trace.actuation) < STEADY * mean:
        return False
    laws = [design.laws.get(name, "proportional") for name in model.slip_forces]
    return any(law != "proportional" for law in laws)


def gaussians_of(fit: JointFit, unpooled: NDArray[np.bool_], d: int) -> tuple[Array, Array]:
    """Gaussian likelihoods of the d shared coordinates, (J, d) and (J, d, d).

    What is unpooled is integrated over N(0, 1), and has no precision.
    """
    y, precision = np.zeros((len(unpooled), d)), np.zeros((len(unpooled), d, d))
    for j, (mean, p, out) in enumerate(zip(fit.mean, fit.precision, unpooled, strict=True)):
        kept, rest = np.flatnonzero(~out), np.flatnonzero(out)
        across, pull = p[np.ix_(rest, kept)], p @ mean
        gain = np.linalg.solve(p[np.ix_(rest, rest)] + np.eye(rest.size), across).T
        reduced = p[np.ix_(kept, kept)] - gain @ across
        y[j, kept] = np.linalg.solve(reduced, pull[kept] - gain @ pull[rest])
        precision[j][np.ix_(kept, kept)] = 0.5 * (reduced + reduced.T)
    return y, precision


def _weights(design: Design, name: str, scores: Sequence[LawScore]) -> dict[str, float]:
    """Weights of the laws of a quantity; compared ones have those of their scores."""
    laws = design.considered(design.laws[name])
    if len(laws) == 1:
        return {laws[0]: 1.0}
    found = {s.law: float(s.weight) for s in scores if s.quantity == name}
    return found if any(found.values()) else dict.fromkeys(laws, 1.0 / len(laws))


def _choices(design: Design, weights: Mapping[str, Mapping[str, float]], n: int) -> Index:
    """Numbers of the laws of n chains in proportion to the weights, (n, L); no random numbers."""
    choice = np.zeros((n, len(design.laws)), dtype=np.intp)
    for column, name in enumerate(design.laws):
        edges = np.cumsum([weights[name].get(one, 0.0) for one in LAW_NAMES])
        # a low-discrepancy sequence for each quantity, so that their laws are independent
        place = (0.5 + np.arange(n) * np.sqrt(_PRIMES[column % len(_PRIMES)])) % 1.0
        choice[:, column] = np.searchsorted(edges / edges[-1], place, side="right")
    return choice


def _alternatives(
    mixed: MixedModel,
    slips: Sequence[str],
    weights: Mapping[str, Mapping[str, float]],
    gaussians: TestGaussians,
    rng: np.random.Generator,
) -> tuple[LawDraws, Array]:
    """Draws under all laws, for actuations beyond the tested levels, and their weights."""
    design = mixed.design
    many = len(levels_of([s for s in design.settings if s.actuation > 0])) >= LEVELS
    considered = design.considered(COMPARE) if many else ("affine", "power")
    named = [design.laws[n] for n in slips if design.laws[n] != COMPARE]
    laws = {
        law: replace(design, laws={**design.laws, **dict.fromkeys(slips, law)})
        for law in dict.fromkeys([*named, *considered])
    }
    # a test without actuation informs some laws alone, so that these have other effects of levels
    sizes = {law: under.quantity.size for law, under in laws.items()}
    size = design.quantity.size if design.quantity.size in sizes.values() else max(sizes.values())
    usable = [law for law in laws if sizes[law] == size]
    found, weight = [], []
    for law, w in zip(usable, extrapolation_weights(gaussians, slips, usable), strict=True):
        if w == 0.0:
            continue
        under = laws[law]
        other = MixedModel(under, mixed.y, mixed.p, mixed.weight)
        choice = _choices(under, {**weights, **{n: {law: 1.0} for n in slips}}, 1)[0]
        n = max(int(np.ceil(ALTERNATIVES * w)), 20)
        mode, root = other.laplace(choice)
        h = other.of_numbers(mode + rng.standard_normal((n, other.dim)) @ root.T)
        few = np.array_split(h, max(n // 32, 1))  # to bound the memory
        z = np.concatenate([other.marginal(part, choice)[1].draw(rng) for part in few])
        found.append((h[:, : other.f + other.e], z, *other.shapes(h, choice)))
        weight.append(np.full(n, w / n))
    return LawDraws(*map(np.concatenate, zip(*found, strict=True))), np.concatenate(weight)


def _starts(prior: Prior | None, likelihoods: Sequence[TestLikelihood], x: Array) -> Starts:
    """Density of starts, learned from where the tests began, of draws (chain, draw, J, D)."""
    left, free = [], []
    if prior is None or prior.fixed or "start" not in likelihoods[0].coordinates.names:
        return Starts.of(prior)
    even = (prior.family, prior.lower, prior.upper) == ("uniform", 0.0, 1.0)
    for j, one in enumerate(likelihoods):
        model, own = one.posterior.model, x[:, :, j].reshape(-1, x.shape[-1])
        values = one.values(own)
        scales = one.scales(np.median(own, axis=0)[None])
        left.append(place_left(model, values, one.posterior.trace, scales or None))
        free.append(without_load(model, values) if even else None)
    there = [place for place in left if place is not None]
    places = np.array(there) if len(there) == len(left) else None
    begun = likelihoods[0].coordinates.value("start", x)
    return Starts.learned(begun.reshape(-1, len(likelihoods)), places, free)


# --- exact posterior ------------------------------------------------------------------------------


class State(NamedTuple):
    """All chains, n of them."""

    h: Array  # (n, dim)
    z: Array  # (n, Z)
    x: Array  # (n, J, D): the tests' coordinates
    excess: Array  # (n, J): exact less approximate log density of each test


class Draws(NamedTuple):
    """Kept draws, ordered by walker, and their convergence."""

    h: Array  # (chain, draw, dim)
    z: Array  # (chain, draw, Z)
    x: Array  # (chain, draw, J, D)
    convergence: Convergence  # of h and of the levels in z
    sweeps: int
    accepted: tuple[float, float]  # shares of accepted moves of tests and of the population


class ExactSampler:
    """Chains of the exact posterior."""

    def __init__(
        self,
        fit: JointFit,
        approximate: Callable[[JointFit], tuple[MixedModel, Sequence[Array]]],
        unpooled: NDArray[np.bool_],
        choice: Index,
        rng: np.random.Generator,
        evaluate: Evaluate[Array, Array] | None = None,
    ) -> None:
        self.fit, self.approximate, self.unpooled, self.rng = fit, approximate, unpooled, rng
        self.mixed, self.pool = mixed, _ = approximate(fit)
        self.choice, self.d = choice, len(mixed.design.names)
        self.evaluate = evaluate or in_turn([test.log_likelihood for test in fit.tests])
        local = np.any(unpooled, axis=0)
        local[mixed.free] = True
        self.local = np.flatnonzero(local)
        self.beta, self.beta_z = np.full(len(fit.mean), 0.8), 0.8  # step sizes
        # while warming up: proposals x, their excess, and the share of it that each test accepts
        self.proposals: list[tuple[Array, Array, Array]] = []
        self.warming_up = True
        self.rates: list[tuple[Array, float]] = []  # accepted shares: of each test, and of z
        h = self._fresh_h()
        e = rng.standard_normal((len(h), len(fit.mean), self.local.size))
        self.state = self._at(h, mixed.marginal(h, choice)[1].draw(rng), e)

    def _fresh_h(self) -> Array:
        """Draws of h of every chain under the approximation."""
        return np.stack([pool[self.rng.integers(len(pool))] for pool in self.pool])

    def _linear(self, z: Array) -> Array:
        """Levels, slopes and effects of the tests, (n, J, d)."""
        return self.mixed.design.linear(z, self.mixed.rows)

    def _sd(self, h: Array) -> Array:
        """Scatter of the free quantities of the tests, (n, J, F)."""
        return self.mixed.tau(h)[:, None] / np.sqrt(self.mixed.weight)

    def _conditional(self, h: Array, z: Array) -> tuple[Array, Array]:
        """Mean (n, J, D) of the tests given the population, and factor of the local precision.

        Of the coordinates that are not local the mean is what the population says.
        """
        local, mean = self.local, np.zeros((len(h), *self.unpooled.shape))
        mean[..., : self.d] = self.mixed.offsets(h, self.choice) + self._linear(z)
        mean = np.where(self.unpooled, 0.0, mean)
        sd = np.ones((len(h), len(self.unpooled), local.size))
        sd[..., np.searchsorted(local, self.mixed.free)] = self._sd(h)
        sd = np.where(self.unpooled[:, local], 1.0, sd)
        p = self.fit.precision[:, local]
        inner = p[:, :, local] + sd[..., None] ** -2.0 * np.eye(local.size)
        pull = np.einsum("jla,nja->njl", p, self.fit.mean - mean)
        mean[..., local] += forward(inner, pull)
        return mean, np.asarray(np.linalg.cholesky(inner))

    def _at(self, h: Array, z: Array, e: Array) -> State:
        """State with standard normal numbers e (n, J, L) of the tests."""
        x, factor = self._conditional(h, z)
        x[..., self.local] += backward(factor, e)
        return State(h, z, x, self._excess(x))

    def _excess(self, x: Array) -> Array:
        """Exact less approximate log density of each test, (n, J)."""
        away = x - self.fit.mean
        pairs = "nja,jab,njb->nj"
        gaussian = -0.5 * np.einsum(pairs, away, self.fit.precision, away, optimize=True)
        exact = self.evaluate((j, np.ascontiguousarray(x[:, j])) for j in range(x.shape[1]))
        excess = np.stack(list(exact), axis=1) - gaussian
        for j, unpooled in enumerate(self.unpooled):
            if np.any(unpooled):
                excess[:, j] += self.fit.tests[j].coordinates.log_prior(x[:, j], unpooled)
                excess[:, j] += 0.5 * np.sum(x[:, j][:, unpooled] ** 2, axis=1)
        return np.where(np.isnan(excess), -np.inf, excess)

    def sweep(self) -> None:
        """One move of each kind; while warming up the step sizes are tuned."""
        s, rng, marginal = self.state, self.rng, self.mixed.marginal
        mean, factor = self._conditional(s.h, s.z)
        e = np.einsum("njab,nja->njb", factor, (s.x - mean)[..., self.local])
        # each test
        moved = self._autoregressive(e, self.beta[:, None])
        new = self._at(s.h, s.z, moved)
        self._keep(s, new)
        tests = np.log(rng.random(s.excess.shape)) < new.excess - s.excess
        own, e = tests[..., None], np.where(tests[..., None], moved, e)
        excess = np.where(tests, new.excess, s.excess)
        s = s._replace(x=np.where(own, new.x, s.x), excess=excess)
        # z, with h from its draws
        gaussian = marginal(s.h, self.choice)[1]
        e_z = np.einsum("nji,nj->ni", gaussian.factor, s.z - gaussian.mean)
        e_z, h = self._autoregressive(e_z, self.beta_z), self._fresh_h()
        gaussian = marginal(h, self.choice)[1]
        new = self._at(h, gaussian.mean + backward(gaussian.factor, e_z), e)
        self._keep(s, new)
        better = new.excess.sum(axis=1) - s.excess.sum(axis=1)
        accepted = np.log(rng.random(len(better))) < better
        self.state = State(
            *(
                np.where(accepted.reshape(-1, *[1] * (a.ndim - 1)), b, a)
                for a, b in zip(s, new, strict=True)
            )
        )
        self._move_h()
        each, together = tests.mean(axis=0), float(accepted.mean())
        self.rates.append((each, together))
        if self.warming_up:
            self.beta = np.clip(self.beta * np.exp(0.1 * (each - ACCEPT)), 0.05, 1.0)
            step = self.beta_z * np.exp(0.1 * (together - ACCEPT_Z))
            self.beta_z = float(np.clip(step, 0.02, 1.0))

    def _autoregressive(self, e: Array, beta: Array | float) -> Array:
        """Standard normal numbers near others."""
        return np.sqrt(1.0 - beta**2) * e + beta * self.rng.standard_normal(e.shape)

    def _keep(self, state: State, new: State) -> None:
        """Keep a proposal for the next fit."""
        if self.warming_up:
            possible = np.isfinite(new.excess)
            excess = np.where(possible, new.excess, 0.0)
            share = np.exp(np.minimum(excess - state.excess, 0.0)) * possible
            self.proposals.append((new.x, excess, share))

    def refit(self, x: Array, excess: Array, weight: Array) -> None:
        """Take other Gaussian likelihoods of the tests, and go on from where the chains are.

        Least squares on draws x (m, J, D) of the posterior: what the exact log densities have over
        the Gaussian ones, `excess` (m, J), is a quadratic form (response surface).
        """
        old, size = self.fit, x.shape[-1]
        mean, precision = old.mean.copy(), old.precision.copy()
        i, k = np.triu_indices(size)
        for j, p in enumerate(old.precision):
            w = weight[:, j]
            centre = np.average(x[:, j], axis=0, weights=w)
            spread = np.cov(x[:, j].T, aweights=w)
            root = np.asarray(np.linalg.cholesky(spread + 1e-9 * np.eye(size)), dtype=np.float64)
            u = forward(root, x[:, j] - centre)
            terms = np.column_stack([u, u[:, i] * u[:, k] - (i == k)])
            weighted = (terms * w[:, None]).T
            pairs = weighted @ terms + RIDGE * np.eye(terms.shape[1])
            pulled = weighted @ (excess[:, j] - np.average(excess[:, j], weights=w))
            linear, square = np.split(np.linalg.solve(pairs, pulled), [size])
            quadratic = np.zeros((size, size))
            quadratic[i, k] = square
            inner = root.T @ p @ root - quadratic - quadratic.T
            values, vectors = np.linalg.eigh(inner)
            values = np.maximum(values, LEAST)
            pull = root.T @ p @ (old.mean[j] - centre) + linear
            mean[j] = centre + root @ (vectors / values) @ vectors.T @ pull
            outer = np.linalg.solve(root.T, vectors)
            precision[j] = (outer * values) @ outer.T
        self.fit = replace(old, mean=mean, precision=precision)
        self.mixed, self.pool = self.approximate(self.fit)
        self.state = self.state._replace(excess=self._excess(self.state.x))

    def _move_h(self) -> None:
        """Random-walk Metropolis of each coordinate of h with z and x as they are."""
        mixed, s, rng, v = self.mixed, self.state, self.rng, self.mixed.f + self.mixed.e
        h, names = s.h.copy(), mixed.design.names
        without_law = s.x[..., : self.d] - self._linear(s.z)
        shapes = [names.index(name) in mixed.free for name, _ in mixed.design.shapes]
        log = self._log_given_tests(h, s.z, without_law)
        for i in np.flatnonzero([*[True] * v, *shapes]).tolist():
            new = h.copy()
            new[:, i] += RANDOM_WALK * rng.standard_normal(len(h)) * (1.0 if i < v else 0.3)
            other = self._log_given_tests(new, s.z, without_law)
            accepted = np.log(rng.random(len(h))) < other - log
            h[accepted], log[accepted] = new[accepted], other[accepted]
        left = s.x[..., : self.d] - mixed.offsets(h, self.choice)
        pooled = mixed.weight * ~self.unpooled[:, mixed.free]
        z = mixed.draw_given_tests(h, left, pooled, s.z, rng)
        self.state = s._replace(h=h, z=z)

    def _log_given_tests(self, h: Array, z: Array, without_law: Array) -> Array:
        """Log density of h given z and the tests' coordinates, (n,)."""
        mixed, free, sd = self.mixed, self.mixed.free, self._sd(h)
        away = (without_law - mixed.offsets(h, self.choice))[..., free]
        terms = np.where(self.unpooled[:, free], 0.0, -0.5 * (away / sd) ** 2 - np.log(sd))
        total = mixed.log_prior(h) + terms.sum(axis=(1, 2))
        total += np.where(np.all(np.abs(h) < LARGEST, axis=1), 0.0, -np.inf)
        omega = mixed.omega(h)
        for e, precision in enumerate(mixed.effect_precision):
            u = z[:, mixed.design.columns(e)]
            squares = np.einsum("nmc,cd,nmd->n", u, precision, u, optimize=True)
            total += -u[0].size * np.log(omega[:, e]) - 0.5 * squares / omega[:, e] ** 2
        return np.asarray(total)

    def run(
        self,
        r_hat: float,
        ess: float,
        limit: int,
        kept: int,
        report: Callable[[int, Convergence], None],
    ) -> Draws:
        """Sweep until targets or limit are reached; `kept` draws of each group are kept."""
        for step in range(1, (REFITS + 1) * WARM_UP + 1):
            self.sweep()
            if step % WARM_UP == 0 and step <= REFITS * WARM_UP:
                proposals = self.proposals[len(self.proposals) // 4 :]
                self.refit(*(np.concatenate(part) for part in zip(*proposals, strict=True)))
            if step % WARM_UP == 0:
                self.proposals = []
        self.warming_up = False
        self.rates.clear()
        stride = max(1, self.state.x.size * limit // STORED)
        h, z, x = [], [], []  # x in single precision
        while True:
            for _ in range(BLOCK):
                self.sweep()
                h.append(self.state.h)
                z.append(self.state.z)
                if (len(h) - 1) % stride == 0:
                    x.append(np.asarray(self.state.x, dtype=np.float32))
            # of the coordinates of h and of the levels, across groups of chains
            every = np.concatenate([np.array(h), np.array(z)[..., : self.d]], axis=2)
            grouped = every.reshape(len(h), CHAINS, every.shape[1] // CHAINS, -1)
            found = measure(np.swapaxes(grouped, 0, 1))
            report(len(h), found)
            if found.reached(r_hat, ess) or len(h) >= limit:
                break
        most = max(1, min(len(x), kept // (len(self.choice) // CHAINS)))
        steps = np.linspace(0, len(x) - 1, most).astype(int)

        def by_chain(history: Sequence[NDArray[Any]]) -> Array:
            some = np.stack([history[t] for t in steps], axis=1).astype(np.float64)
            return some.reshape(CHAINS, -1, *some.shape[2:])

        tests, together = (float(np.mean(r)) for r in zip(*self.rates, strict=True))
        kept_draws = by_chain(h[::stride]), by_chain(z[::stride]), by_chain(x)
        return Draws(*kept_draws, found, len(h), (tests, together))
