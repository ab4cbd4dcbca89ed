"""Laws: how a parameter's median follows the actuation (paper Eq. 5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.friction import models

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Law:
    """A law v(p) = v(p0) [w (p/p0)^b + 1 − w]; the share w and the exponent b may be free.

    Attributes
    ----------
    name : str
    share, exponent : float or None
        The value that the law gives it; None where it is inferred.
    """

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
        """Whether it has a value without actuation, v(0) = v(p0) (1 − w); else v(0) = 0."""
        return self.share != 1.0


LAWS = {
    law.name: law
    for law in (
        # F = K p: K = v(p0)/p0
        Law("proportional", 1.0, 1.0),
        # σ0 = α p + σ0|p=0: of the value at p0 the share w is in proportion, w uniform in (0, 1)
        Law("affine", None, 1.0),
        # v = v(p0) (p/p0)^b, b ~ N(1, ½²)
        Law("power", 1.0, None),
        Law("constant", 0.0, 1.0),
        # residual friction F0 + K p^b: F0 = v(p0) (1 − w). Stored draws have the laws' numbers,
        # so a new one comes last
        Law("residual_power", None, None),
    )
}

COMPARE = "compare"
"""In place of a law: all laws, weighted by how well they predict levels left out."""


def default_laws() -> dict[str, str]:
    """Law of every sampled quantity that follows the actuation: the paper's, by its model."""
    return {name: law for m in models.MODELS.values() for name, law in m.laws.items()}


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


TIED = {name: other for m in models.MODELS.values() for name, other in m.tied_laws.items()}
"""Names that have the law of another quantity, and which."""


def shapes_of(law: str) -> tuple[str, ...]:
    """What is inferred of a law by name besides its level; of "compare", those of every law."""
    return ("share", "exponent") if law == COMPARE else LAWS[law].shapes


INTERCEPTS = {"sigma0_0": "kip/in"} | {
    f"{name}_0": "kip" for name in ("Fc_fwd", "Fc_bwd", "Fy_fwd", "Fy_bwd")
}
"""Units of what is left without actuation: the stiffness, and the residual friction."""

_MOST = 1e100  # largest ratio, so that what is computed from it is finite


def ratio(relative: Array, share: Array, exponent: Array) -> Array:
    """v(p)/v(p0) at p/p0, all broadcast; 0 at p = 0 for a proportional law."""
    positive = relative > 0
    with np.errstate(over="ignore"):  # an actuation far beyond the tests
        power = np.where(positive, np.power(np.where(positive, relative, 1.0), exponent), 0.0)
    power = np.minimum(power, _MOST)
    followed: Array = share * power + (1.0 - share)
    return followed


def ratios_along(relative: Array, share: Array, exponent: Array) -> Array:
    """As `ratio` for long histories: v(p)/v(p0) at p/p0 (T,) of laws (n,), time first, (T, n)."""
    positive = relative > 0
    power = np.multiply.outer(np.log(np.where(positive, relative, 1.0)), exponent)
    with np.errstate(over="ignore"):
        np.exp(power, out=power)
    np.minimum(power, _MOST, out=power)
    power[~positive] = 0.0
    power *= share
    power += 1.0 - share
    return np.asarray(power)


def value_of(shape: str, q: Array) -> Array:
    """A shape at its coordinate q: a share is the logistic function of it, others q itself."""
    return np.asarray(special.expit(q)) if shape == "share" else q


def log_prior(shape: str, q: Array) -> Array:
    """Log density of a shape's coordinate, without its constant."""
    if shape == "share":
        return np.asarray(special.log_expit(q) + special.log_expit(-q))
    centre, sd = _moments(shape)
    return np.asarray(-0.5 * ((q - centre) / sd) ** 2)


def _moments(shape: str) -> tuple[float, float]:
    """Mean and sd of a shape's normal prior: of an exponent, or of a dependence."""
    return (1.0, 0.5) if shape == "exponent" else (0.0, SENSITIVITY)


@cache
def prior_of(shape: str) -> Any:
    """Prior of a shape's coordinate, as a distribution of scipy.stats."""
    from scipy import stats  # which takes long to import

    if shape == "share":
        return stats.logistic()
    return stats.norm(*_moments(shape))


def draw_shape(shape: str, uniform: Array) -> Array:
    """Coordinates of a shape drawn from its prior, from uniform numbers in (0, 1)."""
    return np.asarray(prior_of(shape).ppf(uniform))


SENSITIVITY = 0.1
"""Prior sd of a dependence: change of a parameter's coordinate per e-fold of what it follows."""


def law_unit(name: str, actuation_unit: str) -> str:
    """Unit of a law's constant: K in kip per unit of actuation, α in kip/in per unit.

    Scatter and deviations are of logarithms, and have none, but for the offset's.
    """
    if name.startswith("K_"):
        return "in^2" if actuation_unit == "ksi" else "1"
    if name == "alpha_sigma0":
        return "in" if actuation_unit == "ksi" else "1/in"
    if name in INTERCEPTS:
        return INTERCEPTS[name]
    spread = name.startswith(("scatter_", "deviation_"))
    return "kip" if spread and name.endswith("_offset") else "1"
