"""Draws of the dampers of a building from a calibrated population."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.model import Model
from mfd_bayes.population.along import Along
from mfd_bayes.population.parts import Parts
from mfd_bayes.population.population import Population
from mfd_bayes.population.residual import slip_force_of
from mfd_bayes.population.sequel import standing_of
from mfd_bayes.population.setting import Setting
from mfd_bayes.population.unshared import scales_of, unknown_of
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
    rng = np.random.default_rng([choice.seed, 0])
    index = rng.choice(population.size, size=choice.draws)
    found = levels_along(building)
    times = found[0] if found else None
    histories = found[1] if found else [np.array([level]) for level in levels]
    deviation = _deviation(population, choice, levels, histories)
    drawn = [_values(model, choice, index, deviation, damper) for damper in enumerate(levels)]
    about = [_about(model, values, typical) for values, typical in drawn]
    slip = np.stack([slip_force_of(model, values) for values, _ in drawn], axis=1)
    each = [
        scales_of(model, history, index, deviation, level)
        for history, level in zip(histories, levels, strict=True)
    ]
    scales = {name: np.stack([one[name] for one in each], axis=1) for name in each[0]}
    return Dampers(
        model,
        np.stack([model.theta(values) for values, _ in drawn], axis=1),
        np.stack([values["start"] for values, _ in drawn], axis=1),
        slip,
        _leftover(population, slip, choice),
        scales if found else {},
        times,
        {name: np.stack([one[name] for one in about], axis=1) for name in about[0]},
    )


def _setting(population: Population, choice: Choice, level: float) -> Setting:
    return Setting(level, choice.session, dict(population.layout.covariate_reference))


def _deviation(
    population: Population, choice: Choice, levels: Sequence[float], histories: Sequence[Array]
) -> tuple[Along, Array]:
    """How dampers deviate from the laws, and the numbers of each draw (n, m).

    All dampers of a building have one deviation: it belongs to the session.
    """
    setting = _setting(population, choice, max(levels))
    around = Along.of(population, setting, np.unique(np.concatenate(histories)))
    rng = np.random.default_rng([choice.seed, 5])
    return around, rng.standard_normal((choice.draws, around.size))


def _values(
    model: Model,
    choice: Choice,
    index: NDArray[np.intp],
    deviation: tuple[Along, Array],
    damper: tuple[int, float],
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Quantities of a damper, by number and level, (n,) each, with and without scatter."""
    (around, numbers), (j, level), population = deviation, damper, deviation[0].population
    parts = population.expected(_setting(population, choice, level), index).parts(
        lambda name, k: _generator(choice.seed, name, k, j),
        scattered=choice.kind == "new_test",
        leveled=not around.size,
    )
    parts = around.added(parts, index, numbers, level)
    scatter = choice.scatter * parts.scatter
    values = population.values(Parts(parts.level, parts.law, scatter))
    own = np.random.default_rng([choice.seed, 3, j])
    luck = np.random.default_rng([choice.seed, 6]).random(choice.draws)
    standing = replace(standing_of(population, model, values), luck=luck)
    values = {**values, **unknown_of(population, choice.draws, own, None, standing)}
    typical = population.values(Parts(parts.level, parts.law, np.zeros_like(scatter)))
    return values, {**values, **typical}


def _generator(seed: int, source: str, k: int, damper: int) -> np.random.Generator:
    """Generator for one source of difference in quantity k, whichever other sources there are.

    An untested level has sources that a tested one has not. Each damper has its own scatter.
    """
    if source == "scatter":
        return np.random.default_rng([seed, 2, damper])
    return np.random.default_rng([seed, 1, ("level", "session", "beyond").index(source), k])


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


def _leftover(population: Population, slip: Array, choice: Choice) -> Leftover | None:
    residual = population.residual
    if residual is None:
        return None
    rng = np.random.default_rng([choice.seed, 4])
    learned = residual.draw_coefficients(rng, len(slip))
    return Leftover(residual.basis, learned, slip / residual.slip_force)
