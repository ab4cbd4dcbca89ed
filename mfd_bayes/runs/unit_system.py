"""The systems of units that reports and sentences are written in."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mfd_bayes.errors import UnitError
from mfd_bayes.units import (
    DAMPER,
    UNITS,
    Axes,
    Axis,
    actuation_factor,
    convert,
    factor,
    has_angle,
    in_digits,
    in_place_of,
)

if TYPE_CHECKING:
    from mfd_bayes.records.trace import Trace

SMALL = 0.2
"""Devices whose largest force, kip, is below this are shown in lbf or N."""

PRESSURES = frozenset({"bar", "kPa"})
"""Metric units of pressure that a report keeps where all actuations are in one of them."""

_SET = {"ksi": "psi", "kip": "lbf"}  # in which an actuation is set in tests
_WORD = re.compile(r"[A-Za-z]+")
_CUSTOMARY = re.compile(
    r"(?<![A-Za-z])(?:in|ft|lb|lbf|lbs|kips?|ksi|psi|psf|gal|gallon|gpm|inch)(?![A-Za-z])"
)


@dataclass(frozen=True)
class UnitSystem:
    """Units of a report."""

    name: str
    title: str
    length: str
    force: str
    pressure: str
    level: tuple[str, str] = ("", "")
    axes: Axes = DAMPER

    def label(self, name: str, internal: str = "") -> str:
        """Label of an axis, "displacement, in": a name and an internal unit."""
        name = self.axes.text(name)
        unit = self.unit(internal).replace("*", "·") if internal else "1"
        return name if unit == "1" else f"{name}, {unit}"

    def column(self, name: str, internal: str) -> str:
        """Head of a column of a table, "displacement_in": a name and an internal unit."""
        unit = self.unit(internal).replace("/", "_per_")
        name = self.axes.text(name).replace(" ", "_")
        return name if unit == "1" else f"{name}_{unit}"

    def text(self, words: str) -> str:
        """A sentence about a damper in the names of the model's motion and response."""
        return self.axes.text(words)

    def unit(self, internal: str) -> str:
        """Unit of this system for an internal one, in the metric system "kN/mm" for "kip/in"."""
        if internal == "s" and not self.axes.timed:
            return "samples"
        units = {"kip": self.force, "in": self.length, "ksi": self.pressure}
        level, level_unit = self.level
        if level:
            units[level] = level_unit
        if not self.axes.of_damper:
            axis_units = ((self.axes.motion, self.length), (self.axes.response, self.force))
            units |= {axis.unit: unit for axis, unit in axis_units if _WORD.fullmatch(axis.unit)}
        text = in_place_of(internal, units)
        if "*" not in level:
            return text
        return re.sub(rf"(?<![A-Za-z]){re.escape(level)}(?![A-Za-z])", level_unit, text)

    def factor(self, internal: str) -> float:
        """Factor from an internal unit to this system's."""
        if internal == "s" and not self.axes.timed:
            return 1.0
        return _factor(self.axes.unit(internal), self.unit(internal))

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
        scale, unit = self.factor(internal), self.unit(internal).replace("*", "·")
        if actuation:
            scale, unit = self.of_actuation(internal)
        texts = dict.fromkeys(in_digits(value * scale, digits) for value in values)
        return f"{' to '.join(texts)}{f' {unit}' if unit != '1' else ''}"

    def actuation(self, trace: Trace, unit: str) -> str:
        """Actuation of a trace in words, "" of none; `unit` is the internal one, such as "ksi"."""
        if not self.axes.actuated:
            return ""
        text = self.words([trace.reference_actuation], unit, actuation=True)
        return f"{text} (mean of a history)" if trace.varying else text


US = UnitSystem("us", "kip and in", "in", "kip", "ksi")
SI = UnitSystem("si", "kN and mm", "mm", "kN", "MPa")
US_SMALL = UnitSystem("us", "lbf and in", "in", "lbf", "psi")
SI_SMALL = UnitSystem("si", "N and mm", "mm", "N", "MPa")
SYSTEMS = (US, SI)


def both_systems(base: UnitSystem) -> tuple[UnitSystem, UnitSystem]:
    """Customary and metric system for the same device, one of which is `base`."""
    small = base.force in (US_SMALL.force, SI_SMALL.force)
    us, si = (
        replace(system, level=base.level, axes=base.axes)
        for system in ((US_SMALL, SI_SMALL) if small else SYSTEMS)
    )
    if not base.axes.of_damper:
        lengths = _in_both(base.axes.motion, base.length)
        forces = _in_both(base.axes.response, base.force)
        us, si = (_in_units(us, lengths[0], forces[0]), _in_units(si, lengths[1], forces[1]))
    return (us, base) if base.name == si.name else (base, si)


def named_system(name: str, default: UnitSystem) -> UnitSystem:
    """System of units of a name, "us" or "si"; `default` where the name is empty."""
    if not name:
        return default
    for system in both_systems(default):
        if system.name == name:
            return system
    raise UnitError(f"--units must be us (kip, in, ksi) or si (kN, mm, MPa), got {name!r}")


def system_of(
    lengths: Iterable[str],
    forces: Iterable[ArrayLike | None] = (),
    actuations: Iterable[str] = (),
    axes: Axes = DAMPER,
    responses: Iterable[str] = (),
) -> UnitSystem:
    """System of units that records were measured in, fit for the size of their forces.

    `axes` are the model's own quantities, and `responses` the units of their response.
    """
    of_motion = list(lengths)
    peaks = [float(np.max(np.abs(force))) for force in forces if force is not None]
    metric = sum(1 if _is_metric(unit) else -1 for unit in of_motion) > 0
    small = 0.0 < max(peaks, default=0.0) < SMALL
    customary, si = (US_SMALL, SI_SMALL) if small else SYSTEMS
    system = si if metric else customary
    if axes != DAMPER:
        system = replace(system, axes=axes)
    if not axes.of_damper:
        x, y = _most_common(of_motion, axes.motion), _most_common(list(responses), axes.response)
        metric = not any(_CUSTOMARY.search(unit) for unit in (x, y))
        system = _in_units(replace(SI if metric else US, axes=axes), x, y)
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


def _in_units(system: UnitSystem, length: str, force: str) -> UnitSystem:
    """A system with the units of a user's own model."""
    title = " and ".join(unit for unit in (force, length) if unit != "1")
    return replace(system, title=title, length=length, force=force)


def _most_common(units: list[str], axis: Axis) -> str:
    """The unit that most records have; that of the model where they have none."""
    return next((unit for unit, _ in Counter(filter(None, units)).most_common(1)), axis.unit)


def _in_both(axis: Axis, unit: str) -> tuple[str, str]:
    """Customary and metric unit of an axis, one of which is that of the records."""
    customary = bool(_CUSTOMARY.search(unit))
    for pair in UNITS.values():
        try:
            convert(pair[0], axis.unit)
        except UnitError:
            continue
        if has_angle(pair[0]) == has_angle(axis.unit) and pair[0] != pair[1]:
            return (unit, pair[1]) if customary else (pair[0], unit)
    return unit, unit


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
