"""A basis of smooth functions of the travel since the last turn and of the direction of motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

KNOTS = 16
"""Knots of each direction."""

FINE = 20.0
"""Travels are told apart on the logarithm of 1 + travel · FINE/stroke: finest after a turn."""

LENGTH = 0.2
"""Correlation length of the functions, as a share of the knots' range."""


@dataclass(frozen=True)
class TravelBasis:
    """Piecewise linear functions of the travel since a turn, for each direction of motion.

    The motion alone fixes their values. Beyond the longest stroke, and where the stroke before
    the turn was less than half of the shortest full stroke, all of them are zero: what repeats
    in full cycles says nothing of such motions.

    Attributes
    ----------
    shortest, longest : float, in
        Full strokes of the tests from which functions are learned.
    """

    shortest: float
    longest: float

    @classmethod
    def of(cls, traces: Sequence[Trace]) -> TravelBasis:
        """Basis for the motions of some tests."""
        strokes = [float(np.ptp(trace.displacement)) for trace in traces]
        return cls(min(strokes), max(strokes))

    @property
    def size(self) -> int:
        """Number of functions."""
        return 2 * KNOTS

    def values(self, trace: Trace) -> Array:
        """Values of the functions at each sample, (T, size)."""
        _, before, _ = _since_turn(trace)
        known = np.clip(4.0 * before / self.shortest - 2.0, 0.0, 1.0)
        return self.of_any_stroke(trace) * known[:, None]

    def of_any_stroke(self, trace: Trace) -> Array:
        """The same where no stroke before the turn is too short, (T, size)."""
        travel, _, forward = _since_turn(trace)
        step = np.log1p(FINE) / (KNOTS - 1)
        place = np.log1p(FINE * travel / self.longest) / step
        one = np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(KNOTS)))
        return np.concatenate([one * forward[:, None], one * ~forward[:, None]], axis=1)

    def covariance(self) -> Array:
        """Prior covariance of the coefficients for unit sd: Matérn 3/2 in each direction."""
        knots = np.linspace(0.0, 1.0, KNOTS)
        apart = np.sqrt(3.0) * np.abs(knots[:, None] - knots) / LENGTH
        one = (1.0 + apart) * np.exp(-apart) + 1e-6 * np.eye(KNOTS)
        return np.asarray(linalg.block_diag(one, one))


def _since_turn(trace: Trace) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Travel since the last turn, length of the stroke before it, and whether forward, (T,) each.

    Before the first turn the travel is that since the first sample, and no stroke is known.
    """
    x = trace.displacement
    turns = np.concatenate([[0], trace.turning_points, [trace.samples - 1]])
    stretch = np.searchsorted(turns[1:-1], np.arange(trace.samples), side="right")
    strokes = np.diff(x[turns])
    before = np.concatenate([[0.0], np.abs(strokes[:-1])])
    return np.abs(x - x[turns[stretch]]), before[stretch], strokes[stretch] > 0
