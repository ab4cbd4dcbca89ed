"""Factors from the units that people write to the internal ones: s, in, kip, ksi.

At the end: what a model's motion and response are called, and their units.

pint is met here and nowhere else, and is imported when the first unit is read.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from functools import cache, cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from mfd_bayes.errors import UnitError

if TYPE_CHECKING:
    from pint import UnitRegistry


ActuationUnit = str
"""Internal unit of an actuation: "ksi" of pressures, "kip" of forces, "A" of currents, …"""

SMALLEST, LARGEST = 1e-20, 1e10  # sizes of a force or a pressure, kip or ksi, other than 0

GRAVITY = 386.0886
"""Standard acceleration of gravity, in/s²."""


class Dimension(NamedTuple):
    """A dimension: its internal unit, and in messages its name, units and a quantity."""

    unit: str
    measure: str
    examples: str
    quantity: str


DIMENSIONS: Mapping[str, Dimension] = MappingProxyType(
    {
        "time": Dimension("s", "time", "'s' or 'ms'", "10 s"),
        "displacement": Dimension("in", "length", "'in' or 'mm'", "1 in"),
        "velocity": Dimension("in/s", "velocity", "'in/s' or 'mm/s'", "2 in/s"),
        "force": Dimension("kip", "force", "'kip' or 'kN'", "2 kip"),
        "pressure": Dimension("ksi", "pressure", "'psi' or 'MPa'", "500 psi"),
        "stiffness": Dimension("kip/in", "stiffness", "'kip/in' or 'kN/mm'", "30 kip/in"),
        "damping": Dimension("kip*s/in", "damping", "'kip*s/in' or 'kN*s/mm'", "0.1 kip*s/in"),
        "area": Dimension("in^2", "area", "'in^2' or 'mm^2'", "1.5 in^2"),
        "mass": Dimension("kip*s^2/in", "mass", "'kg' or 'slug'", "100 kg"),
        "rate": Dimension("Hz", "rate", "'Hz' or '1/s'", "64 Hz"),
        "dimensionless": Dimension("1", "ratio", "'1' or '%'", "5 %"),
    }
)
"""The dimensions that a unit can have, by name."""


def dimension_of(kind: str) -> Dimension:
    """The dimension of that name, or, for any other unit such as "MPa", that unit itself."""
    return DIMENSIONS.get(kind) or Dimension(kind, kind, repr(kind), f"1 {kind}")


def by_spelling(spellings: Mapping[str, str]) -> dict[str, str]:
    """Unit of each spelling, from the spellings of each unit, with blanks between them."""
    return {spelled: unit for unit, words in spellings.items() for spelled in words.split()}


# Usual spellings of units, and pint's; from three letters on, upper or lower case does not matter.
# There are no masses here, so a pound is a force, and no conductances, so S is the second.
_SPELLINGS = by_spelling(
    {
        "s": "S sec secs Sek sek seg",
        "ms": "mS msec msecs",
        "min": "Min MIN mins",
        "m": "M",
        "in": "IN In inch",
        "ft": "FT Ft foot feet",
        "mm": "MM",
        "cm": "CM",
        "lbf": "lb Lb LB lbs lbf pound pounds",
        "kip": "kip kips",
        "kN": "KN Kn kn",
        "MPa": "MPA Mpa",
        "kPa": "KPA Kpa kpa",
        "psi": "psi psig",
        "A": "amp amps Amp Amps ampere",
        "turn": "rev revs",
        "N*m": "Nm",
        "kN*m": "kNm",
        "%": "%",
        "percent": "percent",
        "ksi": "ksi",
        "psf": "psf",
        "bar": "bar",
        "deg": "deg",
        "klbf": "klbf klb klbs",
        "kgf": "kp Kgf KGF",
        "thou": "mil mils thous",  # not a thousandth of a radian
        "Gal": "gal gals",  # of earthquakes; of a flow, see `_GALLONS`
        "microstrain": "µε με uε µstrain μstrain ue",
        "strain": "ε",
        "(L/min)": "lpm",
        "(gallon/min)": "gpm",
        "(ft^3/min)": "cfm",
    }
)

_METRIC_TON, _US_TON = "'tf' (9.807 kN)", "'ton_force' (2000 lbf)"
_FORCES = {
    word: meant
    for words, meant in (
        ("kg kgs kilogram kilograms", "'kgf' (9.807 N)"),
        ("t tonne tonnes", _METRIC_TON),
        ("ton tons tonf tonsf", f"{_METRIC_TON} or {_US_TON}"),
    )
    for word in words.split()
}
"""What to write for a mass, or for one of several units, that people write for a force."""

UNREAD = frozenset(_FORCES) | {"div", "volt", "volts", "v", "mv", "ma", "counts", "cts", "bits"}
"""Words, in lower case, that are units of a column, and none that a record can have."""

_PLAIN: Mapping[str, tuple[float, ActuationUnit]] = MappingProxyType(
    {"ksi": (1.0, "ksi"), "psi": (0.001, "ksi"), "kip": (1.0, "kip")}
)
"""Actuations in these units, as in internal ones, need no registry, which is slow to build."""

_NONE = "dimensionless"  # pint's name of the unit 1

_COUNTED = ("click", "notch", "step")
"""Words for the setting of an adjuster, each a unit of its own."""

_ACTUATIONS = ("ksi", "kip", "A", "V", "W", "N*m", "turn", "%", "K", "T", *_COUNTED)
"""Internal units of actuations, one for each dimension; turn and % have none."""

# pint's parser evaluates its input: it is given names, products and small powers alone.
# A power may be written as in N/mm2.
_POWER = re.compile(r"(?<=[A-Za-zµμ])([23])(?!\w)")
_TERM = r"\(*[A-Za-zµμε°%_]+\)*(?:(?:\^|\*\*)-?\d|[²³])?\)*"
_UNIT = re.compile(rf"(?:1|{_TERM})(?:(?:\s*[*/·]\s*|\s+){_TERM})*")
_ABBREVIATED = re.compile(r"(?<=[A-Za-z])\.(?!\w)")  # in., lb./in.
_INCHES = re.compile("\"|''|″|′′|”")
_DASH = re.compile(r"(?<=[A-Za-z])-(?=[A-Za-z])")  # kip-in, kN-m
_GALLONS = re.compile(r"\bgals?(?=\s*/\s*(?:s|sec|min|h|hr|d)\b)", re.IGNORECASE)  # of a flow
_GROUPED = re.compile(r"\s*[+-]?\d{1,3}(?:[ ,'’\u00a0\u202f]\d{3})+(?!\d)")  # 1,000 · 1 000
_ANGLES = re.compile(r"radian|degree|revolution|turn|grad|cycle|arc")  # pint takes them for 1
_LONGEST = 200  # characters of a quantity
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*", re.ASCII)


def factor(unit: str, dimension: str, *, of: str = "") -> float:
    """Factor from a unit, as people write it, to the internal unit of its dimension.

    `dimension` is a key of `DIMENSIONS`, or a unit of one's own; `of` says in the message what has
    the unit: "column 'force_N'".
    """
    if dimension not in DIMENSIONS:
        # a unit that is its own target needs no registry, which is slow to build
        return 1.0 if unit == dimension else convert(unit, dimension)
    target = DIMENSIONS[dimension]
    if unit == target.unit:
        return 1.0
    named = _named(unit, of)
    parsed = _parse(unit, named)
    measure = _measure(parsed)
    if measure != target.measure:
        article = "an" if target.measure == "area" else "a"
        raise UnitError(
            f"{named} measures {measure}; {dimension} needs {article} {target.measure} "
            f"such as {target.examples}{force_meant(unit)}"
        )
    if dimension != "dimensionless" and (angle := _ANGLES.search(str(parsed))):
        raise UnitError(
            f"{named} has an angle ({angle[0]}) in it, and is no {target.measure}; {dimension} "
            f"needs one such as {target.examples}"
        )
    return _scale(parsed, target.unit, named)


def actuation_factor(unit: str, *, of: str = "") -> tuple[float, ActuationUnit]:
    """Factor and internal unit of an actuation: ksi, kip, or another such as A, V, turn."""
    if isinstance(unit, str) and unit in _PLAIN:
        return _PLAIN[unit]
    named = _named(unit, of)
    parsed = _parse(unit, named)
    is_angle = bool(_ANGLES.search(str(parsed)))
    for internal in _ACTUATIONS:
        candidate = _registry().parse_units(internal)
        is_mismatch = internal in ("turn", "%") and (internal == "turn") != is_angle
        if (
            parsed.dimensionality == candidate.dimensionality
            and not is_mismatch
            and str(parsed) != _NONE
        ):
            return _scale(parsed, internal, named), internal
    raise UnitError(
        f"{named} measures {_measure(parsed)}; actuation needs a pressure such as 'psi', a force "
        f"such as 'lbf', or a unit such as 'A', 'V', 'N*m', 'turn' or '%'{force_meant(unit)}"
    )


def actuation_kind(internal: ActuationUnit) -> str:
    """What an internal unit of actuation measures, with its article: "a pressure"."""
    named = {"ksi": "a pressure", "kip": "a force"}
    return named.get(internal, f"in {internal} or a multiple of it")


def convert(unit: str, target: str) -> float:
    """Factor from one unit to another of the same measure: ``("kip/in", "kN/mm")``."""
    named = _named(unit)
    parsed, parsed_target = _parse(unit, named), _parse(target, _named(target))
    if parsed.dimensionality != parsed_target.dimensionality:
        raise UnitError(f"{named} cannot be given in {target!r}")
    return _scale(parsed, str(parsed_target), named)


def force_meant(unit: str) -> str:
    """Part of a sentence: what to write for a unit if it is one of force; empty for others."""
    words = re.findall(r"[a-z]+", unit.lower()) if isinstance(unit, str) else []
    return next((f"; if it is a force, write {_FORCES[w]}" for w in words if w in _FORCES), "")


def may_mean(unit: str, read: str) -> bool:
    """Whether a force of a unit such as "kg" or "tonf" may have been read in the other unit."""
    meant = re.findall(r"'(\w+)'", _FORCES.get(unit.lower(), ""))
    return any(same_unit(name, read) for name in meant)


def measure(unit: str) -> str | None:
    """Name of a unit's dimension: ``"force"`` of ``"kips"``; None for an unknown unit."""
    try:
        return _measure(_parse(unit, unit))
    except UnitError:
        return None


def measures(unit: str, reference: str) -> bool:
    """Whether a unit is of the same dimension as another."""
    return bool(_parse(unit, unit).dimensionality == _parse(reference, reference).dimensionality)


def force_and_length(unit: str) -> tuple[float, float]:
    """Powers of a force and of a length in a unit: ``(1, -1)`` of ``"kip*s/in"``."""
    dimensions = _parse(unit, _named(unit)).dimensionality
    force = float(dimensions.get("[mass]", 0.0))
    return force, float(dimensions.get("[length]", 0.0)) - force


def has_angle(unit: str) -> bool:
    """Whether a unit is one of an angle, or has one in it: those measure a ratio too."""
    return bool(_ANGLES.search(str(_parse(unit, _named(unit)))))


def same_unit(unit: str, target: str) -> bool:
    """Whether two units are the same, however they are spelled: ``"kip"`` and ``"Kips"``."""
    try:
        return math.isclose(convert(unit, target), 1.0)
    except UnitError:
        return False


def in_digits(value: float, digits: int) -> str:
    """A number with so many digits, without an exponent from 1000 to ten million: "6340"."""
    rounded = float(f"{value:.{digits}g}")
    return f"{rounded:.0f}" if 1e3 <= abs(rounded) < 1e7 else f"{rounded:.{digits}g}"


def percent(probability: float) -> str:
    """A probability in percent, with as many digits as it needs not to be 0 or 100."""
    text = f"{100 * probability:g}"
    exact = Decimal(repr(float(probability))) * 100
    certain = text in ("0", "100") and exact not in (0, 100)
    return f"{exact.normalize():f}" if certain else text


def parse_quantity(text: str, dimension: str, *, of: str = "") -> float:
    """Value of ``"500 psi"`` in the internal unit of its dimension."""
    value, unit = split_quantity(text, of=of, example=dimension_of(dimension).quantity)
    return value * factor(unit, dimension, of=of or f"{text!r}")


def parse_mass(text: str, *, of: str = "") -> float:
    """Mass, kip*s^2/in, of ``"3 kg"``; a force such as ``"6.6 lb"`` is its weight."""
    if measure(split_quantity(text, of=of)[1]) == "force":
        return parse_quantity(text, "force", of=of) / GRAVITY
    return parse_quantity(text, "mass", of=of)


def parse_actuation(text: str, *, of: str = "") -> tuple[float, ActuationUnit]:
    """Value and internal unit of an actuation: ``"500 psi"`` is ``(0.5, "ksi")``."""
    value, unit = split_quantity(text, of=of)
    if value < 0:
        raise UnitError(f"actuation must not be negative, got {text!r}")
    scale, internal = actuation_factor(unit, of=of or f"{text!r}")
    level = value * scale
    if (level != 0.0 and not SMALLEST <= level <= LARGEST) or (value > 0.0) != (level > 0.0):
        raise UnitError(
            f"{f'{of}: ' if of else ''}expected an actuation of 0, or of {SMALLEST:g} to "
            f"{LARGEST:g} {internal}, got {text!r}: too small or too large to use"
        )
    return level, internal


def split_quantity(text: str, *, of: str = "", example: str = "500 psi") -> tuple[float, str]:
    """Number and unit of ``"518.7 mm^2"``, whatever it measures; `example` is for messages."""
    expected = f"{of + ': ' if of else ''}expected a number and a unit such as {example!r}"
    if not isinstance(text, str):
        raise UnitError(f"{expected}, got {' '.join(repr(text).split())}")
    # The time of matching grows with the square of the number of blanks.
    match = _QUANTITY.fullmatch(text) if len(text) <= _LONGEST else None
    text = text if len(text) <= _LONGEST else f"{text[:40]}…"
    if _GROUPED.match(text):
        raise UnitError(f"{expected}, got {text!r}; write the number without thousands separators")
    if match is None:
        raise UnitError(f"{expected}, got {text!r}")
    value, unit = float(match[1]), match[2]
    if not math.isfinite(value):
        raise UnitError(f"{expected}, got {text!r}, which is not finite")
    if not unit:
        raise UnitError(f"{expected}; {text!r} has no unit")
    return value, unit


@cache
def _registry() -> UnitRegistry[Any]:
    """Registry of pint, built once in a tenth of a second."""
    from pint import UnitRegistry

    registry: UnitRegistry[Any] = UnitRegistry()
    for word in _COUNTED:
        registry.define(f"{word} = [{word}] = _ = {word}{'es' if word[-1] == 'h' else 's'}")
    return registry


def _parse(unit: str, named: str) -> Any:
    """Unit of a text, as pint has it."""
    unknown = f"{named} is unknown; expected one such as 'in', 'mm', 'kip', 'kN', 'psi'"
    unknown += force_meant(unit)
    text = _ABBREVIATED.sub("", unit.strip()) if isinstance(unit, str) else ""
    text = _INCHES.sub("in", text)
    text = _DASH.sub("*", _POWER.sub(r"^\1", text))
    text = _GALLONS.sub("gallon", text)
    if not text or len(text) > 60 or not _UNIT.fullmatch(text):
        raise UnitError(unknown)
    words = re.sub(r"[A-Za-z_µμε]+", lambda word: _spelled(word[0]), text)
    try:
        parsed = _registry().parse_units(words)
        _ = parsed.dimensionality  # fails for units such as "delta_dB"
        return parsed
    except Exception as error:  # pint raises AssertionError, TypeError, TokenError and its own
        raise UnitError(unknown) from error


def _spelled(word: str) -> str:
    """Word of a unit in pint's spelling."""
    lower = word.lower()
    if spelling := _SPELLINGS.get(word) or (_SPELLINGS.get(lower) if len(word) > 2 else None):
        return spelling
    # A longer word is no symbol but a name: "Newtons".
    return lower if len(word) > 4 else word


def _measure(parsed: Any) -> str:
    """Name of the dimension of pint's unit."""
    for dimension in DIMENSIONS.values():
        if parsed.dimensionality == _registry().get_dimensionality(dimension.unit):
            return dimension.measure
    return str(parsed.dimensionality).replace("[", "").replace("]", "")


def _scale(parsed: Any, target: str, named: str) -> float:
    """Factor from pint's unit to another; the values at 0 and 2 show an offset or a logarithm."""
    try:
        to = _registry().parse_units(target)
        zero, ratio, two = (float(_registry().convert(x, parsed, to)) for x in (0.0, 1.0, 2.0))
    except Exception as error:  # offset and logarithmic units fail in several ways
        raise UnitError(f"{named} is not a plain multiple of {target!r}") from error
    if zero != 0.0 or not (math.isfinite(ratio) and ratio > 0.0 and math.isclose(two, 2.0 * ratio)):
        raise UnitError(f"{named} is not a plain multiple of {target!r}")
    return ratio


def _named(unit: str, of: str = "") -> str:
    """A unit, and what has it, for messages."""
    return f"unit {unit!r} of {of}" if of else f"unit {unit!r}"


# --- motion and response of a model ---------------------------------------------------------------


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
        """Factor from a unit of a column to the model's."""
        axis = {"displacement": self.motion, "force": self.response}.get(role)
        if axis is None and role == "velocity":
            axis = Axis(self.name(role), self.unit("in/s"))
        if axis is None or axis in (DAMPER.motion, DAMPER.response) or self == DAMPER:
            return factor(unit, role, of=of)
        return check_unit(unit, axis, of)

    @cached_property
    def energetic(self) -> bool:
        """Whether the area of a loop is an energy, or one of a unit of volume, area or length."""
        area = f"{self.motion.unit}*({self.response.unit})"
        energies = ("J", "J/m", "J/m^2", "J/m^3")
        return self.of_damper or any(measures(area, energy) for energy in energies)

    def text(self, words: str) -> str:
        """A sentence of the package about a damper in the names of this motion and response."""
        phrases = () if self.timed else (" and velocity", " over time", " against time")
        for text in (*phrases, *(() if self.actuated else (" and actuation",))):
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
        plural = f"{response}es" if response.endswith("s") else f"{response}s"
        names = {"offset of the load cell": f"offset of the {response}", "load cell": "sensor"}
        names |= {"of the damper": "of the device", "spikes at build-up": "spikes"}
        if self.response != DAMPER.response:
            names |= {"force": response, "forces": plural}
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


_OTHER_NAMES = {"displacement": "travel, mm", "force": "load, N"}


def axis_of(spec: object, default: Axis) -> Axis:
    """Axis of "stress, MPa", ("stress", "MPa"), or of a quantity of `UNITS` alone, "stress"."""
    items = spec if isinstance(spec, tuple | list) else str(spec).split(",", 1)
    name, *unit = (str(item).strip() for item in items)
    if not re.fullmatch(r"[A-Za-z]\w*", name) or len(unit) > 1:
        raise UnitError(f"expected a quantity and its unit such as 'stress, MPa', got {spec!r:.60}")
    if name in ("time", "velocity", "actuation", "rate"):
        raise UnitError(f"{name!r} is the name of another column")
    if name in ("displacement", "force"):
        standard_axis = Axis(name, {"displacement": "in", "force": "kip"}[name])
        if standard_axis != default or unit not in ([], [standard_axis.unit]):
            raise UnitError(
                "a model gets its displacement in in and gives its force in kip, whatever the "
                f"units of the records, got {spec!r:.60}: leave the unit out, or use another name "
                f"than {name}, such as '{_OTHER_NAMES[name]}'"
            )
        return standard_axis
    if not unit and name not in UNITS:
        raise UnitError(f"{name!r} needs a unit, such as '{name}, kN*m'; 1 is that of a ratio")
    axis = Axis(name, unit[0] if unit else UNITS[name][1])
    convert(axis.unit, axis.unit)
    if name in UNITS:
        check_unit(axis.unit, Axis(name, UNITS[name][1]), name)
    return axis


def check_unit(unit: str, axis: Axis, of: str) -> float:
    """Factor from a unit to that of an axis; raises UnitError where it measures something else."""
    owner = f" of {of}" if of else ""
    try:
        ratio = convert(unit, axis.unit)
    except UnitError as error:
        if "cannot be given" not in str(error):
            raise UnitError(
                str(error).replace(f"unit {unit!r}", f"unit {unit!r}{owner}")
            ) from error
        ratio = 0.0
    if not ratio > 0.0 or has_angle(unit) != has_angle(axis.unit):
        raise UnitError(
            f"unit {unit!r}{owner} is none of a {axis.name}, which needs one such as {axis.unit!r}"
        )
    return ratio


def in_place_of(unit: str, units: Mapping[str, str]) -> str:
    """A unit with others in place of some of its words, "MPa" of "kip/in" with in as 1."""

    def replaced(match: re.Match[str]) -> str:
        replacement = units.get(match[2], match[2])
        compound = match[1] == "/" and re.search(r"[*/]", replacement)
        return f"{match[1]}({replacement})" if compound else f"{match[1]}{replacement}"

    text = re.sub(r"([*/]?)([A-Za-z%]+)", replaced, unit)
    text = re.sub(r"/\(1/(\w*)\)", r"*\1", text).replace("*1/", "/")
    text = re.sub(r"[*/]1(?![\d./])", "", text)
    return re.sub(r"^1\*", "", text)
