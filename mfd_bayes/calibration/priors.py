"""The prior of one quantity: its family, and the coordinate in which the quantity is sampled.

Densities and draws are written out: those of scipy's frozen distributions take many times as long.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.errors import PriorError

Array = NDArray[np.float64]
Figures = Mapping[str, Any]

RANGE = 1e15  # values beyond this, or as near to a bound, are out of support: no damper has them


class Figure(NamedTuple):
    """One number of a family: whether it has the quantity's unit, must be positive, is needed."""

    dimensional: bool
    positive: bool = False
    needed: bool = True


MIDDLE = Figure(dimensional=True)
WIDTH = Figure(dimensional=True, positive=True)
SHAPE = Figure(dimensional=False, positive=True)


WHOLE_LINE = (-np.inf, np.inf)


@dataclass(frozen=True)
class Family:
    """A family of densities of a quantity x."""

    figures: Mapping[str, Figure]  # Figure: what a prior file gives for it
    # normalised log density at x, any shape, inside the support
    log_density: Callable[[Array, Figures], Array]
    draw: Callable[[np.random.Generator, int, Figures], Array]  # independent draws, (n,)
    median: Callable[[Figures], float]  # median of x
    # (float, float), or None: lower and upper bound of x; None where they are the figures "lower"
    # and "upper"
    support: tuple[float, float] | None = (0.0, np.inf)


def _normal(x: Array, mean: float, sd: float) -> Array:
    density: Array = -0.5 * ((x - mean) / sd) ** 2 - np.log(sd) - 0.5 * np.log(2 * np.pi)
    return density


def _gamma(x: Array, f: Figures) -> Array:
    k, scale = f["shape"], f["scale"]
    density: Array = (k - 1) * np.log(x) - x / scale - special.gammaln(k) - k * np.log(scale)
    return density


def _beta(x: Array, f: Figures) -> Array:
    powers = special.xlogy(f["a"] - 1, x) + special.xlog1py(f["b"] - 1, -x)
    return np.asarray(powers - special.betaln(f["a"], f["b"]))


def _tail(f: Figures) -> tuple[float, float, float]:
    """Log probabilities below both bounds of a normal, in the tail where they keep their digits.

    The third figure is -1 where that is the upper tail.
    """
    a, b = ((bound - f["mean"]) / f["sd"] for bound in (f["lower"], f.get("upper", np.inf)))
    side = -1.0 if a > 0 else 1.0
    return float(special.log_ndtr(side * a)), float(special.log_ndtr(side * b)), side


def _truncated(x: Array, f: Figures) -> Array:
    low, high = sorted(_tail(f)[:2])
    density: Array = _normal(x, f["mean"], f["sd"]) - high - np.log1p(-np.exp(low - high))
    return density


def _truncated_quantile(u: Any, f: Figures) -> Any:
    low, high, side = _tail(f)
    probability = np.logaddexp(low + np.log1p(-u), high + np.log(u))
    return f["mean"] + side * f["sd"] * special.ndtri_exp(probability)


# every family by its name in prior files: a new one is registered here, by one entry
FAMILIES: Mapping[str, Family] = MappingProxyType(
    {
        "lognormal": Family(
            {"median": WIDTH, "spread": SHAPE},
            lambda x, f: _normal(np.log(x), np.log(f["median"]), f["spread"]) - np.log(x),
            lambda rng, n, f: rng.lognormal(np.log(f["median"]), f["spread"], n),
            lambda f: f["median"],
        ),
        "normal": Family(
            {"mean": MIDDLE, "sd": WIDTH},
            lambda x, f: _normal(x, f["mean"], f["sd"]),
            lambda rng, n, f: rng.normal(f["mean"], f["sd"], n),
            lambda f: f["mean"],
            WHOLE_LINE,
        ),
        "truncated_normal": Family(
            {"mean": MIDDLE, "sd": WIDTH, "lower": MIDDLE, "upper": Figure(True, needed=False)},
            _truncated,
            lambda rng, n, f: np.asarray(_truncated_quantile(1.0 - rng.random(n), f)),
            lambda f: float(_truncated_quantile(0.5, f)),
            None,
        ),
        "half_normal": Family(
            {"sd": WIDTH},
            lambda x, f: _normal(x, 0.0, f["sd"]) + np.log(2.0),
            lambda rng, n, f: np.abs(rng.normal(0.0, f["sd"], n)),
            lambda f: float(f["sd"] * special.ndtri(0.75)),
        ),
        "uniform": Family(
            {"lower": MIDDLE, "upper": MIDDLE},
            lambda x, f: np.full_like(x, -np.log(f["upper"] - f["lower"])),
            lambda rng, n, f: rng.uniform(f["lower"], f["upper"], n),
            lambda f: 0.5 * (f["lower"] + f["upper"]),
            None,
        ),
        "gamma": Family(
            {"shape": SHAPE, "scale": WIDTH},
            _gamma,
            lambda rng, n, f: rng.gamma(f["shape"], f["scale"], n),
            lambda f: float(f["scale"] * special.gammaincinv(f["shape"], 0.5)),
        ),
        "beta": Family(
            {"a": SHAPE, "b": SHAPE},
            _beta,
            lambda rng, n, f: np.asarray(rng.beta(f["a"], f["b"], n)),
            lambda f: float(special.betaincinv(f["a"], f["b"], 0.5)),
            (0.0, 1.0),
        ),
        "fixed": Family(
            {"value": MIDDLE},
            lambda x, _: np.zeros_like(x),
            lambda _, n, f: np.full(n, f["value"]),
            lambda f: f["value"],
            WHOLE_LINE,
        ),
    }
)


@dataclass(frozen=True)
class Prior:
    """Density of one quantity x, and its unconstrained coordinate q.

    q is x itself on the whole line, log(x − lower) on a half line, and the logit of the place
    between two bounds.
    """

    family: str
    figures: Mapping[str, float]  # float, internal units
    reason: str = ""
    lower: float = field(init=False)  # between which the quantity is
    upper: float = field(init=False)

    def __post_init__(self) -> None:
        family, figures = FAMILIES[self.family], self.figures
        needed = {key for key, figure in family.figures.items() if figure.needed}
        if not needed <= set(figures) <= set(family.figures):
            raise PriorError(
                f"{self.family} needs {' and '.join(sorted(needed))}, "
                f"got {', '.join(sorted(figures))}"
            )
        for key, value in figures.items():
            if family.figures[key].positive and not value > 0:
                raise PriorError(f"{key} must be positive, got {value:g}")
        if "upper" in figures and not figures["upper"] > figures.get("lower", -np.inf):
            raise PriorError("upper must be above lower")
        lower, upper = family.support or (figures["lower"], figures.get("upper", np.inf))
        object.__setattr__(self, "lower", float(lower))
        object.__setattr__(self, "upper", float(upper))

    @property
    def on_half_line(self) -> bool:
        """Whether the quantity may be any positive value, so that its logarithm is sampled."""
        return self.lower == 0.0 and self.upper == np.inf

    @property
    def fixed(self) -> bool:
        """Whether the quantity has one value and is not sampled."""
        return self.family == "fixed"

    @property
    def typical(self) -> float:
        """Median of x."""
        return float(FAMILIES[self.family].median(self.figures))

    def value(self, q: Array) -> Array:
        """Quantity x at coordinate q, same shape; inf where q is beyond all range."""
        if self.lower == -np.inf:
            return q
        if self.upper == np.inf:
            return self.lower + np.exp(np.minimum(q, 700.0))
        return self.lower + (self.upper - self.lower) * special.expit(q)

    def coordinate(self, x: Array) -> Array:
        """Coordinate q of quantity x, the inverse of `value`."""
        if self.lower == -np.inf:
            return x
        if self.upper == np.inf:
            return np.log(x - self.lower)
        return special.logit((x - self.lower) / (self.upper - self.lower))

    def log_density(self, q: Array) -> Array:
        """Log density of q, with the Jacobian; −inf where x is out of range, same shape."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            x = self.value(q)
            density = FAMILIES[self.family].log_density(x, self.figures)
            if self.upper < np.inf:
                width = np.log(self.upper - self.lower)
                density = density + width + special.log_expit(q) + special.log_expit(-q)
            elif self.lower > -np.inf:
                density = density + q
            inside = (np.abs(x) < RANGE) & (x - self.lower > 1.0 / RANGE)
        return np.where(inside & np.isfinite(density), density, -np.inf)

    def draw(self, rng: np.random.Generator, n: int) -> Array:
        """Independent draws of x, (n,)."""
        return FAMILIES[self.family].draw(rng, n, self.figures)
