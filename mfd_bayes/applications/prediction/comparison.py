"""A prediction beside the force that was measured in the same motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.errors import CampaignError
from mfd_bayes.evaluation.scores import Row, crps, rrse
from mfd_bayes.population.bands import Band
from mfd_bayes.records.cycles import PROPERTIES
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.unit_system import UnitSystem
from mfd_bayes.units import percent

OFTEN = 3.0
"""A band is said to miss a record that leaves it so many times as often as its probability says."""

STILL, DWELL = 0.01, 0.125
"""At rest: within this share of the stroke, for longer than this share of a mean cycle. A sine is
so near to its turn for half as long."""

_OF_MEASUREMENT = [n for n, p in PROPERTIES.items() if p.unit == "kip"]  # with offset and noise


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
    given: bool  # whether a first part of the record was given

    def sentence(self, system: UnitSystem) -> str:
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

    def judged(self, rows: Sequence[Row]) -> tuple[str, bool]:
        """What measured values outside their intervals, and a low coverage, say; "" for nothing.

        And whether prediction and record disagree: most measured values are outside, or far more
        samples than the band allows. `rows` are those of `predicted_rows`.
        """
        measurement = self.kind == "observation"
        skipped = () if measurement else _OF_MEASUREMENT
        measured = [r for r in rows if np.isfinite(r["measured"]) and r["name"] not in skipped]
        outliers = [r["name"] for r in measured if not r["lower"] <= r["measured"] <= r["upper"]]
        promised, clauses = f"{percent(self.probability)} %", []
        if outliers:
            noise = ", offset and noise included" if measurement else ""
            clauses = [
                f"{len(outliers)} of {len(measured)} measured values lie outside their {promised} "
                f"intervals{noise} ({', '.join(outliers)})"
            ]
        missed = 1.0 - np.nanmin([self.coverage, self.full]) > OFTEN * (1.0 - self.probability)
        if not (missed and measurement) and 2 * len(outliers) <= len(measured):
            return "".join(clauses), False
        if measurement:
            full = "" if np.isnan(self.full) else f", {100 * self.full:.0f} % at full stroke"
            clauses.append(
                f"the band holds {100 * self.coverage:.0f} % of the samples{full}, not {promised}"
            )
        return (
            f"the prediction does not agree with the measurement: {', and '.join(clauses)}; check "
            "the record and its actuation, or the device is not as it was in the calibrated tests"
        ), True


def compare(band: Band, trace: Trace) -> Compared:
    """A band beside the measured force of its motion, where that moves and was not given."""
    force = np.asarray(trace.force)
    remaining = (
        ~band.conditioning.holds(band.time)
        if band.conditioning
        else np.ones(force.size, dtype=np.bool_)
    )
    if not np.any(remaining):
        raise CampaignError("nothing is left to compare: the whole record was given")
    moving = in_motion(trace)
    mask = remaining & moving if np.any(remaining & moving) else remaining
    covered = (force >= band.lower) & (force <= band.upper)
    full, loops = np.zeros(force.size, dtype=np.bool_), find_loops(trace)
    for (begin, end), strong in zip(pairwise(loops.bounds.tolist()), loops.strong, strict=True):
        full[begin:end] |= mask[begin:end] & strong
    return Compared(
        float(np.mean(covered[mask])),
        float(np.mean(covered[full])) if np.any(full) else float("nan"),
        int(np.count_nonzero(mask)),
        rrse(band.median[mask], force[mask]),
        float(np.mean(crps(band.draws[:, mask], force[mask]))),
        band.kind,
        band.probability,
        band.conditioning is not None,
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
    at_rest = span <= STILL * float(np.ptp(x))
    return np.asarray(~binary_dilation(at_rest, np.ones(window, dtype=np.bool_)))
