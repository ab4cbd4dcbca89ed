"""Priors: families on their natural support, and the coordinates they are sampled in."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import special

from mfd_bayes.errors import PriorError

Array = NDArray[np.float64]

KINDS = {
    "sigma0": "stiffness",
    "sigma1": "damping",
    "sigma2": "damping",
    "Fc_fwd": "force",
    "Fc_bwd": "force",
    "static_excess_fwd": "dimensionless",
    "static_excess_bwd": "dimensionless",
    "k2": "stiffness",
    "k3": "stiffness",
    "d2": "displacement",
    "d3": "displacement",
    "ell": "displacement",
    "gamma1": "dimensionless",
    "v_s": "velocity",
    "k": "stiffness",
    "alpha": "dimensionless",
    "Fy_fwd": "force",
    "Fy_bwd": "force",
    "beta": "dimensionless",
    "exponent": "dimensionless",
    "c": "damping",
    "start": "dimensionless",
    "offset": "force",
    "noise_sd": "force",
    "noise_time": "time",
    "noise_dof": "dimensionless",
    "noise_build": "force",
    "noise_fade": "displacement",
    "noise_build_time": "time",
}
"""What each sampled quantity measures."""

_LOG_2PI = float(np.log(2 * np.pi))
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
        _check_figures(self.family, self.figures)
        lower, upper = _SUPPORTS[self.family](self.figures)
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", upper)

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
            density = _LOG_DENSITIES[self.family](x, self.figures) + self._log_jacobian(q)
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
        return _DRAWS[self.family](rng, n, self.figures)


FAMILIES: dict[str, tuple[set[str], set[str]]] = {
    "lognormal": ({"median", "spread"}, set()),
    "normal": ({"mean", "sd"}, set()),
    "truncated_normal": ({"mean", "sd"}, {"lower", "upper"}),
    "half_normal": ({"sd"}, set()),
    "uniform": ({"lower", "upper"}, set()),
    "gamma": ({"shape", "scale"}, set()),
    "beta": ({"a", "b"}, set()),
    "fixed": ({"value"}, set()),
}
"""Figures that each family needs, and those that it may have besides."""
_POSITIVE = frozenset({"median", "spread", "sd", "shape", "scale", "a", "b"})


def _check_figures(family: str, figures: Mapping[str, float]) -> None:
    needed, optional = FAMILIES[family]
    if not needed <= set(figures) <= needed | optional:
        raise PriorError(
            f"{family} needs {' and '.join(sorted(needed))}, got {', '.join(sorted(figures))}"
        )
    for key in _POSITIVE & set(figures):
        if not figures[key] > 0:
            raise PriorError(f"{key} must be positive, got {figures[key]:g}")
    if "upper" in figures and not figures["upper"] > figures.get("lower", -np.inf):
        raise PriorError("upper must be above lower")
    if family == "truncated_normal" and "lower" not in figures:
        raise PriorError("truncated_normal needs lower, and may have upper")


def _half_line(_: Mapping[str, float]) -> tuple[float, float]:
    return 0.0, np.inf


def _whole_line(_: Mapping[str, float]) -> tuple[float, float]:
    return -np.inf, np.inf


_SUPPORTS: dict[str, Callable[[Mapping[str, float]], tuple[float, float]]] = {
    "lognormal": _half_line,
    "normal": _whole_line,
    "truncated_normal": lambda f: (f["lower"], f.get("upper", np.inf)),
    "half_normal": _half_line,
    "uniform": lambda f: (f["lower"], f["upper"]),
    "gamma": _half_line,
    "beta": lambda _: (0.0, 1.0),
    "fixed": _whole_line,
}


def _normal(x: Array, mean: float, sd: float) -> Array:
    density: Array = -0.5 * ((x - mean) / sd) ** 2 - np.log(sd) - 0.5 * _LOG_2PI
    return density


def _beta(x: Array, a: float, b: float) -> Array:
    powers = special.xlogy(a - 1, x) + special.xlog1py(b - 1, -x)
    return np.asarray(powers - special.betaln(a, b), dtype=np.float64)


def _log_mass(f: Mapping[str, float]) -> float:
    """Log of a normal's mass between its bounds, in the tail where it keeps its digits."""
    a = (f["lower"] - f["mean"]) / f["sd"]
    b = (f.get("upper", np.inf) - f["mean"]) / f["sd"]
    if a > 0:
        a, b = -b, -a
    low, high = special.log_ndtr(a), special.log_ndtr(b)
    return float(high + np.log1p(-np.exp(low - high)))


_LOG_DENSITIES: dict[str, Callable[[Array, Mapping[str, float]], Array]] = {
    "lognormal": lambda x, f: _normal(np.log(x), np.log(f["median"]), f["spread"]) - np.log(x),
    "normal": lambda x, f: _normal(x, f["mean"], f["sd"]),
    "truncated_normal": lambda x, f: _normal(x, f["mean"], f["sd"]) - _log_mass(f),
    "half_normal": lambda x, f: _normal(x, 0.0, f["sd"]) + np.log(2.0),
    "uniform": lambda x, f: np.full_like(x, -np.log(f["upper"] - f["lower"])),
    "gamma": lambda x, f: (
        (f["shape"] - 1) * np.log(x)
        - x / f["scale"]
        - special.gammaln(f["shape"])
        - f["shape"] * np.log(f["scale"])
    ),
    "beta": lambda x, f: _beta(x, f["a"], f["b"]),
    "fixed": lambda x, _: np.zeros_like(x),
}


def _truncated_draws(rng: np.random.Generator, n: int, f: Mapping[str, float]) -> Array:
    from scipy.stats import truncnorm

    a = (f["lower"] - f["mean"]) / f["sd"]
    b = (f.get("upper", np.inf) - f["mean"]) / f["sd"]
    draws = truncnorm.rvs(a, b, loc=f["mean"], scale=f["sd"], size=n, random_state=rng)
    return np.asarray(draws, dtype=np.float64)


_DRAWS: dict[str, Callable[[np.random.Generator, int, Mapping[str, float]], Array]] = {
    "lognormal": lambda rng, n, f: rng.lognormal(np.log(f["median"]), f["spread"], n),
    "normal": lambda rng, n, f: rng.normal(f["mean"], f["sd"], n),
    "truncated_normal": _truncated_draws,
    "half_normal": lambda rng, n, f: np.abs(rng.normal(0.0, f["sd"], n)),
    "uniform": lambda rng, n, f: rng.uniform(f["lower"], f["upper"], n),
    "gamma": lambda rng, n, f: rng.gamma(f["shape"], f["scale"], n),
    "beta": lambda rng, n, f: np.asarray(rng.beta(f["a"], f["b"], n), dtype=np.float64),
    "fixed": lambda _, n, f: np.full(n, f["value"]),
}
