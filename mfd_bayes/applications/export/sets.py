"""Parameter sets of a device for a step in another program: nominal, lower, upper, and draws.

The draws are "this device tested again", as `draw_device` has them. The others are one vector each,
of a property: the slip force forward and backward, in the motion of a test (or of a sine) at the
level of actuation. It is that of the data sheet, whose nominal value is the mean of the mean
property, and whose bounds are the quantiles of a measurement of the device tested again
(`evaluation.bounds`). All parameters are the medians of the mean property; then kinetic and static
friction of each direction are multiplied until the computed slip force is the nominal value, or the
bound. So the bounds are those of slip forces; gap, stiffness and start are the nominal ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import CampaignError
from mfd_bayes.evaluation.bounds import bounds, drawn_properties, places_of, with_gains
from mfd_bayes.evaluation.properties import properties_of
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.models import MODELS
from mfd_bayes.population.design import SAME_LEVEL, TestConditions, ratio, same_level
from mfd_bayes.population.population import LevelEffects
from mfd_bayes.records.trace import Harmonic, Trace
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.tested_range import FAR, PARTIAL

Array = NDArray[np.float64]

SIDES = ("slip_fwd", "slip_bwd")  # properties whose bounds the sets have
PROBABILITY, BASIS = 0.95, "observation"  # of the bounds of the data sheet
TYPICAL_DRAWS = 1000  # of the nominal set, however few draws are exported
CYCLES = 3  # of a motion that was not tested, as the sheet has it
MOST_LEVELS = 64  # DAMPER_LEVELS of damper.h
SOLVED = 1e-12  # relative error of a slip force at which its friction is found
FIXED = ("nominal", "lower", "upper")


class Laws(NamedTuple):
    """How parameters follow the actuation: see `damper_law` in damper.h; L laws, G levels."""

    share: Array  # (n, L)
    exponent: Array  # (n, L)
    deviation: Array  # (n, L, G)


@dataclass(frozen=True, eq=False)
class ParameterSets:
    """Sets of a model's parameters in internal units, and what they have in common.

    Attributes
    ----------
    names : tuple of str, (n,)
    theta, start : (n, p), (n,)
    laws : Laws
        Of `Model.laws`, in its order.
    level, reference : float, ksi or kip
        Actuation at which theta stands, and that of the laws.
    grid : (G,), ksi or kip
        Actuations of the deviations, increasing; of one alone there are none.
    tested, reach : (float, float), ksi or kip
        Actuations that were tested, and that a step takes.
    unit : str
        Of the actuation; "" of a device without one.
    condition : str
        Motion of which the slip forces are the sheet's, in words.
    slip : (3, 2), kip
        Slip forces forward and backward, of "nominal", "lower" and "upper".
    """

    model: Model
    names: tuple[str, ...]
    theta: Array
    start: Array
    laws: Laws
    level: float
    reference: float
    grid: Array
    tested: tuple[float, float]
    reach: tuple[float, float]
    unit: str
    condition: str = ""
    slip: Array = field(default_factory=lambda: np.zeros((0, 2)))

    def factors(self, actuation: float) -> dict[str, Array]:
        """Factors at an actuation of what follows it, (n,) each, as `Model.step` takes them."""
        if not self.unit:
            return {}
        values = _factors(self.laws, self.grid, self.reference, self.level, np.array([actuation]))
        scales = dict(zip(self.model.laws, values[..., 0].T, strict=True))
        tied = self.model.shared_laws.items()
        return scales | {name: scales[followed] for name, followed in tied}


def _factors(laws: Laws, grid: Array, reference: float, level: float, actuation: Array) -> Array:
    """Factors of the parameters with a law at actuations (m,), over those at a level, (n, L, m)."""
    share, exponent = laws.share[..., None], laws.exponent[..., None]
    at_level = ratio(np.array([level / reference]), share, exponent)
    factors = ratio(actuation / reference, share, exponent) / np.where(at_level > 0, at_level, 1.0)
    factors = np.where(at_level > 0, factors, 1.0)
    if grid.size < 2:
        return factors
    position = np.log(np.maximum(actuation, 1e-300))
    lines = np.array([np.interp(position, np.log(grid), unit) for unit in np.eye(grid.size)])
    return np.asarray(factors * np.exp(laws.deviation @ lines))


def middle_level(run: Run) -> float:
    """Median level of actuation of a run's calibrated tests, ksi or kip."""
    return float(np.median([test.trace.reference_actuation for test in run.tests.values()]))


def check_model(run: Run, use: str) -> None:
    """Refuse a run of a model that is not the package's: its step is Python alone."""
    name = run.manifest.settings.model
    if name not in MODELS:
        raise CampaignError(
            f"{use} has the steps of {', '.join(MODELS)}, and this run has a model of its own, "
            f"{name}, in Python only: give --to csv and write its step in your program, or call "
            "run.model.step in Python"
        )


def parameter_sets(
    run: Run, level: float, draws: int, seed: int = 1, *, extrapolate: bool = False
) -> ParameterSets:
    """Nominal, lower and upper set of a run's device at a level of actuation, and draws.

    The range of actuations is the tested one and what lies not far outside of it; all of them with
    `extrapolate`.

    Raises
    ------
    CampaignError
        When the run has a model of its own, or the device does not slip in the motion.
    """
    check_model(run, "a step in C")
    model, population = run.model, run.population
    spans = {span.name: (span.lowest, span.highest) for span in run.tested}
    tested = spans.get("actuation", (level, level))
    tested = tested[0] * (1.0 - SAME_LEVEL), tested[1] * (1.0 + SAME_LEVEL)
    reach = (0.0, 1e300) if extrapolate else (tested[0] / FAR, FAR * tested[1])
    grid = population.grid(level, [tested[0] / FAR, FAR * tested[1]])
    if grid.size > MOST_LEVELS:
        thin = np.linspace(0, grid.size - 1, MOST_LEVELS - 1).astype(np.intp)
        grid = np.union1d(grid[thin], [level])
    theta, start, laws = _drawn(run, level, grid, draws, seed)
    reference = population.design.reference if run.manifest.axes.actuated else 1.0
    # of one vector: medians, and deviations to the mean factor of the draws
    sample = _drawn(run, level, grid, TYPICAL_DRAWS, seed)
    share, exponent = (np.median(shape, axis=0)[None] for shape in sample.laws[:2])
    typical = Laws(share, exponent, np.zeros((1, len(model.laws), grid.size)))
    factor, mean_factor = (
        _factors(each, grid, reference, level, grid).mean(axis=0) for each in (typical, sample.laws)
    )
    positive = (factor > 0.0) & (mean_factor > 0.0)
    deviation = np.log(np.where(positive, mean_factor, 1.0) / np.where(positive, factor, 1.0))
    typical = typical._replace(deviation=deviation[None])
    median, place = np.median(sample.theta["mean"], axis=0), float(np.median(sample.start))
    trace, condition, slip = _sheet(run, level)
    fixed = [_with_slip(model, median, place, trace, row, condition) for row in slip]
    repeated = (np.repeat(a, len(FIXED), axis=0) for a in typical)
    return ParameterSets(
        model,
        (*FIXED, *map(str, range(1, draws + 1))),
        np.concatenate([fixed, theta["new_test"]]),
        np.concatenate([np.full(len(FIXED), place), start]),
        Laws(*(np.concatenate(pair) for pair in zip(repeated, laws, strict=True))),
        level,
        reference,
        grid,
        tested,
        reach,
        run.actuation_unit if run.manifest.axes.actuated else "",
        condition,
        slip,
    )


class _Drawn(NamedTuple):
    """Draws of a device: parameters of "mean" and "new_test", (n, p), start, (n,), and laws."""

    theta: Mapping[str, Array]
    start: Array
    laws: Laws


def _drawn(run: Run, level: float, grid: Array, draws: int, seed: int) -> _Drawn:
    """Draws of the device at a level, as in `draw_dampers`, and of its laws over a grid."""
    model, population = run.model, run.population
    names = list(population.design.laws)
    index = population.draw_index(draws, level, np.random.default_rng([seed, 0]))
    numbers = population.draw_numbers(draws, grid.size, np.random.default_rng([seed, 1]))
    effects = population.level_effects(index, "", grid, numbers.level)
    setting = TestConditions(level, "", dict(population.design.covariates))
    theta = {}
    for kind in ("mean", "new_test"):
        scatter = kind == "new_test"
        x = np.add(*population.parts(setting, index, numbers, effects, scatter=scatter))
        unshared = population.unshared(model, x, numbers.start)
        theta[kind] = model.theta(unshared | population.values(x))
    shapes = [np.zeros((draws, len(model.laws))), np.ones((draws, len(model.laws)))]
    for name, values in zip(("share", "exponent"), shapes, strict=True):
        pair = getattr(population.draws, name), getattr(population.alternatives, name)
        table = np.concatenate([pair[0].reshape(population.size, -1), pair[1]])[index]
        for column, law in enumerate(model.laws):
            if law in names:
                values[:, column] = table[:, names.index(law)]
    laws = Laws(shapes[0], shapes[1], _deviations(model, effects, level, draws))
    return _Drawn(theta, unshared["start"], laws)


def _deviations(model: Model, effects: LevelEffects, level: float, draws: int) -> Array:
    """Logarithmic deviations from the laws at the levels of effects, less those at a level."""
    at_level = effects.at(level)
    deviation = np.zeros((draws, len(model.laws), effects.actuation.size))
    for column, name in enumerate(model.laws):
        if name in at_level:
            deviation[:, column] = effects.log[name] - at_level[name][:, None]
    return deviation


def _sheet(run: Run, level: float) -> tuple[Trace, str, Array]:
    """Motion at a level, in words too, and its nominal, lower and upper slip forces, (3, 2), kip.

    As the data sheet has them, of a test at the level or, where there is none, of a sine like those
    of the tests.
    """
    traces = {name: test.trace for name, test in run.tests.items()} | dict(run.held_out)
    conditions = {name: run.manifest.tests[name].conditions for name in traces}
    cyclic = [name for name in traces if conditions[name].get("partial", 1.0) <= PARTIAL]
    matching = [
        name
        for name in cyclic
        if same_level(traces[name].reference_actuation, level) and not traces[name].varying
    ]
    if matching:
        first = matching[0]
        trace, condition = traces[first], f"the motion of test {first}"
        alike = [name for name in matching if _alike(conditions[name], conditions[first])]
        devices = run.manifest.settings.devices
        places = list(dict.fromkeys((run.session(name), devices[name]) for name in alike))
    else:
        values = [conditions[name] for name in cyclic or traces]
        stroke = float(np.median([each["stroke"] for each in values]))
        speed = float(np.median([each.get("speed", np.pi * stroke) for each in values]))
        frequency = speed / (np.pi * stroke)
        trace = Harmonic(0.5 * stroke, frequency, CYCLES, run.system.axes.timed).trace(level)
        words = run.system.words([0.5 * stroke], "in", 3)
        condition, places = f"a sine of {words}, {frequency:.3g} Hz", list(places_of(run))
    draws = with_gains(run, drawn_properties(run, trace, places))
    rows = [bounds(draws["mean"][side], draws[BASIS][side], PROBABILITY) for side in SIDES]
    return trace, condition, np.array([[row[name] for row in rows] for name in FIXED])


def _alike(first: Mapping[str, float], second: Mapping[str, float]) -> bool:
    """Whether two tests have about the same stroke and frequency."""
    pairs = [(first.get(key, 0.0), second.get(key, 0.0)) for key in ("stroke", "frequency")]
    return all(abs(a - b) <= 0.05 * max(a, b) for a, b in pairs)


def _with_slip(
    model: Model, theta: Array, start: float, trace: Trace, slip: Array, condition: str
) -> Array:
    """Parameters whose slip forces in a motion are these, (2,), kip: friction is multiplied."""
    theta = theta.copy()
    for _ in range(60):
        force = model.force(theta[None], trace, np.array([start]))
        computed = properties_of(trace, force)
        now = np.array([float(computed[side][0]) for side in SIDES])
        if not (np.all(np.isfinite(now) & (now > 0)) and np.all(slip > 0)):
            break
        if np.all(np.abs(now - slip) <= SOLVED * slip):
            return theta
        for name, factor in zip(model.slip_forces, slip / now, strict=True):
            tied = [n for n, followed in model.shared_laws.items() if followed == name]
            theta[[model.parameters.index(n) for n in (name, *tied)]] *= factor
    raise CampaignError(
        f"the data sheet has no slip force in {condition}, at the level of the sets: there is no "
        "nominal set, and no bound. Give an --actuation at which the device slips"
    )
