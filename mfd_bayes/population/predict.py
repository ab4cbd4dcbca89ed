"""Force bands for any motion and actuation, tested or not (model.md section 7)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.noise import Noise
from mfd_bayes.calibration.priors import RANGE
from mfd_bayes.errors import FitError
from mfd_bayes.friction.model import Model
from mfd_bayes.population.population import Population
from mfd_bayes.population.setting import setting_of
from mfd_bayes.records.trace import Trace, check_magnitude

Array = NDArray[np.float64]

KINDS = ("device", "new_test", "observation")
"""The parameters' uncertainty; plus test-to-test scatter; plus the record's offset and noise."""


@dataclass(frozen=True)
class Forecast:
    """Settings of a prediction.

    Attributes
    ----------
    kind : {"device", "new_test", "observation"}
    probability : float
    draws, seed : int
    session : str
        Of the predicted test, where the campaign declares sessions.

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

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise FitError(f"unknown kind {self.kind!r}: expected one of {', '.join(KINDS)}")
        if not 0.0 < self.probability < 1.0:
            raise FitError(f"probability must lie between 0 and 1, got {self.probability}")
        if self.draws < 10:
            raise FitError(f"a band needs at least 10 draws, got {self.draws}")


@dataclass(frozen=True, eq=False)
class Band:
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
        Reasons to trust it less, in sentences.
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
    return Band(time, lower, median, upper, draws, *asked, source, values or {})


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

    def predict(
        self, trace: Trace, forecast: Forecast, tested: Mapping[str, Array] | None = None
    ) -> Band:
        """Band of the force under a motion and an actuation, tested or not.

        Parameters
        ----------
        trace : Trace
            With its actuation, constant or a history.
        forecast : Forecast
        tested : mapping of str to (m,), optional
            Posterior draws of the tests at this very level, for the kind `device`. Without
            them `device` is the laws' own uncertainty.

        Raises
        ------
        FitError
            When the trace has no actuation.
        RecordError
            When the force is too large for a number, as far from what was tested.
        """
        rng = np.random.default_rng(forecast.seed)
        index = rng.choice(self.population.size, size=forecast.draws)
        if forecast.kind == "device" and tested is not None:
            pick = rng.choice(len(next(iter(tested.values()))), size=forecast.draws)
            values = {name: column[pick] for name, column in tested.items()}
            source = "posterior draws of the tests at this actuation"
        else:
            scattered = forecast.kind != "device"
            setting = setting_of(trace, forecast.session)
            values = self.population.draw_test(setting, index, rng, scattered=scattered)
            source = "population laws" + (" with scatter" if scattered else "")
        values |= _unknown(self.population, forecast.draws, rng)
        with np.errstate(over="ignore", invalid="ignore"):  # refused right below
            force = self._force(trace, values, index)
            if forecast.kind == "observation":
                travel = self._travel(trace, values) if self.noise.needs_travel else None
                noise = self.noise.draw(rng, trace.time, values, travel)
                force = force + values["offset"][:, None] + noise
        check_magnitude("the predicted force", force)
        return band_of(trace.time, force, forecast, source, values)

    def _force(self, trace: Trace, values: Mapping[str, Array], index: NDArray[np.intp]) -> Array:
        """Force draws, (n, T), kip."""
        theta = self.model.theta(values)
        check_magnitude("a predicted parameter", theta, RANGE)
        scales = _scales(self.population, trace, index) if trace.varying else None
        return self.model.force(theta, trace, values.get("start"), scales=scales)

    def _travel(self, trace: Trace, values: Mapping[str, Array]) -> Array:
        """Travel since the last turn, (n, T), in."""
        return self.model.travel(self.model.theta(values), trace, values.get("start"))


def _unknown(population: Population, n: int, rng: np.random.Generator) -> dict[str, Array]:
    """Prior draws of what tests do not share: the start in the gap, γ1, and fixed quantities."""
    shared = set(population.layout.names)
    unknown = {name: p.draw(rng, n) for name, p in population.priors.items() if name not in shared}
    return {"gamma1": np.ones(n), "start": np.full(n, 0.5)} | unknown


def _scales(population: Population, trace: Trace, index: NDArray[np.intp]) -> dict[str, Array]:
    """Factors of the quantities with a law along a history of actuation, (n, T) each."""
    history = np.asarray(trace.actuation)
    level = np.array([trace.reference_actuation])
    scales = {}
    for name in population.layout.laws:
        along = population.ratio(name, history).reshape(-1, history.size)[index]
        at_level = population.ratio(name, level).reshape(-1, 1)[index]
        # without any actuation along the history it stays at its level
        scales[name] = np.where(at_level > 0, along / np.maximum(at_level, 1e-300), 1.0)
        if name.startswith("Fc"):
            scales[name.replace("Fc", "Fs")] = scales[name]
    return scales
