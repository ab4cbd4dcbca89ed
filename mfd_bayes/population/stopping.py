"""When to stop a test: what is known of it after each cycle, and what one more cycle would tell.

Cycles of one motion are repeated measurements, so that their information adds up: where a quantity
of the test had the variance v0 before and has vk after k cycles, the next one is expected to leave

    v = 1 / (1/vk + (1/vk - 1/v0) / k)

What an engineer wants to know is the device, not this test of it: by the scatter τ from test to
test, one test tells its property with the variance vk + τ². A test is long enough where one more
cycle would narrow the interval of every property by less than a stated share.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.friction.model import Model

Array = NDArray[np.float64]

NARROWING = 0.02  # share by which one more cycle must narrow a property's interval
FEWEST_CYCLES = 2  # the first cycle may begin from rest or in the gap
ONE_SD = (0.15866, 0.5, 0.84134)  # shares of a normal distribution at one sd on both sides


@dataclass(frozen=True)
class Estimate:
    """A property of a test that runs, beside new tests of this device."""

    name: str
    unit: str
    median: float
    lower: float  # interval of 95 %
    upper: float
    percentile: float  # share of new tests with a smaller value than the median
    narrowing: float  # share by which one more cycle is expected to narrow the device's interval


def is_enough(estimates: Mapping[str, Estimate], cycles: int, narrowing: float = NARROWING) -> bool:
    """Whether one more cycle would narrow no property by as much as `narrowing`."""
    most = max((estimate.narrowing for estimate in estimates.values()), default=0.0)
    return cycles >= FEWEST_CYCLES and most < narrowing


def properties(model: Model, values: Mapping[str, Array]) -> dict[str, Array]:
    """Slip forces and the gap's width of draws of a model's quantities, (n,) each, by name.

    Of a model that names neither, these are the quantities that follow the actuation.
    """
    named = {name: values[name] for name in model.slip_forces or model.laws if name in values}
    gap = model.gap_width(values)
    return named if gap is None else {**named, "gap_width": gap}


class Stopping:
    """Judges a test by the draws of its quantities, with weights, after each cycle.

    `prior` are properties of new tests, above zero, `typical` the same draws without the scatter
    from test to test.
    """

    def __init__(
        self, prior: Mapping[str, Array], typical: Mapping[str, Array], units: Mapping[str, str]
    ) -> None:
        self.prior, self.units = prior, units
        self.sd = {name: _log_sd(values) for name, values in prior.items()}
        self.scatter = {name: _log_sd(prior[name] / values) for name, values in typical.items()}

    def estimates(
        self, draws: Mapping[str, Array], weights: Array, cycles: int
    ) -> dict[str, Estimate]:
        """What is known after so many cycles, from draws (m,) with weights (m,)."""
        known = {}
        for name, values in draws.items():
            lower, median, upper = quantiles(values, weights, (0.025, 0.5, 0.975))
            below = float(np.mean(self.prior[name] < median))
            narrowing = self._narrowing(name, _log_sd(values, weights), cycles)
            unit = self.units[name]
            known[name] = Estimate(name, unit, median, lower, upper, below, narrowing)
        return known

    def _narrowing(self, name: str, sd: float, cycles: int) -> float:
        """Expected narrowing of a property's interval by one more cycle."""
        now, before, scatter = sd**2, self.sd[name] ** 2, self.scatter[name] ** 2
        if now <= 0.0:
            return 0.0
        each = max(1.0 / now - 1.0 / before, 0.0) / cycles if before > 0.0 else 0.0
        after = 1.0 / (1.0 / now + each)
        return float(1.0 - np.sqrt((after + scatter) / (now + scatter)))


def _log_sd(values: Array, weights: Array | None = None) -> float:
    """Standard deviation of the logarithm: half of the interval that holds 68 %."""
    weights = np.ones(len(values)) if weights is None else weights
    low, _, high = quantiles(np.log(np.maximum(values, 1e-300)), weights, ONE_SD)
    return 0.5 * (high - low)


def quantiles(values: Array, weights: Array, shares: tuple[float, ...]) -> list[float]:
    """Quantiles of weighted draws."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    middle = (total - 0.5 * weights[order]) / total[-1]
    found: list[float] = np.interp(shares, middle, values[order]).tolist()
    return found
