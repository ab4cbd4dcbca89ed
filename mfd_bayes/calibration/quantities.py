"""Units of everything that has a posterior, by name."""

from __future__ import annotations

from collections.abc import Mapping

from mfd_bayes.calibration.priors import KINDS
from mfd_bayes.friction.model import UNITS as PARAMETER_UNITS
from mfd_bayes.units import KINDS as UNIT_KINDS

UNITS: Mapping[str, str] = PARAMETER_UNITS | {
    name: UNIT_KINDS[kind].unit for name, kind in KINDS.items()
}
"""Internal unit of every parameter and sampled quantity."""


def law_unit(name: str, actuation_unit: str) -> str:
    """Unit of a law's constant: K in kip per unit of actuation, α in kip/in per unit.

    Scatter and deviations are of logarithms, and have none, but for the offset's.
    """
    if name.startswith("K_"):
        return "in^2" if actuation_unit == "ksi" else "1"
    if name == "alpha_sigma0":
        return "in" if actuation_unit == "ksi" else "1/in"
    if name == "sigma0_0":
        return "kip/in"
    spread = name.startswith(("scatter_", "deviation_"))
    return "kip" if spread and name.endswith("_offset") else "1"
