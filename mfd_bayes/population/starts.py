"""Where in the gap tests begin.

Tests are often made one after the other with the same motion, and the device is not reset in
between: it then stands where such a motion leaves it. So a repeat of the calibrated tests begins
near the middle of the gap, or near the place at which its own motion ends; which of the two, and
how near, is learned from the calibrated tests (Beta densities on a grid of shapes). For every
other motion nothing is learned from repeats: it begins without load, or anywhere. A repeat does so
with probability `ELSEWHERE` too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betaincinv, betaln, expit, logit, ndtr, softmax

from mfd_bayes.calibration.priors import Prior
from mfd_bayes.friction.model import Model
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]

SHAPES = np.geomspace(1.0, 100.0, 41)  # of the Beta densities: from anywhere (1) to one place
ELSEWHERE = 0.2  # probability that a repeat begins without load or anywhere
# probability, before the tests of a run, that tests begin without load and not anywhere. All
# records of the three sessions in shared/data/brfd begin with less than a tenth of the slip
# force. With k sessions of k, Laplace's rule gives (k + 1)/(k + 2) to the next one; k is 2 here,
# so that none of the three is counted twice.
BEFORE = 0.75
MOST = 0.95  # largest probability that tests begin without load
SLOW = 1e3  # time between two displacements of a motion without speed, s


@dataclass(frozen=True, eq=False)
class Starts:
    """Density of the place in the gap, from 0 to 1, where a new test begins."""

    # (2, A): posterior of the modes (middle of the gap, where the motion ends) and of the shapes
    weights: Array | None = None
    unloaded: float = 0.0  # probability of a start without load; 0 where the model tells of none
    fixed: float | None = None  # the start that the prior file fixes

    @classmethod
    def of(cls, prior: Prior | None) -> Starts:
        """Of a prior alone."""
        return cls(fixed=float(prior.typical) if prior is not None and prior.fixed else None)

    def learned(
        self, begun: Array, left: Array | None, without_load: Sequence[tuple[Array, Array] | None]
    ) -> Starts:
        """What draws of the places (n, J) say where tests began."""
        w = np.clip(np.median(begun, axis=0), 1e-6, 1.0 - 1e-6)
        log = np.full((2, SHAPES.size), -np.inf)
        for i, mode in enumerate((np.full(w.size, 0.5), left)):
            if mode is not None:
                a, b = _exponents(SHAPES[:, None], mode)
                density = (a - 1.0) * np.log(w) + (b - 1.0) * np.log1p(-w) - betaln(a, b)
                log[i] = density.sum(axis=1)
        ends = [part for part in without_load if part is not None]
        if len(ends) < len(without_load):
            return Starts(softmax(log), self.unloaded, self.fixed)
        factors = 0.0
        for place, (lower, upper) in zip(begun.T, ends, strict=True):
            inside = (place >= lower) & (place <= upper)
            factors += np.log((inside.mean() + 1e-3) / ((upper - lower).mean() + 1e-3))
        chance = min(float(expit(logit(BEFORE) + factors)), MOST)
        return Starts(softmax(log), chance, self.fixed)

    def place(
        self,
        numbers: Array,
        left: float | None,
        without_load: tuple[Array, Array] | None,
        *,
        repeat: bool,
    ) -> Array:
        """Places of tests, (n,), of normal numbers (n, 2): which density, and where in it."""
        if self.fixed is not None:
            return np.full(len(numbers), self.fixed)
        which, u = ndtr(numbers).T
        found, share = u, 1.0
        if repeat and self.weights is not None:
            share = ELSEWHERE
            edges = np.cumsum(self.weights.ravel())
            pick = np.searchsorted(edges / edges[-1], (which - share) / (1.0 - share))
            mode, shape = np.divmod(np.clip(pick, 0, edges.size - 1), SHAPES.size)
            modes = np.array([0.5, 0.5 if left is None else left])
            a, b = _exponents(SHAPES[shape], modes[mode])
            found = np.where(which >= share, betaincinv(a, b, u), u)
        if without_load is not None:
            lower, upper = without_load
            found = np.where(which < share * self.unloaded, lower + (upper - lower) * u, found)
        return np.asarray(np.clip(found, 1e-9, 1.0 - 1e-9))


def _exponents(shape: Array, mode: Array) -> tuple[Array, Array]:
    """Exponents of Beta densities of these shapes a and modes, with the sum 2a."""
    return 1.0 + 2.0 * (shape - 1.0) * mode, 1.0 + 2.0 * (shape - 1.0) * (1.0 - mode)


def without_load(model: Model, values: Mapping[str, Array]) -> tuple[Array, Array] | None:
    """Ends of the part of the gap without load, (n,) each, of quantities by name; None if all."""
    found = model.unloaded(values)
    if found is None:
        return None
    lower, upper, edge = found
    fine = np.isfinite(lower) & np.isfinite(upper) & np.isfinite(edge)
    half = 0.5 * np.clip(np.where(fine, edge, 0.0), 0.0, 0.5)
    ends = np.where(fine, lower - half, 0.0), np.where(fine, upper + half, 1.0)
    return np.clip(ends[0], 0.0, 1.0), np.clip(ends[1], 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Ending:
    """Where a test ended, as draws: another that follows without a reset begins there."""

    test: str  # its id
    theta: Array  # (m, p)
    place: Array  # (m,), 1: place in the gap when the next test begins, as `Model.end` has it
    predicted: bool = False  # whether it was predicted itself, and not calibrated

    @classmethod
    def of(
        cls,
        model: Model,
        test: str,
        trace: Trace,
        values: Mapping[str, Array],
        scales: Mapping[str, Array] | None = None,
    ) -> Ending:
        """Ending of a test of a motion, of draws of its quantities by name, with `start`."""
        theta = model.theta(values)
        return cls(test, theta, model.end(theta, trace, values["start"], scales=scales))

    @property
    def words(self) -> str:
        """What a test that follows begins with."""
        how = ", which is predicted itself," if self.predicted else ""
        return f"begun where in its gap test {self.test}{how} ended"

    def starts(self, model: Model, theta: Array, trace: Trace, seed: int) -> Array:
        """Draws of the `start` of a motion that follows, with parameters theta (n, p), (n,)."""
        rng = np.random.default_rng((seed, 1))  # of its own: all other draws stay as they are
        pick = rng.choice(len(self.place), size=len(theta))
        return model.start_at(self.place[pick], trace, self.theta[pick], theta)

    def moved(self, model: Model, way: ArrayLike) -> Ending:
        """The same after a slow motion, straight from each displacement (M,), in, to the next."""
        x = np.asarray(way, dtype=np.float64)
        x = np.concatenate([x[:1], x[:1], x])  # a trace has three samples at least
        time = SLOW * np.arange(x.size)
        trace = Trace.from_arrays(time, x, velocity=np.zeros(x.size), hysteresis=0.0)
        place = model.end(self.theta, trace, model.start_at(self.place, trace))
        return Ending(self.test, self.theta, place, self.predicted)


def place_left(
    model: Model,
    values: Mapping[str, Array],
    trace: Trace,
    scales: Mapping[str, Array] | None = None,
) -> float | None:
    """Place, as a `start` of it, at which a motion leaves a device of typical quantities.

    The medians of these, (n,) each by name, are taken. The device goes straight back to the first
    displacement. None for a model without a gap, or one that does not say where a motion ends.
    """
    if not model.has_gap or type(model).compute_end is Model.compute_end:
        return None
    theta = model.theta({name: np.array([np.median(value)]) for name, value in values.items()})
    ended = Ending("", theta, model.end(theta, trace, scales=scales))
    ended = ended.moved(model, trace.displacement[[-1, 0]])
    return float(np.clip(model.start_at(ended.place, trace)[0], 0.0, 1.0))
