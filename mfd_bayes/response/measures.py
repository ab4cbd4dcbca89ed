"""Quantities of buildings that tests do not have: masses and accelerations."""

from __future__ import annotations

import re

from mfd_bayes.errors import UnitError
from mfd_bayes.units import GRAVITY, convert, parse_quantity, split_quantity

MASS = "kip*s^2/in"
ACCELERATION = "in/s^2"

GAL = 1.0 / 2.54
"""1 cm/s², in in/s²."""

_NAMED = {
    **dict.fromkeys(("g", "g's", "gs", "gn"), GRAVITY),
    **dict.fromkeys(("%g", "%ofg"), 0.01 * GRAVITY),
    **dict.fromkeys(("mg", "milli-g"), 0.001 * GRAVITY),
    **dict.fromkeys(("gal", "gals"), GAL),
    **dict.fromkeys(("mgal", "milligal"), 0.001 * GAL),
}


def parse_mass(text: str) -> float:
    """Mass of ``"98.3 kg"``, kip s²/in; a weight is no mass.

    Raises
    ------
    UnitError
    """
    try:
        return parse_quantity(text, "mass")
    except UnitError as error:
        raise UnitError(
            f"expected a mass such as '45 Mg' or '0.26 kip*s^2/in', got {text!r}"
        ) from (error)


def parse_acceleration(text: str) -> float:
    """Acceleration of ``"0.3 g"`` or ``"3 m/s^2"``, in/s²; g is that of gravity, no gram.

    Raises
    ------
    UnitError
    """
    value, unit = split_quantity(text, example="0.3 g")
    try:
        return value * acceleration_factor(unit)
    except UnitError as error:
        raise UnitError(
            f"expected an acceleration such as '0.3 g' or '3 m/s^2', got {text!r}"
        ) from error


def acceleration_factor(unit: str) -> float:
    """Factor from a unit of acceleration to in/s²: "g", "gal", "%g", "cm/s^2", "(CM/SEC/SEC)".

    Upper and lower case are the same, for headers are in capitals.

    Raises
    ------
    UnitError
    """
    plain = unit.strip().strip("\"'").lower()
    if bracketed := re.fullmatch(r"[(\[]([^()\[\]]*)[)\]]", plain):
        plain = bracketed[1].strip()
    plain = plain.removesuffix(".")
    if known := _NAMED.get(plain.replace(" ", "")):
        return known
    plain = re.sub(r"\s*\bper\b\s*", "/", plain)
    plain = re.sub(r"(?<=[a-z])\.(?=[a-z])", "*", plain)
    plain = re.sub(r"(?<=[a-z])(-?2)\b", r"^\1", plain)  # "cm/s2", "cm s-2"
    try:
        return convert(plain, ACCELERATION)
    except UnitError as error:
        raise UnitError(f"unit {unit!r} is no acceleration such as 'g' or 'm/s^2'") from error


def parse_share(text: str) -> float:
    """Share of ``"2 %"`` or ``"0.02"``.

    Raises
    ------
    UnitError
    """
    try:
        return float(text)
    except ValueError:
        return parse_quantity(text, "dimensionless")
