"""Units of everything that has a posterior, by name."""

from __future__ import annotations

from collections.abc import Mapping

from mfd_bayes.calibration.priors import KINDS
from mfd_bayes.friction.model import UNITS as PARAMETER_UNITS
from mfd_bayes.units import DIMENSIONS

UNITS: Mapping[str, str] = PARAMETER_UNITS | {
    name: DIMENSIONS[kind].unit for name, kind in KINDS.items()
}
"""Internal unit of every parameter and sampled quantity."""
