"""A building with dampers in an earthquake: `mfd-bayes respond`."""

from mfd_bayes.applications.buildings.dampers import draw_device

__all__ = ["draw_device"]
