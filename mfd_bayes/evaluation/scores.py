"""Bands of draws, and how they are scored against a measured force."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import COVERAGES
from mfd_bayes.population.bands import ADVICE, Band
from mfd_bayes.runs.manifest import Score

Array = NDArray[np.float64]
Row = dict[str, Any]
Rows = tuple[Row, ...]


@dataclass(frozen=True, eq=False)
class Interval:
    """Equal-tailed band of one probability, (T,) each, kip; or the band of the whole history."""

    probability: float
    lower: Array
    upper: Array
    simultaneous: bool = False


@dataclass(frozen=True, eq=False)
class QuantileBand:
    """A median, (T,), and its bands, the widest last; `kind` is in `KIND_NAMES`, or "prior"."""

    kind: str
    median: Array
    intervals: tuple[Interval, ...]

    @property
    def widest(self) -> Interval:
        """The band of the largest probability."""
        return max(self.intervals, key=lambda interval: interval.probability)

    def times(self, factor: float) -> QuantileBand:
        """The fan times a factor."""
        scaled = (
            replace(i, lower=i.lower * factor, upper=i.upper * factor) for i in self.intervals
        )
        return QuantileBand(self.kind, self.median * factor, tuple(scaled))


# --- bands and their scores

PROBABILITIES = (0.5, 0.95)  # probabilities of the equal-tailed bands in figures


def fan_of(kind: str, draws: Array) -> QuantileBand:
    """Median and bands of draws (n, T)."""
    tails = [0.5 * (1.0 - p) for p in PROBABILITIES]
    levels = [0.5, *tails, *(1.0 - t for t in tails)]
    median, *bounds = np.quantile(draws, levels, axis=0)
    n = len(tails)
    intervals = (Interval(p, bounds[i], bounds[n + i]) for i, p in enumerate(PROBABILITIES))
    return QuantileBand(kind, median, tuple(intervals))


def fan_of_band(band: Band) -> QuantileBand:
    """Median and bounds of a prediction, with those of the whole history if it has them."""
    intervals = [Interval(band.probability, band.lower, band.upper)]
    if band.shows_simultaneous:
        intervals.append(Interval(band.probability, *band.simultaneous, simultaneous=True))
    return QuantileBand(band.kind, band.median, tuple(intervals))


def spread_of(draws: Array, tail: float = 0.025) -> dict[str, float]:
    """Mean, sd, median, and the bounds that leave `tail` of the draws (n,) on either side."""
    lower, median, upper = np.quantile(draws, [tail, 0.5, 1.0 - tail]).tolist()
    mean, sd = float(draws.mean()), float(draws.std())
    return {"mean": mean, "sd": sd, "lower": lower, "median": median, "upper": upper}


def score(draws: Array, observed: Array) -> Score:
    """Scores of draws (n, T) against an observed force (T,), kip."""
    coverage = []
    width = interval = np.nan
    draws = np.sort(draws, axis=0)  # once: quantiles of what is sorted take a fifth of the time
    tails = [0.5 * (1.0 - probability) for probability in COVERAGES]
    bounds = np.quantile(draws, [side for tail in tails for side in (tail, 1.0 - tail)], axis=0)
    for tail, lower, upper in zip(tails, bounds[::2], bounds[1::2], strict=True):
        coverage.append(float(np.mean((observed >= lower) & (observed <= upper))))
        width = float(np.mean(upper - lower))
        excess = np.maximum(lower - observed, 0.0) + np.maximum(observed - upper, 0.0)
        interval = width + float(np.mean(excess)) / tail
    return Score(
        coverage=tuple(coverage),
        width=width,
        interval_score=interval,
        crps=float(np.mean(crps(draws, observed))),
        rrse=rrse(np.median(draws, axis=0), observed),
    )


def log_score(draws: Array, observed: Array) -> float:
    """Mean log density of an observed force (T,), per kip, under draws (n, T).

    Of each sample by itself, under a normal with the mean and sd of the draws: neighbours resemble
    each other, so that a test counts for about one observation, whatever its length.
    """
    variance = draws.var(axis=0)
    terms = np.log(2.0 * np.pi * variance) + (observed - draws.mean(axis=0)) ** 2 / variance
    return float(-0.5 * np.mean(terms))


def score_record(scores: Score) -> Row:
    """Scores as they stand in tables."""
    cover_50, cover_90, cover_95 = scores.coverage
    return {
        "coverage_50": cover_50,
        "coverage_90": cover_90,
        "coverage_95": cover_95,
        "width_95": scores.width,
        "interval_score": scores.interval_score,
        "crps": scores.crps,
        "rrse": scores.rrse,
    }


def crps(draws: Array, observed: Array) -> Array:
    """Continuous ranked probability score E|X − y| − ½ E|X − X'| of each sample, (T,), kip."""
    n = len(draws)
    weights = (2.0 * np.arange(1, n + 1) - n - 1.0)[:, None] / n**2
    spread = np.sum(weights * np.sort(draws, axis=0), axis=0)
    return np.asarray(np.mean(np.abs(draws - observed), axis=0) - spread)


def rrse(predicted: Array, observed: Array) -> float:
    """Root relative squared error √(Σ(F − F̂)² / Σ(F − F̄)²), NaN for a constant force."""
    error, spread = np.sum((observed - predicted) ** 2), np.sum((observed - observed.mean()) ** 2)
    return float(np.sqrt(error / spread)) if spread > 0 else float("nan")


def width_sentence(shares: Mapping[str, float]) -> str:
    """Which source makes a band wide, and what can be done about it; "" without shares."""
    if not shares:
        return ""
    name = max(shares, key=lambda source: shares[source])
    article = "" if name == "noise" or name.startswith("test-to-test") else "the "
    return f"{100 * shares[name]:.0f} % of the variance is from {article}{name}. {ADVICE[name]}"
