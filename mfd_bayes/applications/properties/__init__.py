"""The data sheet, bounding properties for design, and conformity with a standard."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mfd_bayes.applications.properties.datasheet import sheet_conditions, sheet_values
    from mfd_bayes.applications.properties.design import design_factors, standard_bounds
    from mfd_bayes.applications.properties.protocol import print_protocol

__all__ = [
    "design_factors",
    "print_protocol",
    "sheet_conditions",
    "sheet_values",
    "standard_bounds",
]

_MODULES = {
    "design_factors": "design",
    "standard_bounds": "design",
    "print_protocol": "protocol",
    "sheet_conditions": "datasheet",
    "sheet_values": "datasheet",
}


def __getattr__(name: str) -> Any:
    """What others use, loaded when they do."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
