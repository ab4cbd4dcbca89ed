"""One test: its bands, parameters, checks and scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.identifiability import Identifiability
from mfd_bayes.evaluation.views.check import Check
from mfd_bayes.records.trace import Trace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseRow:
    """A quantity of a test under the campaign's noise and under another, in `unit`.

    `lower`, `median` and `upper` are 2.5 %, 50 % and 97.5 % quantile; those with `other` are
    under the noise of that name. `decides` says that the choice of the noise decides the value.
    """

    subject: str
    name: str
    unit: str
    noise: str
    lower: float
    median: float
    upper: float
    other: str
    other_lower: float
    other_median: float
    other_upper: float
    decides: bool


@dataclass(frozen=True)
class Row:
    """Posterior of one quantity: mean, sd, and 2.5 %, 50 % and 97.5 % quantile, in `unit`.

    `contraction` is the share of the prior's variance that the data removed. `note` is a
    warning to the reader, such as that the data do not inform the quantity. `others` is the
    quantity under other noises, where the choice of the noise decides it.
    """

    subject: str
    name: str
    unit: str
    mean: float
    sd: float
    lower: float
    median: float
    upper: float
    r_hat: float
    ess_bulk: float
    ess_tail: float
    contraction: float
    note: str = ""
    others: tuple[NoiseRow, ...] = ()


@dataclass(frozen=True)
class DerivedRow:
    """A quantity derived from the damper's force, without offset and noise, in `unit`.

    `role` is the test's, or the kind of a prediction. `lower` and `upper` bound an
    equal-tailed interval. `measured` is the record's own value, NaN where it has none.
    `note` gives the number of full cycles; without one, all figures are NaN.
    """

    subject: str
    role: str
    name: str
    unit: str
    mean: float
    sd: float
    lower: float
    median: float
    upper: float
    measured: float
    note: str = ""


@dataclass(frozen=True)
class ReadingRow:
    """A figure read off the loop, `value` in `unit`, beside the quantity that should agree.

    `name` is the quantity, with the bounds and the median of its equal-tailed 95 % interval.
    `missed` says that the interval misses the reading by more than the tolerance. Where `largest`,
    the value is the largest measured force, and missed if the median is above it. `far` says that a
    slip force is so far from its reading that the noise stands in for the friction.
    """

    subject: str
    name: str
    unit: str
    value: float
    lower: float
    median: float
    upper: float
    tolerance: float
    missed: bool
    largest: bool = False
    far: bool = False


@dataclass(frozen=True, eq=False)
class Interval:
    """Equal-tailed band of one probability, (T,) each, kip; or the band of the whole history."""

    probability: float
    lower: Array
    upper: Array
    whole: bool = False


@dataclass(frozen=True, eq=False)
class Fan:
    """A median and its bands.

    Attributes
    ----------
    kind : {"device", "new_test", "observation", "this_test", "prior"}
    median : (T,), kip
    intervals : tuple of Interval
        Widest last.
    """

    kind: str
    median: Array
    intervals: tuple[Interval, ...]


@dataclass(frozen=True)
class ScoreRow:
    """Scores of a test's observation bands against its force; width and scores in kip."""

    subject: str
    role: str
    coverage_50: float
    coverage_90: float
    coverage_95: float
    width_95: float
    interval_score: float
    crps: float
    rrse: float


@dataclass(frozen=True, eq=False)
class Marginal:
    """Draws of one quantity from prior (m,) and posterior (n,), in `unit`."""

    name: str
    unit: str
    prior: Array
    posterior: Array
    contraction: float


@dataclass(frozen=True, eq=False)
class TestView:
    """One test in the report.

    Attributes
    ----------
    role : {"calibrate", "validate"}
    actuation : str
        With its unit.
    trace : Trace
        With its force.
    first : int
        First sample that was fitted.
    device : Fan or None
        Model and offset, without noise; None where the test was predicted.
    chains : mapping of str to (chain, draw)
        Sampled quantities for trace plots; a draw is the mean over walkers at a step.
    corner : tuple of str
        Quantities of the corner plot, in its order: those that the data inform.
    identifiability : Identifiability or None
        None where the test was predicted.
    derived : tuple of DerivedRow
        With 95 % intervals.
    readings : tuple of ReadingRow
        What is read off the loop of a fitted test.
    noises : tuple of NoiseRow
        Every quantity under other noises, where a fitted test was checked.
    modes : tuple of mapping of str to float
        Median of each quantity among the draws of each mode, where there are several; the share of
        the draws is under "share".
    stage : (T,) int or None
        Stage at each sample for the posterior medians: 1 slip, 2 stick, 3 build-up;
        None where the test was predicted or the model has no gap.
    travel : (T,), in, or None
        Travel in the gap since the last slip, for the posterior medians.
    shares : mapping of str to float
        What makes the band of a predicted test wide: share of each source in the variance.
    begun : str
        In words, where in its gap a predicted test begins; "" where that is unknown.
    """

    __test__ = False

    id: str
    role: str
    actuation: str
    trace: Trace
    first: int
    observation: Fan
    score: ScoreRow
    device: Fan | None = None
    rows: tuple[Row, ...] = ()
    marginals: tuple[Marginal, ...] = ()
    chains: Mapping[str, Array] = field(default_factory=dict)
    corner: tuple[str, ...] = ()
    checks: tuple[Check, ...] = ()
    identifiability: Identifiability | None = None
    derived: tuple[DerivedRow, ...] = ()
    stage: NDArray[np.int8] | None = None
    travel: Array | None = None
    shares: Mapping[str, float] = field(default_factory=dict)
    readings: tuple[ReadingRow, ...] = ()
    noises: tuple[NoiseRow, ...] = ()
    modes: tuple[Mapping[str, float], ...] = ()
    begun: str = ""
