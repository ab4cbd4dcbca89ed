"""Laws by which quantities follow the actuation, and the mixed model that a campaign calls for.

A law is how the median of a quantity follows the actuation (paper Eq. 5). Its share w and its
exponent b are given by its name, or inferred:

    v(p) = v(p0) [w (p/p0)^b + 1 - w]

In prior units the coordinate of quantity k of test j is

    x_jk = level_k + law_k(p_j) + b_k' covariates_j + level effect_k(p_j, session_j)
           + session effect_k(session_j) + device effect_k(device_j) + d_jk,   d_jk ~ N(0, τ_k²)

Level, slopes b and effects are linear; the shapes of laws (share, exponent) are not. Quantities
that are the same in all tests (`sparse` in the prior file) have no scatter and no effects. The
actuation p_j, covariates, session and device are the test's setting.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from mfd_bayes.calibration.priors import Prior, PriorFile, known_quantities
from mfd_bayes.errors import FitError, PriorError, real_number
from mfd_bayes.friction import models
from mfd_bayes.friction.model import Model
from mfd_bayes.records.trace import Trace, check_trace

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Cell = tuple[str, float]


# --- laws -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Law:
    """A law by name; a share or an exponent of None is inferred."""

    name: str
    share: float | None
    exponent: float | None

    @property
    def shapes(self) -> tuple[str, ...]:
        """What is inferred besides the level v(p0): "share", "exponent", both or nothing."""
        exponents = {"share": self.share, "exponent": self.exponent}
        return tuple(name for name, value in exponents.items() if value is None)

    @property
    def intercept(self) -> bool:
        """Whether it has a value without actuation, v(0) = v(p0) (1 - w); else v(0) = 0."""
        return self.share != 1.0


LAWS = {
    law.name: law
    for law in (
        Law("proportional", 1.0, 1.0),
        Law("affine", None, 1.0),
        Law("power", 1.0, None),
        Law("constant", 0.0, 1.0),
        Law("residual_power", None, None),
    )
}
"""All laws, in the order of their numbers in stored draws."""

LAW_NAMES = tuple(LAWS)

# in place of a law: all laws, weighted by how well they predict levels that were left out
COMPARE = "compare"
# mean and sd of the normal prior of an exponent. That of a share is uniform from 0 to 1.
EXPONENT = (1.0, 0.5)
# prior sd of a dependence: change of a parameter's coordinate per e-fold of a covariate
SENSITIVITY = 0.1
LARGEST = 1e100  # largest ratio that a law gives, so that what is computed from it is finite
# parameters that have the law of another, and which
TIED = {name: other for m in models.MODELS.values() for name, other in m.shared_laws.items()}
INTERCEPTS = {"sigma0_0": "kip/in"} | {
    f"{name}_0": "kip" for name in ("Fc_fwd", "Fc_bwd", "Fy_fwd", "Fy_bwd")
}
"""Units of what is left without actuation."""


def default_laws(model: Model | None = None) -> dict[str, str]:
    """Law of every sampled quantity that follows the actuation, of a model or of all ours."""
    candidates = models.MODELS.values() if model is None else [model]
    return {name: law for m in candidates for name, law in m.laws.items()}


def complete_laws(stated: Mapping[str, str]) -> dict[str, str]:
    """Law of every name that may have one in a campaign: the given one, or the default.

    Where a law must be that of another quantity, that is its default.
    """
    laws: dict[str, str] = {}
    for model in models.MODELS.values():
        for name, default in model.laws.items():
            source = model.laws_from.get(name, "")
            laws[name] = stated.get(name, laws.get(source, default))
        for name, followed in model.shared_laws.items():
            laws[name] = stated.get(name, laws[followed])
    return laws


def shapes_of(law: str) -> tuple[str, ...]:
    """What is inferred of a law besides its level; of "compare", the shapes of every law."""
    return ("share", "exponent") if law == COMPARE else LAWS[law].shapes


def usual_shapes(law: str) -> tuple[float, float]:
    """Share and exponent of a law; of free ones the medians of their priors."""
    law_of_name = LAWS["residual_power" if law == COMPARE else law]
    share = 0.5 if law_of_name.share is None else law_of_name.share
    return share, EXPONENT[0] if law_of_name.exponent is None else law_of_name.exponent


def ratio(relative: Array, share: Array, exponent: Array) -> Array:
    """v(p)/v(p0) at p/p0 = `relative`, all broadcast; 0 at p = 0 for a proportional law."""
    positive = relative > 0
    with np.errstate(over="ignore"):  # an actuation far beyond the tests
        power = np.exp(np.log(np.where(positive, relative, 1.0)) * exponent)
    power = np.where(positive, np.minimum(power, LARGEST), 0.0)
    return share * power + (1.0 - share)


def shape_prior(shape: str) -> Prior:
    """Prior of a share or an exponent of a law, as one test by itself may have it."""
    if shape == "share":
        return Prior("uniform", {"lower": 0.0, "upper": 1.0})
    return Prior("normal", {"mean": EXPONENT[0], "sd": EXPONENT[1]})


def _grouped(unit: str) -> str:
    """A unit as it stands below a fraction's line."""
    return f"({unit})" if "*" in unit else unit


def law_unit(name: str, actuation_unit: str) -> str:
    """Unit of a law's constant: K in kip per unit of actuation, α in kip/in per unit.

    Scatter and deviations are of logarithms and have none, but for the offset's.
    """
    if name.startswith("K_"):
        return {"ksi": "in^2", "kip": "1"}.get(actuation_unit, f"kip/{_grouped(actuation_unit)}")
    if name == "alpha_sigma0":
        slope_unit = f"kip/in/{_grouped(actuation_unit)}"
        return {"ksi": "in", "kip": "1/in"}.get(actuation_unit, slope_unit)
    if name in INTERCEPTS:
        return INTERCEPTS[name]
    spread = name.startswith(("scatter_", "deviation_"))
    return "kip" if spread and name.endswith("_offset") else "1"


# --- settings and design --------------------------------------------------------------------------

# sd of what a quantity that differs between tests may change by, for each e-fold of stroke, and
# of speed or frequency, outside the tests
STROKE, RATE = 0.2, 0.1
SAME_LEVEL = 0.01  # tests whose actuation differs by less than this share are at one level
ZERO = 1e-3  # share of the largest actuation below which one is zero: what an idle gauge shows
# what a test may say of the state of its device: decimal years, number of cycles, °C
CONDITIONS = ("date", "cycles", "temperature")
FULL = 0.8  # share of the largest stroke from which one is a full stroke
# correlation length of a level's effect along the logarithm of the actuation
ALIKE = float(np.log(2.0))
# scale of the sd of a level's effect, over that of scatter: real levels lie farther from a law
# than repeats from each other
WIDER = 2.0
# least and largest sd of a level's effect, over that at the reference actuation
BOUNDS = (0.5, 2.0)
LEVELS = 3  # fewest levels at which a deviation from a law can be told from the law
TESTS = 4  # fewest tests in which a dependence on a covariate is looked for
# prior sd of the change of a logarithm over the span of dates, counts or temperatures of the tests
DRIFT = 0.3
# Mean over peak speed of a sine: where on the Stribeck curve slip forces are compared
USUAL_SPEED = 2.0 / np.pi
DRAWS = 4000  # prior draws by which the centre and the spread of the coordinates are found


@dataclass(frozen=True)
class TestConditions:
    """Conditions of a test."""

    __test__ = False  # for pytest

    actuation: float  # ksi or kip
    session: str = ""  # tests of one session were made together; "" where none is declared
    # velocity (in/s, its peak; if timed), amplitude (in, half the stroke), full_strokes (share of
    # the path that lies in full strokes: 1 for a sine, 0.2 for an earthquake), and `CONDITIONS`
    covariates: Mapping[str, float] = field(default_factory=dict)
    device: str = ""


def setting_of(
    trace: Trace, session: str = "", device: str = "", conditions: Mapping[str, float] | None = None
) -> TestConditions:
    """Setting under which a trace was made, or is to be predicted."""
    check_trace(trace, FitError)
    if not np.isfinite(trace.reference_actuation):
        raise FitError("a prediction needs the trace's actuation, in ksi (pressure) or kip (force)")
    x = trace.displacement
    strokes = np.abs(np.diff(x[np.unique([0, *trace.turning_points, trace.samples - 1])]))
    full = strokes[strokes >= FULL * strokes.max(initial=0.0)].sum()
    speed = {"velocity": float(np.quantile(np.abs(trace.velocity), 0.98))} if trace.timed else {}
    covariates = speed | {
        "amplitude": 0.5 * float(np.ptp(x)),
        "full_strokes": float(full / max(strokes.sum(), 1e-300)),
    }
    covariates |= conditions or {}
    return TestConditions(trace.reference_actuation, session, covariates, device)


def planned_setting(
    tested: Sequence[TestConditions],
    actuation: float,
    session: str,
    planned: Mapping[str, float | None],
) -> TestConditions:
    """Setting of a test before it is made."""
    units = {"velocity": "in/s", "amplitude": "in"}
    level = real_number("the planned actuation", actuation, FitError, (0.0, np.inf))
    covariates = {}
    for name, value in planned.items():
        if value is None:
            tested_values = [
                s.covariates[name] for s in tested if s.covariates.get(name, 0.0) > 0.0
            ]
            covariates[name] = geometric_mean(tested_values) if tested_values else 1.0
        else:
            label = f"the planned {name} ({units.get(name, '1')})"
            covariates[name] = real_number(label, value, FitError, (0.0, np.inf), exclusive=True)
    return TestConditions(level, session, covariates)


def same_level(actuation: float, reference: float) -> bool:
    """Whether two actuations are at one level."""
    return abs(actuation - reference) <= SAME_LEVEL * max(actuation, reference)


def levels_of(settings: Sequence[TestConditions]) -> list[list[int]]:
    """Indices of the tests at each level of actuation, lowest level first."""
    levels: list[list[int]] = []
    for j in np.argsort([setting.actuation for setting in settings]).tolist():
        if levels and same_level(settings[levels[-1][0]].actuation, settings[j].actuation):
            levels[-1].append(j)
        else:
            levels.append([j])
    return levels


def with_zeros(settings: Sequence[TestConditions]) -> tuple[TestConditions, ...]:
    """The settings with an actuation of zero where it is next to nothing."""
    actuation = np.array([setting.actuation for setting in settings])
    if not (np.all(actuation >= 0) and np.max(actuation) > 0):
        raise FitError(
            "the laws need an actuation above zero in at least one calibrated test, and none that "
            "is negative"
        )
    zero = actuation < ZERO * actuation.max()
    return tuple(replace(s, actuation=0.0) if z else s for s, z in zip(settings, zero, strict=True))


def varies(settings: Sequence[TestConditions], covariate: str) -> bool:
    """Whether a covariate varies between settings by more than a fifth."""
    values = [setting.covariates.get(covariate, 0.0) for setting in settings]
    return min(values) > 0.0 and max(values) > 1.2 * min(values)


def geometric_mean(values: Sequence[float]) -> float:
    """Geometric mean of numbers above zero."""
    return float(np.exp(np.mean(np.log(values))))


def folds_beyond(setting: TestConditions, tested: Sequence[TestConditions]) -> tuple[float, float]:
    """E-folds by which the stroke, and speed or frequency, lie outside those of the tests.

    Of speed and frequency the one that lies farther outside counts.
    """

    def logs(s: TestConditions) -> Array:
        stroke, speed = (np.log(s.covariates.get(n) or np.nan) for n in ("amplitude", "velocity"))
        return np.array([stroke, speed, speed - stroke])

    tests, target = np.array([logs(s) for s in tested]), logs(setting)
    lowest, highest = np.fmin.reduce(tests, axis=0), np.fmax.reduce(tests, axis=0)
    # what is not known, of a setting or of all tests, is not outside
    distance = np.fmax(np.fmax(target - highest, lowest - target), 0.0)
    return float(distance[0]), float(distance[1:].max())


@dataclass(frozen=True)
class Coordinates:
    """Coordinates x (n, D) in which tests are compared: unconstrained, in units of the prior.

    In one test F_c trades off with F_s and ẋ_s, and d2 with d3: only their sums or products are
    known well, and these are what differs between tests. So the coordinate of F_c,fwd (and bwd) is
    the logarithm of the slip force at a speed common to all tests, F_c [1 + (F_s/F_c - 1)
    exp(-(v/ẋ_s)²)]; that of d2 is log(d2 + d3), the width of the gap, and that of d3 is log(d3/d2).
    All others are those of their priors. These changes of variables have determinant 1. Prior units
    have mean 0 and standard deviation 1 under the prior of a test by itself.
    """

    names: tuple[str, ...]  # quantities, D of them, in the order of the coordinates
    priors: Mapping[str, Prior]
    speed: float  # in/s, at which slip forces are compared
    by_name: bool = True  # whether d2 is a gap's, and so on: not those of a user's own model
    centre: Array = field(init=False)  # (D,), mean and sd of the coordinates under the priors
    spread: Array = field(init=False)

    def __post_init__(self) -> None:
        rng, priors = np.random.default_rng(0), [self.priors[name] for name in self.names]
        samples = [prior.coordinate(prior.draw(rng, DRAWS)) for prior in priors]
        q = self._compared(np.stack(samples, axis=1))
        object.__setattr__(self, "centre", q.mean(axis=0))
        object.__setattr__(self, "spread", q.std(axis=0))

    def _column(self, name: str) -> int | None:
        """Column of a quantity on the positive half line; None where there is none."""
        is_logarithmic = self.by_name and name in self.names and self.priors[name].on_half_line
        return self.names.index(name) if is_logarithmic else None

    def _shifts(self, q: Array) -> list[tuple[int, Array]]:
        """Column of F_c and log of the slip force at `speed` over F_c, (n,), by direction."""
        shifts, values = [], {}
        for side in ("fwd", "bwd"):
            excess, kinetic = f"static_excess_{side}", self._column(f"Fc_{side}")
            if kinetic is not None and {excess, "v_s"} <= set(self.names):
                for name in ("v_s", excess):
                    values[name] = self.priors[name].value(q[:, self.names.index(name)])
                stribeck = np.exp(-((self.speed / np.maximum(values["v_s"], 1e-12)) ** 2))
                shifts.append((kinetic, np.log1p(values[excess] * stribeck)))
        return shifts

    @cached_property
    def _gap(self) -> tuple[int, int] | None:
        """Columns of d2 and d3; None where they are not both there."""
        d2, d3 = self._column("d2"), self._column("d3")
        return None if d2 is None or d3 is None else (d2, d3)

    def _compared(self, values: Array) -> Array:
        """Compared coordinates, of those of the priors, (n, D)."""
        q = values.copy()
        for kinetic, shift in self._shifts(values):
            q[:, kinetic] += shift
        if self._gap:
            d2, d3 = self._gap
            q[:, d2] = np.logaddexp(values[:, d2], values[:, d3])
            q[:, d3] = values[:, d3] - values[:, d2]
        return q

    def of_priors(self, x: Array) -> Array:
        """Coordinates of the priors, (n, D), of x (n, D)."""
        q = self.centre + self.spread * x
        shifted = q.copy()
        for kinetic, shift in self._shifts(q):
            shifted[:, kinetic] -= shift
        if self._gap:
            d2, d3 = self._gap
            shifted[:, d2] = q[:, d2] - np.logaddexp(0.0, q[:, d3])
            shifted[:, d3] = shifted[:, d2] + q[:, d3]
        return shifted

    def values(self, x: Array) -> dict[str, Array]:
        """Quantities at x (n, D), by name, (n,) each, internal units."""
        q = self.of_priors(x)
        return {name: self.priors[name].value(q[:, k]) for k, name in enumerate(self.names)}

    def value(self, name: str, x: Array) -> Array:
        """A quantity whose coordinate is its prior's, such as the noise, at x (..., D), (...)."""
        k = self.names.index(name)
        return self.priors[name].value(self.centre[k] + self.spread[k] * x[..., k])

    def of(self, values: Mapping[str, Array]) -> Array:
        """Coordinates x (n, D) of quantities by name, (n,) each; of a missing one, its median."""
        n = max(np.size(value) for value in values.values())
        filled = {**{k: np.full(n, self.priors[k].median) for k in self.names}, **values}
        q = [self.priors[name].coordinate(np.atleast_1d(filled[name])) for name in self.names]
        return (self._compared(np.stack(q, axis=1)) - self.centre) / self.spread

    def log_prior(self, x: Array, columns: NDArray[np.bool_]) -> Array:
        """Log density of some coordinates of x (n, D) under their priors, in prior units, (n,)."""
        q, total = self.of_priors(x), np.zeros(len(x))
        for k in np.flatnonzero(columns):
            total += self.priors[self.names[k]].log_density(q[:, k]) + np.log(self.spread[k])
        return total


class Effect(NamedTuple):
    """Random effect of levels, sessions or devices on some quantities, with one sd.

    A level's effect is like that of a wrong actuation, wrong by as much at every level: in the
    logarithm of a force its sd is in inverse proportion to the actuation.
    """

    name: str  # "level", "session" or "device"
    group: str  # of the prior file's scatter
    members: tuple[int, ...]  # the quantities
    homes: Sequence[object]  # cells, sessions or devices that it differs between
    scale: float  # of the half-normal prior of the sd


@dataclass(frozen=True, eq=False)
class Design:
    """Layout of the mixed model of a campaign's J tests; made by `design_of`."""

    names: tuple[str, ...]  # the d quantities that tests share, the first of the coordinates
    coordinates: Coordinates  # of these, and of each test's own: start in the gap, shapes of laws
    spread: Array  # (d,): prior units
    laws: Mapping[str, str]  # of each quantity that follows the actuation; or "compare"
    dependence: Mapping[str, tuple[str, ...]]  # covariates that quantities follow
    settings: tuple[TestConditions, ...]  # of the tests
    groups: Mapping[str, str]  # scatter group of each quantity
    scatter_sd: Array  # (d,): scale of the prior of τ
    common: NDArray[np.bool_]  # (d,): quantities that are the same in all tests
    reference: float  # ksi or kip: actuation p0 of the levels
    leveled: bool = True  # whether levels may deviate from the laws

    @cached_property
    def covariates(self) -> dict[str, float]:
        """Geometric mean of each covariate over the tests."""
        names = {c for covariates in self.dependence.values() for c in covariates} - {*CONDITIONS}
        names |= {"amplitude", "velocity"}
        values = {c: [s.covariates.get(c, 0.0) for s in self.settings] for c in sorted(names)}
        return {c: geometric_mean(v) for c, v in values.items() if min(v) > 0}

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """Session and level of the tests, each once."""
        return tuple(dict.fromkeys(self.cell_of(s) for s in self.settings))

    @cached_property
    def sessions(self) -> tuple[str, ...]:
        """Sessions of the tests, each once."""
        return tuple(dict.fromkeys(s.session for s in self.settings))

    @cached_property
    def devices(self) -> tuple[str, ...]:
        """Devices of the tests, each once."""
        return tuple(dict.fromkeys(s.device for s in self.settings))

    def home(self, effect: str, setting: TestConditions) -> object:
        """Cell, session or device of a setting."""
        return self.cell_of(setting) if effect == "level" else getattr(setting, effect)

    @cached_property
    def informs(self) -> NDArray[np.bool_]:
        """Whether each test informs each quantity, (J, d).

        A law without an intercept says nothing of a test at zero actuation: there the quantity has
        the prior of a test by itself.
        """
        informative = np.ones((len(self.settings), len(self.names)), dtype=bool)
        zero = [s.actuation == 0 for s in self.settings]
        for name, law in self.laws.items():
            if not all(LAWS[law_name].intercept for law_name in self.considered(law)):
                informative[zero, self.names.index(name)] = False
        return informative

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """Effects of levels on what has a law, of sessions and devices on all that has scatter."""
        followers = [self.names.index(n) for n in self.laws] if self.leveled else []
        free_indices, effects = self.free.tolist(), []
        for name, quantities, homes, wider in (
            ("level", followers, self.cells, WIDER),
            ("session", free_indices, self.sessions, 1.0),
            ("device", free_indices, self.devices, 1.0),
        ):
            members: dict[str, list[int]] = {}
            for k in quantities:
                informative = [self.settings[j] for j in np.flatnonzero(self.informs[:, k])]
                count = len(
                    levels_of(informative)
                    if name == "level"
                    else {getattr(s, name) for s in informative}
                )
                if count >= (LEVELS if name == "level" else 2):
                    members.setdefault(self.groups[self.names[k]], []).append(k)
            for group, columns in members.items():
                scale = wider * float(self.scatter_sd[columns[0]])
                effects.append(Effect(name, group, tuple(columns), homes, scale))
        return tuple(effects)

    @cached_property
    def _columns(self) -> Index:
        """Quantity and effect (-1 for none) of each linear coefficient, (2, Z)."""
        pairs = [(k, -1) for k in range(len(self.names))]
        pairs += [
            (self.names.index(n), -1)
            for n, covariates in self.dependence.items()
            for _ in covariates
        ]
        for e, effect in enumerate(self.effects):
            pairs += [(k, e) for k in effect.members for _ in effect.homes]
        return np.array(pairs).T

    @property
    def quantity(self) -> Index:
        """Quantity of each linear coefficient, (Z,)."""
        return np.asarray(self._columns[0])

    @property
    def effect(self) -> Index:
        """Effect of each linear coefficient, (Z,); -1 for a level or a slope."""
        return np.asarray(self._columns[1])

    def columns(self, effect: int) -> Index:
        """Numbers of the coefficients of an effect: (its quantities, cells or sessions)."""
        columns = np.flatnonzero(self.effect == effect)
        return columns.reshape(len(self.effects[effect].members), -1)

    @property
    def z_sd(self) -> Array:
        """Prior sd of the linear coefficients that are no effects: levels and slopes."""
        sd = np.full(np.count_nonzero(self.effect < 0), SENSITIVITY)
        sd[: len(self.names)] = 1.0
        pairs = [c for covariates in self.dependence.values() for c in covariates]
        sd[len(self.names) :][[c in CONDITIONS for c in pairs]] = DRIFT
        return sd

    @property
    def tabled(self) -> NDArray[np.bool_]:
        """Whether each of the levels and slopes counts as shown by the table of the laws."""
        shown = np.ones(self.z_sd.size, dtype=bool)
        if self.coordinates.by_name:  # of a user's own model all count: it shows all parameters
            shown[: len(self.names)] = [name in self.laws for name in self.names]
        return shown

    def changed(self, covariate: str, setting: TestConditions) -> float:
        """Change of a condition from the mean of the tests, over their span.

        A setting that does not say it has the latest date or count of the tests, and their mean
        temperature.
        """
        values = np.array([s.covariates[covariate] for s in self.settings])
        default = values.mean() if covariate == "temperature" else values.max()
        value = setting.covariates.get(covariate, default)
        return float((value - values.mean()) / (np.ptp(values) or 1.0))

    @property
    def free(self) -> Index:
        """Columns of the quantities that differ between tests, (F,)."""
        return np.flatnonzero(~self.common)

    @property
    def shapes(self) -> tuple[tuple[str, str], ...]:
        """Quantity and shape of each shape that is inferred."""
        return tuple((name, s) for name, law in self.laws.items() for s in shapes_of(law))

    def considered(self, law: str) -> tuple[str, ...]:
        """Laws that a name stands for; with tests at zero actuation those that hold there."""
        if law != COMPARE:
            return (law,)
        zero = any(s.actuation == 0 for s in self.settings)
        return tuple(name for name in LAWS if LAWS[name].intercept or not zero)

    def cell_of(self, setting: TestConditions) -> Cell:
        """Session, and the actuation of calibrated tests at the setting's level, if any."""
        levels = [s.actuation for s in self.settings if same_level(s.actuation, setting.actuation)]
        return setting.session, levels[0] if levels else setting.actuation

    def level_covariance(self, rows: Sequence[Cell], other_cells: Sequence[Cell]) -> Array:
        """Covariance of a level's effect between cells, for an sd of 1 at the reference.

        Matérn 3/2 over the logarithm of the actuation, within a session; zero actuation is far from
        all others.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = [np.log([actuation for _, actuation in cells]) for cells in (rows, other_cells)]
            distance = np.abs(np.subtract.outer(*logs))
            sizes = [np.clip(self.reference / np.exp(log), *BOUNDS) for log in logs]
        distance[np.isnan(distance)] = 0.0  # zero and zero
        r = np.minimum(np.sqrt(3.0) * distance / ALIKE, 1e3)
        same_session = np.array([[a[0] == b[0] for b in other_cells] for a in rows])
        return np.asarray(np.outer(*sizes) * same_session * (1.0 + r) * np.exp(-r))

    def krige(self, session: str, actuations: ArrayLike) -> tuple[Array, Array]:
        """Level effects of a session at actuations (m,) given those of the tests' cells (kriging).

        Weights (m, cells), and covariance (m, m) of what the cells do not tell, for an sd of 1.
        """
        levels = np.atleast_1d(actuations)
        cells = [self.cell_of(TestConditions(float(level), session)) for level in levels]
        covariance = self.level_covariance(self.cells, self.cells) + 1e-9 * np.eye(len(self.cells))
        across = self.level_covariance(cells, self.cells)
        weights = np.asarray(np.linalg.solve(covariance, across.T).T)
        for i, cell in enumerate(cells):
            if cell in self.cells:
                weights[i] = np.eye(len(self.cells))[self.cells.index(cell)]
        remainder = self.level_covariance(cells, cells) - weights @ across.T
        tested = np.array([cell in self.cells for cell in cells])
        remainder[tested], remainder[:, tested] = 0.0, 0.0
        return weights, 0.5 * (remainder + remainder.T)

    def row(self, setting: TestConditions, *, level_effects: bool = True) -> Array:
        """Weights of the linear coefficients z under a setting, (Z,), of a tested level or none."""
        blocks: list[Array] = [np.ones(len(self.names))]
        for name, covariates in self.dependence.items():
            for c in covariates:
                spread = self.spread[self.names.index(name)]
                if c in CONDITIONS:
                    blocks.append(np.array([self.changed(c, setting) / spread]))
                    continue
                tested_values = [s.covariates[c] for s in self.settings]
                clipped = np.clip(setting.covariates[c], min(tested_values), max(tested_values))
                blocks.append(np.array([np.log(clipped / self.covariates[c]) / spread]))
        for effect in self.effects:
            applies = level_effects or effect.name != "level"
            group = self.home(effect.name, setting) if applies else None
            weights = np.array([float(group == group_name) for group_name in effect.homes])
            blocks += [weights / self.spread[k] for k in effect.members]
        return np.concatenate(blocks)

    def linear(self, z: Array, rows: Array) -> Array:
        """Levels, slopes and effects A z of coefficients (n, Z) and rows (m, Z), (n, m, d)."""
        values, quantity = np.zeros((len(z), len(rows), len(self.names))), self.quantity
        for k in range(len(self.names)):
            columns = quantity == k
            values[..., k] = z[:, columns] @ rows[:, columns].T
        return values

    def law_shapes(self, q: Array, choice: Index) -> tuple[Array, Array]:
        """Share and exponent of each law, (n, L) each.

        They are of the coordinates of `shapes` (n, S), and of numbers of laws, (L,) or (n, L).
        """
        shapes: list[Array] = []
        for shape in ("share", "exponent"):
            defaults = np.array([getattr(LAWS[law], shape) for law in LAW_NAMES], dtype=np.float64)
            value: Array = defaults[np.broadcast_to(choice, (len(q), choice.shape[-1]))]
            # NaN where it is inferred
            for column, name in enumerate(self.laws):
                if (name, shape) in self.shapes:
                    values = q[:, self.shapes.index((name, shape))]
                    values = scipy.special.expit(values) if shape == "share" else values
                    value[:, column] = np.where(
                        np.isnan(value[:, column]), values, value[:, column]
                    )
            shapes.append(value)
        share, exponent = shapes
        return share, exponent

    def offsets(self, share: Array, exponent: Array, actuation: Array) -> Array:
        """Laws (n, L) in prior units at actuations (m,), (n, m, d)."""
        offsets = np.zeros((len(share), actuation.size, len(self.names)))
        for column, name in enumerate(self.laws):
            k = self.names.index(name)
            shape = share[:, [column]], exponent[:, [column]]
            followed = ratio(actuation / self.reference, *shape)
            offsets[..., k] = np.log(np.maximum(followed, 1e-300)) / self.spread[k]
        return offsets


def design_of(
    priors: PriorFile,
    names: Sequence[str],
    settings: Sequence[TestConditions],
    laws: Mapping[str, str] | None = None,
    dependence: Mapping[str, Sequence[str]] | None = None,
    model: Model | None = None,
) -> Design:
    """Design of the mixed model of tests under these settings.

    `names` are the quantities of the tests, and the shapes, such as "exponent_Fc_fwd", that tests
    have to themselves along a changing actuation. The laws are the paper's where none are given.
    """
    quantities, defaults = known_quantities(model), default_laws(model)
    shapes = {f"{shape}_{law}": shape for law in defaults for shape in ("share", "exponent")}
    pooled = (n for n in names if n not in shapes)
    shared = tuple(n for n in pooled if n not in quantities or quantities[n].pooled)
    chosen_laws = {n: law for n, law in (defaults | dict(laws or {})).items() if n in shared}
    for name in chosen_laws:
        if priors.parameters[name].lower != 0.0 or np.isfinite(priors.parameters[name].upper):
            raise FitError(f"a law for {name} needs a prior on the positive half line")
    group_of = {name: group for group, s in priors.scatter.items() for name in s.parameters}
    for name in shared:
        if name not in group_of:
            raise PriorError(f"prior file {priors.path.name} has no [scatter] group with {name}")
    settings = with_zeros(settings)
    speeds = [s.covariates.get("velocity", 0.0) for s in settings]
    speed = geometric_mean([v for v in speeds if v > 0] or [1.0])
    everything = (*shared, *(n for n in names if n == "start" or n in shapes))
    prior_of = {
        n: shape_prior(shapes[n]) if n in shapes else priors.parameters[n] for n in everything
    }
    coordinates = Coordinates(
        everything, prior_of, USUAL_SPEED * speed, model is None or bool(model.standard_names)
    )
    return Design(
        names=shared,
        coordinates=coordinates,
        spread=coordinates.spread[: len(shared)],
        laws=chosen_laws,
        dependence={n: tuple(c) for n, c in (dependence or {}).items() if n in shared and c},
        settings=settings,
        groups={n: group_of[n] for n in shared},
        scatter_sd=np.array([priors.scatter[group_of[n]].sd for n in shared]),
        common=np.array([priors.scatter[group_of[n]].sparse for n in shared]),
        reference=geometric_mean([s.actuation for s in settings if s.actuation > 0]),
    )
