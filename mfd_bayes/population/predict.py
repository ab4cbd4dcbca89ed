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
from mfd_bayes.population.layout import Setting
from mfd_bayes.population.population import Population
from mfd_bayes.records.trace import Trace, check_magnitude

Array = NDArray[np.float64]

KINDS = ("device", "new_test", "observation")
"""Parameters' uncertainty; plus test-to-test scatter; plus offset and noise of the record."""


@dataclass(frozen=True)
class Forecast:
    """What is asked of a prediction.

    Raises
    ------
    FitError
        When the kind is unknown, or the probability is not between 0 and 1.
    """

    kind: str = "new_test"
    probability: float = 0.95
    draws: int = 500
    seed: int = 0

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
        Bounds hold for each sample by itself.
    draws : (n, T), kip
    kind : str
    probability : float
    source : str
        Where the parameters are from.
    values : mapping of str to (n,)
        Quantities of each draw, by name.
    remarks : tuple of str
        Why it should be trusted less, in sentences.
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
    kind: str,
    probability: float,
    source: str,
    values: Mapping[str, Array] | None = None,
) -> Band:
    """Band of force draws (n, T), kip."""
    tail = 0.5 * (1.0 - probability)
    lower, median, upper = np.quantile(draws, [tail, 0.5, 1.0 - tail], axis=0)
    return Band(time, lower, median, upper, draws, kind, probability, source, values or {})


def predict(
    population: Population,
    model: Model,
    noise: Noise,
    trace: Trace,
    forecast: Forecast,
    tested: Mapping[str, Array] | None = None,
    session: str = "",
) -> Band:
    """Band of the force under a motion and an actuation, seen or not.

    Parameters
    ----------
    population : Population
    model : Model
    noise : Noise
    trace : Trace
        With its actuation, constant or a history.
    forecast : Forecast
    tested : mapping of str to (m,), optional
        Posterior draws of the tests at this very level, for the kind `device`. Without
        them `device` is the laws' own uncertainty.
    session : str, optional
        That of the test that is predicted, where the campaign declares sessions.

    Raises
    ------
    FitError
        When the trace has no actuation.
    RecordError
        When the force would be beyond all range, as far from what was tested.
    """
    rng = np.random.default_rng(forecast.seed)
    index = rng.choice(population.size, size=forecast.draws)
    if forecast.kind == "device" and tested is not None:
        pick = rng.choice(len(next(iter(tested.values()))), size=forecast.draws)
        values = {name: column[pick] for name, column in tested.items()}
        source = "posterior draws of the tests at this actuation"
    else:
        scattered = forecast.kind != "device"
        setting = setting_of(trace, session)
        values = population.draw_test(setting, index, rng, scattered=scattered)
        source = "population laws" + (" with scatter" if scattered else "")
    values |= _unknown(population, forecast.draws, rng)
    with np.errstate(over="ignore", invalid="ignore"):  # it is refused right below
        theta = model.theta(values)
        check_magnitude("a predicted parameter", theta, RANGE)
        force = model.force(
            theta,
            trace,
            values.get("start"),
            scales=_scales(population, trace, index) if trace.varying else None,
        )
        if forecast.kind == "observation":
            travel = model.travel(theta, trace, values.get("start")) if noise.needs_travel else None
            force = force + values["offset"][:, None] + noise.draw(rng, trace.time, values, travel)
    check_magnitude("the predicted force", force)
    return band_of(trace.time, force, forecast.kind, forecast.probability, source, values)


def setting_of(trace: Trace, session: str = "") -> Setting:
    """Setting under which a trace was made, or is to be predicted.

    Raises
    ------
    FitError
        When the trace has no actuation.
    """
    if not np.isfinite(trace.reference_actuation):
        raise FitError("a prediction needs the trace's actuation, in ksi (pressure) or kip (force)")
    covariates = {
        "velocity": float(np.quantile(np.abs(trace.velocity), 0.98)),
        "amplitude": 0.5 * float(np.ptp(trace.displacement)),
    }
    return Setting(trace.reference_actuation, session, covariates)


def _unknown(population: Population, n: int, rng: np.random.Generator) -> dict[str, Array]:
    """What no earlier test tells: the place in the gap at the start, the scale γ1, fixed ones."""
    pooled = set(population.layout.names)
    unknown = {name: p.draw(rng, n) for name, p in population.priors.items() if name not in pooled}
    return {"gamma1": np.ones(n), "start": np.full(n, 0.5)} | unknown


def _scales(population: Population, trace: Trace, index: NDArray[np.intp]) -> dict[str, Array]:
    """Factors along a history of actuation of what follows it, by its law, (n, T) each."""
    history = np.asarray(trace.actuation)
    level = np.array([trace.reference_actuation])
    scales = {}
    for name in population.layout.laws:
        along = population.ratio(name, history).reshape(-1, history.size)[index]
        at_level = population.ratio(name, level).reshape(-1, 1)[index]
        scales[name] = along / np.maximum(at_level, 1e-300)
        if name.startswith("Fc"):
            scales[name.replace("Fc", "Fs")] = scales[name]
    return scales
