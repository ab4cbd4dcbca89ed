"""Predictions of a test while it runs, for hybrid simulation: a band that learns with each sample.

Draws of the population are stepped along the motion with the model's own steps, and weighted by
the likelihood of the force so far, which is that of a given part. An update costs the same however
long the test has run. Where the weights can no longer be trusted, the draws are sampled anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.calibration.diagnostics import psis
from mfd_bayes.errors import FitError, RecordError
from mfd_bayes.population.conditioned import Conditioned
from mfd_bayes.population.given import (
    LARGEST_K,
    TRIED,
    GivenProblem,
    check_forecast,
    counting_of,
    sample_known,
    values_of,
)
from mfd_bayes.population.given_part import GivenLikelihood, GivenPart, Sums
from mfd_bayes.population.incoming import Incoming
from mfd_bayes.population.pace import Pace
from mfd_bayes.population.predict import Band, Forecast, Predictor, band_of
from mfd_bayes.population.prior_of_test import TestPrior
from mfd_bayes.population.residual import slip_force_of
from mfd_bayes.population.setting import Setting
from mfd_bayes.population.tempering import systematic
from mfd_bayes.population.unshared import scales_of
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Walk:
    """Draws of the test, n of them, on their way along the motion.

    Attributes
    ----------
    labels, points : (n,), (n, d + 1)
        As in `TestPrior`.
    values : mapping of str to (n,)
    state : State
        Of the model, at the last sample.
    sums : Sums, or None
        Of all samples so far.
    begun : (n,)
        Log likelihood of what the draws were sampled with, which does not weigh them again.
    """

    labels: Index
    points: Array
    values: Mapping[str, Array]
    state: Any
    sums: Sums | None
    begun: Array


class Forecaster:
    """Predicts a test while it runs; made by `Run.follow`.

    Attributes
    ----------
    time : float, s
        Of the last sample that it was given; NaN before the first.
    """

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
        model = predictor.model
        if not (hasattr(model, "step") and hasattr(model, "start")):
            raise FitError(f"the model {model.name} has no steps, which following a test needs")
        self._predictor, self._forecast, self._level = predictor, forecast, setting.actuation
        self._rng = np.random.default_rng(forecast.seed)
        self._prior = TestPrior.of(predictor.population, setting, self._rng, TRIED)
        self._counting = counting_of(predictor, self._prior, pace, setting)
        self._residual, self._may_refresh = self._counting.residual, refresh
        self._likelihood = GivenLikelihood(self._residual)
        stroke = 2.0 * setting.covariates["amplitude"]
        self._incoming = Incoming(self._counting.usual, stroke)
        self._method = "weights", 0, 1.0
        labels = np.arange(forecast.draws) % self._prior.size
        self._walk = self._begin(labels, self._prior.draw(labels, self._rng))

    @property
    def time(self) -> float:
        """Time of the last sample, s; NaN before the first."""
        return self._incoming.time

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
            When shapes do not fit, a value is not finite, or time does not increase.
        """
        level = self._level if actuation is None else actuation
        new = self._incoming.take(time, displacement, level, force)
        if new.size:
            self._walk = self._along(self._walk, new)

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
            When the trace begins before the last sample, or fewer than three have come in.
        """
        if self._incoming.count < 3:
            raise FitError("a forecaster needs three samples, at the tests' rate, before a band")
        if not trace.time[0] > self.time:
            raise FitError(
                f"the trace must begin after the last sample, at {self.time:g} s, got "
                f"{trace.time[0]:g} s"
            )
        log_weights, k = self._weights()
        if k > LARGEST_K and self._may_refresh:
            self.refresh()
            log_weights, k = self._weights()
        return self._band(trace, np.exp(log_weights), k)

    def refresh(self) -> None:
        """Sample the draws anew, given all samples so far; it takes some seconds."""
        trace = self._incoming.trace()
        window = float(trace.time[0]), float(trace.time[-1])
        part = GivenPart(trace, np.ones(trace.samples, dtype=np.bool_), window)
        problem = GivenProblem(self._predictor, self._prior, part, self._level, self._counting)
        known, powers, accepted = sample_known(problem, self._forecast.draws, self._rng)
        walk = self._along(self._begin(known.labels, known.points), np.arange(trace.samples))
        self._walk = replace(walk, begun=self._log_likelihood(walk))
        self._method = "sampling", powers, accepted

    def _begin(self, labels: Index, points: Array) -> Walk:
        """Draws at rest before the first sample."""
        values, model = values_of(self._predictor, points), self._predictor.model
        state = model.start(  # type: ignore[attr-defined]
            model.theta(values), values["start"], reference_actuation=self._level or None
        )
        return Walk(labels, points, values, state, None, np.zeros(len(labels)))

    def _along(self, walk: Walk, new: Index) -> Walk:
        """Draws after some new samples of the thinned record, with their sums."""
        trace = self._incoming.trace()
        force, state = self._stepped(walk, trace, new)
        counted = self._counting.counted(trace, np.isin(np.arange(trace.samples), new))
        counted = self._counting.first(counted) if walk.sums is None else counted
        slip = slip_force_of(self._predictor.model, walk.values) / self._residual.slip_force
        left = np.asarray(trace.force)[new] - force - walk.values["offset"][:, None]
        left -= np.outer(slip, counted.functions @ self._residual.mean)
        sums = Sums.of(left, counted)
        return replace(walk, state=state, sums=sums if walk.sums is None else walk.sums + sums)

    def _stepped(self, walk: Walk, trace: Trace, new: Index) -> tuple[Array, Any]:
        """Forces at samples of a trace (n, m), kip, and the state after them."""
        model, state = self._predictor.model, walk.state
        scales = self._scales(trace, new, self._prior.index[walk.labels])
        before = np.diff(trace.time, prepend=trace.time[0])
        force = np.empty((len(walk.labels), new.size))
        for i, at in enumerate(new.tolist()):
            given = {name: factors[:, i] for name, factors in scales.items()} or None
            sample = trace.displacement[at], trace.velocity[at], before[at]
            force[:, i], state = model.step(  # type: ignore[attr-defined]
                state, *(float(value) for value in sample), scales=given
            )
        return force, state

    def _scales(self, trace: Trace, new: Index, index: Index) -> dict[str, Array]:
        """Factors of what follows the actuation, (n, m) each; none where it is as planned."""
        history = np.broadcast_to(np.asarray(trace.actuation), trace.time.shape)[new]
        if not np.all(np.isfinite(history)) or np.allclose(history, self._level, rtol=1e-9):
            return {}
        return scales_of(self._predictor.population, history, self._level, index)

    def _log_likelihood(self, walk: Walk) -> Array:
        if walk.sums is None:
            return np.zeros(len(walk.labels))
        slip = slip_force_of(self._predictor.model, walk.values)
        return self._likelihood(walk.sums, slip, walk.values["noise_sd"])

    def _weights(self) -> tuple[Array, float]:
        """Smoothed log weights of the draws, (n,), and Pareto k."""
        log = self._log_likelihood(self._walk) - self._walk.begun
        return psis(np.maximum(np.nan_to_num(log, nan=-np.inf), np.nanmax(log) - 600.0))

    def _band(self, trace: Trace, weights: Array, k: float) -> Band:
        """Band of the motion that follows, of draws with these weights."""
        walk, forecast, rng = self._walk, self._forecast, self._rng
        joined, new = self._incoming.joined(trace)
        force, _ = self._stepped(walk, joined, new)
        chosen = systematic(weights, forecast.draws, rng)
        values = {name: value[chosen] for name, value in walk.values.items()}
        new = new[-trace.samples :]
        force = force[chosen, -trace.samples :]
        force += self._discrepancy(joined, new, chosen, values)
        if forecast.kind == "observation":
            noise = self._residual.draw_noise(rng, joined, values["noise_sd"])
            force += values["offset"][:, None] + noise[:, new]
        first = float(joined.time[0])
        method, powers, accepted = self._method
        effective = float(1.0 / np.sum(weights**2))
        told = Conditioned(
            (first, self.time), self._incoming.count, k, method, effective, powers, accepted
        )
        remarks = told.remarks if k <= LARGEST_K else (*told.remarks, _doubt(k))
        source = f"population laws with scatter, and {told.sentence}"
        band = band_of(trace.time, force, forecast, source, values)
        return replace(band, given=told, remarks=remarks)

    def _discrepancy(
        self, joined: Trace, new: Index, chosen: Index, values: Mapping[str, Array]
    ) -> Array:
        """Discrepancy of chosen draws at samples of the joined motion, (n, m), kip."""
        walk = self._walk
        if walk.sums is None:
            raise RecordError("no sample has come in")
        slip = slip_force_of(self._predictor.model, values)
        coefficients = self._likelihood.draw_coefficients(
            walk.sums.of_tests(chosen), slip, values["noise_sd"], self._rng
        )
        return self._residual.discrepancy(joined, slip, coefficients)[:, new]


def _doubt(k: float) -> str:
    return (
        f"the weights of the draws cannot be trusted (Pareto k {k:.2f}): call refresh() in a pause "
        "of the test"
    )
