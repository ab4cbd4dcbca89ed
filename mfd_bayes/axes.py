"""What a model's motion and response are called, and their units: a damper's, or a user's own."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

from mfd_bayes.errors import UnitError
from mfd_bayes.units import convert, factor, has_angle, measures


class Axis(NamedTuple):
    """A quantity that a model takes or gives, and the unit in which it does."""

    name: str
    unit: str


UNITS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "displacement": ("in", "mm"),
        "force": ("kip", "kN"),
        "strain": ("1", "1"),
        "stress": ("ksi", "MPa"),
        "rotation": ("rad", "rad"),
        "moment": ("kip*in", "kN*m"),
        "torque": ("kip*in", "kN*m"),
        "pressure": ("psi", "MPa"),
        "flow": ("gallon/min", "L/min"),
    }
)
"""Quantities that need no unit in a model, with a customary unit and a metric one; the latter is
then the model's."""


_DISPLACEMENT, _FORCE = Axis("displacement", "in"), Axis("force", "kip")


@dataclass(frozen=True)
class Axes:
    """Motion and response of a model, whether time matters to it, and whether tests are actuated.

    Inside the package they are always called displacement and force, "in" and "kip"; `name` and
    `unit` say what these are.
    """

    motion: Axis = _DISPLACEMENT
    response: Axis = _FORCE
    timed: bool = True
    actuated: bool = True

    @property
    def of_damper(self) -> bool:
        """Whether they are the force and the displacement of a damper."""
        return self.motion == DAMPER.motion and self.response == DAMPER.response

    def name(self, role: str) -> str:
        """What a column of a role, such as "displacement", is called: "strain"."""
        if role == "velocity" and self.motion != DAMPER.motion:
            return f"{self.motion.name}_rate"
        return {"displacement": self.motion.name, "force": self.response.name}.get(role, role)

    def role(self, name: str) -> str:
        """The role of a column that is called so; its own name for any other."""
        by_name = {self.name(role): role for role in ("displacement", "force", "velocity")}
        return by_name.get(name, name)

    def unit(self, internal: str) -> str:
        """The model's unit of one that is written in "in" and "kip": "MPa" of "kip/in"."""
        return in_place_of(internal, {"in": self.motion.unit, "kip": self.response.unit})

    def factor(self, unit: str, role: str, *, of: str = "") -> float:
        """Factor from a unit of a column to the model's.

        Raises
        ------
        UnitError
            When the unit is unknown, or measures something else.
        """
        axis = {"displacement": self.motion, "force": self.response}.get(role)
        if axis is None and role == "velocity":
            axis = Axis(self.name(role), self.unit("in/s"))
        if axis is None or axis in (DAMPER.motion, DAMPER.response) or self == DAMPER:
            return factor(unit, role, of=of)
        return check_unit(unit, axis, of)

    def has(self, name: str) -> bool:
        """Whether a property of a loop, such as "slip_fwd", makes sense."""
        if name == "c_eq" and not self.timed:
            return False
        if self.of_damper:
            return True
        if name.startswith(("energy", "effective_damping", "c_eq")):
            return self.energetic
        return not name.startswith(("slip", "gap", "build_up", "C_"))

    @cached_property
    def energetic(self) -> bool:
        """Whether the area of a loop is an energy, or one of a unit of volume, area or length."""
        area = f"{self.motion.unit}*({self.response.unit})"
        return any(measures(area, energy) for energy in ("J", "J/m", "J/m^2", "J/m^3"))

    def text(self, words: str) -> str:
        """A sentence of the package about a damper in the names of this motion and response."""
        without = () if self.timed else (" and velocity", " over time", " against time")
        for text in (*without, *(() if self.actuated else (" and actuation",))):
            words = words.replace(text, "")
        if self.of_damper:
            return words

        def renamed(match: re.Match[str]) -> str:
            word = match[0]
            name = self._names[word.lower()]
            return name.capitalize() if word[0].isupper() else name

        return self._pattern.sub(renamed, words)

    @cached_property
    def _names(self) -> dict[str, str]:
        """What stands for each word of a damper."""
        motion, response = self.motion.name, self.response.name
        many = f"{response}es" if response.endswith("s") else f"{response}s"
        names = {"offset of the load cell": f"offset of the {response}"}
        if self.response != DAMPER.response:
            names |= {"force": response, "forces": many}
            names |= {"slip force": response, "slip force and gap": response}
        if self.motion != DAMPER.motion:
            names |= {"displacement": motion, "displacements": f"{motion}s", "displ.": motion}
            names |= {"stroke": f"{motion} range", "strokes": f"{motion} ranges"}
            names |= {"velocity": f"{motion} rate", "speed": f"{motion} rate"}
        return names

    @cached_property
    def _pattern(self) -> re.Pattern[str]:
        words = sorted(self._names, key=len, reverse=True)
        return re.compile(rf"(?<!\w)(?:{'|'.join(map(re.escape, words))})(?!\w)", re.IGNORECASE)


DAMPER = Axes()
"""Displacement in in and force in kip, over time."""


def axis_of(given: object, default: Axis) -> Axis:
    """Axis of "stress, MPa", ("stress", "MPa"), or of a quantity of `UNITS` alone, "stress".

    Raises
    ------
    UnitError
        When the name or the unit cannot be used.
    """
    parts = given if isinstance(given, tuple | list) else str(given).split(",", 1)
    name, *unit = (str(part).strip() for part in parts)
    if not re.fullmatch(r"[A-Za-z]\w*", name) or len(unit) > 1:
        raise UnitError(
            f"expected a quantity and its unit such as 'stress, MPa', got {given!r:.60}"
        )
    if name in ("time", "velocity", "actuation", "rate"):
        raise UnitError(f"{name!r} is the name of another column")
    if name in ("displacement", "force"):
        own = Axis(name, {"displacement": "in", "force": "kip"}[name])
        if own != default or unit not in ([], [own.unit]):
            raise UnitError(f"a {name} is in {own.unit} here, got {given!r:.60}")
        return own
    if not unit and name not in UNITS:
        raise UnitError(f"{name!r} needs a unit, such as '{name}, kN*m'; 1 is that of a ratio")
    axis = Axis(name, unit[0] if unit else UNITS[name][1])
    convert(axis.unit, axis.unit)
    if name in UNITS:
        check_unit(axis.unit, Axis(name, UNITS[name][1]), name)
    return axis


def check_unit(unit: str, axis: Axis, of: str) -> float:
    """Factor from a unit to that of an axis; raises UnitError where it measures something else."""
    own = f" of {of}" if of else ""
    try:
        by = convert(unit, axis.unit)
    except UnitError as error:
        if "cannot be given" not in str(error):
            raise UnitError(str(error).replace(f"unit {unit!r}", f"unit {unit!r}{own}")) from error
        by = 0.0
    if not by > 0.0 or has_angle(unit) != has_angle(axis.unit):
        raise UnitError(
            f"unit {unit!r}{own} is none of a {axis.name}, which needs one such as {axis.unit!r}"
        )
    return by


def in_place_of(unit: str, units: Mapping[str, str]) -> str:
    """A unit with others in place of some of its words, "MPa" of "kip/in" with in as 1."""

    def replaced(match: re.Match[str]) -> str:
        other = units.get(match[2], match[2])
        compound = match[1] == "/" and re.search(r"[*/]", other)
        return f"{match[1]}({other})" if compound else f"{match[1]}{other}"

    text = re.sub(r"([*/]?)([A-Za-z%]+)", replaced, unit)
    text = re.sub(r"/\(1/(\w*)\)", r"*\1", text).replace("*1/", "/")
    text = re.sub(r"[*/]1(?![\d./])", "", text)
    return re.sub(r"^1\*", "", text)
