"""The two systems of units that a report is written in."""

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
        level = trace.reference_actuation
        if self.name == "us":
            text = f"{1000 * level:.4g} {'psi' if unit == 'ksi' else 'lbf'}"
        else:
            text = f"{level * self.factor(unit):.4g} {self.unit(unit)}"
        return f"{text} (mean of a history)" if trace.varying else text


US = System("us", "kip and in", "in", "kip", "ksi")
SI = System("si", "kN and mm", "mm", "kN", "MPa")
SYSTEMS = (US, SI)


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
