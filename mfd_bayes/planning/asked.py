"""Draws of a goal from the draws of the population."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import CampaignError
from mfd_bayes.planning.candidate import Candidate
from mfd_bayes.planning.devices import Devices
from mfd_bayes.planning.gain import Goals
from mfd_bayes.planning.goal import GAP, OF_LAWS, Goal
from mfd_bayes.planning.loop import Loop, loop_of
from mfd_bayes.population.discrepancy import slip_force_of
from mfd_bayes.population.settings import setting_of

Array = NDArray[np.float64]

OF_GOALS = 3
"""Marks the random numbers of goals; those of candidates have another mark. Both are of four
numbers, for NumPy takes a shorter seed for one with zeros at its end."""

EVERY = 2
"""Of the samples of a loop, every so many have a band whose width counts."""

_UNITS = {"band": "kip", "energy": "kip*in", GAP: "in"}


def unit_of(goal: Goal, actuation_unit: str) -> str:
    """Internal unit of a goal."""
    if goal.quantity == "exponent":
        return "1"
    if goal.quantity == "slope":
        own = "kip/in" if goal.of == "sigma0" else "kip"
        return f"{own}/{actuation_unit}"
    return _UNITS.get(goal.quantity, "kip")


def draw_goals(
    goal: Goal, places: Sequence[Candidate], devices: Devices, gap: float, session: str
) -> Goals:
    """Draws of a goal at places (motions and actuations), from devices.

    Raises
    ------
    CampaignError
        When the run's population has no such quantity, or it is known without doubt.
    """
    if goal.quantity in OF_LAWS:
        values = _of_law(goal, places, devices)
    elif goal.quantity == GAP:
        values = _gap(places[0], devices, gap, session)
    else:
        scattered = goal.kind == "new_test"
        values = np.concatenate(
            [
                _at(goal, loop_of(place, gap), devices, (session, scattered, number))
                for number, place in enumerate(places)
            ],
            axis=1,
        )
    goals = Goals(values, goal.probability).varying
    if not goals.values.size:
        raise CampaignError(
            f"the {goal.words} is the same in all draws of this run: its law or its prior fixes "
            "it, and no test can make it better known"
        )
    return goals


def _at(goal: Goal, loop: Loop, devices: Devices, how: tuple[str, bool, int]) -> Array:
    """Draws of a quantity at one motion and actuation, (n, m)."""
    session, scattered, number = how
    if goal.quantity == "slip":
        return _slip(loop, devices, session)
    force = devices.damper(loop, session, scattered=scattered, seed=(0, OF_GOALS, number, 0))
    if goal.quantity == "band":
        return force[:, loop.first :: EVERY]
    if goal.quantity == "energy":
        return loop.energy(force)[:, None]
    backward, forward = (half.max(axis=1) for half in loop.halves(force))
    chosen = {"peak_fwd": [forward], "peak_bwd": [backward]}
    return np.stack(chosen.get(goal.quantity, [forward, backward]), axis=1)


def _slip(loop: Loop, devices: Devices, session: str) -> Array:
    drawn = devices.drawn(setting_of(loop.trace, session), np.random.default_rng(0))
    return slip_force_of(devices.predictor.model, devices.predictor.values(drawn))[:, None]


def _gap(place: Candidate, devices: Devices, gap: float, session: str) -> Array:
    setting = setting_of(loop_of(place, gap).trace, session)
    drawn = devices.drawn(setting, np.random.default_rng(0))
    found = devices.predictor.model.gap(devices.predictor.values(drawn))
    if found is None:
        raise CampaignError(f"the model {devices.predictor.model.name} has no gap to be known")
    return found[:, None]


def _of_law(goal: Goal, places: Sequence[Candidate], devices: Devices) -> Array:
    """Exponent of a law, or its slope between the lowest and the highest actuation, (n, 1)."""
    population = devices.population
    known = tuple(population.design.laws)
    if goal.of not in known:
        raise CampaignError(
            f"no law of {goal.of!r} was inferred in this run: those that were are of "
            f"{', '.join(known) or 'nothing'}"
        )
    if goal.quantity == "exponent":
        return population.shapes(goal.of)[1].reshape(-1, 1)[devices.index]
    levels = [place.actuation for place in places]
    low, high = min(levels), max(levels)
    low = 0.0 if not high > low else low
    at = population.median(goal.of, np.array([low, high])).reshape(-1, 2)[devices.index]
    return np.asarray(np.diff(at, axis=1) / (high - low))
