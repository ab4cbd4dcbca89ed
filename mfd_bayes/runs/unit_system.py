"""The systems of units that reports and sentences are written in."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from mfd_bayes.errors import UnitError
from mfd_bayes.records.trace import Trace
from mfd_bayes.units import actuation_factor, convert, factor, in_digits

SMALL = 0.2
"""Devices whose largest force, kip, is below this are shown in lbf or N."""

PRESSURES = frozenset({"bar", "kPa"})
"""Metric units of pressure that a report keeps where all actuations are in one of them."""

_SET = {"ksi": "psi", "kip": "lbf"}  # in which an actuation is set in tests
_WORD = re.compile(r"[A-Za-z]+")


@dataclass(frozen=True)
class System:
    """Units of a report."""

    name: str
    title: str
    length: str
    force: str
    pressure: str
    level: tuple[str, str] = ("", "")

    @property
    def velocity(self) -> str:
        """Unit of velocities."""
        return f"{self.length}/s"

    @property
    def small(self) -> bool:
        """Whether forces are in lbf or N."""
        return self.force in (US_SMALL.force, SI_SMALL.force)

    def unit(self, internal: str) -> str:
        """Unit of this system for an internal one, in the metric system "kN/mm" for "kip/in"."""
        units = {"kip": self.force, "in": self.length, "ksi": self.pressure}
        level, shown = self.level
        if level:
            units[level] = shown
        text = _WORD.sub(lambda word: units.get(word[0], word[0]), internal)
        if "*" not in level:
            return text
        return re.sub(rf"(?<![A-Za-z]){re.escape(level)}(?![A-Za-z])", shown, text)

    def factor(self, internal: str) -> float:
        """Factor from an internal unit to this system's."""
        return _factor(internal, self.unit(internal))

    def of_actuation(self, internal: str) -> tuple[float, str]:
        """Factor from an internal unit, and the unit, in which an actuation is said."""
        if self.name == "us" and internal in _SET:
            return 1000.0, _SET[internal]
        return self.factor(internal), self.unit(internal)

    def words(
        self, values: Iterable[float], internal: str, digits: int = 4, *, actuation: bool = False
    ) -> str:
        """Values of an internal unit in this system: "500 to 1500 psi"; equal ones once.

        An actuation is given in psi or lbf in the customary system, as it is set in tests.
        """
        by, unit = self.factor(internal), self.unit(internal).replace("*", "·")
        if actuation:
            by, unit = self.of_actuation(internal)
        shown = dict.fromkeys(in_digits(value * by, digits) for value in values)
        return f"{' to '.join(shown)} {unit}"

    def actuation(self, trace: Trace, unit: str) -> str:
        """Actuation of a trace in words; `unit` is the internal one, such as "ksi"."""
        text = self.words([trace.reference_actuation], unit, actuation=True)
        return f"{text} (mean of a history)" if trace.varying else text


US = System("us", "kip and in", "in", "kip", "ksi")
SI = System("si", "kN and mm", "mm", "kN", "MPa")
US_SMALL = System("us", "lbf and in", "in", "lbf", "psi")
SI_SMALL = System("si", "N and mm", "mm", "N", "MPa")
SYSTEMS = (US, SI)


def both_systems(own: System) -> tuple[System, System]:
    """Customary and metric system for the same device, one of which is `own`."""
    systems = (US_SMALL, SI_SMALL) if own.small else SYSTEMS
    customary, metric = (replace(system, level=own.level) for system in systems)
    return (customary, own) if own.name == metric.name else (customary, metric)


def named_system(name: str, own: System) -> System:
    """System of units of a name, "us" or "si"; `own` where the name is empty."""
    if not name:
        return own
    for system in both_systems(own):
        if system.name == name:
            return system
    raise UnitError(f"--units must be us (kip, in, ksi) or si (kN, mm, MPa), got {name!r}")


def system_of(
    lengths: Iterable[str], forces: Iterable[ArrayLike | None] = (), actuations: Iterable[str] = ()
) -> System:
    """System of units that records were measured in, fit for the size of their forces."""
    peaks = [float(np.max(np.abs(force))) for force in forces if force is not None]
    metric = sum(1 if _is_metric(unit) else -1 for unit in lengths) > 0
    small = 0.0 < max(peaks, default=0.0) < SMALL
    customary, si = (US_SMALL, SI_SMALL) if small else SYSTEMS
    system = si if metric else customary
    units = set(actuations)
    if len(units) != 1:
        return system
    unit = units.pop()
    if metric and unit in PRESSURES:
        return replace(system, pressure=unit)
    try:
        internal = actuation_factor(unit)[1]
    except UnitError:
        return system
    return system if internal in _SET else replace(system, level=(internal, unit))


@cache
def _factor(unit: str, target: str) -> float:
    return 1.0 if unit == target else convert(unit, target)


def _is_metric(unit: str) -> bool:
    """Whether a unit of length is a power of ten of a metre."""
    try:
        metres = factor(unit, "displacement") * 0.0254
    except UnitError:
        return False
    return any(abs(metres / 10.0**power - 1.0) < 1e-9 for power in range(-9, 4))
