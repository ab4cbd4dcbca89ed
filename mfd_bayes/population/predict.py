"""Force bands for any motion and actuation, tested or not (model.md section 7)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.noise import Noise
from mfd_bayes.calibration.priors import RANGE
from mfd_bayes.friction.model import Model
from mfd_bayes.population.along import Along
from mfd_bayes.population.band import Band, band_of
from mfd_bayes.population.drawn import Drawn
from mfd_bayes.population.forecast import Forecast
from mfd_bayes.population.parts import Parts
from mfd_bayes.population.population import Population
from mfd_bayes.population.residual import slip_force_of
from mfd_bayes.population.sequel import standing_of, told
from mfd_bayes.population.setting import Setting, setting_of
from mfd_bayes.population.shares import DRAWS, FEWEST, PERMUTATIONS, VALUES, shares_of
from mfd_bayes.population.unshared import scales_of, stays, unknown_of
from mfd_bayes.records.trace import Trace, check_magnitude

Array = NDArray[np.float64]


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

    def told(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """Those of some quantities that a band tells: of the model and the noise, and the start."""
        own = {quantity.name for quantity in (*self.model.quantities, *self.noise.quantities)}
        own |= {"start", *self.population.layout.names, *self.model.parameters}
        return {name: value for name, value in values.items() if name in own}

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
        """Drawn tests under a motion, with all but their noise, which follow no other test."""
        index = rng.choice(self.population.size, size=forecast.draws)
        setting, scattered = setting_of(trace, forecast.session), forecast.kind != "device"
        around = self.around(trace, setting)
        leveled = not around.size
        parts = self.population.draw_parts(
            setting, index, rng, scattered=scattered, leveled=leveled
        )
        numbers = rng.standard_normal((len(index), around.size))
        parts = around.added(parts, index, numbers)
        return self._drawn(trace, parts, index, rng, (around, numbers))

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
        around = self.around(trace, setting_of(trace, forecast.session))
        numbers = rng.standard_normal((len(index), around.size))
        drawn = self._drawn(trace, parts, index, rng, (around, numbers))
        drawn = self.begun(trace, forecast, drawn)
        return self.finish(trace, forecast, drawn, rng, "posterior draws of this test")

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def _drawn(
        self,
        trace: Trace,
        parts: Parts,
        index: NDArray[np.intp],
        rng: np.random.Generator,
        deviation: tuple[Along, Array],
    ) -> Drawn:
        """Drawn tests of these parts, with all but their noise; index are their draws of laws."""
        standing = standing_of(self.population, self.model, self.population.values(parts), trace)
        unknown = unknown_of(self.population, len(index), rng, setting_of(trace), standing)
        scales = self.scales(trace, index, deviation)
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
            drawn = replace(drawn, noise=self.draw_noise(rng, trace, values, drawn.levels))
        force, _ = self.total(trace, drawn, damper)
        check_magnitude("the predicted force", force)
        source = told(source, forecast.before)
        band = band_of(trace.time, force, forecast, source, self.told(values))
        orders, seed = forecast.permutations, forecast.seed
        some = drawn.first(int(np.clip(VALUES // trace.samples, FEWEST, DRAWS)))
        explained = self._shares(trace, some, orders, seed) if orders else {}
        explain = partial(self._shares, trace, some, PERMUTATIONS, seed)
        return replace(band, explained=explained, explain=explain)

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def _shares(self, trace: Trace, drawn: Drawn, orders: int, seed: int) -> dict[str, float]:
        """What makes the band of some draws wide."""
        total, names = partial(self.total, trace), self.population.layout.names
        return shares_of(drawn, names, total, orders, seed)

    def total(self, trace: Trace, drawn: Drawn, damper: Array | None = None) -> tuple[Array, Array]:
        """Force, and the damper's part of it where that is not known yet, (n, T) each, kip."""
        damper = self.force(trace, drawn) if damper is None else damper
        if drawn.noise is None:
            return damper, damper
        return damper + self.values(drawn)["offset"][:, None] + drawn.noise, damper

    def around(self, trace: Trace, setting: Setting) -> Along:
        """Deviations from the laws along a trace's history of actuation, around a setting."""
        history = np.asarray(trace.actuation) if trace.varying else None
        return Along.of(self.population, setting, history)

    def scales(
        self, trace: Trace, index: NDArray[np.intp], deviation: tuple[Along, Array]
    ) -> dict[str, Array]:
        """Factors of what follows the actuation, over its values at a level, (n, T) each.

        Empty where the trace has one actuation, that of the level; see `scales_of`.
        """
        actuation = np.broadcast_to(np.asarray(trace.actuation), trace.time.shape)
        if not trace.varying and stays(actuation, deviation[0].level):
            return {}
        return scales_of(self.model, actuation, index, deviation)

    def values(self, drawn: Drawn) -> dict[str, Array]:
        """Quantities of drawn tests, by name, (n,) each."""
        return {**self.population.values(drawn.parts), **drawn.unknown}

    def force(self, trace: Trace, drawn: Drawn) -> Array:
        """The damper's force with the discrepancy of the model, (n, T), kip."""
        values = self.values(drawn)
        theta = self.model.theta(values)
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
        self,
        rng: np.random.Generator,
        trace: Trace,
        values: Mapping[str, Array],
        levels: Array | None = None,
    ) -> Array:
        """Draws of the record's noise, (n, T), kip; levels (n, S) are those of its strokes."""
        residual = self.population.residual
        if residual is not None:
            return residual.draw_noise(rng, trace, values["noise_sd"], levels)
        travel = None
        if self.noise.needs_travel:
            travel = self.model.travel(self.model.theta(values), trace, values.get("start"))
        return self.noise.draw(rng, trace.time, values, travel)
