"""A band of the force, and the draws that it is made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.extras import Extras
from mfd_bayes.errors import FitError
from mfd_bayes.population.conditioned import Conditioned
from mfd_bayes.population.forecast import Forecast
from mfd_bayes.population.shown import ShownBand
from mfd_bayes.population.whole import whole_band
from mfd_bayes.records.numbers import real_number

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Band(ShownBand):
    """Equal-tailed band of the force at each sample.

    Attributes
    ----------
    time, lower, median, upper : (T,), s and kip
        The probability holds for each sample by itself.
    draws : (n, T), kip
    kind : str
    probability : float
    source : str
        Where the parameters come from.
    values : mapping of str to (n,)
        Quantities of each draw, by name.
    remarks : tuple of str
        Reasons to trust it less, and what a recalibrated band promises, in sentences.
    whole_lower, whole_upper : (T,), kip, or None
        Band that holds the whole history with the probability, where it was asked for; `whole`
        computes it where it was not.
    explained : mapping of str to float
        `shares`, where they were asked for; `shares` computes them where they were not.
    given : Conditioned, or None
        The part of the record that was known, where there is one: its `window` (s), `pareto_k`,
        `method` ("weights" or "sampling") and `effective` draws.
    """

    time: Array
    lower: Array
    median: Array
    upper: Array
    draws: Array
    kind: str
    probability: float
    source: str
    values: Mapping[str, Array] = field(default_factory=dict)
    interval: str = "equal-tailed"
    remarks: tuple[str, ...] = ()
    whole_lower: Array | None = None
    whole_upper: Array | None = None
    explained: Mapping[str, float] = field(default_factory=dict)
    explain: Callable[[], Mapping[str, float]] | None = field(default=None, repr=False)
    extras: Extras | None = field(default=None, repr=False)
    given: Conditioned | None = None

    def __post_init__(self) -> None:
        for name in ("lower", "median", "upper", "draws", "whole_lower", "whole_upper"):
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(self, name, read_only(values))

    @cached_property
    def whole(self) -> tuple[Array, Array]:
        """Lower and upper bound, (T,) each, kip, that hold the whole history of most of the draws.

        The share of the draws is the band's probability.
        """
        if self.whole_lower is not None and self.whole_upper is not None:
            return self.whole_lower, self.whole_upper
        return self._around(*whole_band(self.draws, self.probability))

    @cached_property
    def shares(self) -> Mapping[str, float]:
        """What makes the band wide: share of each source in the variance; their sum is 1.

        They take as long as some 70 predictions, once. Empty for several models at once, of a
        `Forecaster`, and where nothing varies. After a given part the sources depend on each
        other: what the part ties together is shared out between them.
        """
        return self.explained or (self.explain() if self.explain else {})

    def widened(self, factor: float) -> Band:
        """The band of single samples, as many times as wide about its median.

        The band of the whole history is never inside it.

        Raises
        ------
        FitError
            When the factor is no number, 0 or more.
        """
        factor = real_number("factor", factor, FitError, (0.0, np.inf))
        lower = self.median - factor * (self.median - self.lower)
        upper = self.median + factor * (self.upper - self.median)
        wide = replace(self, lower=lower, upper=upper)
        if wide.whole_lower is None or wide.whole_upper is None:
            return wide
        whole_lower, whole_upper = wide._around(wide.whole_lower, wide.whole_upper)
        return replace(wide, whole_lower=whole_lower, whole_upper=whole_upper)

    def _around(self, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Bounds that are nowhere inside the band of single samples."""
        return np.minimum(lower, self.lower), np.maximum(upper, self.upper)


def read_only(values: Array) -> Array:
    """The same numbers, which cannot be changed by this name."""
    view = values.view()
    view.flags.writeable = False
    return view


def band_of(
    time: Array,
    draws: Array,
    forecast: Forecast,
    source: str,
    values: Mapping[str, Array] | None = None,
) -> Band:
    """Band of force draws (n, T), kip."""
    tail = 0.5 * (1.0 - forecast.probability)
    lower, median, upper = np.quantile(draws, [tail, 0.5, 1.0 - tail], axis=0)
    asked = forecast.kind, forecast.probability
    band = Band(time, lower, median, upper, draws, *asked, source, values or {})
    if not forecast.whole:
        return band
    whole_lower, whole_upper = whole_band(draws, forecast.probability)
    return replace(band, whole_lower=whole_lower, whole_upper=whole_upper)
