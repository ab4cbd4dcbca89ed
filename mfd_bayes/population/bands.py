"""Force bands for any motion and actuation, tested or not (model.md section 7)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.calibration.noises import Noise
from mfd_bayes.calibration.priors import RANGE
from mfd_bayes.calibration.result import PlottingBackend, needed
from mfd_bayes.errors import MOST_DRAWS, FitError, real_number, whole_number
from mfd_bayes.friction.model import Model
from mfd_bayes.population.design import Design, TestConditions, setting_of
from mfd_bayes.population.population import FinalState, Latents, Population, slip_force_of
from mfd_bayes.records.trace import Trace, check_magnitude
from mfd_bayes.store.cards import card
from mfd_bayes.units import percent

Array = NDArray[np.float64]
Index = NDArray[np.intp]

THIS_TEST = "this_test"  # one calibrated test by itself: what is known of its own parameters
# what each kind of band is about, in the words of design: the law with its level's effect; plus
# test-to-test scatter; plus a record's offset and noise
KIND_NAMES: Mapping[str, str] = MappingProxyType(
    {
        "mean": "mean property",
        "new_test": "this device tested again",
        "observation": "a measurement of it",
        THIS_TEST: "this very test",
    }
)
KINDS = tuple(KIND_NAMES)

DRAWS = 500  # draws of a band where no other number is asked for
FEWEST = 10  # fewest draws of a band
SHARE_DRAWS = 300  # most draws by which the shares of a band's variance are computed


@dataclass(frozen=True)
class PredictionOptions:
    """Settings of a prediction."""

    kind: str = "new_test"  # one of KINDS
    probability: float = 0.95
    draws: int = DRAWS
    seed: int = 0
    session: str = ""  # of the predicted test, where the campaign declares sessions
    simultaneous: bool = False  # whether the band of the whole history is shown too
    before: FinalState | None = field(default=None, repr=False, compare=False)  # without a reset
    device: str = ""  # likewise, where it declares devices
    conditions: Mapping[str, float] = field(default_factory=dict)  # of `design.CONDITIONS`

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise FitError(f"unknown kind {self.kind!r}: expected one of {', '.join(KINDS)}")
        real_number("probability", self.probability, FitError, (0.0, 1.0), exclusive=True)
        whole_number("draws", self.draws, FEWEST, FitError, MOST_DRAWS)
        whole_number("seed", self.seed, 0, FitError)
        for name in ("session", "device"):
            if not isinstance(getattr(self, name), str):
                raise FitError(f"{name} must be text, got {getattr(self, name)!r}")
        check_flag("simultaneous", self.simultaneous)

    def setting(self, trace: Trace) -> TestConditions:
        """Setting of the predicted test under a motion."""
        return setting_of(trace, self.session, self.device, self.conditions)

    @property
    def remarks(self) -> tuple[str, ...]:
        """A remark where the draws are too few for the probability."""
        if 0.5 * (1.0 - self.probability) * self.draws >= 1.0 - 1e-9:
            return ()
        return (
            f"{self.draws} draws are too few for a band of {percent(self.probability)} %: its ends "
            "are about the smallest and the largest draw",
        )


def check_flag(name: str, value: Any) -> None:
    """Refuse what is neither True nor False: the text "no" would count as True."""
    if not isinstance(value, bool | np.bool_):
        raise FitError(f"{name} must be True or False, got {value!r}")


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
    shows_simultaneous : bool
        Whether tables and pictures show `simultaneous` too.
    conditioning : ConditioningSummary, or None
        The part of the record that was known, where there is one.
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
    remarks: tuple[str, ...] = ()
    shows_simultaneous: bool = False
    explain: Callable[[], Mapping[str, float]] | None = field(default=None, repr=False)
    _backend: PlottingBackend | None = field(default=None, repr=False)
    conditioning: Any = None
    interval: ClassVar[str] = "equal-tailed"

    def __post_init__(self) -> None:
        for name in ("lower", "median", "upper", "draws"):
            view = getattr(self, name).view()
            view.flags.writeable = False
            object.__setattr__(self, name, view)

    @classmethod
    def of(
        cls,
        time: Array,
        draws: Array,
        forecast: PredictionOptions,
        source: str,
        values: Mapping[str, Array] | None = None,
    ) -> Band:
        """Band of force draws (n, T), kip."""
        tail = 0.5 * (1.0 - forecast.probability)
        lower, median, upper = np.quantile(draws, [tail, 0.5, 1.0 - tail], axis=0)
        about_band = forecast.kind, forecast.probability, source, values or {}
        return cls(
            time, lower, median, upper, draws, *about_band, shows_simultaneous=forecast.simultaneous
        )

    @cached_property
    def simultaneous(self) -> tuple[Array, Array]:
        """Lower and upper bound, (T,) each, kip, that hold the whole history of most of the draws.

        The share of the draws is the band's probability.
        """
        return whole_band(self.draws, self.probability)

    @cached_property
    def variance_shares(self) -> Mapping[str, float]:
        """What makes the band wide: share of each source in the variance; their sum is 1.

        Each source varies by itself, the others at their means. Empty for several models at once,
        of a `OnlinePredictor`, and where nothing varies.
        """
        return self.explain() if self.explain else {}

    def plot(self, axes: Any = None, *, displacement: ArrayLike | None = None) -> Any:
        """Matplotlib axes with the band over time, or over a displacement, (T,), in.

        Raises
        ------
        FitError
            When the band does not come from a run of `mfd_bayes.open_run`.
        """
        return needed(self._backend).plot_band(self, axes, displacement)

    def to_inference_data(self) -> Any:
        """The draws as ArviZ takes them: group `predictions`, variable `force`, kip.

        Raises
        ------
        FitError
            When the band does not come from a run of `mfd_bayes.open_run`.
        """
        return needed(self._backend).to_inference_data(self)

    def __repr__(self) -> str:
        width = float(np.mean(self.upper - self.lower))
        return (
            f"Band({self.kind}, {percent(self.probability)} %; {self.time.size} samples over "
            f"{np.ptp(self.time):.4g} s; median {self.median.min():.4g} to {self.median.max():.4g} "
            f"kip, mean width {width:.4g} kip; {len(self.draws)} draws from {self.source})"
        )

    def _repr_html_(self) -> str:
        width = float(np.mean(self.upper - self.lower))
        facts = [
            ("what", f"{KIND_NAMES[self.kind]} ({self.kind})"),
            ("probability", f"{percent(self.probability)} %, {self.interval}, of each sample"),
            ("samples", f"{self.time.size} over {np.ptp(self.time):.4g} s"),
            ("median force", f"{self.median.min():.4g} to {self.median.max():.4g} kip"),
            ("mean width", f"{width:.4g} kip"),
            ("draws", f"{len(self.draws)}, from {self.source}"),
        ]
        return card("Force band", facts, "; ".join(self.remarks))


def whole_band(draws: Array, probability: float) -> tuple[Array, Array]:
    """Lower and upper bound that hold whole curves (n, T) with a probability, (T,) each, kip.

    The bounds are centre ± q · scale. Centre and scale are mean and sd of the draws at each
    sample; q is the quantile, over the draws, of the largest |F(t) - centre(t)| / scale(t). They
    are nowhere inside the band of single samples.
    """
    centre, scale = draws.mean(axis=0), draws.std(axis=0)
    tiny = 1e-9 * max(float(np.max(np.abs(draws))), 1e-300)
    scale = np.where(scale > tiny, scale, 0.0)  # rounding is no spread
    deviation = np.abs(draws - centre) / np.where(scale > 0, scale, np.inf)
    reach = np.quantile(deviation.max(axis=1), probability, method="higher")
    tail = 0.5 * (1.0 - probability)
    lower, upper = np.quantile(draws, [tail, 1.0 - tail], axis=0)
    return np.minimum(centre - reach * scale, lower), np.maximum(centre + reach * scale, upper)


def holds_whole(draws: Array, observed: Array) -> bool:
    """Whether an observed curve (T,) is inside the band of whole curves of draws (n, T)."""
    lower, upper = whole_band(draws, 0.95)
    return bool(np.all((observed >= lower) & (observed <= upper)))


@dataclass(frozen=True, eq=False)
class PredictiveDraws:
    """Ingredients of the n draws of a prediction."""

    # (n, d) each, in prior units: parts of the coordinates of what tests share, as in
    # `Population.parts`
    mean: Array
    scatter: Array
    unshared: Mapping[str, Array]  # (n,), what tests do not share, such as the start in the gap
    scales: Mapping[str, Array]  # (n, T), factors of what has a law along a history of actuation
    knots: Array  # (n, K), kip: discrepancy
    noise: Array | None = None  # (n, T), kip; without it the offset is left out too


@dataclass(frozen=True, eq=False)
class Predictor:
    """Predicts forces of a damper with a population, a model, and the noise of its tests."""

    population: Population
    model: Model
    noise: Noise

    def predict(self, trace: Trace, forecast: PredictionOptions) -> Band:
        """Band of the force under a motion and an actuation, tested or not."""
        rng = np.random.default_rng(forecast.seed)
        draws = self.draw(trace, forecast, rng)
        scatter = "" if forecast.kind == "mean" else " with scatter"
        laws = "laws" if self.population.design.laws else "medians"
        return self.to_band(trace, forecast, draws, rng, f"population {laws}{scatter}")

    def repeat(
        self, trace: Trace, forecast: PredictionOptions, values_of_test: Mapping[str, Array]
    ) -> Band:
        """Band of the force of one calibrated test under a motion: the kind `this_test`.

        The place in the gap at the start is unknown, unless a test is before it.
        """
        rng, coordinates = np.random.default_rng(forecast.seed), self.population.design.coordinates
        pick = rng.choice(len(next(iter(values_of_test.values()))), size=forecast.draws)
        x = coordinates.of({name: values_of_test[name][pick] for name in coordinates.names})
        draws = self.draw(trace, forecast, rng, x[:, : len(self.population.design.names)])
        return self.to_band(trace, forecast, draws, rng, "posterior draws of this test")

    def draw(
        self,
        trace: Trace,
        forecast: PredictionOptions,
        rng: np.random.Generator,
        x: Array | None = None,
    ) -> PredictiveDraws:
        """Drawn tests under a motion, with all but their noise; of coordinates x (n, d) if given.

        They begin where the test before ended, if there is one.
        """
        population, setting = self.population, forecast.setting(trace)
        grid, n = population.grid_of(trace), forecast.draws
        index = population.draw_index(n, setting.actuation, rng)
        numbers = population.draw_numbers(n, grid.size, rng)
        scatter = forecast.kind != "mean"
        draws = self.sample_conditional(trace, setting, index, numbers, grid, scatter=scatter, x=x)
        if forecast.before is None or not self.model.has_gap:
            return draws
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            theta = self.model.theta(self.values(draws))
            start = forecast.before.starts(self.model, theta, trace, forecast.seed)
        return replace(draws, unshared={**draws.unshared, "start": start})

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def sample_conditional(
        self,
        trace: Trace,
        setting: TestConditions,
        index: Index,
        numbers: Latents,
        grid: Array,
        *,
        scatter: bool = True,
        x: Array | None = None,
        motion: Trace | None = None,
    ) -> PredictiveDraws:
        """Tests under a motion, with deviations on a grid of actuations (G,).

        `x` (n, d) are their coordinates where these are given, and `motion` is the whole motion
        where `trace` is a part of it.
        """
        population, level = self.population, setting.actuation
        effects = population.level_effects(index, setting.session, grid, numbers.level)
        contributions = population.parts(setting, index, numbers, effects, scatter=scatter)
        if x is not None:
            contributions = x, np.zeros_like(x)
        start, motion = numbers.start, motion or trace
        unshared = population.unshared(
            self.model, contributions[0] + contributions[1], start, setting, motion
        )
        scales = {}
        if trace.varying:
            history = np.asarray(trace.actuation)
            scales = population.scales(self.model, history, index, level, effects)
        return PredictiveDraws(*contributions, unshared, scales, population.knots(index))

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def to_band(
        self,
        trace: Trace,
        forecast: PredictionOptions,
        draws: PredictiveDraws,
        rng: np.random.Generator,
        source: str,
        window: slice = slice(None),
    ) -> Band:
        """Band of drawn tests in a part of a motion, with noise if it is asked for."""
        values = self.values(draws)
        if forecast.kind == "observation":
            noise = self.population.residual.draw_noise(rng, trace, values["noise_sd"])
            draws = replace(draws, noise=noise)
        force = self.total(trace, draws)
        check_magnitude("the predicted force", force)
        if forecast.before is not None:
            source = f"{source}, {forecast.before.words}"
        known_names = {
            quantity.name for quantity in (*self.model.quantities, *self.noise.quantities)
        }
        known_names |= {"start", *self.population.design.names, *self.model.parameters}
        reported = {name: value for name, value in values.items() if name in known_names}
        band = Band.of(trace.time[window], force[:, window], forecast, source, reported)
        return replace(band, explain=partial(self._shares, trace, draws, window))

    def values(self, draws: PredictiveDraws) -> dict[str, Array]:
        """Quantities of drawn tests, by name, (n,) each."""
        return {**self.population.values(draws.mean + draws.scatter), **draws.unshared}

    def model_force(
        self, trace: Trace, values: Mapping[str, Array], scales: Mapping[str, Array]
    ) -> Array:
        """The model's force of quantities by name (n,) and factors (n, T), (n, T), kip."""
        theta, start = self.model.theta(values), values.get("start")
        check_magnitude("a predicted parameter", theta, RANGE)
        series = {k: np.broadcast_to(v, (len(theta), trace.samples)) for k, v in scales.items()}
        return self.model.force_unbounded(theta, trace, start, scales=series or None)

    def force(self, trace: Trace, draws: PredictiveDraws) -> Array:
        """The damper's force with the discrepancy of the model, (n, T), kip."""
        values = self.values(draws)
        slip = slip_force_of(self.model, values)
        force = self.model_force(trace, values, draws.scales)
        return force + self.population.residual.discrepancy(trace, slip, draws.knots)

    def total(self, trace: Trace, draws: PredictiveDraws) -> Array:
        """Force of drawn tests, with noise and offset where they have noise, (n, T), kip."""
        force = self.force(trace, draws)
        if draws.noise is None:
            return force
        return force + self.values(draws)["offset"][:, None] + draws.noise

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def _shares(self, trace: Trace, draws: PredictiveDraws, window: slice) -> dict[str, float]:
        """Share of each source in the mean variance: one varies, the others are at their means."""
        subset, design = slice(SHARE_DRAWS), self.population.design

        def mean(values: Array) -> Array:
            return np.broadcast_to(values.mean(axis=0), values[subset].shape)

        start, noise = draws.unshared["start"][subset], draws.noise
        fixed = PredictiveDraws(
            mean(draws.mean),
            np.zeros_like(draws.scatter[subset]),
            {name: np.full(v[subset].shape, np.median(v)) for name, v in draws.unshared.items()},
            {name: mean(v) for name, v in draws.scales.items()},
            mean(draws.knots),
            None if noise is None else np.zeros_like(noise[subset]),
        )
        sources = np.array([_source_of_scatter(design, name) for name in design.names])
        varied = {}
        for source in ADVICE:
            scattered = np.where(sources == source, draws.scatter[subset], 0.0)
            varied[source] = replace(fixed, scatter=scattered)
        follows = np.isin(design.names, [*design.laws])
        for source, members in ((LAWS, follows), (PARAMETERS, ~follows & (sources != OFFSET))):
            moved = np.where(members, draws.mean[subset], fixed.mean)
            scales = {name: v[subset] for name, v in draws.scales.items()}
            varied[source] = replace(fixed, mean=moved, scales=scales)
        varied[START] = replace(fixed, unshared={**fixed.unshared, "start": start})
        varied[DISCREPANCY] = replace(fixed, knots=draws.knots[subset])
        if noise is None:
            del varied[NOISE], varied[OFFSET]
        else:
            varied[NOISE] = replace(fixed, noise=noise[subset])
        variances = {
            source: float(np.mean(np.var(self.total(trace, variant)[:, window], axis=0)))
            for source, variant in varied.items()
        }
        total = sum(variances.values())
        return {k: v / total for k, v in variances.items() if v > 1e-20} if total > 1e-20 else {}


# Sources of a band's width
SCATTER, OTHERS = "test-to-test scatter of", "other quantities"
OFFSET, LAWS, PARAMETERS = f"{SCATTER} the offset", "law, level and session effects", "parameters"
START, DISCREPANCY, NOISE = "start in the gap", "discrepancy of the model", "noise"

_GROUPS = {
    "forward slip force": ("Fc_fwd", "static_excess_fwd", "Fy_fwd"),
    "backward slip force": ("Fc_bwd", "static_excess_bwd", "Fy_bwd"),
    "gap": ("d2", "d3", "gap"),
    "sigma0": ("sigma0",),
    "stiffness beyond the gap": ("k_fwd", "k_bwd"),
}
_MORE_TESTS = (
    "If few tests were calibrated, more tests make it smaller. If many were, it is the true "
    "difference between tests of this device: find out what differed (temperature, wear, "
    "bedding-in), or declare sessions. A prediction of one calibrated test by itself leaves it out."
)
# what could be done about each source
ADVICE = {
    **{f"{SCATTER} {group}": _MORE_TESTS for group in _GROUPS},
    OFFSET: "Zero the load cell before each test, or ask for the kind new_test, which leaves it "
    "out.",
    f"{SCATTER} {OTHERS}": _MORE_TESTS,
    LAWS: "Calibrate a test at or near this actuation, with such a stroke, in this session.",
    PARAMETERS: "Calibrate more tests, with larger strokes or several speeds.",
    START: "Begin the motion with a stroke that crosses the whole gap: that makes the start known.",
    DISCREPANCY: "Calibrate more tests with full strokes: it repeats in every cycle.",
    NOISE: "It is the record's, not the damper's: the kind new_test leaves it out.",
}


def _source_of_scatter(design: Design, quantity: str) -> str:
    """Source that the scatter of a quantity is; "" of the noise's."""
    if quantity == "offset" or quantity.startswith("noise_"):
        return OFFSET if quantity == "offset" else ""
    groups = _GROUPS if design.coordinates.by_name else {}
    matches = (group for group, members in groups.items() if quantity in members)
    return f"{SCATTER} {next(matches, OTHERS)}"
