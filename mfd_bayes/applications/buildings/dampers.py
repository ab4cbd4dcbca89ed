"""Draws of a building's dampers, and their bounds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.applications.buildings.building import Array, Building, Device, ResponseLimits
from mfd_bayes.friction.model import Columns, Model, State
from mfd_bayes.population.design import TestConditions
from mfd_bayes.population.population import (
    FINE,
    KNOTS,
    Latents,
    Population,
    TravelBasis,
    slip_force_of,
)

Rows = NDArray[np.intp]


# --- its dampers, and springs that yield

KINDS = ("new_test", "mean")
"""With each damper's own scatter from test to test, or the mean property alone."""

FEWEST = 10  # fewest draws of a response
BOUND = 0.95  # probability between the lower and the upper design value of a device
BOUND_DRAWS = 1000  # draws of the bounds: few would leave them to chance
PLACES = 39  # in the gap, among which that of a bound is
GAP = frozenset({"gap", "d2", "d3"})  # parameters that together are the width of a gap
RIGID = 0.001  # travel, in, at which almost rigid friction slips
SETTLE = float(np.expm1(np.log1p(FINE) / (KNOTS - 1)) / FINE)
"""Share of the longest stroke after a turn, over which a discrepancy goes to its new side."""


class _ElastoPlastic(Model):
    """Springs of stiffness k that slip at ±F_y: dF = k dx while |F| < F_y."""

    name = "elastoplastic"

    def advance(
        self, state: State, displacement: Array, velocity: Array, dt: Array, scales: Columns
    ) -> Columns:
        """Force of each spring after a way."""
        c = state.constants
        force = state.memory["spring"] + c["stiffness"] * (displacement - state.displacement)
        return {"spring": np.minimum(np.maximum(force, -c["strength"]), c["strength"])}

    def total(self, state: State) -> Array:
        """Force beside that of the linear structure, (n,), kip."""
        elastic = state.constants["elastic"] * state.displacement
        return np.asarray(state.memory["spring"] - elastic)


class ElastoPlastic(State):
    """A state of such springs."""

    @classmethod
    def at_rest(cls, stiffness: Array, strength: Array, elastic: Array | None = None) -> Self:
        """Springs without force at displacement 0.

        `elastic` is the stiffness whose elastic force is subtracted, (n,), kip/in: that of a storey
        which the linear structure has already, so that the force here is 0 until it yields.
        """
        zero = np.zeros(stiffness.size)
        constants = {"stiffness": stiffness, "strength": strength}
        constants["elastic"] = zero if elastic is None else elastic
        return cls(_ElastoPlastic(), constants, {"spring": zero}, zero, zero, {})


@dataclass(frozen=True, eq=False)
class Leftover:
    """The model's discrepancy as a force of q dampers; a state as `friction.model.State`.

    A turn would let the force jump from one side to the other. It goes there over the first
    `SETTLE` of the longest stroke instead, so that the force is continuous in time.
    """

    basis: TravelBasis
    # (q, 2, KNOTS + 2), kip, values forward and backward, and zeros beyond the longest stroke
    knots: Array
    # (6, q): displacement, in; direction, ±1; displacement at the last turn; stroke before it;
    # force at the last turn, kip, and now
    memory: Array

    @classmethod
    def at_rest(cls, basis: TravelBasis, coefficients: Array, relative: Array) -> Leftover:
        """State before any motion, without force, for no stroke is known.

        `coefficients`, (n, K), kip, are common to the dampers of a building, as to the tests of a
        device; `relative` is the slip force of each damper over the one at which the discrepancy
        stands as it is, (n, m).
        """
        knots = relative[..., None, None] * coefficients.reshape(len(relative), 1, 2, KNOTS)
        knots = np.pad(knots.reshape(-1, 2, KNOTS), ((0, 0), (0, 0), (0, 2)))
        memory = np.zeros((6, relative.size))
        memory[1] = 1.0
        return cls(basis, knots, memory)

    @property
    def force(self) -> Array:
        """Force of each damper, (q,), kip."""
        return np.asarray(self.memory[5])

    def chosen(self, rows: Rows) -> Leftover:
        """That of some dampers."""
        return Leftover(self.basis, self.knots[rows], self.memory[:, rows])

    def replaced(self, rows: Rows, replacement: Leftover) -> Leftover:
        """The same with that of some dampers replaced."""
        memory = self.memory.copy()
        memory[:, rows] = replacement.memory
        return replace(self, memory=memory)

    def step(self, x: Array, velocity: Array, dt: float, scales: object = None) -> Leftover:
        """State at the next displacements, (q,), in."""
        position, direction, turn, stroke, turn_force, force = self.memory
        reversing = (x - position) * direction < 0
        direction = np.where(reversing, -direction, direction)
        stroke = np.where(reversing, np.abs(position - turn), stroke)
        turn, turn_force = (
            np.where(reversing, position, turn),
            np.where(reversing, force, turn_force),
        )
        travel, longest = np.abs(x - turn), self.basis.longest
        # linear between the knots, which are even in log(1 + FINE · travel/longest), as TravelBasis
        knot = np.log1p(FINE * travel / longest) / (np.log1p(FINE) / (KNOTS - 1))
        cell = np.minimum(knot, KNOTS).astype(np.intp)
        row, side, share = np.arange(x.size), (direction < 0).astype(np.intp), knot - cell
        value = (1.0 - share) * self.knots[row, side, cell] + share * self.knots[
            row, side, cell + 1
        ]
        value = np.where(knot < KNOTS, value, 0.0)
        value *= np.clip(4.0 * stroke / self.basis.shortest - 2.0, 0.0, 1.0)
        progress = np.minimum(travel / (SETTLE * longest), 1.0)
        force = progress * value + (1.0 - progress) * turn_force
        return replace(self, memory=np.stack([x, direction, turn, stroke, turn_force, force]))


@dataclass(frozen=True, eq=False)
class Dampers:
    """Dampers of n buildings, m in each."""

    # none for dampers that are almost rigid until they slip; theta is the slip force then
    model: Model | None
    theta: Array  # (n, m, p)
    start: Array  # (n, m), places in the gap at the start
    slip: Array  # (n, m), kip, mean slip forces
    leftover: Leftover | None = None
    # (n, m, T), factors of what follows the actuation, at the times `times`; none
    # for constant actuations
    scales: Mapping[str, Array] = field(default_factory=dict)
    times: Array | None = None
    # (n, m), values by which the draws differ, by the name of the source, for
    # shares of variance
    about: Mapping[str, Array] = field(default_factory=dict)

    @property
    def draws(self) -> int:
        """Number of buildings n."""
        return len(self.theta)

    @property
    def count(self) -> int:
        """Number of dampers in each, m."""
        return int(self.theta.shape[1])

    def slip_forces(self) -> Array:
        """Slip forces forward and backward, (2, n, m), kip; NaN where the model names none."""
        if self.model is None or not self.model.slip_forces:
            return np.full((2, *self.slip.shape), np.nan)
        columns = [self.model.parameters.index(name) for name in self.model.slip_forces]
        return np.moveaxis(self.theta[..., [columns[0], columns[-1]]], -1, 0)

    @property
    def at_rest(self) -> Array:
        """Forces that the dampers hold before the motion, (n, m), kip."""
        return np.asarray(self.state(np.ones(self.count)).force).reshape(self.slip.shape)

    def chosen(self, rows: Rows) -> Dampers:
        """Those of some buildings."""
        places = (rows[:, None] * self.count + np.arange(self.count)).ravel()
        return replace(
            self,
            theta=self.theta[rows],
            start=self.start[rows],
            slip=self.slip[rows],
            leftover=self.leftover and self.leftover.chosen(places),
            scales={name: s[rows] for name, s in self.scales.items()},
            about={name: a[rows] for name, a in self.about.items()},
        )

    def state(self, way: Array) -> Any:
        """The n m dampers at rest, about to move in the directions `way`, (m,) of ±1."""
        if self.model is None:
            slip = self.slip.ravel()
            return ElastoPlastic.at_rest(slip / RIGID, slip)
        theta = self.theta.reshape(-1, self.theta.shape[2])
        direction, zero = np.tile(way, self.draws), np.zeros(len(theta))
        state = self.model.start(theta, self.start.ravel(), direction=direction)
        return state.step(zero, zero, 0.0)


def no_dampers(draws: int = 1) -> Dampers:
    """Of a building without any."""
    return Dampers(None, np.zeros((draws, 0, 1)), np.zeros((draws, 0)), np.zeros((draws, 0)))


def plain_friction(slip: Array) -> Dampers:
    """One building whose dampers are almost rigid until they slip at forces (m,), kip."""
    force = np.asarray(slip, dtype=np.float64)[None]
    return Dampers(None, force[..., None], np.full(force.shape, 0.5), force)


def draw_dampers(
    population: Population,
    model: Model,
    building: Building,
    kind: str = "new_test",
    draws: int = 300,
    seed: int = 1,
    *,
    session: str = "",
    scatter: float = 1.0,
) -> Dampers:
    """Dampers of n draws of a building, from the run's population.

    What tests share (laws, levels, effects of level and session, the discrepancy, whether they
    begin without load) is one draw for all dampers of a building; each has its own scatter from
    test to test and its own place in its gap. The noise of measurements is left out: it belongs to
    load cells. The same seed gives the same random numbers at any actuation, tested or not. A
    factor of the `scatter` other than 1 shows what it does.
    """
    levels = [device.level for device in building.devices]
    if not levels:
        return no_dampers(draws)
    times, histories = building.actuations
    untested = [level for level in levels if not population.within_levels(level)]
    rng = np.random.default_rng([seed, 0])
    index = population.draw_index(draws, (untested or levels)[0], rng)
    varying = times is not None
    driven = np.concatenate([levels, *histories])
    grid = np.unique([*levels, *(population.grid(max(levels), driven) if varying else ())])
    rng = np.random.default_rng([seed, 1])
    shared = population.draw_numbers(draws, grid.size, rng)
    effects = population.level_effects(index, session, grid, shared.level)
    values, variables, scales = [], [], []
    for damper, (level, history) in enumerate(zip(levels, histories, strict=True)):
        setting = TestConditions(level, session, dict(population.design.covariates))
        numbers = _own(shared, np.random.default_rng([seed, 2, damper]))
        mean, scattered = population.parts(
            setting, index, numbers, effects, scatter=kind == "new_test"
        )
        x = mean + scatter * scattered
        unshared = population.unshared(model, x, numbers.start)
        parameters = {**unshared, **population.values(x)}
        typical = slip_force_of(model, {**unshared, **population.values(mean)})
        sources = {
            "law and level": typical,
            "scatter of slip force": np.log(slip_force_of(model, parameters) / typical),
            "gap": model.gap(parameters),
            "start in the gap": parameters["start"],
        }
        values.append(parameters)
        variables.append({name: source for name, source in sources.items() if source is not None})
        scales.append(population.scales(model, history, index, level, effects))
    slip = np.stack([slip_force_of(model, entry) for entry in values], axis=1)
    residual = population.residual
    return Dampers(
        model,
        np.stack([model.theta(entry) for entry in values], axis=1),
        np.stack([entry["start"] for entry in values], axis=1),
        slip,
        Leftover.at_rest(residual.basis, population.knots(index), slip / residual.slip_force),
        {k: np.stack([entry[k] for entry in scales], axis=1) for k in scales[0]} if varying else {},
        times,
        {name: np.stack([entry[name] for entry in variables], axis=1) for name in variables[0]},
    )


def draw_device(
    population: Population, model: Model, level: float, unit: str, draws: int, seed: int
) -> tuple[Array, Array]:
    """Draws of a new device: parameters, (n, P), and start in its gap, (n,)."""
    matrix, vector = np.ones((1, 1)), np.ones(1)
    building = Building(
        *("one device", matrix, matrix, matrix, vector, matrix, vector, vector, vector),
        (Device("device", 1, 0, level, unit),),
        ResponseLimits(),
    )
    dampers = draw_dampers(population, model, building, draws=draws, seed=seed)
    return dampers.theta[:, 0], dampers.start[:, 0]


def bound_dampers(
    population: Population,
    model: Model,
    building: Building,
    dampers: Dampers,
    seed: int,
    factors: Mapping[float, tuple[Mapping[str, float], Mapping[str, float]]] | None = None,
) -> dict[str, Dampers]:
    """One building with all dampers at the "lower", and one at the "upper", design value.

    Upper is strong: its slip forces and stiffnesses are the upper quantiles of a new test at its
    actuation, its gap is the lower one, and of the places where a test begins it has that at which
    it holds the least force. Lower is weak, and is the other end of each: what a damper holds at
    rest it lacks in one direction. The quantiles leave out half of 1 − `BOUND` each. All else is
    the mean property (the median of each quantity). Of a model that names no slip forces, the
    parameters that follow the actuation are taken for them. Histories of actuation are those of
    `dampers`, in their median.

    `factors` of a standard, on each parameter for both sides, by level of actuation, take the place
    of the quantiles: slip forces and stiffnesses are the mean property times these, all minima
    together and all maxima together, and the gap is that of the mean property.
    """
    levels, of = np.unique([device.level for device in building.devices], return_inverse=True)
    template = replace(building.devices[0], history=None)
    variant = replace(
        building, devices=tuple(replace(template, actuation=a) for a in levels.tolist())
    )
    mean, scattered = (
        draw_dampers(population, model, variant, kind, BOUND_DRAWS, seed)
        for kind in ("mean", "new_test")
    )
    names, standard, residual = model.parameters, model.standard_names, population.residual
    slips = [names.index(name) for name in model.slip_forces]
    stiff = [q.name for q in model.quantities if q.kind == "stiffness" and q.name in standard]
    widths = [names.index(name) for name in sorted(standard & GAP)]
    tail = 0.5 * (1.0 - BOUND)
    places = np.quantile(scattered.start, np.linspace(tail, 1.0 - tail, PLACES), axis=0)
    bounds = {}
    for side, share in (("lower", tail), ("upper", 1.0 - tail)):
        theta = np.median(mean.theta, axis=0)
        bound = np.quantile(scattered.theta, share, axis=0)
        if factors is not None:
            by_level = [factors[level][side == "upper"] for level in levels.tolist()]
            bound = theta * [[of.get(name, 1.0) for name in names] for of in by_level]
        for name in dict.fromkeys([*(model.slip_forces or model.laws), *stiff]):
            column = names.index(name)
            tied = [names.index(n) for n, followed in model.shared_laws.items() if followed == name]
            theta[:, tied] *= (bound / np.where(theta, theta, 1.0))[:, [column]]
            theta[:, column] = bound[:, column]
        if widths and factors is None:
            width = np.quantile(scattered.theta[..., widths].sum(axis=-1), 1.0 - share, axis=0)
            theta[:, widths] *= (width / theta[:, widths].sum(axis=1))[:, None]
        thetas = np.broadcast_to(theta, (PLACES, *theta.shape))
        rest_force = np.abs(Dampers(model, thetas, places, np.ones(places.shape)).at_rest)
        pick = rest_force.argmin(axis=0) if side == "upper" else rest_force.argmax(axis=0)
        start = np.take_along_axis(places, pick[None], axis=0)
        slip = theta[:, slips].mean(axis=1)[None] if slips else np.ones((1, len(theta)))
        slip = slip[:, of]
        bounds[side] = Dampers(
            model,
            theta[None, of],
            start[:, of],
            slip,
            Leftover.at_rest(residual.basis, residual.mean[None], slip / residual.slip_force),
            {k: np.median(s, axis=0, keepdims=True) for k, s in dampers.scales.items()},
            dampers.times,
        )
    return bounds


def _own(shared: Latents, rng: np.random.Generator) -> Latents:
    """Numbers of one damper: its own scatter, its own place in the gap; a device of its own."""
    if shared.device is not None:
        shared = shared._replace(device=rng.standard_normal(shared.device.shape))
    scatter, start = rng.standard_normal(shared.scatter.shape), shared.start.copy()
    start[:, 1] = rng.standard_normal(len(start))
    return shared._replace(scatter=scatter, start=start)
