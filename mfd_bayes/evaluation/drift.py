"""Change of a device with its age, its cycles or its temperature, and when it is too much."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date, timedelta

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.evaluation.acceptance import DEFAULT_LIMITS
from mfd_bayes.population.settings import CONDITIONS
from mfd_bayes.runs.run import Run

Array = NDArray[np.float64]

UNITS = {"date": (1.0, "year"), "cycles": (1000.0, "1000 cycles"), "temperature": (10.0, "10 °C")}
"""For how much of a condition a change is said, and its words."""

_AFTER = {
    "date": "ten years later",
    "cycles": "after ten times the cycles",
    "temperature": "ten times as far",
}
AHEAD = 10.0  # years, or spans of cycles or temperatures, after the last test that are looked at


@dataclass(frozen=True)
class DriftRow:
    """Change of a quantity along a condition of the tests.

    Attributes
    ----------
    quantity, condition, per : str
        `per` is what the change is for: "year".
    change, lower, upper : float
        Per cent: median and 95 % interval.
    probability : float
        That there is a change in the direction of the median.
    limit : float
        Per cent, from the value at the earliest date, the least count or temperature.
    left : float
        Probability that the quantity has left its limit at the last test.
    leaves : float
        Probability that it does within `AHEAD` after it.
    when, when_lower, when_upper : str
        When it does: median and 90 % interval; "" where it is later than that.
    """

    quantity: str
    condition: str
    per: str
    change: float
    lower: float
    upper: float
    probability: float
    limit: float
    left: float
    leaves: float
    when: str
    when_lower: str
    when_upper: str

    @property
    def found(self) -> bool:
        """Whether the 95 % interval has no zero in it."""
        return self.lower > 0.0 or self.upper < 0.0

    @property
    def sentence(self) -> str:
        """The change, and when it is too much, in words."""
        first = (
            f"{self.change:+.2g} % per {self.per} (95 % interval {self.lower:+.2g} to "
            f"{self.upper:+.2g} %)"
        )
        if not self.found:
            first += ", which may be none"
        when = f" (median: {self.when})" if self.when else ""
        return (
            f"{first}. At the last test it has left ±{self.limit:.0f} % with a probability of "
            f"{self.left:.2f}; {_AFTER[self.condition]} it will have with {self.leaves:.2f}{when}."
        )


def drift_rows(run: Run) -> tuple[DriftRow, ...]:
    """Change of each quantity that follows a date, a count of cycles or a temperature."""
    given, design = run.manifest.settings.limits, run.population.design
    rows = []
    for name, those in design.dependence.items():
        kind = "gap" if name in ("d2", "gap") else "slip"
        limit = given.get(kind) or given.get("all") or DEFAULT_LIMITS["all"]
        for condition in those:
            if condition in CONDITIONS:
                draws = run.population.dependences[f"{name}_{condition}"].reshape(-1)
                values = np.array([s.covariates[condition] for s in design.settings])
                rows.append(drift_row(name, condition, draws, values, limit))
    return tuple(rows)


def drift_row(quantity: str, condition: str, draws: Array, values: Array, limit: float) -> DriftRow:
    """Row of draws (n,) of the change of a logarithm over the span of the tests' values (J,)."""
    step, per = UNITS[condition]
    span, first = float(np.ptp(values)) or 1.0, float(values.min())
    slope = draws / span
    change = 100.0 * np.expm1(slope * step)
    lower, middle, upper = np.quantile(change, [0.025, 0.5, 0.975]).tolist()
    room = np.where(slope > 0.0, np.log1p(limit), -np.log1p(-limit))
    with np.errstate(divide="ignore"):
        leaving = first + room / np.abs(slope)
    last = float(values.max())
    end = last + AHEAD * (1.0 if condition == "date" else span)
    whens = [_shown(condition, at, end) for at in np.quantile(leaving, [0.5, 0.05, 0.95])]
    return DriftRow(
        *(quantity, condition, per, middle, lower, upper),
        float(np.mean(np.sign(slope) == np.sign(middle))),
        100.0 * limit,
        float(np.mean(leaving <= last)),
        float(np.mean(leaving <= end)),
        *whens,
    )


def _shown(condition: str, value: float, end: float) -> str:
    """A value of a condition as it is given; "" beyond what is looked at."""
    if not value <= end:
        return ""
    if condition == "date":
        year = int(value)
        return str(date(year, 1, 1) + timedelta(days=round(365.25 * (value - year))))
    return f"{value:.3g}"
