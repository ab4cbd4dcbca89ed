"""Bands and their scores: coverage, width, CRPS and error against a measured force."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import COVERAGES
from mfd_bayes.errors import CampaignError
from mfd_bayes.evaluation.views import Fan, Interval, Row
from mfd_bayes.population.bands import ADVICE, Band
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.manifest import Score
from mfd_bayes.runs.unit_system import System
from mfd_bayes.units import percent

Array = NDArray[np.float64]

PROBABILITIES = (0.5, 0.95)  # probabilities of the equal-tailed bands in figures
OFTEN = 3.0
"""A band is said to miss a record that leaves it so many times as often as its probability says."""

STILL, DWELL = 0.01, 0.125
"""At rest: within this share of the stroke, for longer than this share of a mean cycle. A sine is
so near to its turn for half as long."""

_OF_MEASUREMENT = ("peak_fwd", "peak_bwd", "slip_fwd", "slip_bwd")  # with offset and noise


def fan_of(kind: str, draws: Array) -> Fan:
    """Median and bands of draws (n, T)."""
    tails = [0.5 * (1.0 - p) for p in PROBABILITIES]
    levels = [0.5, *tails, *(1.0 - t for t in tails)]
    median, *bounds = np.quantile(draws, levels, axis=0)
    n = len(tails)
    intervals = (Interval(p, bounds[i], bounds[n + i]) for i, p in enumerate(PROBABILITIES))
    return Fan(kind, median, tuple(intervals))


def fan_of_band(band: Band) -> Fan:
    """Median and bounds of a prediction, with those of the whole history if it has them."""
    intervals = [Interval(band.probability, band.lower, band.upper)]
    if band.shows_whole:
        intervals.append(Interval(band.probability, *band.whole, whole=True))
    return Fan(band.kind, band.median, tuple(intervals))


def spread_of(draws: Array, tail: float = 0.025) -> dict[str, float]:
    """Mean, sd, median, and the bounds that leave `tail` of the draws (n,) on either side."""
    lower, median, upper = np.quantile(draws, [tail, 0.5, 1.0 - tail]).tolist()
    mean, sd = float(draws.mean()), float(draws.std())
    return {"mean": mean, "sd": sd, "lower": lower, "median": median, "upper": upper}


def score(draws: Array, observed: Array) -> Score:
    """Scores of draws (n, T) against an observed force (T,), kip."""
    coverage = []
    width = interval = np.nan
    for probability in COVERAGES:
        tail = 0.5 * (1.0 - probability)
        lower, upper = np.quantile(draws, [tail, 1.0 - tail], axis=0)
        coverage.append(float(np.mean((observed >= lower) & (observed <= upper))))
        width = float(np.mean(upper - lower))
        beyond = np.maximum(lower - observed, 0.0) + np.maximum(observed - upper, 0.0)
        interval = width + float(np.mean(beyond)) / tail
    return Score(
        coverage=tuple(coverage),
        width=width,
        interval_score=interval,
        crps=float(np.mean(crps(draws, observed))),
        rrse=rrse(np.median(draws, axis=0), observed),
    )


def score_record(scores: Score) -> Row:
    """Scores as they stand in tables."""
    half, most, nearly = scores.coverage
    return {
        "coverage_50": half,
        "coverage_90": most,
        "coverage_95": nearly,
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


# --- a prediction and the force that was measured in the same motion


@dataclass(frozen=True)
class Compared:
    """A predicted band beside the force that was measured in the same motion."""

    # share inside the band of the measured samples in motion, and of those in full cycles at
    # full stroke; NaN where there are none
    coverage: float
    full: float
    samples: int  # those in motion that were not given
    # error of the median; mean distance between the draws and the force, kip
    rrse: float
    crps: float
    kind: str  # of the band
    probability: float
    given: bool = False  # whether a first part of the record was given

    def sentence(self, system: System) -> str:
        """Coverage and error in words; whether the band holds what a load cell adds."""
        full = "" if np.isnan(self.full) else f", {100 * self.full:.1f} % at full stroke"
        text = (
            f"the {percent(self.probability)} % band of kind {self.kind} holds "
            f"{100 * self.coverage:.1f} % of the {self.samples} measured samples in motion"
            f"{' that were not given' if self.given else ''}{full}; error of the "
            f"median (RRSE) {self.rrse:.3g}, mean distance (CRPS) "
            f"{system.words([self.crps], 'kip', 3)}"
        )
        if self.kind == "observation":
            return text
        return f"{text}; this kind holds no offset and noise: measured data need --kind observation"

    def _held(self, rows: Sequence[Row]) -> list[Row]:
        """Properties whose measured value can be held to their interval."""
        skipped = () if self.kind == "observation" else _OF_MEASUREMENT
        return [r for r in rows if np.isfinite(r["measured"]) and r["name"] not in skipped]

    def _outside(self, rows: Sequence[Row]) -> list[str]:
        return [
            r["name"] for r in self._held(rows) if not r["lower"] <= r["measured"] <= r["upper"]
        ]

    def disagrees(self, rows: Sequence[Row]) -> bool:
        """Whether most measured values are outside, or far more samples than the band allows."""
        worst = np.nanmin([self.coverage, self.full])
        missed = 1.0 - worst > OFTEN * (1.0 - self.probability)
        most_outside = 2 * len(self._outside(rows)) > len(self._held(rows))
        return bool((missed and self.kind == "observation") or most_outside)

    def judged(self, rows: Sequence[Row]) -> str:
        """What measured values outside their intervals, and a low coverage, say; "" for nothing.

        `rows` are those of `predicted_rows`.
        """
        outside, promised, parts = self._outside(rows), f"{percent(self.probability)} %", []
        if outside:
            noise = ", offset and noise included" if self.kind == "observation" else ""
            parts = [
                f"{len(outside)} of {len(self._held(rows))} measured values lie outside their "
                f"{promised} intervals{noise} ({', '.join(outside)})"
            ]
        if not self.disagrees(rows):
            return "".join(parts)
        if self.kind == "observation":
            full = "" if np.isnan(self.full) else f", {100 * self.full:.0f} % at full stroke"
            parts.append(
                f"the band holds {100 * self.coverage:.0f} % of the samples{full}, not {promised}"
            )
        return (
            f"the prediction does not agree with the measurement: {', and '.join(parts)}; check "
            "the record and its actuation, or the device is not as it was in the calibrated tests"
        )


def compare(band: Band, trace: Trace) -> Compared:
    """A band beside the measured force of its motion, where that moves and was not given."""
    force = np.asarray(trace.force)
    rest = ~band.given.holds(band.time) if band.given else np.ones(force.size, dtype=np.bool_)
    if not np.any(rest):
        raise CampaignError("nothing is left to compare: the whole record was given")
    moving = in_motion(trace)
    kept = rest & moving if np.any(rest & moving) else rest
    inside = (force >= band.lower) & (force <= band.upper)
    full, loops = np.zeros(force.size, dtype=np.bool_), find_loops(trace)
    for (begin, end), strong in zip(pairwise(loops.bounds.tolist()), loops.strong, strict=True):
        full[begin:end] |= kept[begin:end] & strong
    return Compared(
        float(np.mean(inside[kept])),
        float(np.mean(inside[full])) if np.any(full) else float("nan"),
        int(np.count_nonzero(kept)),
        rrse(band.median[kept], force[kept]),
        float(np.mean(crps(band.draws[:, kept], force[kept]))),
        band.kind,
        band.probability,
        band.given is not None,
    )


def in_motion(trace: Trace) -> NDArray[np.bool_]:
    """Samples at which the device is not at rest, (T,), by `STILL` and `DWELL`."""
    from scipy.ndimage import binary_dilation, maximum_filter1d, minimum_filter1d

    x, speed = trace.displacement, float(trace.velocity.std())
    if not speed > 0.0:
        return np.zeros(x.size, dtype=np.bool_)
    cycle = 2.0 * np.pi * float(x.std()) / speed
    step = float(np.median(np.diff(trace.time)))
    window = 2 * max(int(0.5 * DWELL * cycle / step), 1) + 1
    span = maximum_filter1d(x, window, mode="nearest") - minimum_filter1d(x, window, mode="nearest")
    still = span <= STILL * float(np.ptp(x))
    return np.asarray(~binary_dilation(still, np.ones(window, dtype=np.bool_)))
