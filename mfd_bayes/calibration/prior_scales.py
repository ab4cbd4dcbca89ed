"""Figures of a prior file that are multiples of a device's own force, length and speed."""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from mfd_bayes.errors import PriorError, UnitError
from mfd_bayes.units import parse_quantity

SCALES = MappingProxyType({"force": "force", "length": "displacement", "speed": "velocity"})
"""The scales that a prior file may state, and what each measures."""

_UNITS: Mapping[str, tuple[str, str, str]] = MappingProxyType(
    {
        "force": ("force", "", "kip"),
        "length": ("length", "", "in"),
        "speed": ("speed", "", "in/s"),
        "force/length": ("force", "length", "kip/in"),
        "force/speed": ("force", "speed", "kip*s/in"),
        "length/speed": ("length", "speed", "s"),
    }
)
_MULTIPLE = re.compile(rf"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s+({'|'.join(_UNITS)})\s*")


def in_units(name: str, content: Mapping[str, Any]) -> dict[str, Any]:
    """Content of a prior file, with multiples of its scales written in internal units.

    Parameters
    ----------
    name : str
        The file's, for messages.
    content : mapping
        With the table `scales`, or without any multiple.

    Raises
    ------
    PriorError
        When a scale is missing, unknown, or not above 0.
    """
    given = content.get("scales")
    scales = None if given is None else _scales(name, given)
    rest = {key: part for key, part in content.items() if key != "scales"}
    return {
        key: {k: _table(name, t, scales) for k, t in part.items()}
        if key in ("parameters", "scatter") and isinstance(part, dict)
        else part
        for key, part in rest.items()
    }


def _scales(name: str, given: object) -> dict[str, float]:
    if not isinstance(given, dict) or set(given) != set(SCALES):
        raise PriorError(f"[scales] of prior file {name} must hold force, length and speed")
    found = {}
    for key, measured in SCALES.items():
        where = f"{key} in [scales] of prior file {name}"
        if not isinstance(given[key], str):
            raise PriorError(f"{where}: expected a quantity such as '7 N', got {given[key]!r:.60}")
        try:
            found[key] = parse_quantity(given[key], measured, of=where)
        except UnitError as error:
            raise PriorError(str(error)) from error
        if not found[key] > 0.0:
            raise PriorError(f"{where}: expected more than 0, got {given[key]!r}")
    return found


def _table(name: str, table: object, scales: Mapping[str, float] | None) -> object:
    if not isinstance(table, dict):
        return table
    return {key: _figure(name, value, scales) for key, value in table.items()}


def _figure(name: str, value: object, scales: Mapping[str, float] | None) -> object:
    match = _MULTIPLE.fullmatch(value) if isinstance(value, str) and len(value) < 100 else None
    if match is None:
        return value
    if scales is None:
        raise PriorError(
            f"prior file {name} holds multiples of a force, a length and a speed, and does not "
            "state them: copy it beside the campaign and complete [scales] in it, or let "
            "mfd-bayes init campaign.toml write a priors.toml from your records"
        )
    over, under, unit = _UNITS[match[2]]
    return f"{float(match[1]) * scales[over] / scales.get(under, 1.0)!r} {unit}"
