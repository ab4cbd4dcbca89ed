"""Constants of the laws that are straight lines, and what laws leave without actuation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.population.laws import INTERCEPTS

Array = NDArray[np.float64]

_STRAIGHT = ("proportional", "affine")


class StraightLaws:
    """Properties of a `Population` for laws; a population has all the attributes that they use."""

    @property
    def slopes(self: Any) -> dict[str, Array]:
        """The paper's constants of those laws that are straight, and the laws' intercepts.

        K_c and K_s in kip per unit of actuation, `alpha_sigma0` in kip/in per unit of actuation;
        what is left without actuation: `Fc_fwd_0` and its like in kip, `sigma0_0` in kip/in.
        All are (chain, draw).
        """
        found: dict[str, Array] = {}
        for side in ("fwd", "bwd"):
            if self.layout.laws.get(f"Fc_{side}") not in _STRAIGHT:
                continue
            kinetic = self._slope(f"Fc_{side}")
            found[f"K_c_{side}"] = kinetic
            if f"static_excess_{side}" in self.layout.names:
                at = np.array([self.layout.reference])
                excess = self.median(f"static_excess_{side}", at)[..., 0]
                found[f"K_s_{side}"] = kinetic * (1.0 + excess)
        if self.layout.laws.get("sigma0") in _STRAIGHT:
            found["alpha_sigma0"] = self._slope("sigma0")
        nothing = np.zeros(1)
        for name, law in self.layout.laws.items():
            if law in ("affine", "residual_power") and f"{name}_0" in INTERCEPTS:
                found[f"{name}_0"] = self.median(name, nothing)[..., 0]
        return found

    def _slope(self: Any, name: str) -> Array:
        """Slope of a straight law, (chain, draw)."""
        p0 = self.layout.reference
        ends = self.median(name, np.array([0.0, p0]))
        return np.asarray((ends[..., 1] - ends[..., 0]) / p0)
