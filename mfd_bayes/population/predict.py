"""Force bands for any motion and actuation, tested or not (model.md section 7)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.extras import Extras
from mfd_bayes.calibration.noise import Noise
from mfd_bayes.calibration.priors import RANGE
from mfd_bayes.errors import FitError
from mfd_bayes.friction.model import Model
from mfd_bayes.population.conditioned import Conditioned
from mfd_bayes.population.drawn import Drawn
from mfd_bayes.population.kinds import KINDS
from mfd_bayes.population.parts import Parts
from mfd_bayes.population.population import Population
from mfd_bayes.population.residual import slip_force_of
from mfd_bayes.population.sequel import Ending, left_of, told
from mfd_bayes.population.setting import setting_of
from mfd_bayes.population.shares import DRAWS, FEWEST, VALUES, shares_of
from mfd_bayes.population.shown import ShownBand
from mfd_bayes.population.unshared import scales_of, unknown_of
from mfd_bayes.population.whole import whole_band
from mfd_bayes.records.numbers import whole_number
from mfd_bayes.records.trace import Trace, check_magnitude

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Forecast:
    """Settings of a prediction.

    Attributes
    ----------
    kind : {"device", "new_test", "observation", "this_test"}
    probability : float
    draws, seed : int
    session : str
        Of the predicted test, where the campaign declares sessions.
    whole : bool
        Whether a band of the whole history is computed too.
    permutations : int
        Orders of sources for `Band.shares`; 0 for none.
    before : Ending, optional
        Of the test that the motion follows without a reset.

    Raises
    ------
    FitError
        When the kind is unknown, or the probability is not between 0 and 1.
    """

    kind: str = "new_test"
    probability: float = 0.95
    draws: int = 500
    seed: int = 0
    session: str = ""
    whole: bool = False
    permutations: int = 0
    before: Ending | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise FitError(f"unknown kind {self.kind!r}: expected one of {', '.join(KINDS)}")
        if not 0.0 < self.probability < 1.0:
            raise FitError(f"probability must lie between 0 and 1, got {self.probability}")
        if whole_number("draws", self.draws, 0, FitError) < 10:
            raise FitError(f"a band needs at least 10 draws, got {self.draws}")
        whole_number("seed", self.seed, 0, FitError)


@dataclass(frozen=True, eq=False)
class Band(ShownBand):
    """Equal-tailed band of the force at each sample.

    Attributes
    ----------
    time, lower, median, upper : (T,), s and kip
        The probability holds for each sample by itself.
    draws : (n, T), kip
    kind : str
    probability : float
    source : str
        Where the parameters come from.
    values : mapping of str to (n,)
        Quantities of each draw, by name.
    remarks : tuple of str
        Reasons to trust it less, and what a recalibrated band promises, in sentences.
    whole_lower, whole_upper : (T,), kip, or None
        Band that holds the whole history with the probability, where it was asked for.
    shares : mapping of str to float
        What makes it wide: share of each source in the variance, where it was asked for.
    given : Conditioned, or None
        The part of the record that was known, where there is one: its `window` (s), `pareto_k`,
        `method` ("weights" or "sampling") and `effective` draws.
    """

    time: Array
    lower: Array
    median: Array
    upper: Array
    draws: Array
    kind: str
    probability: float
    source: str
    values: Mapping[str, Array] = field(default_factory=dict)
    interval: str = "equal-tailed"
    remarks: tuple[str, ...] = ()
    whole_lower: Array | None = None
    whole_upper: Array | None = None
    shares: Mapping[str, float] = field(default_factory=dict)
    extras: Extras | None = field(default=None, repr=False)
    given: Conditioned | None = None

    def widened(self, factor: float) -> Band:
        """The band of single samples, as many times as wide about its median."""
        lower = self.median - factor * (self.median - self.lower)
        return replace(self, lower=lower, upper=self.median + factor * (self.upper - self.median))


def band_of(
    time: Array,
    draws: Array,
    forecast: Forecast,
    source: str,
    values: Mapping[str, Array] | None = None,
) -> Band:
    """Band of force draws (n, T), kip."""
    tail = 0.5 * (1.0 - forecast.probability)
    lower, median, upper = np.quantile(draws, [tail, 0.5, 1.0 - tail], axis=0)
    asked = forecast.kind, forecast.probability
    band = Band(time, lower, median, upper, draws, *asked, source, values or {})
    if not forecast.whole:
        return band
    whole_lower, whole_upper = whole_band(draws, forecast.probability)
    return replace(band, whole_lower=whole_lower, whole_upper=whole_upper)


@dataclass(frozen=True, eq=False)
class Predictor:
    """Predicts forces of a damper.

    Attributes
    ----------
    population : Population
    model : Model
    noise : Noise
    """

    population: Population
    model: Model
    noise: Noise

    def predict(self, trace: Trace, forecast: Forecast) -> Band:
        """Band of the force under a motion and an actuation, tested or not.

        Parameters
        ----------
        trace : Trace
            With its actuation, constant or a history.
        forecast : Forecast
            Of a kind other than `this_test`.

        Raises
        ------
        FitError
            When the trace has no actuation.
        RecordError
            When the force is too large for a number.
        """
        rng = np.random.default_rng(forecast.seed)
        drawn = self.begun(trace, forecast, self.draw(trace, forecast, rng))
        scatter = "" if forecast.kind == "device" else " with scatter"
        return self.finish(trace, forecast, drawn, rng, f"population laws{scatter}")

    def draw(self, trace: Trace, forecast: Forecast, rng: np.random.Generator) -> Drawn:
        """Drawn tests under a motion, with all but their noise, which begin anywhere."""
        index = rng.choice(self.population.size, size=forecast.draws)
        setting, scattered = setting_of(trace, forecast.session), forecast.kind != "device"
        parts = self.population.draw_parts(setting, index, rng, scattered=scattered)
        return self._drawn(trace, parts, index, rng)

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def begun(self, trace: Trace, forecast: Forecast, drawn: Drawn) -> Drawn:
        """Drawn tests that begin where the one before ended, if there is one."""
        if forecast.before is None or not self.model.has_gap:
            return drawn
        theta = self.model.theta(self.values(drawn))
        start = forecast.before.starts(self.model, theta, trace, forecast.seed)
        return replace(drawn, unknown={**drawn.unknown, "start": start})

    def repeat(self, trace: Trace, forecast: Forecast, own: Mapping[str, Array]) -> Band:
        """Band of the force of one calibrated test under a motion: the kind `this_test`.

        The place in the gap at the start is unknown, unless a test is before it.

        Parameters
        ----------
        trace : Trace
            With the actuation of the test.
        forecast : Forecast
        own : mapping of str to (m,)
            Posterior draws of the test.

        Raises
        ------
        RecordError
            When the force is too large for a number.
        """
        rng = np.random.default_rng(forecast.seed)
        index = rng.choice(self.population.size, size=forecast.draws)
        pick = rng.choice(len(next(iter(own.values()))), size=forecast.draws)
        layout = self.population.layout
        level = layout.coordinates.of({name: own[name][pick] for name in layout.names})
        level = (level - layout.centre) / layout.spread
        parts = Parts(level, np.zeros_like(level), np.zeros_like(level))
        drawn = self.begun(trace, forecast, self._drawn(trace, parts, index, rng))
        return self.finish(trace, forecast, drawn, rng, "posterior draws of this test")

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def _drawn(
        self, trace: Trace, parts: Parts, index: NDArray[np.intp], rng: np.random.Generator
    ) -> Drawn:
        """Drawn tests of these parts, with all but their noise; index are their draws of laws."""
        left = left_of(self.population, self.model, self.population.values(parts), trace)
        unknown = unknown_of(self.population, len(index), rng, setting_of(trace), left)
        level, history = trace.reference_actuation, np.asarray(trace.actuation)
        scales = scales_of(self.population, history, level, index) if trace.varying else {}
        residual = self.population.residual
        learned = None if residual is None else residual.draw_coefficients(rng, len(index))
        return Drawn(parts, unknown, scales, discrepancy=learned)

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def finish(
        self,
        trace: Trace,
        forecast: Forecast,
        drawn: Drawn,
        rng: np.random.Generator,
        source: str,
    ) -> Band:
        """Band of drawn tests with all that they do not share; what is no number is refused."""
        values = self.values(drawn)
        damper = self.force(trace, drawn)
        if forecast.kind == "observation":
            drawn = replace(drawn, noise=self.draw_noise(rng, trace, values))
        force, _ = self.total(trace, drawn, damper)
        check_magnitude("the predicted force", force)
        band = band_of(trace.time, force, forecast, told(source, forecast.before), values)
        return replace(band, shares=self._shares(trace, drawn, forecast))

    def _shares(self, trace: Trace, drawn: Drawn, forecast: Forecast) -> dict[str, float]:
        """What makes the band wide, of some of its draws; empty where it is not asked for."""
        if not forecast.permutations:
            return {}
        some = drawn.first(int(np.clip(VALUES // trace.samples, FEWEST, DRAWS)))
        total, names = partial(self.total, trace), self.population.layout.names
        return shares_of(some, names, total, forecast.permutations, forecast.seed)

    def total(self, trace: Trace, drawn: Drawn, damper: Array | None = None) -> tuple[Array, Array]:
        """Force, and the damper's part of it where that is not known yet, (n, T) each, kip."""
        damper = self.force(trace, drawn) if damper is None else damper
        if drawn.noise is None:
            return damper, damper
        return damper + self.values(drawn)["offset"][:, None] + drawn.noise, damper

    def values(self, drawn: Drawn) -> dict[str, Array]:
        """Quantities of drawn tests, by name, (n,) each."""
        return {**self.population.values(drawn.parts), **drawn.unknown}

    def force(self, trace: Trace, drawn: Drawn) -> Array:
        """The damper's force with the discrepancy of the model, (n, T), kip."""
        theta = self.model.theta(values := self.values(drawn))
        check_magnitude("a predicted parameter", theta, RANGE)
        force = self.model.force_unbounded(
            theta, trace, values.get("start"), scales=drawn.scales or None
        )
        residual = self.population.residual
        if residual is None or drawn.discrepancy is None:
            return force
        slip = slip_force_of(self.model, values)
        return force + residual.discrepancy(trace, slip, drawn.discrepancy)

    def draw_noise(
        self, rng: np.random.Generator, trace: Trace, values: Mapping[str, Array]
    ) -> Array:
        """Draws of the record's noise, (n, T), kip."""
        residual = self.population.residual
        if residual is not None:
            return residual.draw_noise(rng, trace, values["noise_sd"])
        travel = None
        if self.noise.needs_travel:
            travel = self.model.travel(self.model.theta(values), trace, values.get("start"))
        return self.noise.draw(rng, trace.time, values, travel)
