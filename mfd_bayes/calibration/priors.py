"""The prior of one quantity, and the coordinate in which the quantity is sampled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration import families

Array = NDArray[np.float64]

RANGE = 1e15  # values beyond this, or as near to a bound, are out of support: no damper has them


@dataclass(frozen=True)
class Prior:
    """Density of one quantity x > `lower`, < `upper`, sampled as an unconstrained q.

    q is x itself on the whole line, log(x − lower) on a half line, and the logit of the
    place between two bounds.

    Attributes
    ----------
    family : str
    figures : mapping of str to float, internal units
    reason : str
    """

    family: str
    figures: Mapping[str, float]
    reason: str = ""
    lower: float = field(init=False)
    upper: float = field(init=False)

    def __post_init__(self) -> None:
        families.FAMILIES[self.family].check(self.family, self.figures)
        lower, upper = families.FAMILIES[self.family].support(self.figures)
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", upper)

    @property
    def on_half_line(self) -> bool:
        """Whether the quantity may be any positive value, so that its logarithm is sampled."""
        return self.lower == 0.0 and bool(np.isinf(self.upper))

    @property
    def fixed(self) -> bool:
        """Whether the quantity has one value and is not sampled."""
        return self.family == "fixed"

    def value(self, q: Array) -> Array:
        """Quantity x at coordinate q, same shape; inf where q is beyond all range."""
        if np.isinf(self.lower):
            return q
        if np.isinf(self.upper):
            return self.lower + np.exp(np.minimum(q, 700.0))
        return self.lower + (self.upper - self.lower) * special.expit(q)

    def coordinate(self, x: Array) -> Array:
        """Coordinate q of quantity x, the inverse of `value`."""
        if np.isinf(self.lower):
            return x
        if np.isinf(self.upper):
            return np.log(x - self.lower)
        return special.logit((x - self.lower) / (self.upper - self.lower))

    def log_density(self, q: Array) -> Array:
        """Log density of q, with the Jacobian; −inf where x is out of range, same shape."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            x = self.value(q)
            density = families.FAMILIES[self.family].log_density(x, self.figures)
            density = density + self._log_jacobian(q)
            inside = (np.abs(x) < RANGE) & (x - self.lower > 1.0 / RANGE)
        return np.where(inside & np.isfinite(density), density, -np.inf)

    def _log_jacobian(self, q: Array) -> Array:
        if np.isinf(self.lower):
            return np.zeros_like(q)
        if np.isinf(self.upper):
            return q
        width = np.log(self.upper - self.lower)
        jacobian: Array = width + special.log_expit(q) + special.log_expit(-q)
        return jacobian

    @property
    def typical(self) -> float:
        """Median of x, by 1001 draws that are always the same."""
        return float(np.median(self.draw(np.random.default_rng(0), 1001)))

    def draw(self, rng: np.random.Generator, n: int) -> Array:
        """Independent draws of x, (n,)."""
        return families.FAMILIES[self.family].draw(rng, n, self.figures)
