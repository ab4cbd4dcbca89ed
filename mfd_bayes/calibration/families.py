"""The families of priors: a new one is registered here, by one entry.

Each has its own density and draws, not those of scipy's frozen distributions: a density of
scipy's takes many times as long, and a log-normal of scipy's draws other bits for a seed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.errors import PriorError

Array = NDArray[np.float64]
Figures = Mapping[str, Any]
"""Numbers of one family: of one quantity, or those of k quantities as (k, 1) arrays."""

_LOG_2PI = float(np.log(2 * np.pi))


class Figure(NamedTuple):
    """One number of a family: whether it has the quantity's unit, must be positive, is needed."""

    dimensional: bool
    positive: bool = False
    needed: bool = True


MIDDLE = Figure(dimensional=True)
WIDTH = Figure(dimensional=True, positive=True)
SHAPE = Figure(dimensional=False, positive=True)


@dataclass(frozen=True)
class Family:
    """A family of densities of a quantity x.

    Attributes
    ----------
    figures : mapping of str to Figure
        What a prior file gives for it.
    log_density : callable
        Normalised log density at x, any shape, inside the support.
    draw : callable
        Independent draws, (n,).
    median : callable
        Median of x.
    support : callable
        Lower and upper bound of x.
    """

    figures: Mapping[str, Figure]
    log_density: Callable[[Array, Figures], Array]
    draw: Callable[[np.random.Generator, int, Figures], Array]
    median: Callable[[Figures], float]
    support: Callable[[Figures], tuple[float, float]] = lambda _: (0.0, np.inf)

    def check(self, family: str, figures: Figures) -> None:
        """Raise PriorError where a figure is missing, unknown or out of its range."""
        needed = {key for key, figure in self.figures.items() if figure.needed}
        if not needed <= set(figures) <= set(self.figures):
            raise PriorError(
                f"{family} needs {' and '.join(sorted(needed))}, got {', '.join(sorted(figures))}"
            )
        for key, value in figures.items():
            if self.figures[key].positive and not value > 0:
                raise PriorError(f"{key} must be positive, got {value:g}")
        if "upper" in figures and not figures["upper"] > figures.get("lower", -np.inf):
            raise PriorError("upper must be above lower")


def _whole_line(_: Figures) -> tuple[float, float]:
    return -np.inf, np.inf


def _normal(x: Array, mean: float, sd: float) -> Array:
    density: Array = -0.5 * ((x - mean) / sd) ** 2 - np.log(sd) - 0.5 * _LOG_2PI
    return density


def _gamma(x: Array, f: Figures) -> Array:
    shape, scale = f["shape"], f["scale"]
    density: Array = (
        (shape - 1) * np.log(x) - x / scale - special.gammaln(shape) - shape * np.log(scale)
    )
    return density


def _beta(x: Array, f: Figures) -> Array:
    powers = special.xlogy(f["a"] - 1, x) + special.xlog1py(f["b"] - 1, -x)
    return np.asarray(powers - special.betaln(f["a"], f["b"]), dtype=np.float64)


def _bounds(f: Figures) -> tuple[float, float]:
    return f["lower"], f.get("upper", np.inf)


def _standard_bounds(f: Figures) -> tuple[float, float]:
    lower, upper = _bounds(f)
    return (lower - f["mean"]) / f["sd"], (upper - f["mean"]) / f["sd"]


def _truncated(x: Array, f: Figures) -> Array:
    """Normal density over its mass between the bounds, in the tail where it keeps its digits."""
    a, b = _standard_bounds(f)
    a, b = np.where(a > 0, (-b, -a), (a, b))
    low, high = special.log_ndtr(a), special.log_ndtr(b)
    log_mass = high + np.log1p(-np.exp(low - high))
    density: Array = _normal(x, f["mean"], f["sd"]) - log_mass
    return density


def _median_truncated(f: Figures) -> float:
    """Median of a truncated normal, in the tail where its probabilities keep their digits."""
    a, b = _standard_bounds(f)
    side = -1.0 if a > 0 else 1.0
    probability = np.logaddexp(special.log_ndtr(side * a), special.log_ndtr(side * b)) - np.log(2.0)
    return float(f["mean"] + side * f["sd"] * special.ndtri_exp(probability))


def _draw_truncated(rng: np.random.Generator, n: int, f: Figures) -> Array:
    from scipy.stats import truncnorm  # which takes long to import

    a, b = _standard_bounds(f)
    draws = truncnorm.rvs(a, b, loc=f["mean"], scale=f["sd"], size=n, random_state=rng)
    return np.asarray(draws, dtype=np.float64)


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
            _whole_line,
        ),
        "truncated_normal": Family(
            {
                "mean": MIDDLE,
                "sd": WIDTH,
                "lower": MIDDLE,
                "upper": Figure(dimensional=True, needed=False),
            },
            _truncated,
            _draw_truncated,
            _median_truncated,
            _bounds,
        ),
        "half_normal": Family(
            {"sd": WIDTH},
            lambda x, f: _normal(x, 0.0, f["sd"]) + np.log(2.0),
            lambda rng, n, f: np.abs(rng.normal(0.0, f["sd"], n)),
            lambda f: f["sd"] * special.ndtri(0.75),
        ),
        "uniform": Family(
            {"lower": MIDDLE, "upper": MIDDLE},
            lambda x, f: np.full_like(x, -np.log(f["upper"] - f["lower"])),
            lambda rng, n, f: rng.uniform(f["lower"], f["upper"], n),
            lambda f: 0.5 * (f["lower"] + f["upper"]),
            _bounds,
        ),
        "gamma": Family(
            {"shape": SHAPE, "scale": WIDTH},
            _gamma,
            lambda rng, n, f: rng.gamma(f["shape"], f["scale"], n),
            lambda f: f["scale"] * special.gammaincinv(f["shape"], 0.5),
        ),
        "beta": Family(
            {"a": SHAPE, "b": SHAPE},
            _beta,
            lambda rng, n, f: np.asarray(rng.beta(f["a"], f["b"], n), dtype=np.float64),
            lambda f: float(special.betaincinv(f["a"], f["b"], 0.5)),
            lambda _: (0.0, 1.0),
        ),
        "fixed": Family(
            {"value": MIDDLE},
            lambda x, _: np.zeros_like(x),
            lambda _, n, f: np.full(n, f["value"]),
            lambda f: f["value"],
            _whole_line,
        ),
    }
)
"""Every family by its name in prior files."""
