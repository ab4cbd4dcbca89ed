"""A building with dampers in an earthquake: `mfd-bayes respond`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mfd_bayes.applications.buildings.dampers import draw_device

__all__ = ["draw_device"]


def __getattr__(name: str) -> Any:
    """What others use, loaded when they do: the options of the command need no numpy."""
    if name != "draw_device":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from mfd_bayes.applications.buildings.dampers import draw_device

    return draw_device
