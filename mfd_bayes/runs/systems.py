"""The two systems of units that reports and sentences are written in."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

from mfd_bayes.errors import UnitError
from mfd_bayes.records.trace import Trace
from mfd_bayes.units import convert, factor

_METRIC = {"kip": "kN", "in": "mm", "ksi": "MPa"}
_TOKEN = re.compile(r"[A-Za-z]+")


@dataclass(frozen=True)
class System:
    """Units of a report; `name` is "us" or "si"."""

    name: str
    title: str
    length: str
    force: str
    pressure: str

    @property
    def velocity(self) -> str:
        """Unit of velocities."""
        return f"{self.length}/s"

    def unit(self, internal: str) -> str:
        """Unit of this system for an internal one, in the metric system "kN/mm" for "kip/in"."""
        if self.name == "us":
            return internal
        return _TOKEN.sub(lambda word: _METRIC.get(word[0], word[0]), internal)

    def factor(self, internal: str) -> float:
        """Factor from an internal unit to this system's."""
        return _factor(internal, self.unit(internal))

    def actuation(self, trace: Trace, unit: str) -> str:
        """Actuation of a trace in words; `unit` is the internal one, "ksi" or "kip"."""
        text = self.words([trace.reference_actuation], unit, actuation=True)
        return f"{text} (mean of a history)" if trace.varying else text

    def words(
        self, values: Iterable[float], internal: str, digits: int = 4, *, actuation: bool = False
    ) -> str:
        """Values of an internal unit in this system: "500 to 1500 psi"; equal ones once.

        An actuation is given in psi or lbf in the customary system, as it is set in tests.
        """
        by, unit = self.factor(internal), self.unit(internal)
        if actuation and self.name == "us":
            by, unit = 1000.0, "psi" if internal == "ksi" else "lbf"
        shown = dict.fromkeys(f"{value * by:.{digits}g}" for value in values)
        return f"{' to '.join(shown)} {unit}"


US = System("us", "kip and in", "in", "kip", "ksi")
SI = System("si", "kN and mm", "mm", "kN", "MPa")
SYSTEMS = (US, SI)


def named_system(name: str, own: System) -> System:
    """System of units of a name, "us" or "si"; `own` where the name is empty.

    Raises
    ------
    UnitError
        When the name is unknown.
    """
    for system in SYSTEMS:
        if system.name == name:
            return system
    if name:
        raise UnitError(f"--units must be us (kip, in, ksi) or si (kN, mm, MPa), got {name!r}")
    return own


def system_of(units: Iterable[str]) -> System:
    """System of units that most records were measured in, by their units of length."""
    metric = sum(1 if _is_metric(unit) else -1 for unit in units)
    return SI if metric > 0 else US


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
