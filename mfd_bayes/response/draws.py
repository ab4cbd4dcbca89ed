"""Draws of the dampers of a building from a calibrated population."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.model import Model
from mfd_bayes.population.discrepancy import slip_force_of
from mfd_bayes.population.population import Numbers, Population
from mfd_bayes.population.settings import Setting
from mfd_bayes.response.building import Building
from mfd_bayes.response.choice import Choice
from mfd_bayes.response.devices import Dampers
from mfd_bayes.response.history import level_of, levels_along
from mfd_bayes.response.leftover import Leftover

Array = NDArray[np.float64]


def draw_dampers(
    population: Population, model: Model, building: Building, choice: Choice
) -> Dampers:
    """Dampers of n draws of a building, from the run's population.

    What tests share (laws, levels, effects of level and session, the discrepancy, whether they
    begin without load) is one draw for all dampers of a building; each has its own scatter from
    test to test and its own place in its gap. The noise of measurements is left out: it belongs to
    load cells. The same seed gives the same random numbers at any actuation, tested or not.
    """
    levels = [level_of(device, building.folder) for device in building.devices]
    if not levels:
        return no_dampers(choice.draws)
    found = levels_along(building)
    histories = found[1] if found else [np.array([level]) for level in levels]
    beyond = [level for level in levels if not population.within_levels(level)]
    rng = np.random.default_rng([choice.seed, 0])
    index = population.draw_index(choice.draws, (beyond or levels)[0], rng)
    driven = np.concatenate([levels, *histories])
    grid = np.unique([*levels, *(population.grid(max(levels), driven) if found else ())])
    rng = np.random.default_rng([choice.seed, 1])
    shared = population.draw_numbers(choice.draws, grid.size, rng)
    effects = population.level_effects(index, choice.session, grid, shared.level)
    values, about, scales = [], [], []
    for damper, (level, history) in enumerate(zip(levels, histories, strict=True)):
        at = int(np.argmin(np.abs(grid - level)))
        here = {name: effect[:, at] for name, effect in effects.items()}
        setting = Setting(level, choice.session, dict(population.design.covariates))
        numbers = _own(shared, np.random.default_rng([choice.seed, 2, damper]))
        scattered = choice.kind == "new_test"
        parts = population.parts(setting, index, numbers, here, scatter=scattered)
        x = parts.mean + choice.scatter * parts.scatter
        unshared = population.unshared(model, x, numbers.start)
        values.append({**unshared, **population.values(x)})
        about.append(_about(model, values[-1], {**unshared, **population.values(parts.mean)}))
        scales.append(population.scales(model, history, index, level, (grid, effects)))
    slip = np.stack([slip_force_of(model, one) for one in values], axis=1)
    return Dampers(
        model,
        np.stack([model.theta(one) for one in values], axis=1),
        np.stack([one["start"] for one in values], axis=1),
        slip,
        _leftover(population, slip, choice),
        {k: np.stack([one[k] for one in scales], axis=1) for k in scales[0]} if found else {},
        found[0] if found else None,
        {name: np.stack([one[name] for one in about], axis=1) for name in about[0]},
    )


def _own(shared: Numbers, rng: np.random.Generator) -> Numbers:
    """Numbers of one damper: its own scatter, and its own place in the gap."""
    flat = shared.flat.copy()
    flat[:, : shared.quantities] = rng.standard_normal((len(flat), shared.quantities))
    flat[:, -1] = rng.standard_normal(len(flat))
    return Numbers(flat, shared.quantities, shared.leveled, shared.grid)


def _about(model: Model, values: dict[str, Array], typical: dict[str, Array]) -> dict[str, Array]:
    """What may have most to do with a response, of one damper, (n,) each."""
    slip, gap = slip_force_of(model, typical), model.gap(values)
    found = {
        "law and level": slip,
        "scatter of slip force": np.log(slip_force_of(model, values) / slip),
    }
    if gap is not None:
        found["gap"] = gap
    return {**found, "start in the gap": values["start"]}


def no_dampers(draws: int = 1) -> Dampers:
    """Of a building without any."""
    return Dampers(None, np.zeros((draws, 0, 1)), np.zeros((draws, 0)), np.zeros((draws, 0)))


def plain_friction(slip: Array) -> Dampers:
    """One building whose dampers are almost rigid until they slip at forces (m,), kip."""
    force = np.asarray(slip, dtype=np.float64)[None]
    return Dampers(None, force[..., None], np.full(force.shape, 0.5), force)


def _leftover(population: Population, slip: Array, choice: Choice) -> Leftover:
    residual = population.residual
    learned = residual.draw_knots(np.random.default_rng([choice.seed, 4]), len(slip))
    return Leftover(residual.basis, learned, slip / residual.slip_force)
