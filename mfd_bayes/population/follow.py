"""Predictions of a test while it runs, for hybrid simulation: a band that learns with each sample.

Draws of the population are stepped along the motion with the model's own steps, and weighted by
the likelihood of the force so far, which is that of a given part. An update costs the same however
long the test has run. Where the weights can no longer be trusted, the draws are sampled anew.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.calibration.diagnostics import psis
from mfd_bayes.errors import FitError, RecordError
from mfd_bayes.population.along import Along
from mfd_bayes.population.band import Band, band_of
from mfd_bayes.population.checks import check_flag
from mfd_bayes.population.conditioned import Conditioned
from mfd_bayes.population.forecast import Forecast
from mfd_bayes.population.given import (
    LARGEST_K,
    TRIED,
    GivenProblem,
    check_forecast,
    counting_of,
    sample_known,
)
from mfd_bayes.population.given_likelihood import GivenLikelihood
from mfd_bayes.population.given_part import GivenPart
from mfd_bayes.population.incoming import AHEAD, Incoming
from mfd_bayes.population.pace import Pace
from mfd_bayes.population.predict import Predictor
from mfd_bayes.population.prior_of_test import TestPrior
from mfd_bayes.population.residual import slip_force_of
from mfd_bayes.population.sequel import standing_of
from mfd_bayes.population.setting import Setting
from mfd_bayes.population.strokes import strokes_of
from mfd_bayes.population.tempering import systematic
from mfd_bayes.population.walk import Steps, Walk
from mfd_bayes.population.zeros import NOTHING
from mfd_bayes.records.numbers import real_numbers
from mfd_bayes.records.trace import Trace, check_trace

Array = NDArray[np.float64]
Index = NDArray[np.intp]

EITHER_WAY = np.array([0.25, 4.0])
"""Actuations over the planned one, between which deviations from the laws are known to differ; so
they are between all that were tested."""


class Forecaster:
    """Predicts a test while it runs; made by `Run.follow`.

    Attributes
    ----------
    time : float, s
        Of the last sample that it was given; NaN before the first.
    complete : callable
        Called with each band and with the motion from the first sample to the band's last; gives
        the band with what the run says of such a motion.
    """

    complete: Callable[[Band, Trace], Band]

    def __init__(
        self,
        predictor: Predictor,
        setting: Setting,
        forecast: Forecast,
        pace: Pace,
        *,
        refresh: bool = True,
    ) -> None:
        check_forecast(forecast)
        check_flag("refresh", refresh)
        self.complete = _as_it_is
        model = predictor.model
        if not (hasattr(model, "step") and hasattr(model, "start")):
            raise FitError(f"the model {model.name} has no steps, which following a test needs")
        self._predictor, self._forecast, self._level = predictor, forecast, setting.actuation
        tested = [one.actuation for one in predictor.population.layout.settings]
        self._nothing = NOTHING * max(tested)
        reached = np.append(self._level * EITHER_WAY, [p for p in tested if p > 0.0])
        around = Along.of(predictor.population, setting, reached)
        self._rng = np.random.default_rng(forecast.seed)
        standing = partial(standing_of, predictor.population, model)
        self._prior = TestPrior.of(around, self._rng, TRIED, standing)
        self._counting = counting_of(predictor, self._prior, pace, setting)
        self._residual, self._may_refresh = self._counting.residual, refresh
        self._likelihood = GivenLikelihood(self._residual)
        self._steps = Steps(predictor, self._prior, self._counting)
        stroke = 2.0 * setting.covariates["amplitude"]
        self._incoming = Incoming(self._counting.usual, stroke)
        self._sampled: tuple[float, int, float] | None = None
        psis(0.01 * np.arange(100.0))  # loads its library now, not while the test runs
        labels = np.arange(forecast.draws) % self._prior.size
        self._walk = self._steps.begin(labels, self._prior.draw(labels, self._rng))

    @property
    def time(self) -> float:
        """Time of the last sample, s; NaN before the first."""
        return self._incoming.time

    @property
    def pareto_k(self) -> float:
        """Pareto k of the draws' weights; above 0.7 they cannot be trusted."""
        return self._weights(self._walk)[1]

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
        new = self._incoming.take(time, displacement, level, force)
        if new.size and self._incoming.direction:
            self._walk = self._steps.along(
                self._walk, self._incoming.trace(), self._still_to_go(new)
            )

    def band(self, trace: Trace) -> Band:
        """Band of the force in the motion that follows, given all samples so far.

        Where the weights cannot be trusted, `refresh` comes first; with `refresh=False` in
        `Run.follow` a remark of the band says so instead.

        Parameters
        ----------
        trace : Trace
            Its first sample is after the last one measured. Its actuation, if it has one, may
            differ.

        Returns
        -------
        Band
            Of the samples of the trace.

        Raises
        ------
        FitError
            When it is no trace, begins before the last sample, or too few have come in.
        RecordError
            When a test that was planned without actuation shall have one.
        """
        check_trace("trace", trace, FitError)
        if not self._incoming.count:
            raise FitError(
                "a band needs some samples: a forecaster averages them over "
                f"{self._incoming.wanted:.3g} s, and no such mean is complete"
            )
        if not trace.time[0] > self.time:
            raise FitError(
                f"the trace must begin after the last sample, at {self.time:g} s, got "
                f"{trace.time[0]:g} s"
            )
        self._check_actuation(trace.actuation)
        joined, new = self._incoming.joined(trace)
        walk = self._walk
        if walk.state is None:  # at rest: the motion that follows tells on which side
            walk = self._steps.along(walk, joined, np.arange(AHEAD, AHEAD + 1))
        log_weights, k = self._weights(walk)
        if k > LARGEST_K and self._may_refresh and walk is self._walk:
            self.refresh()
            walk = self._walk
            log_weights, k = self._weights(walk)
        return self._band(walk, trace.samples, (joined, new), np.exp(log_weights), k)

    def refresh(self) -> None:
        """Sample the draws anew, given all samples so far; it takes some seconds.

        Before the first motion nothing is done: the side of the gap is not known.
        """
        if not self._incoming.direction:
            return
        trace, k = self._incoming.trace(), self.pareto_k
        counted = np.arange(trace.samples) >= AHEAD
        part = GivenPart(trace, counted, strokes_of(trace), self._incoming.window)
        problem = GivenProblem(self._predictor, self._prior, part, self._counting)
        known, powers, accepted = sample_known(problem, self._forecast.draws, self._rng)
        begun = self._steps.begin(known.labels, known.points)
        walk = self._steps.along(begun, trace, np.flatnonzero(counted))
        self._walk = replace(walk, begun=self._steps.log_likelihood(walk))
        self._sampled = k, powers, accepted

    def _check_actuation(self, actuation: ArrayLike) -> None:
        """Refuse an actuation where the laws say nothing of it."""
        if self._level > 0.0:
            return
        if np.any(real_numbers("actuation", actuation, RecordError) > self._nothing):
            raise RecordError(
                "the test was planned without actuation, and now has one: give run.follow the "
                "actuation of the test"
            )

    def _still_to_go(self, new: Index) -> Index:
        """Of new samples, and of those at rest, the ones that the draws have not stepped to."""
        return new if self._walk.state is not None else np.arange(AHEAD, new[-1] + 1)

    def _weights(self, walk: Walk) -> tuple[Array, float]:
        """Smoothed log weights of the draws, (n,), and Pareto k."""
        log = self._steps.log_likelihood(walk) - walk.begun
        return psis(np.maximum(np.nan_to_num(log, nan=-np.inf), np.nanmax(log) - 600.0))

    def _band(
        self, walk: Walk, samples: int, motion: tuple[Trace, Index], weights: Array, k: float
    ) -> Band:
        """Band of the last samples of a joined motion, of draws with these weights."""
        forecast, rng, (joined, new) = self._forecast, self._rng, motion
        force, _ = self._steps.stepped(walk, joined, new)
        chosen = systematic(weights, forecast.draws, rng)
        values = {name: value[chosen] for name, value in walk.values.items()}
        new = new[-samples:]
        discrepancy, levels = self._leftover(walk, joined, chosen)
        force = force[chosen, -samples:] + discrepancy[:, new]
        if forecast.kind == "observation":
            noise = self._residual.draw_noise(rng, joined, values["noise_sd"], levels)
            force += values["offset"][:, None] + noise[:, new]
        told = self._told(weights, k)
        source = f"population laws with scatter, and {told.sentence}"
        own = self._predictor.told(values)
        band = band_of(joined.time[new], force, forecast, source, own)
        remarks = told.remarks if k <= LARGEST_K else (*told.remarks, _doubt(k))
        return self.complete(replace(band, given=told, remarks=remarks), joined)

    def _told(self, weights: Array, k: float) -> Conditioned:
        """What was given so far, and how it was taken in."""
        effective, samples = float(1.0 / np.sum(weights**2)), self._incoming.count - AHEAD
        window = self._incoming.window
        if self._sampled is None:
            return Conditioned(window, samples, k, "weights", effective)
        before, powers, accepted = self._sampled
        return Conditioned(window, samples, before, "sampling", effective, powers, accepted)

    def _leftover(self, walk: Walk, joined: Trace, chosen: Index) -> tuple[Array, Array]:
        """Discrepancy of chosen draws along a joined motion, (n, T), kip, and strokes' levels."""
        if walk.sums is None:
            raise RecordError("no sample has come in")
        slip = slip_force_of(self._predictor.model, walk.values)[chosen]
        tests, sums = (slip, walk.values["noise_sd"][chosen]), walk.sums.of_tests(chosen)
        coefficients = self._likelihood.draw_coefficients(sums, *tests, self._rng)
        strokes = int(strokes_of(joined)[-1]) + 1
        levels = self._likelihood.draw_levels(sums, coefficients, tests, strokes, self._rng)
        return self._residual.discrepancy(joined, slip, coefficients), levels


def _as_it_is(band: Band, motion: Trace) -> Band:
    return band


def _doubt(k: float) -> str:
    return (
        f"the weights of the draws cannot be trusted (Pareto k {k:.2f}): call refresh() in a pause "
        "of the test"
    )
