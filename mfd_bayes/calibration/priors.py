"""The prior of one quantity, and the coordinate in which the quantity is sampled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.calibration import families

Array = NDArray[np.float64]
Bound = float | Array

RANGE = 1e15  # values beyond this, or as near to a bound, are out of support: no damper has them


@dataclass(frozen=True)
class Line:
    """The unconstrained coordinate q of quantities x between bounds: of one, or of k alike.

    q is x itself on the whole line, log(x − lower) on a half line, and the logit of the
    place between two bounds.

    Attributes
    ----------
    lower, upper : float or (k, 1)
        All of them finite, or all infinite.
    """

    lower: Bound
    upper: Bound
    _whole: bool = field(init=False, repr=False)
    _half: bool = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_whole", bool(np.all(np.isinf(self.lower))))
        object.__setattr__(self, "_half", bool(np.all(np.isinf(self.upper))))

    def value(self, q: Array) -> Array:
        """Quantity x at coordinate q, same shape; inf where q is beyond all range."""
        if self._whole:
            return q
        if self._half:
            return self.lower + np.exp(np.minimum(q, 700.0))
        return self.lower + (self.upper - self.lower) * special.expit(q)

    def coordinate(self, x: Array) -> Array:
        """Coordinate q of quantity x, the inverse of `value`."""
        if self._whole:
            return x
        if self._half:
            return np.log(x - self.lower)
        return special.logit((x - self.lower) / (self.upper - self.lower))

    def log_jacobian(self, q: Array) -> Array:
        """Logarithm of dx/dq, same shape."""
        if self._whole:
            return np.zeros_like(q)
        if self._half:
            return q
        width = np.log(self.upper - self.lower)
        jacobian: Array = width + special.log_expit(q) + special.log_expit(-q)
        return jacobian

    def log_density(self, q: Array, family: str, figures: families.Figures) -> Array:
        """Log density of q, with the Jacobian; −inf where x is out of range, same shape."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            x = self.value(q)
            density = families.FAMILIES[family].log_density(x, figures) + self.log_jacobian(q)
            inside = (np.abs(x) < RANGE) & (x - self.lower > 1.0 / RANGE)
        return np.where(inside & np.isfinite(density), density, -np.inf)


@dataclass(frozen=True)
class Prior:
    """Density of one quantity, and the line on which it is sampled.

    Attributes
    ----------
    family : str
    figures : mapping of str to float, internal units
    reason : str
    """

    family: str
    figures: Mapping[str, float]
    reason: str = ""
    line: Line = field(init=False)

    def __post_init__(self) -> None:
        families.FAMILIES[self.family].check(self.family, self.figures)
        object.__setattr__(
            self, "line", Line(*families.FAMILIES[self.family].support(self.figures))
        )

    @property
    def lower(self) -> float:
        """What the quantity is larger than."""
        return float(self.line.lower)

    @property
    def upper(self) -> float:
        """What the quantity is smaller than."""
        return float(self.line.upper)

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
        return self.line.value(q)

    def coordinate(self, x: Array) -> Array:
        """Coordinate q of quantity x, the inverse of `value`."""
        return self.line.coordinate(x)

    def log_density(self, q: Array) -> Array:
        """Log density of q, with the Jacobian; −inf where x is out of range, same shape."""
        return self.line.log_density(q, self.family, self.figures)

    @property
    def typical(self) -> float:
        """Median of x."""
        return float(families.FAMILIES[self.family].median(self.figures))

    def draw(self, rng: np.random.Generator, n: int) -> Array:
        """Independent draws of x, (n,)."""
        return families.FAMILIES[self.family].draw(rng, n, self.figures)
