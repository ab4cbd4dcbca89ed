"""Laws: how the median of a parameter follows the actuation (paper Eq. 5).

    v(p) = v(p0) [w (p/p0)^b + 1 - w]

The share w and the exponent b are given by the law, or inferred.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.priors import Prior
from mfd_bayes.friction import models
from mfd_bayes.friction.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Law:
    """A law by name; a share or an exponent of None is inferred."""

    name: str
    share: float | None
    exponent: float | None

    @property
    def shapes(self) -> tuple[str, ...]:
        """What is inferred besides the level v(p0): "share", "exponent", both or nothing."""
        free = {"share": self.share, "exponent": self.exponent}
        return tuple(name for name, value in free.items() if value is None)

    @property
    def intercept(self) -> bool:
        """Whether it has a value without actuation, v(0) = v(p0) (1 - w); else v(0) = 0."""
        return self.share != 1.0


LAWS = {
    law.name: law
    for law in (
        Law("proportional", 1.0, 1.0),
        Law("affine", None, 1.0),
        Law("power", 1.0, None),
        Law("constant", 0.0, 1.0),
        Law("residual_power", None, None),
    )
}
"""All laws, in the order of their numbers in stored draws."""

LAW_NAMES = tuple(LAWS)

# in place of a law: all laws, weighted by how well they predict levels that were left out
COMPARE = "compare"
# mean and sd of the normal prior of an exponent. That of a share is uniform from 0 to 1.
EXPONENT = (1.0, 0.5)
# prior sd of a dependence: change of a parameter's coordinate per e-fold of a covariate
SENSITIVITY = 0.1
LARGEST = 1e100  # largest ratio that a law gives, so that what is computed from it is finite
# parameters that have the law of another, and which
TIED = {name: other for m in models.MODELS.values() for name, other in m.tied_laws.items()}
INTERCEPTS = {"sigma0_0": "kip/in"} | {
    f"{name}_0": "kip" for name in ("Fc_fwd", "Fc_bwd", "Fy_fwd", "Fy_bwd")
}
"""Units of what is left without actuation."""


def default_laws(model: Model | None = None) -> dict[str, str]:
    """Law of every sampled quantity that follows the actuation, of a model or of all ours."""
    among = models.MODELS.values() if model is None else [model]
    return {name: law for m in among for name, law in m.laws.items()}


def complete_laws(given: Mapping[str, str]) -> dict[str, str]:
    """Law of every name that may have one in a campaign: the given one, or the default.

    Where a law must be that of another quantity, that is its default.
    """
    laws: dict[str, str] = {}
    for model in models.MODELS.values():
        for name, default in model.laws.items():
            other = model.laws_from.get(name, "")
            laws[name] = given.get(name, laws.get(other, default))
        for name, followed in model.tied_laws.items():
            laws[name] = given.get(name, laws[followed])
    return laws


def shapes_of(law: str) -> tuple[str, ...]:
    """What is inferred of a law besides its level; of "compare", the shapes of every law."""
    return ("share", "exponent") if law == COMPARE else LAWS[law].shapes


def usual_shapes(law: str) -> tuple[float, float]:
    """Share and exponent of a law; of free ones the medians of their priors."""
    given = LAWS["residual_power" if law == COMPARE else law]
    share = 0.5 if given.share is None else given.share
    return share, EXPONENT[0] if given.exponent is None else given.exponent


def ratio(relative: Array, share: Array, exponent: Array) -> Array:
    """v(p)/v(p0) at p/p0 = `relative`, all broadcast; 0 at p = 0 for a proportional law."""
    positive = relative > 0
    with np.errstate(over="ignore"):  # an actuation far beyond the tests
        power = np.exp(np.log(np.where(positive, relative, 1.0)) * exponent)
    power = np.where(positive, np.minimum(power, LARGEST), 0.0)
    return np.asarray(share * power + (1.0 - share))


def shape_prior(shape: str) -> Prior:
    """Prior of a share or an exponent of a law, as one test by itself may have it."""
    if shape == "share":
        return Prior("uniform", {"lower": 0.0, "upper": 1.0})
    return Prior("normal", {"mean": EXPONENT[0], "sd": EXPONENT[1]})


def _grouped(unit: str) -> str:
    """A unit as it stands below a fraction's line."""
    return f"({unit})" if "*" in unit else unit


def law_unit(name: str, actuation_unit: str) -> str:
    """Unit of a law's constant: K in kip per unit of actuation, α in kip/in per unit.

    Scatter and deviations are of logarithms and have none, but for the offset's.
    """
    if name.startswith("K_"):
        return {"ksi": "in^2", "kip": "1"}.get(actuation_unit, f"kip/{_grouped(actuation_unit)}")
    if name == "alpha_sigma0":
        own = f"kip/in/{_grouped(actuation_unit)}"
        return {"ksi": "in", "kip": "1/in"}.get(actuation_unit, own)
    if name in INTERCEPTS:
        return INTERCEPTS[name]
    spread = name.startswith(("scatter_", "deviation_"))
    return "kip" if spread and name.endswith("_offset") else "1"
