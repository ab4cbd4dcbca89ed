"""Quantities of buildings that tests do not have: masses and accelerations."""

from __future__ import annotations

import re

from mfd_bayes.errors import UnitError
from mfd_bayes.units import GRAVITY, convert, parse_quantity, split_quantity

MASS = "kip*s^2/in"
ACCELERATION = "in/s^2"

_IN_G = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*[gG]\s*")


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
    if match := _IN_G.fullmatch(text):
        return float(match[1]) * GRAVITY
    value, unit = split_quantity(text, example="0.3 g")
    try:
        return value * convert(unit, ACCELERATION)
    except UnitError as error:
        raise UnitError(
            f"expected an acceleration such as '0.3 g' or '3 m/s^2', got {text!r}"
        ) from error


def acceleration_factor(unit: str) -> float:
    """Factor from a unit of acceleration, such as "g" or "cm/s^2", to in/s².

    Raises
    ------
    UnitError
    """
    if unit.strip() in ("g", "G"):
        return GRAVITY
    try:
        return convert(unit, ACCELERATION)
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
