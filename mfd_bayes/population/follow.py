"""Predictions of a test while it runs, for hybrid simulation: a band that learns with each sample.

Draws of the population are stepped along the motion with the model's own steps, and weighted by the
likelihood of the force so far. An update costs the same however long the test has run. Where the
weights can no longer be trusted, the force so far is taken in again as a given part is
(`given.take_in`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.calibration.diagnostics import psis
from mfd_bayes.errors import FitError, RecordError
from mfd_bayes.population.bands import Band, Drawn, Forecast, Predictor, check_flag
from mfd_bayes.population.discrepancy import slip_force_of, strokes_of
from mfd_bayes.population.given import (
    LARGEST_K,
    Conditioned,
    KnownTest,
    Particles,
    Sums,
    block_size,
    check_kind,
    counts,
    effective_draws,
    noise_shape,
    systematic,
    take_in,
    usual_step,
)
from mfd_bayes.population.settings import ZERO, Setting
from mfd_bayes.records.motion import HYSTERESIS
from mfd_bayes.records.numbers import real_numbers
from mfd_bayes.records.trace import Trace, check_magnitude, check_trace

Array = NDArray[np.float64]
Index = NDArray[np.intp]

ROWS = ("time", "displacement", "actuation", "force")

AHEAD = 2
"""Samples at rest before the first, so that any record has three."""

EITHER_WAY = (0.25, 4.0)
"""Actuations over the planned one between which deviations from the laws are drawn."""


class Forecaster:
    """Predicts a test while it runs; made by `Run.follow`.

    Attributes
    ----------
    complete : callable
        Called with each band and with the motion from the first sample to the band's last; gives
        the band with what the run says of such a motion.
    """

    complete: Callable[[Band, Trace], Band]

    def __init__(
        self, predictor: Predictor, setting: Setting, forecast: Forecast, *, refresh: bool = True
    ) -> None:
        check_kind(forecast)
        check_flag("refresh", refresh)
        model, population = predictor.model, predictor.population
        if not (hasattr(model, "step") and hasattr(model, "start")):
            raise FitError(f"the model {model.name} has no steps, which following a test needs")
        self.complete = lambda band, motion: band
        self._predictor, self._forecast, self._may_refresh = predictor, forecast, refresh
        self._residual, self._level = population.residual, setting.actuation
        tested = [one.actuation for one in population.design.settings]
        self._zero = ZERO * max(tested)
        reached = [self._level * way for way in EITHER_WAY] + [p for p in tested if p > 0.0]
        grid = population.grid(self._level, reached)
        self._test = KnownTest(predictor, setting, None, grid)
        self._rng = np.random.default_rng(forecast.seed)
        self._wanted = usual_step(self._residual, setting)
        self._play = HYSTERESIS * setting.covariates["amplitude"]
        self._waiting, self._rows = np.empty((4, 0)), np.empty((4, 0))
        self._first, self._last, self._resting, self._size = np.nan, np.nan, 0, 0
        psis(0.01 * np.arange(100.0))  # loads its library now, not while the test runs
        self._begin(self._test.begin(forecast.draws, self._rng), np.zeros(forecast.draws))
        self._told: Conditioned | None = None

    # --- samples ----------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Time of the last sample, s; NaN before the first."""
        return self._last

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
        rows = _rows(time, displacement, level, force)
        times = np.concatenate([[self._last], rows[0]])
        if np.any(np.diff(times) <= 0):
            at = int(np.argmax(np.diff(times) <= 0))
            raise RecordError(
                f"time must increase; it does not at sample {at} of the update "
                f"(t = {rows[0, at]:g} s)"
            )
        if not rows.size:
            return
        self._first = rows[0, 0] if np.isnan(self._first) else self._first
        self._last = float(rows[0, -1])
        self._waiting = np.concatenate([self._waiting, rows], axis=1)
        if not self._size and self._waiting.shape[1] > 1:
            own = float(np.median(np.diff(self._waiting[0])))
            self._size = block_size(own, self._wanted)
        blocks = self._waiting.shape[1] // self._size if self._size else 0
        if blocks:
            used = blocks * self._size
            means = self._waiting[:, :used].reshape(4, blocks, self._size).mean(axis=2)
            self._waiting = self._waiting[:, used:]
            self._add(means)

    def _add(self, means: Array) -> None:
        """Take in means (4, m); those at rest are one, with their mean force."""
        if not self._rows.size:
            self._rows = np.repeat(means[:, :1], AHEAD, axis=1)
            self._rows[0] += self._wanted * np.arange(-AHEAD, 0)
        means[1] = self._without_play(means[1])
        moving = self._state is not None
        rest = 0 if moving else int(np.argmax([*(means[1] != self._rows[1, -1]), True]))
        if rest:
            before = self._rows[3, AHEAD] if self._resting else 0.0
            mean = means[:, rest - 1].copy()
            mean[3] = (self._resting * before + means[3, :rest].sum()) / (self._resting + rest)
            self._resting += rest
            self._rows = np.concatenate([self._rows[:, :AHEAD], mean[:, None]], axis=1)
        begun = self._rows.shape[1]
        self._rows = np.concatenate([self._rows, means[:, rest:]], axis=1)
        if self._rows.shape[1] > begun:
            self._advance(begun if moving else AHEAD)

    def _without_play(self, displacement: Array) -> Array:
        """Displacement that follows the measured one as through a small play, (m,), in."""
        here, found = float(self._rows[1, -1]), np.empty(displacement.size)
        for i, x in enumerate(displacement.tolist()):
            here = min(max(here, x - self._play), x + self._play)
            found[i] = here
        return found

    def _check_actuation(self, actuation: ArrayLike) -> None:
        """Refuse an actuation where the laws say nothing of it."""
        given = real_numbers("actuation", actuation, RecordError)
        if self._level <= 0.0 and np.any(given > self._zero):
            raise RecordError(
                "the test was planned without actuation, and now has one: give run.follow the "
                "actuation of the test"
            )

    # --- draws ------------------------------------------------------------------------------------

    def _begin(self, p: Particles, log_weights: Array) -> None:
        """Draws before the first sample, with these weights."""
        size = Trace.from_arrays([0.0, 1.0, 2.0], [0.0, 0.0, 0.0], self._level, np.zeros(3))
        self._particles, self._prior = p, log_weights
        self._drawn: Drawn = self._test.drawn(p, size)
        self._values = self._predictor.values(self._drawn)
        self._state: Any = None
        self._sums: Sums | None = None

    def _advance(self, begin: int) -> None:
        """Step the draws along the means from `begin` on, and add up what their force says."""
        trace = _trace(self._rows)
        new = np.arange(begin, trace.samples)
        force, self._state = self._stepped(trace, new, self._state)
        counted = np.arange(trace.samples) >= AHEAD
        residual, slip = self._residual, slip_force_of(self._predictor.model, self._values)
        basis = residual.basis(trace)
        left = np.asarray(trace.force)[new] - force - self._values["offset"][:, None]
        left -= np.outer(slip / residual.slip_force, basis[new] @ residual.mean)
        left = left / noise_shape(residual, trace, slip)[new]
        left = np.where(np.isfinite(left), left, 1e6)
        strokes, count = strokes_of(trace), counts(residual, trace, counted)
        sums = Sums.of(left, count[new], strokes[new], int(strokes[-1]) + 1)
        self._sums = sums if self._sums is None else self._sums + sums

    def _stepped(self, trace: Trace, new: Index, state: Any) -> tuple[Array, Any]:
        """Forces at samples of a trace (n, m), kip, and the state after them."""
        model, n = self._predictor.model, len(self._particles.index)
        if state is None:
            state = model.start(  # type: ignore[attr-defined]
                model.theta(self._values),
                self._values["start"],
                direction=trace.path.direction,
                reference_actuation=self._level or None,
            )
        actuation = np.broadcast_to(np.asarray(trace.actuation), trace.time.shape)[new]
        scales = {}
        if np.any(np.abs(actuation - self._level) > 1e-9 * self._level) and self._level > 0:
            population, index = self._predictor.population, self._particles.index
            session, grid = self._test.setting.session, self._test.grid
            effects = population.level_effects(index, session, grid, self._particles.numbers.level)
            scales = population.scales(model, actuation, index, self._level, (grid, effects))
        before, force = np.diff(trace.time, prepend=trace.time[0]), np.empty((n, new.size))
        for i, at in enumerate(new.tolist()):
            sample = (float(a[at]) for a in (trace.displacement, trace.velocity, before))
            given = {name: factors[:, i] for name, factors in scales.items()} or None
            force[:, i], state = model.step(state, *sample, scales=given)  # type: ignore[attr-defined]
        return force, state

    @property
    def pareto_k(self) -> float:
        """Pareto k of the draws' weights; above 0.7 they cannot be trusted."""
        return self._weights()[1]

    def _weights(self) -> tuple[Array, float]:
        """Smoothed log weights of the draws, (n,), and Pareto k."""
        log = self._prior
        if self._sums is not None:
            log = log + self._sums.log_likelihood(
                self._values["noise_sd"], self._residual.stroke_share
            )
        return psis(np.maximum(np.nan_to_num(log, nan=-np.inf), np.nanmax(log) - 600.0))

    def refresh(self) -> None:
        """Take in all samples so far anew, in some seconds; nothing before the first motion."""
        if self._state is None:
            return
        trace = _trace(self._rows)
        counted = np.arange(trace.samples) >= AHEAD
        test = replace(self._test, trace=None)
        p, weights, self._told = take_in(
            test, trace, counted, max(self._forecast.draws, 1000), self._rng
        )
        p = p.of(systematic(weights, self._forecast.draws, self._rng))
        self._begin(p, np.zeros(self._forecast.draws))
        self._advance(AHEAD)
        assert self._sums is not None
        share = self._residual.stroke_share
        self._prior = -self._sums.log_likelihood(self._values["noise_sd"], share)

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
        check_trace("trace", trace, FitError)
        if not self._rows.size:
            raise FitError(
                f"a band needs some samples: a forecaster averages them over {self._wanted:.3g} s, "
                "and no such mean is complete"
            )
        if not trace.time[0] > self._last:
            raise FitError(
                f"the trace must begin after the last sample, at {self._last:g} s, got "
                f"{trace.time[0]:g} s"
            )
        self._check_actuation(np.nan_to_num(np.asarray(trace.actuation)))
        log_weights, k = self._weights()
        if k > LARGEST_K and self._may_refresh:
            self.refresh()
            log_weights, k = self._weights()
        return self._band(trace, log_weights, k)

    def _band(self, after: Trace, log_weights: Array, k: float) -> Band:
        forecast, rng = self._forecast, self._rng
        actuation = np.broadcast_to(np.asarray(after.actuation), after.time.shape)
        planned = np.where(np.isnan(actuation), self._rows[2, -1], actuation)
        future = np.stack([after.time, after.displacement, planned, np.zeros(after.samples)])
        rows = np.concatenate([self._waiting, future], axis=1)
        rows[1] = self._without_play(rows[1])
        joined = _trace(np.concatenate([self._rows, rows], axis=1))
        first = self._rows.shape[1] if self._state is not None else AHEAD
        force, _ = self._stepped(joined, np.arange(first, joined.samples), self._state)
        chosen = systematic(log_weights, forecast.draws, rng)
        values = {name: value[chosen] for name, value in self._values.items()}
        residual, last = self._residual, slice(-after.samples, None)
        slip = slip_force_of(self._predictor.model, values)
        knots = residual.draw_knots(rng, len(chosen))
        force = force[chosen, last] + residual.discrepancy(joined, slip, knots)[:, last]
        if forecast.kind == "observation":
            noise = residual.draw_noise(rng, joined, values["noise_sd"])
            force = force + values["offset"][:, None] + noise[:, last]
        window, samples = (self._first, self._last), self._rows.shape[1] - AHEAD
        told = Conditioned(
            window, samples, k, "weights", float(effective_draws(log_weights[:, None])[0])
        )
        if self._told is not None:
            stages, accepted = self._told.stages, self._told.accepted
            told = replace(told, method="sampling", stages=stages, accepted=accepted)
        source = f"population laws with scatter, and {told.sentence}"
        shown = self._predictor.shown(values)
        band = Band.of(joined.time[last], force, forecast, source, shown)
        return self.complete(replace(band, given=told, remarks=told.remarks), joined)


def _trace(rows: Array) -> Trace:
    time, displacement, actuation, force = rows
    level = actuation if np.ptp(actuation) > 0 else float(actuation[0])
    # backward difference of second order: samples that are still to come do not change it
    step = np.diff(time, prepend=time[0] - 1.0)
    speed = np.diff(displacement, prepend=displacement[0]) / step
    speed[1:] += np.diff(speed) * step[1:] / (step[1:] + step[:-1])
    return Trace.from_arrays(time, displacement, level, force, speed, hysteresis=0.0)


def _rows(
    time: ArrayLike, displacement: ArrayLike, actuation: ArrayLike, force: ArrayLike
) -> Array:
    """Samples that came in, (4, m), checked."""
    given = time, displacement, actuation, force
    columns = [real_numbers(name, column) for name, column in zip(ROWS, given, strict=True)]
    size = columns[0].size
    for name, column in zip(ROWS, columns, strict=True):
        if column.shape != (size,) and not (name == "actuation" and column.ndim == 0):
            raise RecordError(
                f"{name} of an update must have shape ({size},) as time, got {column.shape}"
            )
        if not np.all(np.isfinite(column)):
            raise RecordError(f"{name} of an update must be finite")
        check_magnitude(name, column)
    if np.any(columns[2] < 0):
        raise RecordError("actuation of an update must not be negative")
    return np.stack([np.broadcast_to(column, (size,)) for column in columns])
