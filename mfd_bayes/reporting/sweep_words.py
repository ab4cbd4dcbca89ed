"""The best actuation of a sweep, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mfd_bayes.population.settings import SAME_LEVEL
from mfd_bayes.response.sweep import Sweep
from mfd_bayes.runs.tested_range import Span
from mfd_bayes.runs.unit_system import System

_WHAT = {
    "mean": "The mean of the largest {}",
    "q90": "The 90 % quantile of the largest {}",
    "passing": "The probability that the largest {} exceeds its limit",
}


def sweep_sentence(sweep: Sweep, tested: Sequence[Span], system: System) -> str:
    """The best actuation with its interval, and what to do where it lies at an end.

    Where several levels are best alike, it says that none of them is better.

    Parameters
    ----------
    sweep : Sweep
    tested : sequence of Span
        What the calibrated tests cover, with their actuation.
    system : System
    """

    def words(*levels: float) -> str:
        return system.words(levels, sweep.unit, 3, actuation=True)

    what = _WHAT[sweep.goal].format(sweep.quantity)
    ties, place = sweep.lowest, f"smallest at {words(sweep.best)}"
    first = last = sweep.best
    if ties.size > 1:
        first, last = float(ties[0]), float(ties[-1])
        alike, none = f"{ties.size} levels", f"{words(first, last)}: none of them is better"
        if ties.size == np.isfinite(sweep.scores).sum():
            return f"{what} is the same at all {alike}, {none}."
        place = f"smallest at {alike} alike, {none}"
    found = f"{what} is {place} (90 % interval: {words(*sweep.interval)})."
    span = next(one for one in tested if one.name == "actuation")
    low, high = span.lowest * (1.0 - SAME_LEVEL), span.highest * (1.0 + SAME_LEVEL)
    if not low <= first <= last <= high:
        return (
            f"{found} No test was made there (tests: {span.words(system)}): make one before you "
            "use this actuation."
        )
    if sweep.best == sweep.levels[0]:
        return found + _on("lower", "below", low < (1.0 - SAME_LEVEL) * sweep.best)
    if sweep.best == sweep.levels[-1]:
        return found + _on("upper", "above", high > (1.0 + SAME_LEVEL) * sweep.best)
    return found


def _on(end: str, side: str, covered: bool) -> str:
    """What to do where the best level is this end of the sweep."""
    if covered:
        return f" This is the {end} end of the sweep: sweep further."
    return (
        f" This is the {end} end of the sweep and of the tests: make a test {side} it before you "
        "sweep further."
    )
