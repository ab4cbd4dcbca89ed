"""Peak forces of a test as a load cell sees them: above those of the computed force."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

SIDES: Mapping[str, float] = {"fwd": 1.0, "bwd": -1.0}
"""Directions, and the sign of the force in each."""

PRIOR_TESTS, PRIOR_SCATTER = 3.0, 0.05
"""Prior of the scatter between tests: worth so many tests, with this share of the mean peak."""

CERTAIN = 1e6  # tests by which an excess is known


@dataclass(frozen=True)
class PeakExcess:
    """What the largest force of a test has above the computed one, in one direction, kip.

    When the gap closes at a speed v, the impact adds v √(k m) to the force, whatever the friction;
    a filter and a thinned record lose a part of it, and the model has no mass. Of test j

        excess_j = rate v_j + t_j,    t_j ~ N(0, scatter²)

    with v the largest speed of the test. This is a regression through the origin with the
    conjugate prior, so that what a new test has is Student-t. The rate is negative where the model
    computes too large peaks, as with a static friction that the device does not have.
    """

    rate: float = 0.0  # kip s/in
    rate_variance: float = 0.0  # (s/in)², of the rate, over the variance between tests
    scatter: float = 0.0  # kip, scale of the difference from test to test
    tests: float = 0.0  # from which it was learned

    @classmethod
    def of(cls, excess: Array, speed: Array, peak: Array) -> PeakExcess:
        """Excess of J tests, kip, by their largest speeds, in/s, and computed peaks, (J,) each."""
        squares = float(speed @ speed)
        if not squares > 0.0:
            return cls()
        rate = float(speed @ excess) / squares
        prior = PRIOR_TESTS * (PRIOR_SCATTER * float(peak.mean())) ** 2
        variance = (prior + float(np.sum((excess - rate * speed) ** 2))) / _freedom(excess.size)
        return cls(rate, 1.0 / squares, float(np.sqrt(variance)), excess.size)

    def draw(self, rng: np.random.Generator) -> PeakExcess:
        """An excess that the posterior allows: its rate and scatter are known."""
        freedom = _freedom(self.tests)
        scatter = self.scatter * np.sqrt(freedom / rng.chisquare(freedom))
        rate = self.rate + scatter * np.sqrt(self.rate_variance) * rng.standard_normal()
        return PeakExcess(float(rate), 0.0, float(scatter), CERTAIN)

    def scores(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """Differences of new tests over their scale, in an array of a shape."""
        return rng.standard_t(_freedom(self.tests), shape)

    def scale(self, speed: Array | float) -> Array:
        """Scale of the excess of a new test, kip, at its largest speed, in/s."""
        return np.asarray(self.scatter * np.sqrt(1.0 + self.rate_variance * np.square(speed)))

    def bound(self, probability: float, spread: Array, speed: Array) -> Array:
        """Score of a bound that leaves out 1 − `probability` of new tests, for `seen`.

        The computed peak at the bound lies `spread` from its middle, kip: the scatter of both adds
        up by its squares.
        """
        excess = scipy.special.stdtrit(_freedom(self.tests), probability) * self.scale(speed)
        change = np.sign(excess) * (np.hypot(spread, excess) - spread)
        return np.asarray(change / np.maximum(self.scale(speed), 1e-300))

    def seen(self, largest: Array, speed: Array | float, slip: Array, scores: Array) -> Array:
        """Peaks that a load cell sees, of computed ones, kip; the arrays broadcast.

        `speed` is the largest of the motion, in/s, `slip` the slip force, kip, NaN where there is
        none, and `scores` are those of `scores`, or zero. A peak is no smaller than the slip force,
        unless the computed one is, for the damper does not slip then, and has less of the excess.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.clip(np.nan_to_num(largest / slip, nan=1.0, posinf=1.0), 0.0, 1.0)
        peak = largest + share * (self.rate * np.asarray(speed) + self.scale(speed) * scores)
        return np.asarray(np.fmax(peak, np.minimum(largest, slip)))


def _freedom(tests: float) -> float:
    """Degrees of freedom of the scatter between so many tests."""
    return PRIOR_TESTS + tests - 1.0


Peaks = Mapping[str, PeakExcess]  # by direction, of `SIDES`


class MeanExcess(PeakExcess):
    """The mean excess of all tests: its rate is uncertain, and no test scatters about it."""

    def scale(self, speed: Array | float) -> Array:
        """Scale of the mean excess, kip, at a largest speed, in/s."""
        return np.asarray(self.scatter * np.sqrt(self.rate_variance) * np.abs(speed))


def of_mean(peaks: Peaks) -> Peaks:
    """The excess of the mean property."""
    return {side: MeanExcess(**vars(excess)) for side, excess in peaks.items()}


def certain(peaks: Peaks) -> Peaks:
    """The excess at its most likely rate, without scatter."""
    return {side: replace(excess, scatter=0.0) for side, excess in peaks.items()}


NO_EXCESS: Peaks = {side: PeakExcess() for side in SIDES}


def largest_speed(trace: Trace) -> float:
    """Largest speed of a motion, in/s; 1 where it has no time."""
    return float(np.abs(trace.velocity).max()) if trace.timed else 1.0
