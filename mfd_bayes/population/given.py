"""Predictions of a test of which a first part is known: the band of the rest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import psis
from mfd_bayes.errors import FitError
from mfd_bayes.population.band import Band
from mfd_bayes.population.conditioned import Conditioned
from mfd_bayes.population.drawn import Drawn
from mfd_bayes.population.forecast import Forecast
from mfd_bayes.population.given_likelihood import GivenLikelihood, Sums
from mfd_bayes.population.given_part import GivenPart, given_part
from mfd_bayes.population.pace import Counted, Counting, Pace
from mfd_bayes.population.predict import Predictor
from mfd_bayes.population.prior_of_test import TestPrior
from mfd_bayes.population.residual import Residual, slip_force_of
from mfd_bayes.population.sequel import standing_of
from mfd_bayes.population.setting import Setting, setting_of
from mfd_bayes.population.strokes import strokes_of
from mfd_bayes.population.tempering import systematic, temper
from mfd_bayes.population.unshared import stays
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]
Index = NDArray[np.intp]

TRIED = 4000
"""Draws of the population that are weighted."""

LARGEST_K = 0.7
"""Pareto k above which weights cannot be trusted (Vehtari et al., 2024)."""

FEWEST = 0.25
"""Effective draws of the weights, over those of the band, below which the posterior is sampled."""

POINTS = 1000
"""Points of the sampler."""

AT_ONCE = 1 << 22
"""Draws times samples whose forces are computed at once."""

ALLOWED = ("new_test", "observation")
"""Kinds of bands of which a given part says something."""


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of n tests after the given part.

    Attributes
    ----------
    labels, points : (n,), (n, D)
        As in `TestPrior`.
    log_likelihood : (n,)
    sums : Sums
    slip, sd : (n,), kip
        Slip force and noise sd of each.
    """

    labels: Index
    points: Array
    log_likelihood: Array
    sums: Sums
    slip: Array
    sd: Array

    def of(self, chosen: Index) -> Known:
        """That of some of the tests."""
        return Known(
            self.labels[chosen],
            self.points[chosen],
            self.log_likelihood[chosen],
            self.sums.of_tests(chosen),
            self.slip[chosen],
            self.sd[chosen],
        )


@dataclass(frozen=True, eq=False)
class GivenProblem:
    """A test that follows a population, and the part of its record that is given.

    Attributes
    ----------
    predictor : Predictor
    prior : TestPrior
    part : GivenPart
    counting : Counting
    """

    predictor: Predictor
    prior: TestPrior
    part: GivenPart
    counting: Counting

    @property
    def residual(self) -> Residual:
        """Discrepancy and noise of the population."""
        return self.counting.residual

    @cached_property
    def likelihood(self) -> GivenLikelihood:
        """Likelihood of sums."""
        return GivenLikelihood(self.residual)

    @cached_property
    def counted(self) -> Counted:
        """Functions of the discrepancy and shape of the noise where samples count."""
        counted = self.counting.counted(self.part.trace, self.part.counted)
        return self.counting.first(replace(counted, strokes=self.part.strokes[self.part.counted]))

    def known(self, prior: TestPrior, labels: Index, points: Array) -> Known:
        """What the given part says of points, some at a time to bound the memory."""
        pieces = -(-len(labels) * self.part.trace.samples // AT_ONCE)
        parts = [
            self._known(prior, labels[at], points[at])
            for at in np.array_split(np.arange(len(labels)), max(pieces, 1))
        ]
        sums = parts[0].sums.beside([part.sums for part in parts[1:]])
        columns = ("log_likelihood", "slip", "sd")
        found = {name: np.concatenate([getattr(p, name) for p in parts]) for name in columns}
        return Known(labels, points, sums=sums, **found)

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def _known(self, prior: TestPrior, labels: Index, points: Array) -> Known:
        values = values_of(self.predictor, prior, labels, points)
        model, trace = self.predictor.model, self.part.trace
        deviation = prior.deviation(points)
        scales = self.predictor.scales(trace, prior.index[labels], deviation) or None
        force = model.force_unbounded(model.theta(values), trace, values["start"], scales=scales)
        slip, sd = slip_force_of(model, values), values["noise_sd"]
        mean = self.counted.functions @ self.residual.mean
        left = np.asarray(trace.force)[self.part.counted] - force[:, self.part.counted]
        left = left - values["offset"][:, None] - np.outer(slip / self.residual.slip_force, mean)
        lost = ~np.all(np.isfinite(left), axis=1)
        left[lost] = 0.0
        sums = Sums.of(left, self.counted)
        density = self.likelihood(sums, slip, sd)
        density[lost | ~np.isfinite(density)] = -1e300
        return Known(labels, points, density, sums, slip, sd)


def counting_of(predictor: Predictor, prior: TestPrior, pace: Pace, setting: Setting) -> Counting:
    """How samples of a test under a setting are counted.

    Raises
    ------
    FitError
        When the run is older than the noise that all tests have in common.
    """
    found = predictor.population.residual
    if found is None:
        raise FitError(
            "the run is of an earlier version, which did not keep the noise that a given part "
            "needs: calibrate the campaign again"
        )
    values = values_of(predictor, prior, np.arange(prior.size), prior.middle)
    slip = np.median(slip_force_of(predictor.model, values))
    return Counting(found, pace, pace.step(setting.covariates["velocity"]), float(slip))


def values_of(
    predictor: Predictor, prior: TestPrior, labels: Index, points: Array
) -> dict[str, Array]:
    """Quantities of points (n, D) of a prior, by name, (n,) each."""
    population, n = predictor.population, len(points)
    others = [name for name in population.priors if name not in population.layout.names]
    values = {name: np.full(n, population.priors[name].typical) for name in others}
    values |= {"gamma1": np.ones(n), "start": prior.starts(points)}
    return values | population.values(prior.parts(labels, points))


def predict_given(
    predictor: Predictor,
    trace: Trace,
    forecast: Forecast,
    window: tuple[float, float],
    pace: Pace,
) -> Band:
    """Band of a record of which a part is known; all of it, with the given part.

    Parameters
    ----------
    predictor : Predictor
    trace : Trace
        With its actuation, and with the force in the window.
    forecast : Forecast
        Of the kind `new_test` or `observation`.
    window : (float, float), s
        What is given.
    pace : Pace
        Of the calibrated tests.

    Raises
    ------
    FitError
        When the kind does not allow it, the window is none, or there is no force in it.
    """
    check_forecast(forecast)
    setting = setting_of(trace, forecast.session)
    part = given_part(trace, window, pace.step(setting.covariates["velocity"]))
    rng = np.random.default_rng(forecast.seed)
    standing = partial(standing_of, predictor.population, predictor.model, trace=trace)
    around = predictor.around(trace, setting)
    prior = TestPrior.of(around, rng, TRIED, standing)
    counting = counting_of(predictor, prior, pace, setting)
    problem = GivenProblem(predictor, prior, part, counting)
    known, told = draw_known(problem, forecast.draws, rng)
    deviation = prior.deviation(known.points)
    scales = predictor.scales(trace, prior.index[known.labels], deviation)
    strokes = int(strokes_of(trace)[-1]) + 1
    drawn = replace(drawn_of(problem, known, strokes, rng), scales=scales)
    source = f"population laws with scatter, and {told.sentence}"
    band = predictor.finish(trace, forecast, drawn, rng, source)
    return replace(band, given=told, remarks=(*band.remarks, *told.remarks))


def check_forecast(forecast: Forecast) -> None:
    """Refuse kinds of which a given part says nothing."""
    if forecast.kind not in ALLOWED:
        raise FitError(
            f"given is for the kinds {' and '.join(ALLOWED)}, not for {forecast.kind}: a first "
            "part shows the force of one new test"
        )


def draw_known(
    problem: GivenProblem, n: int, rng: np.random.Generator
) -> tuple[Known, Conditioned]:
    """Draws of a test given its part: by weights where they can be trusted, else sampled."""
    prior = problem.prior
    labels = rng.permutation(prior.size)
    tried = problem.known(prior, labels, prior.draw(labels, rng))
    log_weights, k = psis(np.maximum(tried.log_likelihood, tried.log_likelihood.max() - 600.0))
    effective = float(np.exp(-np.logaddexp.reduce(2.0 * log_weights)))
    window, samples = problem.part.window, int(np.count_nonzero(problem.part.counted))
    if k <= LARGEST_K and effective >= FEWEST * n:
        chosen = systematic(np.exp(log_weights), n, rng)
        return tried.of(chosen), Conditioned(window, samples, k, "weights", effective)
    known, powers, accepted = sample_known(problem, n, rng)
    return known, Conditioned(window, samples, k, "sampling", float(n), powers, accepted)


def sample_known(
    problem: GivenProblem, n: int, rng: np.random.Generator
) -> tuple[Known, int, float]:
    """Draws of a test given its part by sampling; powers and share of accepted steps."""
    smooth = problem.prior.smoothed()

    def log_likelihood(labels: Index, points: Array) -> Array:
        return problem.known(smooth, labels, points).log_likelihood

    stay = stays(np.atleast_1d(problem.part.trace.actuation), smooth.around.level)
    depends = not stay or smooth.around.size > 0
    found = temper(smooth, log_likelihood, rng, max(n, POINTS), depends=depends)
    chosen = rng.permutation(len(found.labels))[:n]
    known = problem.known(smooth, found.labels[chosen], found.points[chosen])
    return known, found.powers, found.accepted


def drawn_of(problem: GivenProblem, known: Known, strokes: int, rng: np.random.Generator) -> Drawn:
    """The ingredients of a band of known tests, in a motion of so many strokes."""
    values = values_of(problem.predictor, problem.prior, known.labels, known.points)
    shared = problem.predictor.population.layout.names
    unknown = {name: v for name, v in values.items() if name not in shared}
    tests, likelihood = (known.slip, known.sd), problem.likelihood
    coefficients = likelihood.draw_coefficients(known.sums, *tests, rng)
    levels = likelihood.draw_levels(known.sums, coefficients, tests, strokes, rng)
    parts = problem.prior.parts(known.labels, known.points)
    return Drawn(parts, unknown, {}, discrepancy=coefficients, levels=levels)
