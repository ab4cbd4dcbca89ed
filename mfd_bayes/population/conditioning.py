"""Predictions of a test of which a first part is given, or arrives sample by sample.

Draws of the population are weighted by the likelihood of the known force. Where the weights of a
few draws would take over, the likelihood is taken in by growing powers of it, and after each the
draws are resampled and moved (sequential Monte Carlo with adaptive tempering: Del Moral, Doucet and
Jasra, 2006 and 2012). Islands of draws that are resampled apart show whether the moves mix. A test
that runs, as in hybrid simulation, is a given part that grows.

Such a test should stop when the next cycle tells little. Cycles of one motion are repeated
measurements, so that their information adds up: where a quantity of the test had the variance v0
before and has vk after k cycles, the next one is expected to leave

    v = 1 / (1/vk + (1/vk - 1/v0) / k)

What an engineer wants to know is the device, not this test of it: by the scatter τ from test to
test, one test tells its property with the variance vk + τ². A test is long enough where one more
cycle would narrow the interval of every property by less than a stated share.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, special

from mfd_bayes.calibration.diagnostics import psis, systematic
from mfd_bayes.calibration.priors import units
from mfd_bayes.errors import FitError, RecordError, real_numbers
from mfd_bayes.friction.model import Model
from mfd_bayes.population.bands import (
    Band,
    PredictionOptions,
    PredictiveDraws,
    Predictor,
    check_flag,
)
from mfd_bayes.population.design import ZERO, TestConditions
from mfd_bayes.population.law_scores import LARGEST_K
from mfd_bayes.population.population import Residual, slip_force_of, strokes_of
from mfd_bayes.records.record import checked_window
from mfd_bayes.records.trace import HYSTERESIS, Trace, check_magnitude, check_trace

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

PARTICLES = 1600  # draws of the population that take in a given part
LEAST_EFFECTIVE = 0.3  # share of effective draws below which they are resampled and moved
ISLANDS = 8  # groups of draws, of which each is resampled by itself
MOVES, MOST = 5, 50  # Metropolis steps after each resampling; most after the last one
ACCEPT = 0.25  # share of moves that is to be accepted
FEWEST = 100  # effective draws below which a band is said not to be reliable
LOWEST = -1e15  # log likelihood of what cannot be
QUIET = 0.25  # share of the slip force below which a device is taken to be in its gap
SAMPLES = 3  # fewest samples of a given part, at the rate of the calibrated tests
ALLOWED = ("new_test", "observation")  # kinds of bands of which a given part says something
EITHER_WAY = (0.25, 4.0)  # actuations over the planned one, for deviations from the laws
FEWEST_CYCLES = 2  # the first cycle may begin from rest or in the gap
ONE_SD = (0.15866, 0.5, 0.84134)  # shares of a normal distribution at one sd on both sides


@dataclass(frozen=True)
class ConditioningSummary:
    """The given part of a record, and how the population's draws took it in."""

    window: tuple[float, float]  # s
    samples: int  # at the rate of the calibrated tests
    pareto_k: float  # of the last importance weights
    effective: float  # effective number of draws behind the band
    stages: int  # how often the draws were resampled and moved

    @property
    def method(self) -> str:
        """How they took it in: "weights" alone, or "sampling", resampled and moved too."""
        return "sampling" if self.stages else "weights"

    def holds(self, time: Array) -> Mask:
        """Whether times (T,), s, are in the given part."""
        return (time >= self.window[0]) & (time <= self.window[1])

    @property
    def sentence(self) -> str:
        """What was given, and how it was used, for the source of a band."""
        text = f"the force given from {self.window[0]:.4g} s to {self.window[1]:.4g} s"
        if self.method == "weights":
            return f"{text} (importance weights, Pareto k {self.pareto_k:.2f})"
        return f"{text} (resampled and moved {self.stages} times)"

    @property
    def remarks(self) -> tuple[str, ...]:
        """Reason to trust the band less, if there is one."""
        if self.effective >= FEWEST and self.pareto_k <= LARGEST_K:
            return ()
        return (
            f"the band is not reliable: {self.effective:.0f} effective draws (Pareto k "
            f"{self.pareto_k:.2f}) hold what the given part says",
        )


def stroke_likelihood(
    residuals: Array, count: Array, strokes: Index, sd: Array, share: float
) -> Array:
    """Log likelihood of residuals (n, T), (n,).

    The noise has standard deviations (n,) and a `share` that the samples of a stroke (T,) have in
    common: a random intercept. Each sample counts for `count` (T,) independent ones.
    """
    membership = (strokes[:, None] == np.arange(strokes[-1] + 1)) * count[:, None]
    samples, unshared, level = membership.sum(axis=0), 1.0 - share**2, share**2
    sums, squares_of_strokes = (
        residuals @ membership / sd[:, None],
        residuals**2 @ membership / sd[:, None] ** 2,
    )
    factor = 1.0 + level * samples / unshared
    squares = squares_of_strokes / unshared - level / unshared**2 * sums**2 / factor
    log = np.log(factor) + samples * np.log(unshared)
    return np.asarray(-0.5 * (squares + log).sum(axis=1) - samples.sum() * np.log(sd))


class Particles(NamedTuple):
    """New tests: which draws of the population (n,), and their standard normal numbers (n, m)."""

    draw: Index
    numbers: Array

    def of(self, rows: Index) -> Particles:
        """Some of them."""
        return Particles(self.draw[rows], self.numbers[rows])


@dataclass(frozen=True, eq=False)
class PartialTest:
    """A test of which a part is given, with deviations from the laws on a grid of actuations (G,).

    `motion` is that of the whole test, which says where it begins; None where it is not known yet.
    """

    predictor: Predictor
    setting: TestConditions
    grid: Array
    motion: Trace | None = None

    def draw(self, n: int, rng: np.random.Generator) -> Particles:
        """Particles of which nothing is known."""
        population = self.predictor.population
        index = population.draw_index(n, self.setting.actuation, rng)
        size = n, population.count_numbers(self.grid.size)
        return Particles(index, rng.standard_normal(size))

    def sample_conditional(
        self, p: Particles, trace: Trace, *, scatter: bool = True
    ) -> PredictiveDraws:
        """Tests of the particles under a part of the motion."""
        numbers, motion = self.predictor.population.numbers(p.numbers, self.grid.size), self.motion
        return self.predictor.sample_conditional(
            trace, self.setting, p.draw, numbers, self.grid, scatter=scatter, motion=motion
        )

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def log_likelihood(self, p: Particles, motion: Trace, counted: Mask) -> Array:
        """Log likelihood of the counted samples, (n,).

        Of all counted samples (T,) the first one counts as an independent sample.
        """
        residual, model = self.predictor.population.residual, self.predictor.model
        draws, rows, strokes = (
            self.sample_conditional(p, motion),
            np.flatnonzero(counted),
            strokes_of(motion),
        )
        values, functions = self.predictor.values(draws), residual.basis(motion)
        slip, measured = slip_force_of(model, values), np.asarray(motion.force)
        force = self.predictor.model_force(motion, values, draws.scales)[:, rows]
        # before a full stroke a device far below slip is as quiet as in its gap
        shape = np.exp(functions @ residual.log_shape)
        quiet = np.abs(measured) < QUIET * np.median(slip)
        unknown = ~np.any(functions, axis=1) & quiet
        shape[unknown] = min(float(np.exp(residual.log_shape.min())), 1.0)
        discrepancy = residual.discrepancy(motion, slip, draws.knots)[:, rows]
        residuals = measured[rows] - force - discrepancy - values["offset"][:, None]
        residuals = residuals / shape[rows]
        residuals = np.where(np.isfinite(residuals), residuals, 1e6)
        count = np.where(counted, residual.counts(motion), 0.0)
        count[rows[0]] = 1.0
        noise = values["noise_sd"], residual.stroke_share
        log = stroke_likelihood(residuals, count[rows], strokes[rows], *noise)
        return np.maximum(np.nan_to_num(log, nan=LOWEST), LOWEST)

    def condition(
        self, motion: Trace, counted: Mask, n: int, rng: np.random.Generator
    ) -> tuple[Particles, Array, ConditioningSummary]:
        """Particles given the counted samples of a part, n or some more, with log weights."""
        p = self.draw(n + -n % ISLANDS, rng)
        log, power, stages, beta = self.log_likelihood(p, motion, counted), 0.0, 0, 1.0
        while power < 1.0:
            previous, power = power, next_power(log, power)
            weights = (power - previous) * log
            if power == 1.0:
                log_weights, k = smoothed(weights)
                effective = effective_draws(log_weights)
                if not stages:  # weights alone
                    break
            gaussian = self._gaussian(p, weights)
            p, log = resampled(p, log, weights, rng)
            stages, log_weights = stages + 1, np.zeros(len(log))
            for moves in range(1, MOST + 1):
                p, log, beta = self._move(p, log, motion, counted, power, gaussian, beta, rng)
                if moves % MOVES:
                    continue
                if power < 1.0 or (effective := self._effective(p, motion)) >= 2 * FEWEST:
                    break
        conditioned = ConditioningSummary(
            window=(float(motion.time[counted][0]), float(motion.time[counted][-1])),
            samples=int(counted.sum()),
            pareto_k=k,
            effective=effective,
            stages=stages,
        )
        return p, log_weights, conditioned

    def _gaussian(self, p: Particles, log_weights: Array) -> tuple[Index, Array, Array]:
        """Columns of the numbers that matter, their weighted mean and root of covariance."""
        active = self.predictor.population.active(self.setting, self.grid)
        weights, points = np.exp(log_weights - log_weights.max()), p.numbers[:, active]
        spread = np.atleast_2d(np.cov(points.T, aweights=weights)) + 1e-9 * np.eye(active.size)
        root = np.asarray(np.linalg.cholesky(spread), dtype=np.float64)
        return active, np.average(points, axis=0, weights=weights), root

    def _move(
        self,
        p: Particles,
        log: Array,
        motion: Trace,
        counted: Mask,
        power: float,
        gaussian: tuple[Index, Array, Array],
        beta: float,
        rng: np.random.Generator,
    ) -> tuple[Particles, Array, float]:
        """Particles after a Metropolis step, their log likelihood, and the size of the next step.

        A preconditioned Crank-Nicolson step, which leaves a Gaussian as it is; half of the
        particles take another draw of the population.
        """
        active, mean, root = gaussian
        n, current, flat = len(log), p.numbers, p.numbers.copy()
        walk = rng.standard_normal((n, active.size)) @ root.T
        flat[:, active] = mean + np.sqrt(1.0 - beta**2) * (current[:, active] - mean) + beta * walk
        proposed_index = self.predictor.population.draw_index(n, self.setting.actuation, rng)
        index = np.where(rng.random(n) < 0.5, proposed_index, p.draw)
        proposed = Particles(index, flat)
        log_proposed = self.log_likelihood(proposed, motion, counted)

        def over_gaussian(numbers: Array) -> Array:
            u = linalg.solve_triangular(root, (numbers[:, active] - mean).T, lower=True)
            prior = -0.5 * np.sum(numbers[:, active] ** 2, axis=1)
            return np.asarray(prior + 0.5 * np.sum(u**2, axis=0))

        ratio = power * (log_proposed - log) + over_gaussian(flat) - over_gaussian(current)
        accepted = np.log(rng.random(n)) < ratio
        numbers = np.where(accepted[:, None], flat, current)
        beta = float(np.clip(beta * np.exp(accepted.mean() - ACCEPT), 0.05, 1.0))
        moved = Particles(np.where(accepted, index, p.draw), numbers)
        return moved, np.where(accepted, log_proposed, log), beta

    def _effective(self, p: Particles, motion: Trace) -> float:
        """Effective number of draws of the worst quantity, by the means of islands' ranks."""
        from scipy.stats import rankdata  # which takes long to import

        values = self.predictor.values(self.sample_conditional(p, motion))
        ranks = rankdata(np.column_stack([*values.values()]), axis=0)
        islands = ranks.reshape(ISLANDS, -1, ranks.shape[1])
        variance_between = islands.mean(axis=1).var(axis=0, ddof=1)
        variance_within = islands.var(axis=1, ddof=1).mean(axis=0)
        worst = np.max(variance_between / np.maximum(variance_within, 1e-9))
        return float(min(len(ranks), ISLANDS / max(worst, 1e-9)))


def next_power(log: Array, power: float) -> float:
    """Largest power of the likelihood that leaves enough effective draws, at most 1."""

    def share(next_value: float) -> float:
        return effective_draws((next_value - power) * log) / len(log)

    if share(1.0) >= LEAST_EFFECTIVE:
        return 1.0
    from scipy.optimize import brentq  # which takes long to import

    return float(brentq(lambda next_value: share(next_value) - LEAST_EFFECTIVE, power, 1.0))


def resampled(
    p: Particles, log: Array, log_weights: Array, rng: np.random.Generator
) -> tuple[Particles, Array]:
    """Particles and their log likelihoods, resampled within each island."""
    islands = np.split(np.arange(len(log)), ISLANDS)
    rows = np.concatenate(
        [island[systematic(log_weights[island], island.size, rng)] for island in islands]
    )
    return p.of(rows), log[rows]


def smoothed(log_weights: Array) -> tuple[Array, float]:
    """Pareto-smoothed log weights, (n,), and Pareto k."""
    floor = np.nanmax(log_weights) - 600.0
    return psis(np.maximum(np.nan_to_num(log_weights, nan=-np.inf), floor))


def effective_draws(log_weights: Array) -> float:
    """Effective number of draws of log weights (n,)."""
    w = np.exp(log_weights - log_weights.max())
    return float(w.sum() ** 2 / np.sum(w**2))


def check_kind(forecast: PredictionOptions) -> None:
    """Refuse kinds of which a given part says nothing."""
    if forecast.kind not in ALLOWED:
        raise FitError(
            f"condition_on is for the kinds {' and '.join(ALLOWED)}, not for {forecast.kind}: a "
            "first part shows the force of one new test"
        )


def usual_step(residual: Residual, setting: TestConditions) -> float:
    """Time between samples, s, at which a motion of such a peak speed would be fitted."""
    noise_step = -residual.noise_time * np.log(residual.lag_one)
    speed = setting.covariates.get("velocity", 0.0)
    crossing_time = 0.5 * np.pi * residual.travel / speed if speed > 0 else np.inf
    return float(np.clip(crossing_time, 0.25 * noise_step, 4.0 * noise_step))


def block_size(time: Array, step: float) -> int:
    """Samples that are averaged, so that their means are at most about `step` s apart."""
    return max(1, int(step / float(np.median(np.diff(time))) + 0.25))


# --- a window -------------------------------------------------------------------------------------


def predict_given(
    predictor: Predictor, trace: Trace, forecast: PredictionOptions, window: tuple[float, float]
) -> Band:
    """Band of a record of which a part is known; all of it, with the given part."""
    check_kind(forecast)
    setting, population = forecast.setting(trace), predictor.population
    motion, counted = given_part(trace, window, usual_step(population.residual, setting))
    rng, n = np.random.default_rng(forecast.seed), forecast.draws
    test = PartialTest(predictor, setting, population.grid_of(trace), trace)
    p, log_weights, summary = test.condition(motion, counted, max(PARTICLES, n), rng)
    summary = replace(summary, window=checked_window(window, "condition_on", FitError))
    return given_band(test, p.of(systematic(log_weights, n, rng)), trace, forecast, summary, rng)


def given_band(
    test: PartialTest,
    p: Particles,
    trace: Trace,
    forecast: PredictionOptions,
    summary: ConditioningSummary,
    rng: np.random.Generator,
    samples: int = 0,
) -> Band:
    """Band of particles that took a part in: of all samples of a motion, or of so many last."""
    draws = test.sample_conditional(p, trace)
    source = f"population laws with scatter, and {summary.sentence}"
    band = test.predictor.to_band(trace, forecast, draws, rng, source, slice(-samples, None))
    return replace(band, conditioning=summary, remarks=(*band.remarks, *summary.remarks))


def given_part(trace: Trace, window: tuple[float, float], step: float) -> tuple[Trace, Mask]:
    """The motion up to the end of a window, as means over about `step` s, and which count, (T,).

    It goes on to the second turn, so that its first direction is known.
    """
    begin, end = checked_window(window, "condition_on", FitError)
    words = f"from {begin:g} s to {end:g} s"
    if trace.force is None:
        raise FitError(f"the trace has no force: condition_on {words} needs the force there")
    begin_time, end_time = float(trace.time[0]), float(trace.time[-1])
    if begin < begin_time - step or end > end_time + step:
        raise FitError(
            f"the given part {words} must lie within the record, which goes from {begin_time:g} "
            f"s to {end_time:g} s"
        )
    in_window = np.flatnonzero((trace.time >= begin) & (trace.time <= end))
    size = block_size(trace.time, step)
    if in_window.size < SAMPLES * size:
        raise FitError(
            f"the given part {words} holds {in_window.size} samples, too few: at least "
            f"{SAMPLES * size} are expected"
        )
    if not np.any(trace.force[in_window]):
        raise FitError(
            f"the force is zero in the whole given part {words}: expected a measured force"
        )
    turns = trace.turning_points
    stop = max(int(in_window[-1]), int(turns[1]) if turns.size > 1 else trace.samples - 1) + 1
    edges = np.arange(int(in_window[0]) % size, stop - size + 1, size)

    def mean(values: ArrayLike) -> Array:
        return np.asarray(np.asarray(values)[edges[:, None] + np.arange(size)].mean(axis=1))

    motion = Trace.from_arrays(
        mean(trace.time),
        mean(trace.displacement),
        mean(trace.actuation) if trace.varying else trace.actuation,
        mean(trace.force),
        mean(trace.velocity),
        hysteresis=trace.hysteresis,
    )
    motion = replace(motion, timed=trace.timed)
    return motion, (edges >= in_window[0]) & (edges + size <= in_window[-1] + 1)


# --- samples that arrive --------------------------------------------------------------------------


class OnlinePredictor:
    """Predicts a test while it runs; made by `Run.follow`.

    Attributes
    ----------
    complete : callable
        Called with each band and with the motion from the first sample to the band's last; gives
        the band with what the run says of such a motion.
    """

    complete: Callable[[Band, Trace], Band]

    def __init__(
        self,
        predictor: Predictor,
        setting: TestConditions,
        forecast: PredictionOptions,
        *,
        refresh: bool = True,
    ) -> None:
        check_kind(forecast)
        check_flag("refresh", refresh)
        population, self._level = predictor.population, setting.actuation
        self.complete = lambda band, motion: band
        self._predictor, self._forecast, self._may_refresh = predictor, forecast, refresh
        self._model = predictor.model
        tested = [test.actuation for test in population.design.settings]
        self._zero = ZERO * max(tested)
        reached = [self._level * way for way in EITHER_WAY] + [p for p in tested if p > 0.0]
        self._test = PartialTest(predictor, setting, population.grid(self._level, reached))
        self._rng = np.random.default_rng(forecast.seed)
        self._step = usual_step(population.residual, setting)
        self._hysteresis = HYSTERESIS * setting.covariates["amplitude"]
        # time, displacement, actuation and force: measured, and means of complete blocks
        self._waiting, self._rows, self._size = np.empty((4, 0)), np.empty((4, 0)), 0
        self._first, self._last = np.nan, np.nan
        psis(0.01 * np.arange(100.0))  # loads its library now, not while the test runs
        self._new_tests = self._particles = self._test.draw(forecast.draws, self._rng)
        self._log_prior = np.zeros(forecast.draws)
        self._weighted: tuple[Array, float] | None = None  # of the samples so far
        self._stages = 0  # how often the last refresh resampled and moved them

    @property
    def time(self) -> float:
        """Time of the last sample, s; NaN before the first."""
        return self._last

    @property
    def pareto_k(self) -> float:
        """Pareto k of the draws' weights; above 0.7 they cannot be trusted."""
        return self._weights()[1]

    def update(
        self,
        time: ArrayLike,
        displacement: ArrayLike,
        actuation: ArrayLike | None,
        force: ArrayLike,
    ) -> None:
        """Take in the samples that were measured since the last update.

        They are averaged to about the rate of the calibrated tests; what is left of a block waits
        for the next update.

        Parameters
        ----------
        time : (m,), s
            Increasing, and after all samples before.
        displacement : (m,), in
        actuation : scalar or (m,), ksi or kip, or None
            None where it is the one that `Run.follow` was given.
        force : (m,), kip

        Raises
        ------
        RecordError
            When shapes do not fit, a value is not finite, time does not increase, or a test that
            was planned without actuation has one.
        """
        level = self._level if actuation is None else actuation
        self._check_actuation(level)
        rows = _checked_rows(time=time, displacement=displacement, actuation=level, force=force)
        late = np.diff(rows[0], prepend=self._last) <= 0
        if np.any(late):
            index = int(np.argmax(late))
            raise RecordError(
                f"time must increase; it does not at sample {index} of the update "
                f"(t = {rows[0, index]:g} s)"
            )
        if not rows.size:
            return
        self._first = rows[0, 0] if np.isnan(self._first) else self._first
        self._last = float(rows[0, -1])
        self._waiting = np.concatenate([self._waiting, rows], axis=1)
        if not self._size and self._waiting.shape[1] > 1:
            self._size = block_size(self._waiting[0], self._step)
        blocks = self._waiting.shape[1] // self._size if self._size else 0
        if blocks:
            n_used = blocks * self._size
            means = self._waiting[:, :n_used].reshape(4, blocks, self._size).mean(axis=2)
            self._waiting = self._waiting[:, n_used:]
            self._rows, self._weighted = np.concatenate([self._rows, means], axis=1), None

    def _check_actuation(self, actuation: ArrayLike) -> None:
        """Refuse an actuation where the laws say nothing of it."""
        levels = real_numbers("actuation", actuation, RecordError)
        if self._level <= 0.0 and np.any(levels > self._zero):
            raise RecordError(
                "the test was planned without actuation, and now has one: give run.follow the "
                "actuation of the test"
            )

    def _trace(self, rows: Array) -> Trace:
        """Trace of time, displacement, actuation and force, (4, T)."""
        time, displacement, actuation, force = rows
        level = actuation if self._level > 0 and np.any(actuation != self._level) else self._level
        return Trace.from_arrays(time, displacement, level, force, hysteresis=self._hysteresis)

    def _values_of(self, p: Particles, *, scatter: bool = True) -> dict[str, Array]:
        """Quantities of particles by name, (n,) each."""
        motion_at_rest = Trace.from_arrays([0.0, 1.0, 2.0], np.zeros(3), self._level, np.zeros(3))
        return self._predictor.values(
            self._test.sample_conditional(p, motion_at_rest, scatter=scatter)
        )

    def _log_likelihood(self) -> Array:
        """Log likelihood of the force so far, (n,); 0 before there is a trace of it."""
        if self._rows.shape[1] < SAMPLES:
            return np.zeros(len(self._particles.draw))
        all_samples = np.ones(self._rows.shape[1], dtype=bool)
        return self._test.log_likelihood(self._particles, self._trace(self._rows), all_samples)

    def _weights(self, *, trusted: bool = False) -> tuple[Array, float]:
        """Smoothed log weights of the particles, (n,), and Pareto k.

        Where they are to be trusted, but cannot be, and it is allowed, `refresh` comes first.
        """
        if self._weighted is None:
            self._weighted = smoothed(self._log_prior + self._log_likelihood())
        if trusted and self._may_refresh and self._weighted[1] > LARGEST_K:
            self.refresh()
            return self._weights()
        return self._weighted

    def refresh(self) -> None:
        """Take in all samples so far anew, in some seconds; before three means, do nothing."""
        if self._rows.shape[1] < SAMPLES:
            return
        trace, n = self._trace(self._rows), self._forecast.draws
        all_samples = np.ones(trace.samples, dtype=bool)
        p, weights, summary = self._test.condition(trace, all_samples, max(n, 1000), self._rng)
        self._particles, self._weighted = p.of(systematic(weights, n, self._rng)), None
        self._stages = summary.stages
        self._log_prior = -self._log_likelihood()

    @property
    def is_misfit(self) -> bool:
        """Whether noise, or deviations of all quantities, are larger than in 99 % of new tests.

        Then the force is not that of such a test of this device, and neither estimates nor bands
        are reliable. A priori the deviations are standard normal.
        """
        weights, values = np.exp(self._weights()[0]), self._values_of(self._particles)
        (noise,) = quantiles(values["noise_sd"], weights, (0.5,))
        active = self._predictor.population.active(self._test.setting, self._test.grid)
        squares = np.sum(self._particles.numbers[:, active] ** 2, axis=1)
        (distance,) = quantiles(squares, weights, (0.5,))
        return bool(noise > self._most_noise or distance > special.chdtri(active.size, 0.01))

    @cached_property
    def _most_noise(self) -> float:
        """Noise that is larger than in 99 % of new tests, kip."""
        return float(np.quantile(self._values_of(self._new_tests)["noise_sd"], 0.99))

    @cached_property
    def _new(self) -> tuple[dict[str, Array], dict[str, Array]]:
        """Properties of new tests of the device, with their scatter and without."""
        with_scatter, without_scatter = (
            properties(self._model, self._values_of(self._new_tests, scatter=scatter))
            for scatter in (True, False)
        )
        return with_scatter, without_scatter

    @cached_property
    def scatter(self) -> dict[str, float]:
        """Scatter of each property from test to test: standard deviation of its logarithm."""
        scattered, typical = self._new
        return {name: _log_sd(scattered[name] / values) for name, values in typical.items()}

    def estimates(self, cycles: int) -> dict[str, Estimate]:
        """What is known of the test after so many cycles of one motion, by name of the property.

        Slip forces and the width of the gap, beside what a new test of the device would have, and
        what one more cycle is expected to tell; `is_enough` says when to stop. Where the
        weights cannot be trusted, `refresh` comes first.
        """
        log_weights, _ = self._weights(trusted=True)
        draws = properties(self._model, self._values_of(self._particles))
        weights = np.exp(log_weights - log_weights.max())
        unit_of, estimates = {**units(self._model), "slip_to_slip": "in"}, {}
        for name, column in draws.items():
            lower, median, upper = quantiles(column, weights, (0.025, 0.5, 0.975))
            new_tests = self._new[0][name]
            sds = _log_sd(column, weights), _log_sd(new_tests), self.scatter[name]
            percentile, narrowing = float(np.mean(new_tests < median)), narrowing_of(*sds, cycles)
            estimates[name] = Estimate(
                name, unit_of[name], median, lower, upper, percentile, narrowing
            )
        return estimates

    def band(self, trace: Trace) -> Band:
        """Band of the force in the motion that follows, given all samples so far.

        Where the weights cannot be trusted, `refresh` comes first; with `refresh=False` in
        `Run.follow` a remark of the band says so instead.

        Parameters
        ----------
        trace : Trace
            Its first sample is after the last one measured. Its actuation, if it has one, may
            differ.

        Raises
        ------
        FitError
            When it is no trace, begins before the last sample, or too few have come in.
        RecordError
            When a test that was planned without actuation shall have one.
        """
        check_trace(trace, FitError)
        if self._rows.shape[1] < SAMPLES:
            raise FitError(
                f"a band needs some samples: a forecaster averages them over {self._step:.3g} s, "
                f"and fewer than {SAMPLES} such means are complete"
            )
        if not trace.time[0] > self._last:
            raise FitError(
                f"the trace must begin after the last sample, at {self._last:g} s, got "
                f"{trace.time[0]:g} s"
            )
        self._check_actuation(np.nan_to_num(np.asarray(trace.actuation)))
        log_weights, k = self._weights(trusted=True)
        window, samples = (self._first, self._last), self._rows.shape[1]
        summary = ConditioningSummary(
            window, samples, k, effective_draws(log_weights), self._stages
        )
        actuation = np.broadcast_to(np.asarray(trace.actuation), trace.time.shape)
        planned = np.where(np.isnan(actuation), self._rows[2, -1], actuation)
        future = np.stack([trace.time, trace.displacement, planned, np.zeros(trace.samples)])
        joined = self._trace(np.concatenate([self._rows, self._waiting, future], axis=1))
        p = self._particles.of(systematic(log_weights, self._forecast.draws, self._rng))
        band = given_band(self._test, p, joined, self._forecast, summary, self._rng, trace.samples)
        return self.complete(band, joined)


def _checked_rows(**columns: ArrayLike) -> Array:
    """Samples that came in, (4, m), checked."""
    rows = {name: real_numbers(name, column) for name, column in columns.items()}
    size = rows["time"].size
    for name, column in rows.items():
        if column.shape != (size,) and not (name == "actuation" and column.ndim == 0):
            raise RecordError(
                f"{name} of an update must have shape ({size},) as time, got {column.shape}"
            )
        if not np.all(np.isfinite(column)):
            raise RecordError(f"{name} of an update must be finite")
        check_magnitude(name, column)
    if np.any(rows["actuation"] < 0):
        raise RecordError("actuation of an update must not be negative")
    return np.stack([np.broadcast_to(column, (size,)) for column in rows.values()])


# --- when to stop ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Estimate:
    """A property of a test that runs, beside new tests of this device."""

    name: str
    unit: str
    median: float
    lower: float  # interval of 95 %
    upper: float
    percentile: float  # share of new tests with a smaller value than the median
    narrowing: float  # share by which one more cycle is expected to narrow the device's interval


def is_enough(estimates: Mapping[str, Estimate], cycles: int, narrowing: float) -> bool:
    """Whether one more cycle would narrow no property by as much as `narrowing`."""
    largest = max((estimate.narrowing for estimate in estimates.values()), default=0.0)
    return cycles >= FEWEST_CYCLES and largest < narrowing


def properties(model: Model, values: Mapping[str, Array]) -> dict[str, Array]:
    """Slip forces and the gap's width of draws of a model's quantities, (n,) each, by name.

    Of a model that names neither, these are the quantities that follow the actuation.
    """
    named = {name: values[name] for name in model.slip_forces or model.laws if name in values}
    gap = model.slip_to_slip(values)
    return named if gap is None else {**named, "slip_to_slip": gap}


def narrowing_of(sd: float, sd_before: float, scatter: float, cycles: int) -> float:
    """Expected narrowing of a property's interval by one more cycle, from sds of its logarithm.

    They are what it is known to now, what it was before the test, and from test to test.
    """
    if sd <= 0.0:
        return 0.0
    precision_per_cycle = max(sd**-2.0 - sd_before**-2.0, 0.0) / cycles if sd_before > 0.0 else 0.0
    variance_after = 1.0 / (sd**-2.0 + precision_per_cycle)
    return float(1.0 - np.sqrt((variance_after + scatter**2) / (sd**2 + scatter**2)))


def _log_sd(values: Array, weights: Array | None = None) -> float:
    """Standard deviation of the logarithm: half of the interval that holds 68 %."""
    weights = np.ones(len(values)) if weights is None else weights
    low, _, high = quantiles(np.log(np.maximum(values, 1e-300)), weights, ONE_SD)
    return 0.5 * (high - low)


def quantiles(values: Array, weights: Array, shares: tuple[float, ...]) -> list[float]:
    """Quantiles of weighted draws."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    middle = (total - 0.5 * weights[order]) / total[-1]
    values_at_shares: list[float] = np.interp(shares, middle, values[order]).tolist()
    return values_at_shares
