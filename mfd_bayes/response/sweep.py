"""Response against the actuation of the dampers, and the actuation that is best."""

from __future__ import annotations

import re
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import BuildingError, UnitError
from mfd_bayes.units import parse_actuation

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from mfd_bayes.response.building import Limits
    from mfd_bayes.response.result import Response

Array = NDArray[np.float64]

STEPS = 8  # steps of a sweep that does not say how many
MOST_STEPS = 100

QUANTITIES = ("drift", "acceleration")
"""What may be made small: the largest of these over the building."""

MOST_AWAY = 0.1  # largest share of draws that may run away at a level
RESAMPLES = 400

GOALS: Mapping[str, Callable[[Array, float], Array]] = MappingProxyType(
    {
        "mean": lambda values, limit: values.mean(axis=-1),
        "q90": lambda values, limit: np.quantile(values, 0.9, axis=-1),
        "passing": lambda values, limit: np.mean(values > limit, axis=-1),
    }
)
"""What is made small: the mean, the 90 % quantile, or the probability of passing a limit."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """Peaks at several actuations, with the same random numbers.

    Attributes
    ----------
    levels : (L,), ksi or kip
    unit : {"ksi", "kip"}
    values : mapping of str to (L, n, g)
        The largest over the building of "drift", in, and "acceleration", g, of the draws that ran
        away at no other level; NaN at levels that are left out.
    quantity, goal : str
    scores : (L,)
        What is made small, over all ground motions; infinite at levels that are left out.
    best : float
        The actuation at which it is smallest; NaN where it is so at several levels alike.
    interval : (float, float)
        Equal-tailed 90 % interval of the best actuation, over resampled draws; levels that are
        best alike are all in it.
    remarks : tuple of str
        What it leaves out.
    """

    levels: Array
    unit: str
    values: Mapping[str, Array]
    quantity: str
    goal: str
    scores: Array
    best: float
    interval: tuple[float, float]
    remarks: tuple[str, ...] = ()

    @property
    def lowest(self) -> Array:
        """Levels that have the smallest score, (k,); several where they tie."""
        return np.asarray(self.levels[self.scores == self.scores.min()])


def parse_sweep(text: str) -> tuple[Array, str]:
    """Levels, (L,), and unit of ``actuation="500 psi to 1500 psi"``, perhaps ``in 5 steps``.

    Raises
    ------
    BuildingError
        When it is no such range.
    """
    form = r"\s*actuation\s*=\s*(.+?)\s+to\s+(.+?)(?:\s+in\s+(\d+)\s+steps)?\s*"
    match = re.fullmatch(form, re.sub("[\"']", "", text))
    if match is None:
        raise BuildingError(
            f'--sweep {text!r}: expected actuation="500 psi to 1500 psi", or the same with '
            "'in 5 steps' after it"
        )
    try:
        (low, unit), (high, other) = (parse_actuation(match[i], of="--sweep") for i in (1, 2))
    except UnitError as error:
        raise BuildingError(str(error)) from error
    if unit != other or not 0 < low < high:
        raise BuildingError(
            f"--sweep {text!r}: expected two levels above 0 of one kind, the lower one first"
        )
    steps = int(match[3] or STEPS)
    if not 1 <= steps <= MOST_STEPS:
        raise BuildingError(f"--sweep {text!r}: expected 1 to {MOST_STEPS} steps, got {steps}")
    return np.linspace(low, high, steps + 1), unit


def check_goal(quantity: str, goal: str, limits: Limits) -> float:
    """The limit that a quantity may not pass; NaN where the goal needs none.

    Raises
    ------
    BuildingError
        When the quantity or the goal is unknown, or a limit is missing.
    """
    if quantity not in QUANTITIES:
        raise BuildingError(f"unknown quantity {quantity!r}: expected {' or '.join(QUANTITIES)}")
    if goal not in GOALS:
        raise BuildingError(f"unknown goal {goal!r}: expected one of {', '.join(GOALS)}")
    limit = limits.drift if quantity == "drift" else limits.acceleration
    if goal == "passing" and limit is None:
        raise BuildingError(f"the goal 'passing' needs limits.{quantity} in the building file")
    return np.nan if limit is None else limit


def sweep_of(
    swept: tuple[Array, str], responses: list[Response], quantity: str, goal: str, seed: int = 0
) -> Sweep:
    """The best actuation among the levels, between which a parabola is drawn, if there is one.

    `swept` is the levels and their unit, as `parse_sweep` has them. Draws are the same at every
    level, so that resampling them compares like with like.

    Raises
    ------
    BuildingError
        When the quantity or the goal is unknown, a limit is missing, or no level is left.
    """
    levels, unit = swept
    limit = check_goal(quantity, goal, responses[0].building.limits)
    away = np.array([r.unstable.any(axis=1) for r in responses])
    lost = away.mean(axis=1) > MOST_AWAY
    if lost.all():
        raise BuildingError("the sweep says nothing: many draws ran away at every level")
    # a draw that ran away at one level is left out at all: the others are of the same dampers
    usable = ~away[~lost].any(axis=0)
    values = {name: np.stack([r.measure(name)[usable] for r in responses]) for name in QUANTITIES}
    for value in values.values():
        value[lost] = np.nan
    shown = values[quantity]
    if goal == "passing":  # limits are of ratios of drifts, and of accelerations in in/s²
        peaks = [r.drift_ratio if quantity == "drift" else r.acceleration for r in responses]
        shown = np.stack([peak.max(axis=-1)[usable] for peak in peaks])
    n = shown.shape[1]

    def score(of: Array) -> Array:
        return np.where(lost, np.inf, GOALS[goal](of.reshape(len(levels), -1), limit))

    scores, rng = score(shown), np.random.default_rng(seed)
    resampled = [
        _lowest(levels, score(shown[:, rng.integers(n, size=n)])) for _ in range(RESAMPLES)
    ]
    firsts, lasts = np.transpose(resampled)
    first, last = _lowest(levels, scores)
    low, high = float(np.quantile(firsts, 0.05)), float(np.quantile(lasts, 0.95))
    best = first
    if first < last:
        best, low, high = np.nan, min(first, low), max(last, high)
    remarks = []
    if out := int((~usable).sum()):
        remarks.append(
            f"the sweep leaves out {out} of {usable.size} draws, which diverged at one of its "
            "levels"
        )
    if lost.any():
        remarks.append(
            f"the sweep leaves out {lost.sum()} of its levels, at which more than "
            f"{100 * MOST_AWAY:.0f} % of the draws diverged"
        )
    return Sweep(levels, unit, values, quantity, goal, scores, best, (low, high), tuple(remarks))


def _lowest(levels: Array, scores: Array) -> tuple[float, float]:
    """First and last place of the minimum; they differ where levels have the same score.

    One level's place is that of a parabola through it and its neighbours.
    """
    k = int(np.argmin(scores))
    ties = levels[scores == scores[k]]
    if ties.size > 1:
        return float(ties[0]), float(ties[-1])
    place = float(levels[k])
    if 0 < k < len(levels) - 1:
        a, b, c = scores[k - 1 : k + 2]
        bend = a - 2.0 * b + c
        if np.isfinite(a + c) and bend > 0:
            place += float(0.5 * (a - c) / bend * (levels[1] - levels[0]))
    return place, place
