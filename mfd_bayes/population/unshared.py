"""What a predicted test does not share with others, and what follows a history of actuation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.model import Model
from mfd_bayes.population.along import SAME, Along
from mfd_bayes.population.population import Population
from mfd_bayes.population.setting import Setting
from mfd_bayes.population.starts import UNKNOWN, Standing

Array = NDArray[np.float64]


def unknown_of(
    population: Population,
    n: int,
    rng: np.random.Generator,
    setting: Setting | None = None,
    standing: Standing = UNKNOWN,
) -> dict[str, Array]:
    """Draws of what tests do not share: the start in the gap, γ1, and fixed quantities.

    The setting is None where the motion is not known.
    """
    shared = set(population.layout.names)
    unknown = {name: p.draw(rng, n) for name, p in population.priors.items() if name not in shared}
    if "start" in unknown:
        unknown["start"] = population.draw_starts(rng, n, setting, standing)
    return {"gamma1": np.ones(n), "start": np.full(n, 0.5)} | unknown


def stays(actuation: Array, level: float) -> bool:
    """Whether an actuation is at a level throughout, or not known."""
    return not np.all(np.isfinite(actuation)) or np.allclose(actuation, level, rtol=SAME, atol=0.0)


def scales_of(
    model: Model,
    actuation: Array,
    index: NDArray[np.intp],
    deviation: tuple[Along, Array],
    level: float | None = None,
) -> dict[str, Array]:
    """Factors along a history of actuation (T,) of what follows it, over their values at a level.

    They are (n, T) each.

    Parameters
    ----------
    model : Model
    actuation : (T,), ksi or kip
    index : (n,) int
        Draws of the hyperparameters.
    deviation : Along, (n, m)
        How they deviate from the laws, with the numbers of each.
    level : float, optional
        Another than that of the setting.
    """
    around, numbers = deviation
    population, level = around.population, around.level if level is None else level
    beside = around.log_factors(index, numbers, actuation, level)
    scales = {}
    for name in population.layout.laws:
        at_level = population.ratio_of(name, np.array([level]), index)[:, 0]
        along = population.ratios_along(name, actuation, index)  # time first, as forces need it
        along /= np.where(at_level > 0, at_level, 1.0)
        # without any actuation along the history it stays at its level
        np.copyto(along, 1.0, where=at_level <= 0)
        if name in beside:
            along *= np.exp(beside[name], out=beside[name])
        scales[name] = along.T
    # what follows another quantity in this model, such as static friction
    tied = {name: scales[other] for name, other in model.tied_laws.items() if other in scales}
    return scales | tied
