"""The population of tests, as draws: laws, levels, effects and scatter, and where tests begin.

What the force model leaves over is a discrepancy that repeats in every cycle of every test, and
noise; `inference` has the formula.

Tests are often made one after the other with the same motion, and the device is not reset in
between: it then stands where such a motion leaves it. So a repeat of the calibrated tests begins
near the middle of the gap, or near the place at which its own motion ends; which of the two, and
how near, is learned from the calibrated tests (Beta densities on a grid of shapes). For every
other motion nothing is learned from repeats: it begins without load, or anywhere. A repeat does so
with probability `ELSEWHERE` too.

The NetCDF file of a population has the paper's constants by name.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betaincinv, betaln, expit, logit, ndtr, softmax

from mfd_bayes.calibration.diagnostics import Convergence
from mfd_bayes.calibration.priors import Prior, PriorFile
from mfd_bayes.errors import FitError, MfdError, NotThereError, StoreError
from mfd_bayes.friction.model import Model
from mfd_bayes.population.design import (
    INTERCEPTS,
    RATE,
    STROKE,
    TIED,
    WIDER,
    Design,
    TestConditions,
    design_of,
    folds_beyond,
    ratio,
    same_level,
)
from mfd_bayes.records.trace import Trace
from mfd_bayes.store.files import json_text
from mfd_bayes.store.netcdf import load_arrays, save_arrays

Array = NDArray[np.float64]
Index = NDArray[np.intp]

# factor of stroke within which a motion repeats a calibrated test, and so may begin as it did
LIKE = 1.1
LIKE_STROKES = 0.25  # difference in the share of full strokes up to which motions are of one kind
OCTAVE = 0.25  # octaves between the actuations at which deviations along a history are drawn
KNOTS = 16  # knots of the discrepancy in each direction
FINE = 20.0  # knots are even in log(1 + FINE · travel/stroke): finest after a turn
SHAPES = np.geomspace(1.0, 100.0, 41)  # of the Beta densities: from anywhere (1) to one place
ELSEWHERE = 0.2  # probability that a repeat begins without load or anywhere
# probability, before the tests of a run, that tests begin without load and not anywhere. All
# records of the three sessions in shared/data/brfd begin with less than a tenth of the slip
# force. With k sessions of k, Laplace's rule gives (k + 1)/(k + 2) to the next one; k is 2 here,
# so that none of the three is counted twice.
BEFORE = 0.75
MOST = 0.95  # largest probability that tests begin without load
SLOW = 1e3  # time between two displacements of a motion without speed, s
FORMAT = "mixed model 3"  # kind of stored population; others are not read
_RESIDUAL = ("mean", "log_shape")
_FIGURES = ("slip_force", "stroke_share", "lag_one", "noise_time", "travel")


# --- discrepancy and noise ------------------------------------------------------------------------


def strokes_of(trace: Trace) -> Index:
    """Number of the stroke to which each sample belongs, (T,), from 0."""
    turns = trace.turning_points
    return np.searchsorted(turns, np.arange(trace.samples), side="right")


@dataclass(frozen=True)
class TravelBasis:
    """Piecewise linear functions of the travel since a turn, for each direction of motion.

    All are zero beyond the longest full stroke, and where the stroke before the turn was less than
    half of the shortest one: what repeats in full cycles says nothing of such motions.
    """

    shortest: float  # in: full strokes of the tests from which functions are learned
    longest: float

    def __call__(self, trace: Trace) -> Array:
        """Values at each sample, (T, 2 · KNOTS)."""
        x, stroke = trace.displacement, strokes_of(trace)
        turns = np.concatenate([[0], trace.turning_points, [trace.samples - 1]])
        length = np.diff(x[turns])
        previous_stroke = np.concatenate([[0.0], np.abs(length[:-1])])[stroke]
        travel, forward = np.abs(x - x[turns[stroke]]), length[stroke] > 0
        knot_position = np.log1p(FINE * travel / self.longest) / np.log1p(FINE) * (KNOTS - 1)
        hats = np.maximum(0.0, 1.0 - np.abs(knot_position[:, None] - np.arange(KNOTS)))
        hats *= np.clip(4.0 * previous_stroke / self.shortest - 2.0, 0.0, 1.0)[:, None]
        return np.concatenate([hats * forward[:, None], hats * ~forward[:, None]], axis=1)


@dataclass(frozen=True, eq=False)
class Residual:
    """Discrepancy and noise that the tests of a device have in common."""

    basis: TravelBasis
    mean: Array  # (K,), kip: mean of δ at the knots
    log_shape: Array  # (K,): log g at the knots
    slip_force: float  # kip: typical slip force, at which δ stands as it is
    stroke_share: float  # h
    lag_one: float  # correlation of neighbouring samples of ε in the tests
    # s and in: correlation time of ε, and mean travel between neighbouring samples of the tests
    noise_time: float
    travel: float

    @property
    def information(self) -> float:
        """Share of independent samples in a record, (1 - φ)/(1 + φ)."""
        return (1.0 - self.lag_one) / (1.0 + self.lag_one)

    def shape(self, trace: Trace) -> Array:
        """Shape g of the noise's standard deviation, (T,)."""
        return np.exp(self.basis(trace) @ self.log_shape)

    def discrepancy(self, trace: Trace, slip_force: Array, knots: Array) -> Array:
        """Discrepancy f δ(u), (n, T), kip, for slip forces (n,) and values at the knots (n, K)."""
        relative = slip_force / self.slip_force
        return relative[:, None] * (knots @ self.basis(trace).T)

    def draw_noise(
        self,
        rng: np.random.Generator,
        trace: Trace,
        sd: Array,
        unshared: ArrayLike = 1.0,
        level: float = 1.0,
    ) -> Array:
        """Draws of the noise for these standard deviations (n,), (n, T), kip.

        ε is multiplied by `unshared`, and the levels of the strokes by `level`.
        """
        e = rng.standard_normal((len(sd), trace.samples))
        for t, f in enumerate(np.exp(-np.diff(trace.time) / self.noise_time), start=1):
            e[:, t] = f * e[:, t - 1] + np.sqrt(1.0 - f * f) * e[:, t]
        strokes, h = strokes_of(trace), self.stroke_share
        levels = rng.standard_normal((len(sd), int(strokes[-1]) + 1))
        noise = np.sqrt(1.0 - h * h) * unshared * e + h * level * levels[:, strokes]
        return np.asarray(sd[:, None] * self.shape(trace) * noise)

    def counts(self, trace: Trace) -> Array:
        """Independent samples that each sample counts for, (T,).

        What the model leaves over changes with the travel, not with time: neighbours are correlated
        by φ to the power of their travel over that of the tests, and a device at rest shows its
        force once, however long one looks at it. The first sample counts once.
        """
        travel = np.abs(np.diff(trace.displacement)) / self.travel
        phi = self.lag_one**travel
        return np.concatenate([[1.0], (1.0 - phi) / (1.0 + phi)])


def slip_force_of(model: Model, values: Mapping[str, Array]) -> Array:
    """Mean of the forward and backward slip forces, (n,), kip; 1 where the model names none."""
    theta = model.theta(values)
    columns = [model.parameters.index(name) for name in model.slip_forces]
    return np.asarray(theta[:, columns].mean(axis=1)) if columns else np.ones(len(theta))


# --- start in the gap -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class InitialGapPrior:
    """Density of the place in the gap, from 0 to 1, where a new test begins."""

    # (2, A): posterior of the modes (middle of the gap, where the motion ends) and of the shapes
    weights: Array | None = None
    unloaded: float = 0.0  # probability of a start without load; 0 where the model tells of none
    fixed: float | None = None  # the start that the prior file fixes

    @classmethod
    def of(cls, prior: Prior | None) -> InitialGapPrior:
        """Of a prior alone."""
        return cls(fixed=float(prior.median) if prior is not None and prior.fixed else None)

    @classmethod
    def learned(
        cls,
        beginnings: Array,
        last_end: Array | None,
        without_load: Sequence[tuple[Array, Array] | None],
    ) -> InitialGapPrior:
        """What draws of the places (n, J) say where tests began."""
        w = np.clip(np.median(beginnings, axis=0), 1e-6, 1.0 - 1e-6)
        log = np.full((2, SHAPES.size), -np.inf)
        for i, mode in enumerate((np.full(w.size, 0.5), last_end)):
            if mode is not None:
                a, b = _exponents(SHAPES[:, None], mode)
                density = (a - 1.0) * np.log(w) + (b - 1.0) * np.log1p(-w) - betaln(a, b)
                log[i] = density.sum(axis=1)
        ends = [bounds for bounds in without_load if bounds is not None]
        if len(ends) < len(without_load):
            return cls(softmax(log))
        factors = 0.0
        for positions, (lower, upper) in zip(beginnings.T, ends, strict=True):
            between_bounds = (positions >= lower) & (positions <= upper)
            factors += np.log((between_bounds.mean() + 1e-3) / ((upper - lower).mean() + 1e-3))
        return cls(softmax(log), min(float(expit(logit(BEFORE) + factors)), MOST))

    def place(
        self,
        numbers: Array,
        last_end: float | None,
        without_load: tuple[Array, Array] | None,
        *,
        repeat: bool,
    ) -> Array:
        """Places of tests, (n,), of normal numbers (n, 2): which density, and where in it."""
        if self.fixed is not None:
            return np.full(len(numbers), self.fixed)
        component, u = ndtr(numbers).T
        position, share = u, 1.0
        if repeat and self.weights is not None:
            share = ELSEWHERE
            edges = np.cumsum(self.weights.ravel())
            pick = np.searchsorted(edges / edges[-1], (component - share) / (1.0 - share))
            mode, shape = np.divmod(np.clip(pick, 0, edges.size - 1), SHAPES.size)
            modes = np.array([0.5, 0.5 if last_end is None else last_end])
            a, b = _exponents(SHAPES[shape], modes[mode])
            position = np.where(component >= share, betaincinv(a, b, u), u)
        if without_load is not None:
            lower, upper = without_load
            position = np.where(
                component < share * self.unloaded, lower + (upper - lower) * u, position
            )
        return np.asarray(np.clip(position, 1e-9, 1.0 - 1e-9))


def _exponents(shape: Array, mode: Array) -> tuple[Array, Array]:
    """Exponents of Beta densities of these shapes a and modes, with the sum 2a."""
    return 1.0 + 2.0 * (shape - 1.0) * mode, 1.0 + 2.0 * (shape - 1.0) * (1.0 - mode)


def without_load(model: Model, values: Mapping[str, Array]) -> tuple[Array, Array] | None:
    """Ends of the part of the gap without load, (n,) each, of quantities by name; None if all."""
    bounds = model.unloaded(values)
    if bounds is None:
        return None
    lower, upper, edge = bounds
    fine = np.isfinite(lower) & np.isfinite(upper) & np.isfinite(edge)
    half = 0.5 * np.clip(np.where(fine, edge, 0.0), 0.0, 0.5)
    ends = np.where(fine, lower - half, 0.0), np.where(fine, upper + half, 1.0)
    return np.clip(ends[0], 0.0, 1.0), np.clip(ends[1], 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class FinalState:
    """Where a test ended, as draws: another that follows without a reset begins there."""

    test: str  # its id
    theta: Array  # (m, p)
    place: Array  # (m,), 1: place in the gap when the next test begins, as `Model.end` has it
    predicted: bool = False  # whether it was predicted itself, and not calibrated

    @classmethod
    def of(
        cls,
        model: Model,
        test: str,
        trace: Trace,
        values: Mapping[str, Array],
        scales: Mapping[str, Array] | None = None,
    ) -> FinalState:
        """Ending of a test of a motion, of draws of its quantities by name, with `start`."""
        theta = model.theta(values)
        return cls(test, theta, model.end(theta, trace, values["start"], scales=scales))

    @property
    def words(self) -> str:
        """What a test that follows begins with."""
        how = ", which is predicted itself," if self.predicted else ""
        return f"begun where in its gap test {self.test}{how} ended"

    def starts(self, model: Model, theta: Array, trace: Trace, seed: int) -> Array:
        """Draws of the `start` of a motion that follows, with parameters theta (n, p), (n,)."""
        rng = np.random.default_rng((seed, 1))  # of its own: all other draws stay as they are
        pick = rng.choice(len(self.place), size=len(theta))
        return model.start_at(self.place[pick], trace, self.theta[pick], theta)

    def moved(self, model: Model, way: ArrayLike) -> FinalState:
        """The same after a slow motion, straight from each displacement (M,), in, to the next."""
        x = np.asarray(way, dtype=np.float64)
        x = np.concatenate([x[:1], x[:1], x])  # a trace has three samples at least
        time = SLOW * np.arange(x.size)
        trace = Trace.from_arrays(time, x, velocity=np.zeros(x.size), hysteresis=0.0)
        position = model.end(self.theta, trace, model.start_at(self.place, trace))
        return FinalState(self.test, self.theta, position, self.predicted)


def place_left(
    model: Model,
    values: Mapping[str, Array],
    trace: Trace,
    scales: Mapping[str, Array] | None = None,
) -> float | None:
    """Place, as a `start` of it, at which a motion leaves a device of typical quantities.

    The medians of these, (n,) each by name, are taken. The device goes straight back to the first
    displacement. None for a model without a gap, or one that does not say where a motion ends.
    """
    if not model.has_gap or type(model).compute_end is Model.compute_end:
        return None
    theta = model.theta({name: np.array([np.median(value)]) for name, value in values.items()})
    ended = FinalState("", theta, model.end(theta, trace, scales=scales))
    ended = ended.moved(model, trace.displacement[[-1, 0]])
    return float(np.clip(model.start_at(ended.place, trace)[0], 0.0, 1.0))


# --- population -----------------------------------------------------------------------------------


class Latents(NamedTuple):
    """Standard normal numbers of n tests: of d quantities, M level effects, G actuations."""

    level: Array  # (n, M, G): of level effects
    start: Array  # (n, 2): of the place in the gap
    scatter: Array  # (n, d): from test to test
    extrapolation: Array  # (n, d): of a motion outside the tests
    session: Array  # (n, d): of a new session
    device: Array | None = None  # (n, d): of a new device, where several devices were tested


class LevelEffects(NamedTuple):
    """Deviations from the laws at actuations (G,): logarithms, (n, G) each, by quantity."""

    actuation: Array
    log: Mapping[str, Array]

    def at(self, level: float) -> dict[str, Array]:
        """Those at one of the actuations, (n,) each."""
        column = int(np.argmin(np.abs(self.actuation - level)))
        return {name: values[:, column] for name, values in self.log.items()}


@dataclass(frozen=True, eq=False)
class LawDraws:
    """Draws of the population, (n, …) or (chain, draw, …)."""

    h: Array  # (…, F + E): logs of the scatter of free quantities, and of the sds of the effects
    z: Array  # (…, Z): linear coefficients, as in `Design`
    share: Array  # (…, L): shapes of the law of each quantity that follows the actuation
    exponent: Array
    knots: Array  # (…, K), kip: discrepancy δ at its knots


@dataclass(frozen=True, eq=False)
class Population:
    """Draws of the population of a campaign's tests, (chain, draw) first."""

    design: Design
    draws: LawDraws  # (chain, draw, …)
    choice: Index  # (chain, draw, L): number of the law of each quantity that has one
    law_weights: Mapping[str, Mapping[str, float]]  # of each law considered, by quantity
    alternatives: LawDraws  # (m, …): under all laws, for actuations beyond the tested levels
    alternative_weight: Array  # (m,)
    residual: Residual  # discrepancy and noise that the tests have in common
    starts: InitialGapPrior
    priors: Mapping[str, Prior]
    actuation_unit: str
    walkers: int  # chains of each group, by which its draws are ordered
    convergence: Convergence  # of scatter, effects' sd, shapes and levels

    def __repr__(self) -> str:
        laws = ", ".join(f"{name}: {law}" for name, law in self.design.laws.items())
        return (
            f"Population({len(self.design.settings)} tests; {self.size} draws; "
            f"{len(self.design.names)} quantities; laws {laws or 'of none'})"
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of chains, and of draws of each."""
        return self.draws.h.shape[0], self.draws.h.shape[1]

    @property
    def size(self) -> int:
        """Number of draws of all chains."""
        return int(np.prod(self.shape))

    @cached_property
    def _all(self) -> LawDraws:
        """All draws and those under other laws, (n, …)."""
        pairs = zip(vars(self.draws).values(), vars(self.alternatives).values(), strict=True)
        return LawDraws(*(np.concatenate([v.reshape(self.size, -1), o]) for v, o in pairs))

    def single(self, number: int) -> Population:
        """The population of one of the draws."""
        rows = (v.reshape(self.size, 1, 1, -1)[number] for v in vars(self.draws).values())
        nothing = LawDraws(*(v[:0] for v in vars(self.alternatives).values()))
        return replace(
            self,
            draws=LawDraws(*rows),
            choice=self.choice.reshape(self.size, 1, 1, -1)[number],
            alternatives=nothing,
            alternative_weight=self.alternative_weight[:0],
            residual=replace(self.residual, mean=self.knots(np.array([number]))[0]),
            walkers=1,
        )

    # --- what tables show -------------------------------------------------------------------------

    @property
    def common(self) -> tuple[str, ...]:
        """Quantities that are the same in all tests."""
        return tuple(self.design.names[k] for k in np.flatnonzero(self.design.common))

    @property
    def scatters(self) -> dict[str, Array]:
        """Test-to-test scatter of each quantity that differs between tests, (chain, draw).

        It is the sd of the logarithm of a positive quantity, and in kip for the offset.
        """
        free_columns = enumerate(self.design.free)
        return {self.design.names[k]: np.exp(self.draws.h[..., i]) for i, k in free_columns}

    @property
    def effect_sds(self) -> dict[str, Array]:
        """Sd of each effect, by "name_group", (chain, draw)."""
        effects = enumerate(self.design.effects, self.design.free.size)
        return {f"{e.name}_{e.group}": np.exp(self.draws.h[..., i]) for i, e in effects}

    @property
    def scatter_scales(self) -> Array:
        """Scale of the half-normal prior of each of `scatters` and `effect_sds`."""
        effects = [effect.scale for effect in self.design.effects]
        return np.concatenate([self.design.scatter_sd[self.design.free], effects])

    @property
    def dependences(self) -> dict[str, Array]:
        """Change of a quantity's coordinate per e-fold of a covariate, (chain, draw)."""
        pairs = [
            f"{name}_{c}" for name, covariates in self.design.dependence.items() for c in covariates
        ]
        begin = len(self.design.names)
        return {pair: self.draws.z[..., begin + i] for i, pair in enumerate(pairs)}

    def shapes(self, name: str) -> tuple[Array, Array]:
        """Share and exponent of a quantity's law, (chain, draw) each."""
        laws = list(self.design.laws)
        if name not in laws:
            raise NotThereError(f"no law of {name!r}: there are {', '.join(laws) or 'none'}")
        column = laws.index(name)
        return self.draws.share[..., column], self.draws.exponent[..., column]

    def ratio(self, name: str, actuation: ArrayLike, index: Index | None = None) -> Array:
        """Law's value at actuations (m,) over that at the reference.

        It is (chain, draw, m), or (n, m) for draws by number. It is 1 for a quantity without a law;
        what follows another, such as static friction, has its law.
        """
        actuations, design = np.atleast_1d(np.asarray(actuation, dtype=np.float64)), self.design
        if not np.all((actuations >= 0.0) & np.isfinite(actuations)):
            raise FitError(f"actuation must be finite numbers of at least 0, got {actuation!r}")
        name = TIED.get(name, name) if name not in design.names else name
        if name not in design.names:
            raise NotThereError(f"no quantity {name!r}: there are {', '.join(design.names)}")
        rows = np.arange(self.size) if index is None else index
        ratios = np.ones((rows.size, actuations.size))
        if name in design.laws:
            column = list(design.laws).index(name)
            shape = (a[rows, column, None] for a in (self._all.share, self._all.exponent))
            ratios = ratio(actuations / design.reference, *shape)
        return ratios.reshape(*self.shape, -1) if index is None else ratios

    def median(self, name: str, actuation: ArrayLike) -> Array:
        """Median of a quantity over tests at actuations (m,), by its law, (chain, draw, m)."""
        followed = self.ratio(name, actuation)
        levels = self.draws.z[..., : len(self.design.names)].reshape(self.size, -1)
        return self.values(levels)[name].reshape(*self.shape, 1) * followed

    @property
    def slopes(self) -> dict[str, Array]:
        """The paper's constants of those laws that are straight, and the laws' intercepts.

        K_c and K_s in kip per unit of actuation, `alpha_sigma0` in kip/in per unit of actuation;
        what is left without actuation: `Fc_fwd_0` and its like in kip, `sigma0_0` in kip/in. All
        are (chain, draw).
        """
        slope_of: dict[str, Array] = {}
        p0, laws = self.design.reference, self.design.laws
        slopes = {"Fc_fwd": "K_c_fwd", "Fc_bwd": "K_c_bwd", "sigma0": "alpha_sigma0"}
        for name, slope in slopes.items():
            if laws.get(name) not in ("proportional", "affine"):
                continue
            zero, at_reference = np.moveaxis(self.median(name, [0.0, p0]), -1, 0)
            slope_of[slope] = (at_reference - zero) / p0
            excess = name.replace("Fc", "static_excess")
            if excess != name and excess in self.design.names:
                static = 1.0 + self.median(excess, [p0])[..., 0]
                slope_of[slope.replace("K_c", "K_s")] = slope_of[slope] * static
        for name, law in laws.items():
            if law in ("affine", "residual_power") and f"{name}_0" in INTERCEPTS:
                slope_of[f"{name}_0"] = self.median(name, [0.0])[..., 0]
        return slope_of

    # --- new tests --------------------------------------------------------------------------------

    def values(self, x: Array) -> dict[str, Array]:
        """Shared quantities at coordinates x (n, d), by name, (n,) each, internal units."""
        coordinates = self.design.coordinates
        padding = np.zeros((len(x), len(coordinates.names) - x.shape[1]))
        values = coordinates.values(np.concatenate([x, padding], axis=1))
        return {name: values[name] for name in self.design.names}

    def within_levels(self, actuation: float) -> bool:
        """Whether an actuation lies between the lowest and the highest tested level, or at one."""
        levels = [s.actuation for s in self.design.settings]
        within_range = min(levels) <= actuation <= max(levels)
        return within_range or any(same_level(actuation, level) for level in levels)

    def draw_index(self, n: int, actuation: float, rng: np.random.Generator) -> Index:
        """Numbers of draws for n new tests, (n,).

        Beyond the tested levels they mix over the laws: numbers from `size` on are those under
        other laws.
        """
        index = rng.choice(self.size, size=n, replace=n > self.size)
        if self.within_levels(actuation) or not self.alternative_weight.size:
            return index
        edges = np.cumsum(self.alternative_weight)
        alternative = np.searchsorted(edges, rng.random(n))
        return np.where(alternative < edges.size, self.size + alternative, index)

    def knots(self, index: Index) -> Array:
        """Discrepancy at its knots of draws by number, (n, K), kip."""
        return np.asarray(self._all.knots[index])

    @cached_property
    def _leveled(self) -> list[tuple[int, int, Index]]:
        """Quantity, column of h and columns of z of each quantity with a level effect."""
        design = self.design
        return [
            (k, design.free.size + e, column)
            for e, effect in enumerate(design.effects)
            if effect.name == "level"
            for k, column in zip(effect.members, design.columns(e), strict=True)
        ]

    def count_numbers(self, grid: int) -> int:
        """How many numbers a test has with a grid of so many actuations."""
        quantities = (3 + self.several_devices) * len(self.design.names)
        return quantities + len(self._leveled) * grid + 2

    def numbers(self, flat: Array, grid: int) -> Latents:
        """What rows (n, m) of numbers stand for."""
        blocks = 3 + self.several_devices
        ends = blocks * len(self.design.names)
        level = flat[:, ends:-2].reshape(len(flat), len(self._leveled), grid)
        return Latents(level, flat[:, -2:], *np.split(flat[:, :ends], blocks, axis=1))

    def draw_numbers(self, n: int, grid: int, rng: np.random.Generator) -> Latents:
        """Numbers of n tests with a grid of so many actuations."""
        return self.numbers(rng.standard_normal((n, self.count_numbers(grid))), grid)

    @property
    def several_devices(self) -> bool:
        """Whether the tests tell how devices differ."""
        return len(self.design.devices) > 1

    def active(self, setting: TestConditions, grid: Array) -> Index:
        """Columns of the numbers that matter under a setting and a grid (G,)."""
        free_mask = ~self.design.common
        new_session = free_mask & (setting.session not in self.design.sessions)
        device = free_mask & (setting.device not in self.design.devices)
        device_mask: Sequence[bool] = device.tolist() if self.several_devices else []
        untested = np.any(np.abs(self.design.krige(setting.session, grid)[1]) > 1e-9)
        level = np.full(len(self._leveled) * grid.size, untested)
        extrapolated = self._extrapolation_sd(setting) > 0
        return np.flatnonzero(
            [*free_mask, *extrapolated, *new_session, *device_mask, *level, True, True]
        )

    def level_effects(
        self, index: Index, session: str, actuations: ArrayLike, numbers: Array
    ) -> LevelEffects:
        """Deviations from the laws at actuations (G,), by draws of the population (n,).

        Tested levels have those of the tests; others are drawn together, given these, by numbers
        (n, M, G).
        """
        weights, covariance = self.design.krige(session, actuations)
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        effects = {}
        for m, (k, e, columns) in enumerate(self._leveled):
            omega = np.exp(self._all.h[index, e])
            deviations = omega[:, None] * (numbers[:, m] @ root.T)
            effects[self.design.names[k]] = (
                self._all.z[np.ix_(index, columns)] @ weights.T + deviations
            )
        return LevelEffects(np.atleast_1d(actuations), effects)

    def parts(
        self,
        setting: TestConditions,
        index: Index,
        numbers: Latents,
        effects: LevelEffects,
        *,
        scatter: bool = True,
    ) -> tuple[Array, Array]:
        """Coordinates of tests under a setting by draws of the population, (n, d) in prior units.

        They are the sum of two parts: levels, laws, covariates and effects; and scatter from test
        to test with what is unknown of a new session or device, 0 for the mean property.
        """
        design, draws, actuations = self.design, self._all, np.array([setting.actuation])
        row = design.row(setting, level_effects=False)[None]
        mean = design.offsets(draws.share[index], draws.exponent[index], actuations)[:, 0]
        mean += design.linear(draws.z[index], row)[:, 0]
        for name, value in effects.at(setting.actuation).items():
            k = design.names.index(name)
            mean[:, k] += value / design.spread[k]
        mean += self._extrapolation_sd(setting) * numbers.extrapolation
        scattered = np.zeros_like(mean)
        if scatter:
            sd, free_indices = np.exp(draws.h[index]), design.free
            scattered[:, free_indices] = (
                sd[:, : free_indices.size]
                / design.spread[free_indices]
                * numbers.scatter[:, free_indices]
            )
            for e, effect in enumerate(design.effects, free_indices.size):
                if effect.name == "level" or design.home(effect.name, setting) in effect.homes:
                    continue
                group_numbers = getattr(numbers, effect.name)
                for k in effect.members:
                    scattered[:, k] += sd[:, e] / design.spread[k] * group_numbers[:, k]
        return mean, scattered

    def _extrapolation_sd(self, setting: TestConditions) -> Array:
        """Sd of what a setting outside those of the tests may change, in prior units, (d,).

        Of a motion outside theirs; and of an untested level, where too few levels were tested to
        tell how far levels lie from a law.
        """
        design = self.design
        stroke, rate = folds_beyond(setting, design.settings)
        untested = self.design.krige(setting.session, setting.actuation)[1][0, 0]
        level = WIDER * design.scatter_sd * np.sqrt(np.maximum(untested, 0.0))
        level[[k for k, _, _ in self._leveled]] = 0.0
        sd = np.zeros(len(design.names))
        for k in design.free:
            name = design.names[k]
            if name != "offset" and not name.startswith("noise_"):
                follows = name in design.laws
                sd[k] = np.sqrt(
                    (STROKE * stroke) ** 2 + ((RATE * rate) ** 2 + level[k] ** 2) * follows
                )
        return sd / design.spread

    def repeats(self, setting: TestConditions) -> bool:
        """Whether a motion repeats those of the tests: of their kind and of their stroke."""
        amplitude, full = (
            np.array([s.covariates.get(name, np.nan) for s in (setting, *self.design.settings)])
            for name in ("amplitude", "full_strokes")
        )
        stroke = np.abs(np.log(amplitude[0] / amplitude[1:])) <= np.log(LIKE)
        return bool(np.any(stroke & (np.abs(full[0] - full[1:]) <= LIKE_STROKES)))

    def unshared(
        self,
        model: Model,
        x: Array,
        numbers: Array,
        setting: TestConditions | None = None,
        trace: Trace | None = None,
    ) -> dict[str, Array]:
        """What tests of coordinates x (n, d) do not share, by name, (n,): start, γ1, what is fixed.

        The numbers (n, 2) are the start's; setting and trace are the motion's, where it is known.
        """
        n = len(x)
        other_priors = {k: p for k, p in self.priors.items() if k not in self.design.names}
        columns = {"gamma1": np.ones(n)} | {
            k: np.full(n, p.median) for k, p in other_priors.items()
        }
        if not model.has_gap:
            return columns | {"start": np.full(n, 0.5)}
        values = columns | self.values(x)
        repeat, last_end = setting is not None and self.repeats(setting), None
        if repeat and trace is not None and self.starts.weights is not None:
            last_end = place_left(model, values, trace)
        start = self.starts.place(numbers, last_end, without_load(model, values), repeat=repeat)
        return columns | {"start": start}

    def scales(
        self, model: Model, actuation: Array, index: Index, level: float, effects: LevelEffects
    ) -> dict[str, Array]:
        """Factors along a history of actuation (T,) of what follows it, over a level, (n, T) each.

        The level is among the actuations of the effects, which increase.
        """
        scales, grid, reference = {}, effects.actuation, effects.at(level)
        along_grid = np.log(np.maximum(grid, 1e-300))
        grid_position = np.clip(
            np.log(np.maximum(actuation, 1e-300)), along_grid[0], along_grid[-1]
        )
        lines = np.array([np.interp(grid_position, along_grid, unit) for unit in np.eye(grid.size)])
        for name in self.design.laws:
            reference_ratio = self.ratio(name, [level], index)
            ratios = self.ratio(name, actuation, index) / np.where(
                reference_ratio > 0.0, reference_ratio, 1.0
            )
            ratios = np.where(
                reference_ratio > 0.0, ratios, 1.0
            )  # without any actuation it stays at its level
            if name in reference and grid.size > 1:
                ratios = ratios * np.exp((effects.log[name] - reference[name][:, None]) @ lines)
            scales[name] = ratios
        return scales | {n: scales[o] for n, o in model.shared_laws.items() if o in scales}

    def grid_of(self, trace: Trace) -> Array:
        """Actuations at which deviations are drawn for a trace, increasing, (G,)."""
        return self.grid(trace.reference_actuation, trace.actuation if trace.varying else None)

    def grid(self, level: float, history: ArrayLike | None) -> Array:
        """Actuations at which deviations are drawn for a level and a history, increasing, (G,)."""
        if history is None or level <= 0.0:
            return np.array([level])
        driven = [*np.asarray(history, dtype=np.float64), level]
        low, high = np.clip([min(driven), max(driven)], level / 16.0, 16.0 * level)
        if high <= low * (1.0 + 1e-9):
            return np.array([level])
        octaves = np.arange(np.log2(low / level), np.log2(high / level) + OCTAVE, OCTAVE)
        tested = [p for _, p in self.design.cells if low < p < high]
        grid = np.sort(np.concatenate([level * 2.0**octaves, tested]))
        return np.sort(np.append(grid[np.abs(np.log(grid / level)) > 0.02], level))


# --- file -----------------------------------------------------------------------------------------


def save_population(path: Path, population: Population) -> None:
    """Write the draws of a population, and all else that it holds."""
    design, residual, starts = population.design, population.residual, population.starts
    arrays: dict[str, Array] = {
        **population.slopes,
        **{f"scatter_{name}": tau for name, tau in population.scatters.items()},
        **{f"deviation_{name}": omega for name, omega in population.effect_sds.items()},
        **{f"draws_{k}": v for k, v in vars(population.draws).items()},
        "law": population.choice.astype(np.float64),
    }
    facts = {
        "format": FORMAT,
        "names": design.coordinates.names,
        "settings": [asdict(setting) for setting in design.settings],
        "laws": design.laws,
        "dependence": design.dependence,
        "weights": population.law_weights,
        "alternatives": vars(population.alternatives),
        "alternative_weight": population.alternative_weight,
        "start_weights": starts.weights,
        "unloaded": starts.unloaded,
        "actuation_unit": population.actuation_unit,
        "walkers": population.walkers,
        "basis": asdict(residual.basis),
        "residual": {name: getattr(residual, name) for name in _FIGURES},
        "discrepancy": {name: getattr(residual, name) for name in _RESIDUAL},
        **vars(population.convergence),
    }
    save_arrays(path, arrays, json.loads(json_text(facts)))


def load_population(path: Path, priors: PriorFile, model: Model | None = None) -> Population:
    """Population of a file written by `save_population`; `model` is that of its tests."""
    arrays, facts = load_arrays(path)
    if facts.get("format") != FORMAT:
        raise StoreError(
            f"{path} holds a population of another version of this program: run "
            "mfd-bayes calibrate again"
        )
    try:
        return _population(arrays, facts, priors, model)
    except (KeyError, ValueError, TypeError, IndexError, AttributeError, MfdError) as error:
        raise StoreError(f"{path} is damaged: {error}") from error


def _population(
    arrays: Mapping[str, Array], facts: Mapping[str, Any], priors: PriorFile, model: Model | None
) -> Population:
    values = {name: np.asarray(array, dtype=np.float64) for name, array in arrays.items()}
    settings = [TestConditions(**entry) for entry in facts["settings"]]
    laws, dependence = facts["laws"], facts["dependence"]
    design = design_of(priors, facts["names"], settings, laws, dependence, model)
    draws = LawDraws(**{k: values[f"draws_{k}"] for k in ("h", "z", "share", "exponent", "knots")})
    alternatives = LawDraws(
        **{k: np.array(v, dtype=np.float64) for k, v in facts["alternatives"].items()}
    )
    z = design.row(settings[0]).size  # which fails where a covariate is unknown
    sizes = (draws.h.shape[-1], draws.z.shape[-1], alternatives.z.shape[-1])
    if sizes != (design.free.size + len(design.effects), z, z):
        raise ValueError("its draws do not fit its design")
    if not all(np.all(np.isfinite(value)) for value in values.values()):
        raise ValueError("it holds numbers that are not finite")
    starts = InitialGapPrior.of(priors.parameters.get("start"))
    if facts["start_weights"] is not None and starts.fixed is None:
        starts = InitialGapPrior(np.array(facts["start_weights"]), float(facts["unloaded"]))
    discrepancy: dict[str, Any] = {k: np.array(v) for k, v in facts["discrepancy"].items()}
    return Population(
        design=design,
        draws=draws,
        choice=values["law"].astype(np.intp),
        law_weights=facts["weights"],
        alternatives=alternatives,
        alternative_weight=np.array(facts["alternative_weight"]),
        residual=Residual(TravelBasis(**facts["basis"]), **discrepancy, **facts["residual"]),
        starts=starts,
        priors=priors.parameters,
        actuation_unit=facts["actuation_unit"],
        walkers=int(facts["walkers"]),
        convergence=Convergence(*(np.array(facts[f.name]) for f in fields(Convergence))),
    )
