"""Tests whose gap, build-up or slip force does not follow the others, and the likely cause."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mfd_bayes.records.motion import Array
from mfd_bayes.units import factor

QUANTITIES = ("gap", "slope", "plateau")
FEWEST = 3  # fewest tests among which one can be odd
SCATTER = np.array([0.08, 0.25, 0.15])  # sd of each logarithm between tests of one device
FAR = 3.3  # a test is odd where a quantity is further away than this many sds of the others
SAME_LEVEL = 0.05  # actuations that differ by less than this share are one level
BEND = np.array([0.3, 0.5, 0.7])  # prior sd of the exponent of each quantity over the actuation
_MIDDLE = np.array([0.0, 0.0, 0.5])  # and its prior mean


@dataclass(frozen=True, eq=False)
class Deviation:
    """How a test deviates from the law of the others.

    Attributes
    ----------
    values : (3,)
        Logarithm of each of `QUANTITIES` over what the others let expect; NaN where unknown.
    sds : (3,)
        Their standard deviations.
    exponents : (3,)
        Exponents of the others' laws over the actuation.
    """

    values: Array
    sds: Array
    exponents: Array

    @property
    def distance(self) -> float:
        """Largest deviation in standard deviations."""
        return float(np.nanmax(np.abs(self.values) / self.sds, initial=0.0))


def find_odd(logs: Array, levels: Array) -> dict[int, Deviation]:
    """Odd tests by their number, the oddest first, each against the tests that are not odd.

    Parameters
    ----------
    logs : (J, 3)
        Logarithms of `QUANTITIES`, NaN where a reading is not known.
    levels : (J,)
        Actuations; a test at 0 is not compared with others, and where it is not known, slip
        forces are not.
    """
    logs = logs.copy()
    logs[np.isnan(levels), 2] = np.nan
    logs[levels == 0.0] = np.nan
    place = np.log(np.where(levels > 0.0, levels, np.nan))
    left = list(range(len(levels)))
    for _ in range(len(levels) // 3):  # without the worst, others that are odd show
        if len(left) > FEWEST - 1:
            rest = {j: [i for i in left if i != j] for j in left}
            left.remove(min(left, key=lambda j: _disagreement(logs, place, rest[j])))
    every = set(range(len(levels)))
    odd = []
    for j in sorted(every - set(left)):  # against the trimmed tests, or all the others
        if any(deviation(logs, place, j, some).distance > FAR for some in (left, every - {j})):
            odd.append(j)
    core = sorted(every - set(odd))
    odd = [j for j in odd if deviation(logs, place, j, core).distance > FAR]
    core = sorted(every - set(odd))
    deviations = {j: deviation(logs, place, j, core) for j in odd}
    deviations = {j: away for j, away in deviations.items() if not _shared(j, deviations, place)}
    return dict(sorted(deviations.items(), key=lambda item: -item[1].distance))


def _shared(j: int, deviations: dict[int, Deviation], place: Array) -> bool:
    """Whether another odd test at the same level deviates alike: the level, not the test, is odd.

    A deviation beyond twice `FAR` is no level's.
    """
    alike = (
        np.nanmax(np.abs(deviations[i].values - deviations[j].values) / SCATTER, initial=0.0) < FAR
        for i in deviations
        if i != j and abs(place[i] - place[j]) < SAME_LEVEL
    )
    return deviations[j].distance < 2.0 * FAR and any(alike)


def deviation(logs: Array, place: Array, j: int, others: Iterable[int]) -> Deviation:
    """Deviation of test j from the law of others."""
    others = sorted(others)
    values, sds, exponents = np.full(3, np.nan), np.full(3, np.inf), _MIDDLE.copy()
    for k in range(3):
        finite = [i for i in others if np.isfinite(logs[i, k]) and np.isfinite(place[i])]
        if not finite:
            finite = [i for i in others if np.isfinite(logs[i, k])]
        if not np.isfinite(logs[j, k]) or len(finite) < FEWEST - 1:
            continue
        x, at = (np.nan_to_num(v) for v in (place[finite], place[j]))
        middle, value, slope, spread, far = _line(x, logs[finite, k], k)
        values[k] = logs[j, k] - value - slope * (float(at) - middle)
        few = 1.0 + 1.0 / (len(finite) - 1)
        sds[k] = few * np.sqrt(spread**2 + (far * (float(at) - middle)) ** 2)
        exponents[k] = slope
    return Deviation(values, sds, exponents)


def _line(x: Array, y: Array, k: int) -> tuple[float, float, float, float, float]:
    """Middle, value there, slope, scatter and error of the slope, of a line with a prior."""
    middle, value = float(x.mean()), float(y.mean())
    away, noise = x - middle, SCATTER[k] ** 2
    weight = float(away @ away) / noise + 1.0 / BEND[k] ** 2
    slope = (float(away @ (y - value)) / noise + _MIDDLE[k] / BEND[k] ** 2) / weight
    rest = y - value - slope * away
    spread = float(np.sqrt((rest @ rest + 2.0 * noise) / (y.size - 1 + 2.0)))
    return middle, value, slope, max(spread, float(SCATTER[k])), float(weight**-0.5)


def _disagreement(logs: Array, place: Array, tests: Sequence[int]) -> float:
    """Sum of squares of what is left of lines through tests, in units of the scatter."""
    total = 0.0
    for k in range(3):
        y, x = logs[list(tests), k], np.nan_to_num(place[list(tests)])
        finite = np.isfinite(y)
        if np.count_nonzero(finite) < 2:
            continue
        middle, value, slope, _, _ = _line(x[finite], y[finite], k)
        rest = y[finite] - value - slope * (x[finite] - middle)
        prior = ((slope - _MIDDLE[k]) / BEND[k]) ** 2
        total += float(np.sum((rest / SCATTER[k]) ** 2)) + prior
    return total


UNITS = {
    "displacement": ("in", "mm", "cm", "m"),
    "force": ("kip", "lbf", "kN", "N", "MN", "kgf"),
}
"""Units that a column may be in instead of the one that it was read in."""
WAYS = {"displacement": np.array([1.0, -1.0, 0.0]), "force": np.array([0.0, 1.0, 1.0])}
"""By how much the logarithms of gap, build-up and slip force grow with that of a wrong factor."""
FREE = 4.0  # penalty of a cause with a free factor: a unit that explains as much is the likelier
ANYTHING = 14.0  # penalty of another device, which explains every deviation


@dataclass(frozen=True)
class Cause:
    """What may be wrong with a test.

    Attributes
    ----------
    name : str
        Of a fault: "unit of force", "force", "actuation", "another device".
    factor : float
        By which it is too large.
    role, unit, read_in : str
        Of a wrong unit: whose, the unit that it seems to be in, and the one it was read in.
    """

    name: str
    factor: float = 1.0
    role: str = ""
    unit: str = ""
    read_in: str = ""


def likely_cause(deviation: Deviation, units: dict[str, str]) -> Cause:
    """The cause that explains a deviation best.

    A length that is too large by f makes the gap f times as wide and the build-up f times less
    steep; a force that is too large by f makes build-up and slip force f times as large; an
    actuation that is too large by f leaves the loop as it is and moves the law's value.
    """
    finite = np.isfinite(deviation.values)
    values = np.where(finite, deviation.values, 0.0)
    weights = np.where(finite, 1.0 / deviation.sds**2, 0.0)
    causes = [(ANYTHING, Cause("another device"))]
    for role, way in (*WAYS.items(), ("actuation", -deviation.exponents)):
        size = float(way**2 @ weights)
        log = float((way * values) @ weights) / size if size > 0 else 0.0
        misfit = float((values - way * log) ** 2 @ weights)
        causes.append((misfit + FREE, Cause(role, float(np.exp(log)))))
        for unit in UNITS.get(role, ()):
            wrong = factor(units[role], role) / factor(unit, role)
            if abs(np.log(wrong)) > 0.2:
                misfit = float((values - way * np.log(wrong)) ** 2 @ weights)
                causes.append((misfit, Cause(f"unit of {role}", wrong, role, unit, units[role])))
    return min(causes, key=lambda pair: pair[0])[1]
