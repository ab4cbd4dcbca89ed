"""Bands, scores and summaries of draws."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.assessment.views import Fan, Interval, ScoreRow
from mfd_bayes.errors import CampaignError
from mfd_bayes.population.bands import Band
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.results import Score
from mfd_bayes.runs.systems import System
from mfd_bayes.units import percent
from mfd_bayes.validation.scores import crps, rrse, score

Array = NDArray[np.float64]

PROBABILITIES = (0.5, 0.95)
"""Probabilities of the equal-tailed bands in figures."""


def fan_of(kind: str, draws: Array) -> Fan:
    """Median and bands of draws (n, T)."""
    tails = [0.5 * (1.0 - p) for p in PROBABILITIES]
    levels = [0.5, *tails, *(1.0 - t for t in tails)]
    median, *bounds = np.quantile(draws, levels, axis=0)
    n = len(tails)
    intervals = (Interval(p, bounds[i], bounds[n + i]) for i, p in enumerate(PROBABILITIES))
    return Fan(kind, median, tuple(intervals))


@dataclass(frozen=True)
class Compared:
    """A predicted band beside the force that was measured in the same motion.

    Attributes
    ----------
    coverage : float
        Share of the measured samples inside the band.
    samples : int
        Those that were not given.
    rrse : float
        Error of the median: 0 for a perfect prediction; 1 where the mean force would be as good.
    crps : float, kip
        Mean distance between the draws and the force.
    kind : str
        Of the band.
    probability : float
    given : bool
        Whether a first part of the record was given.
    """

    coverage: float
    samples: int
    rrse: float
    crps: float
    kind: str
    probability: float
    given: bool = False

    def sentence(self, system: System) -> str:
        """Coverage and error in words; whether the band holds what a load cell adds."""
        text = (
            f"the {percent(self.probability)} % band of kind {self.kind} holds "
            f"{100 * self.coverage:.1f} % of the {self.samples} measured samples"
            f"{' that were not given' if self.given else ''}; error of the "
            f"median (RRSE) {self.rrse:.3g}, mean distance (CRPS) "
            f"{system.words([self.crps], 'kip', 3)}"
        )
        if self.kind == "observation":
            return text
        return f"{text}; this kind holds no offset and noise: measured data need --kind observation"


def compare(band: Band, force: Array) -> Compared:
    """A band beside a measured force, (T,), kip, where that was not given."""
    given = band.given is not None
    rest = ~band.given.holds(band.time) if band.given else np.ones(force.size, dtype=np.bool_)
    if not np.any(rest):
        raise CampaignError("nothing is left to compare: the whole record was given")
    inside = (force >= band.lower) & (force <= band.upper)
    distance = float(np.mean(crps(band.draws[:, rest], force[rest])))
    error = rrse(band.median[rest], force[rest])
    share, samples = float(np.mean(inside[rest])), int(np.count_nonzero(rest))
    return Compared(share, samples, error, distance, band.kind, band.probability, given)


class Spread(TypedDict):
    """Mean, sd and three quantiles of draws, as rows of tables have them."""

    mean: float
    sd: float
    lower: float
    median: float
    upper: float


def spread_of(draws: Array, tail: float = 0.025) -> Spread:
    """Mean, sd, median, and the bounds that leave `tail` of the draws (n,) on either side."""
    lower, median, upper = (float(q) for q in np.quantile(draws, [tail, 0.5, 1.0 - tail]))
    mean, sd = float(draws.mean()), float(draws.std())
    return {"mean": mean, "sd": sd, "lower": lower, "median": median, "upper": upper}


def score_of(name: str, role: str, trace: Trace, draws: Array, first: int) -> ScoreRow:
    """Scores of force draws (n, T) against the force of a record, from sample `first` on."""
    found = score(draws[:, first:], np.asarray(trace.force)[first:])
    return score_row(name, role, found)


def score_row(name: str, role: str, found: Score) -> ScoreRow:
    """A score as a row of a table."""
    half, most, nearly = found.coverage
    scale = found.width, found.interval_score, found.crps
    return ScoreRow(name, role, half, most, nearly, *scale, found.rrse)
