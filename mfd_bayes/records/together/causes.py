"""The likely cause of a deviation: a unit, a sensor's factor, the actuation, or another device."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mfd_bayes.records.motion import Array
from mfd_bayes.records.together.odd import Deviation
from mfd_bayes.units import factor

UNITS = {
    "displacement": ("in", "mm", "cm", "m"),
    "force": ("kip", "lbf", "kN", "N", "MN", "kgf"),
}
"""Units that a column may be in instead of the one that it was read in."""

WAYS = {"displacement": np.array([1.0, -1.0, 0.0]), "force": np.array([0.0, 1.0, 1.0])}
"""By how much the logarithms of gap, build-up and slip force grow with that of a wrong factor."""

FREE = 4.0
"""Penalty of a cause with a free factor: a unit that explains as much is the likelier."""

ANYTHING = 14.0
"""Penalty of another device, which explains every deviation."""


@dataclass(frozen=True)
class Cause:
    """A cause; `name` is that of a fault, `share` the factor by which it is wrong."""

    name: str
    words: str
    misfit: float
    factor: float = 1.0


def likely_cause(found: Deviation, units: dict[str, str]) -> Cause:
    """The cause that explains a deviation best.

    A length that is too large by f makes the gap f times as wide and the build-up f times less
    steep; a force that is too large by f makes build-up and slip force f times as large; an
    actuation that is too large by f leaves the loop as it is and the law is asked elsewhere.
    """
    known = np.isfinite(found.values)
    values = np.where(known, found.values, 0.0)
    weights = np.where(known, 1.0 / found.sds**2, 0.0)
    causes = [
        *_of_units("displacement", units["displacement"], values, weights),
        *_of_units("force", units["force"], values, weights),
        _free("actuation", -found.exponents, values, weights),
        Cause("another device", "", ANYTHING),
    ]
    return min(causes, key=lambda cause: cause.misfit)


def _of_units(role: str, used: str, values: Array, weights: Array) -> Iterator[Cause]:
    """Wrong units of a role, and a factor that is no unit's."""
    way = WAYS[role]
    for unit in UNITS[role]:
        wrong = factor(used, role) / factor(unit, role)
        if abs(np.log(wrong)) > 0.2:
            rest = values - way * np.log(wrong)
            words = f"its {role} seems to be in {unit}, not in {used}"
            yield Cause(f"unit of {role}", words, float(rest**2 @ weights), wrong)
    yield _free(role, way, values, weights)


def _free(role: str, way: Array, values: Array, weights: Array) -> Cause:
    """A factor on a signal, the best one."""
    size = float(way**2 @ weights)
    log = float((way * values) @ weights) / size if size > 0 else 0.0
    rest = values - way * log
    return Cause(role, "", float(rest**2 @ weights) + FREE, float(np.exp(log)))
