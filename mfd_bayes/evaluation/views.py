"""What a report shows, in internal units, and how bands are scored against a measured force.

Tables are records, one dict for each row, all with the same keys. The keys that several tables
have: `test`, `name` and `unit` of a quantity; `mean`, `sd`, and `lower`, `median` and `upper`, its
2.5 %, 50 % and 97.5 % quantile; `note`, what a reader must know of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import COVERAGES, Identifiability
from mfd_bayes.errors import CampaignError
from mfd_bayes.friction.model import Model
from mfd_bayes.messages import Message, Quantity, Writer
from mfd_bayes.planning.candidate import AT_MOTIONS, GAP, Candidate, typical_of
from mfd_bayes.planning.study import CURVE, TOGETHER, Advice, Together
from mfd_bayes.planning.study import Row as AdviceRow
from mfd_bayes.population.bands import ADVICE, Band
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.record import Record
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.folder import Comparison, Finding, Score, Use, Verdict
from mfd_bayes.runs.tested_range import Span
from mfd_bayes.runs.unit_system import SYSTEMS, System
from mfd_bayes.units import percent

if TYPE_CHECKING:
    import pandas as pd


Array = NDArray[np.float64]
Row = dict[str, Any]
Rows = tuple[Row, ...]

FREE_EXPONENT = "exponent if the law were a power law"
SCATTER = "scatter between tests"
CONTRACTION = "prior variance removed"
DIRECTIONS = "directions informed"
PREDICTIVE = "posterior predictive"
LOOP_ESTIMATE = "estimate from the loop"
COVERAGE = "share of samples inside a band"
LENGTH = "autocorrelation times kept"
MODES = "modes found"
CALIBRATION = "calibration"
REPORT = "report"
IDENTIFIABILITY = (CONTRACTION, DIRECTIONS)
"""Names of the checks of what the data inform; beyond its limit such a check is a note."""
SAMPLING = ("R-hat", "bulk ESS", "tail ESS", LENGTH)
"""Names of the checks that say whether the sampling can be trusted."""

INFORMED = 0.5  # least contraction of a parameter that the data inform
NOT_INFORMED = "the data do not determine this parameter: its posterior is about its prior"
"""Note of a parameter with less contraction."""

DEFAULT_LIMITS: Mapping[str, float] = {"all": 0.15}
"""Of ASCE/SEI 7 for the properties of a single device against their nominal values (18.2.4.5)."""

_LIMITS = {
    **dict.fromkeys(("bulk ESS", "tail ESS", LENGTH, CONTRACTION, DIRECTIONS), ">= {:g}"),
    "R-hat": "<= {:g}",
    FREE_EXPONENT: "interval holds {:g}",
    MODES: "{:g}",
}


@dataclass(frozen=True)
class Check:
    """One comparison of a value with what is expected of it, in `unit`.

    `test` is an id, or "population"; `check` and `feature` are such as "R-hat" of a parameter, or
    "posterior predictive" of a feature of a record. `expected` is the limit of a diagnostic, or
    the value of the model; `difference` expected less observed, as a share of what is measured;
    `tolerance` the difference up to which nobody minds. A figure that there is not is NaN.
    """

    test: str
    check: str
    feature: str
    observed: float
    expected: float
    status: Verdict
    unit: str = "1"
    difference: float = float("nan")
    tolerance: float = float("nan")
    p_value: float = float("nan")
    note: str = ""

    @property
    def limit(self) -> str:
        """What passes, in words: "<= 1.01"."""
        return _LIMITS.get(self.check, "{:.3g}").format(self.expected)

    @property
    def message(self) -> Message:
        """The comparison as a sentence: "peak force forward 3.68 kip where 2.9 kip is expected"."""
        values: dict[str, Quantity | str] = {"feature": self.feature}
        if self.check == COVERAGE:
            return Message(f"{{feature}}: {self.observed:.0%} of the samples are inside", values)
        for name, value in (("observed", self.observed), ("expected", self.expected)):
            has_unit = self.unit not in ("1", "dimensionless")
            values[name] = Quantity.of(value, unit=self.unit) if has_unit else f"{value:.3g}"
        if self.check == PREDICTIVE:
            return Message(f"{self.feature} {{observed}} where {{expected}} is expected", values)
        return Message(f"{self.check} of {{feature}}: {{observed}} ({self.limit})", values)


@dataclass(frozen=True)
class Judgement:
    """What a test may be used for, and why.

    `reasons` have the worst first. Tests are ranked by `misfit`, in tolerances. `wrong` says if
    something is wrong with its record or its fit, and not only with its sampling; `notes` are what
    a reader must know besides, no reason for distrust.
    """

    subject: str
    use: Use
    reasons: tuple[Message, ...]
    misfit: float
    wrong: bool = False
    notes: tuple[Message, ...] = ()

    def to_text(self, writer: Writer) -> str:
        """Reasons and notes in a reader's units; "" where there are none."""
        return "; ".join(m.to_text(writer) for m in (*self.reasons, *self.notes))


@dataclass(frozen=True, eq=False)
class Interval:
    """Equal-tailed band of one probability, (T,) each, kip; or the band of the whole history."""

    probability: float
    lower: Array
    upper: Array
    whole: bool = False


@dataclass(frozen=True, eq=False)
class Fan:
    """A median, (T,), and its bands, the widest last; `kind` is in `KIND_NAMES`, or "prior"."""

    kind: str
    median: Array
    intervals: tuple[Interval, ...]

    @property
    def widest(self) -> Interval:
        """The band of the largest probability."""
        return max(self.intervals, key=lambda interval: interval.probability)

    def times(self, by: float) -> Fan:
        """The fan times a factor."""
        scaled = (replace(i, lower=i.lower * by, upper=i.upper * by) for i in self.intervals)
        return Fan(self.kind, self.median * by, tuple(scaled))


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
    """One test in the report; a test that was held out has no parameters.

    `role` is "calibrate" or "validate"; `first` the first fitted sample; `device` the fan of this
    very test, without noise. Scores are those of a table. `rows` are posteriors of each
    quantity with R-hat, ESS, contraction and its joint posterior with all tests; `corner` the
    quantities of the corner plot, in its order; `derived` the properties, with those of the record
    as recorded; `loop_estimates` what a plain rule reads off the loop and off replicated records;
    `noises` every quantity under other noises, and whether that choice `decides` it. Each of
    `modes` has the median of each quantity and its "share" of the draws. `stage` (1 slip, 2 stick,
    3 build-up, 4 gap) and `travel` in the gap since the last slip, in, are those of the posterior
    medians at each sample, (T,); None where the model has no gap. `shares` of each source in the
    variance say what makes the band of a predicted test wide, and `begun` where in its gap that
    begins, in words.
    """

    __test__ = False

    id: str
    role: str
    trace: Trace
    first: int
    observation: Fan
    score: Row
    device: Fan | None = None
    rows: Rows = ()
    marginals: tuple[Marginal, ...] = ()
    chains: int = 0
    corner: tuple[str, ...] = ()
    checks: tuple[Check, ...] = ()
    identifiability: Identifiability | None = None
    derived: Rows = ()
    stage: NDArray[np.int8] | None = None
    travel: Array | None = None
    shares: Mapping[str, float] = field(default_factory=dict)
    loop_estimates: Rows = ()
    noises: Rows = ()
    modes: tuple[Mapping[str, float], ...] = ()
    begun: str = ""


@dataclass(frozen=True, eq=False)
class LawView:
    """A quantity against actuation, (m,), ksi or kip: its law's bands, and the tests' posteriors.

    `law` is its name, or the weights of several; `device` the fan of the mean property, by law and
    level effect without scatter from test to test, `new_test` that of one more test, with it.
    `tested` has id, actuation, and 2.5 %, 50 % and 97.5 % quantile of each test.
    """

    name: str
    unit: str
    law: str
    actuation: Array
    device: Fan
    new_test: Fan
    tested: tuple[tuple[str, float, float, float, float], ...]


@dataclass(frozen=True)
class LeftOutView:
    """Cross-validation of a campaign: each part predicted from all the others.

    `rows` are the scores of each test, beside those of its own fit, and `mean` is the mean of each.
    """

    by: str
    rows: Rows
    mean: Row
    sentence: str


_AFTER = {
    "date": "ten years later",
    "cycles": "after ten times the cycles",
    "temperature": "ten times as far",
}


@dataclass(frozen=True)
class DriftRow:
    """Change of a quantity along a condition of the tests."""

    # `per` is what the change is for: "year"
    quantity: str
    condition: str
    per: str
    # per cent: median and 95 % interval
    change: float
    lower: float
    upper: float
    probability: float  # that there is a change in the direction of the median
    limit: float  # per cent, from the value at the earliest date, the least count or temperature
    left: float  # probability that the quantity has left its limit at the last test
    leaves: float  # probability that it does within `laws.AHEAD` after it
    # when it does: median and 90 % interval; "" where it is later than that
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


@dataclass(frozen=True, eq=False)
class Datasheet:
    """What an engineer needs to use a device, in internal units.

    `rows` has one for each condition, quantity, direction and cycle (0: all cycles at full stroke).
    `stroke` is the amplitude of the motion. `measured` is the value of a test, by the formula of
    the quantity, and the mean of several; `measured_low` and `measured_high` are its smallest and
    its largest cycle, NaN where nothing was tested. `nominal` is the mean of the mean property (the
    device at this actuation). `lower` and `upper` hold what `of` says, the value of a measured
    test, with 95 %, offset, noise and chatter included: `n_outside` of `n_tests` lie outside.
    `lambda_min_other` and `lambda_max_other` are those of another device tested: NaN where all
    tests are of one.
    """

    rows: pd.DataFrame
    tested: Mapping[str, Message]  # ranges and numbers of what was tested, by name
    verdict: tuple[Message, ...]  # three; a fourth of other devices, where there are several
    not_known: tuple[Message, ...]  # what a standard asks for and these tests cannot tell
    formulas: Mapping[str, str]  # how each quantity is computed


@dataclass(frozen=True, eq=False)
class Expected:
    """What the population expects of a record of a device under a motion.

    Where tests of one device are all that is known, `device` and `among` are the same.
    """

    nominal: Mapping[str, Array]  # draws (n,) of the nominal value of each quantity
    device: Mapping[str, Array]  # of a record of a device at the nominal value
    among: Mapping[str, Array]  # of a record of any device
    fan: Fan  # band of a record of any device
    remarks: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ComparedRecord:
    """One record, with its trace at the rate of the calibrated tests, and what was expected."""

    record: Record
    trace: Trace
    measured: Mapping[str, float]  # value of each quantity that the record shows
    expected: Expected


@dataclass(frozen=True, eq=False)
class Acceptance:
    """A device, compared with the others.

    Attributes
    ----------
    device : str
    verdict : {"accepted", "rejected", "cannot tell"}
    sentence : str
        The verdict with its reason, and the power.
    p_value, p_batch : float
        That tests of one device scatter so much, over all quantities; and over the whole batch.
    named : str
        The quantity that differs most; "" where none does.
    rows : DataFrame
        A row for each quantity.
    comparisons : tuple of ComparedRecord
        One for each record.
    """

    device: str
    verdict: str
    sentence: str
    p_value: float
    p_batch: float
    named: str
    rows: pd.DataFrame
    comparisons: tuple[ComparedRecord, ...]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Reasons to trust the answer less."""
        return tuple(dict.fromkeys(r for c in self.comparisons for r in c.expected.remarks))


@dataclass(frozen=True, eq=False)
class CampaignView:
    """The whole report.

    `verdict` and `sentences`, the worst first, say what the run may be used for, and `judgements`
    what each calibrated test, the one to believe least first. `failures` are tests without a
    result, and why. `law_rows` are constants of the laws, their shapes, and the scatter of each
    quantity; `common` the quantities with one value for all tests; `law_scores` how well each law
    predicts levels that were left out, the best first, and `law_choices` that in sentences. `truth`
    are the true values of a synthetic campaign: whether `inside` the interval, and `informed` by
    data. `metric` says which of both `systems` the report begins with, `tested` what the
    calibrated tests cover, `drifts` what follows a date, a count of cycles or a temperature.
    """

    title: str
    verdict: Use
    sentences: tuple[Message, ...]
    actuation_unit: str
    tests: tuple[TestView, ...]
    failures: Mapping[str, str]
    laws: tuple[LawView, ...]
    law_rows: Rows
    checks: tuple[Check, ...]
    truth: Rows
    provenance: Mapping[str, str]
    remarks: tuple[Message, ...]
    common: tuple[str, ...] = ()
    law_scores: Rows = ()
    law_choices: Mapping[str, str] = field(default_factory=dict)
    left_out: LeftOutView | None = None
    comparison: Comparison | None = None
    judgements: tuple[Judgement, ...] = ()
    warnings: tuple[Finding, ...] = ()
    metric: bool = False
    systems: tuple[System, System] = SYSTEMS
    tested: tuple[Span, ...] = ()
    next_test: Advice | None = None
    drifts: tuple[DriftRow, ...] = ()
    model: Model | None = None

    @property
    def whole(self) -> bool:
        """Whether it shows every test that it could."""
        return all(check.check != REPORT for check in self.checks)

    @property
    def unusable(self) -> bool:
        """Whether the run must not be used: a check failed, or something is wrong with a test."""
        return self.verdict == Use.NOT_USABLE

    @property
    def system(self) -> System:
        """System of units of figures and tables: by default the campaign's own."""
        return self.systems[self.metric]


# --- bands and their scores

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

    def judged(self, rows: Sequence[Row]) -> tuple[str, bool]:
        """What measured values outside their intervals, and a low coverage, say; "" for nothing.

        And whether prediction and record disagree: most measured values are outside, or far more
        samples than the band allows. `rows` are those of `predicted_rows`.
        """
        measurement = self.kind == "observation"
        skipped = () if measurement else _OF_MEASUREMENT
        held = [r for r in rows if np.isfinite(r["measured"]) and r["name"] not in skipped]
        outside = [r["name"] for r in held if not r["lower"] <= r["measured"] <= r["upper"]]
        promised, parts = f"{percent(self.probability)} %", []
        if outside:
            noise = ", offset and noise included" if measurement else ""
            parts = [
                f"{len(outside)} of {len(held)} measured values lie outside their {promised} "
                f"intervals{noise} ({', '.join(outside)})"
            ]
        missed = 1.0 - np.nanmin([self.coverage, self.full]) > OFTEN * (1.0 - self.probability)
        if not (missed and measurement) and 2 * len(outside) <= len(held):
            return "".join(parts), False
        if measurement:
            full = "" if np.isnan(self.full) else f", {100 * self.full:.0f} % at full stroke"
            parts.append(
                f"the band holds {100 * self.coverage:.0f} % of the samples{full}, not {promised}"
            )
        return (
            f"the prediction does not agree with the measurement: {', and '.join(parts)}; check "
            "the record and its actuation, or the device is not as it was in the calibrated tests"
        ), True


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


# --- the advice on the next test in words, and as a table in the units of a system

LITTLE = 0.01
"""A test that is expected to narrow the band by less than this share is not worth the frame."""

FEW = 2
"""Motions of a goal that are named in its sentence."""

_SURE = 1.96  # errors of a 95 % interval

_COUNT = ("none", "one", "two", "three", "four", "five", "six")


def in_percent(row: AdviceRow | Together) -> str:
    """Expected reduction with its 95 % interval: "18 % (14 to 22)"."""
    low, high = max(0.0, row.reduction - _SURE * row.error), row.reduction + _SURE * row.error
    digits = 0 if row.reduction >= 0.1 else 1
    figures = (f"{100 * share:.{digits}f}" for share in (row.reduction, low, min(1.0, high)))
    return "{} % ({} to {})".format(*figures)


@dataclass(frozen=True, eq=False)
class AdviceInWords:
    """Advice on the next test for a reader; `unit` is the internal one of the actuation."""

    advice: Advice
    system: System
    unit: str

    def candidate(self, candidate: Candidate) -> str:
        """A test in words: "1350 psi, 0.5 Hz, 1 in", with its waveform where it is no sine."""
        axes, parts = self.system.axes, [self.system.words([candidate.amplitude], "in", 3)]
        if axes.timed:
            parts.insert(0, f"{candidate.frequency:.3g} Hz")
        if axes.actuated:
            parts.insert(0, self.system.words([candidate.actuation], self.unit, actuation=True))
        parts += [f"on {candidate.device}"] if candidate.device else []
        text = ", ".join(parts)
        return text if candidate.waveform == "sine" else f"{text}, {candidate.waveform}"

    @property
    def goal(self) -> str:
        """What is to be known better, in words."""
        goal = self.advice.goal
        if goal.quantity == "band":
            scatter = ", with test-to-test scatter," if goal.kind == "new_test" else ""
            what = f"the {100 * goal.probability:.3g} % band{scatter}"
        else:
            words = self.system.text(goal.words)
            what = f"the {100 * goal.probability:.3g} % interval of the {words}"
        if goal.quantity not in AT_MOTIONS or (goal.quantity == GAP):
            return what
        if not goal.at:
            return f"{what} over the campaign's range"
        places = goal.places(typical_of(self.advice.tests))
        names = list(dict.fromkeys(self.candidate(place) for place in places))
        if len(names) <= FEW:
            return f"{what} at {' and '.join(names)}"
        return f"{what} at {len(names)} places from {names[0]} to {names[-1]}"

    @property
    def sentence(self) -> str:
        """Which test to make next, what it is expected to tell, and when it is enough."""
        best, goal = self.advice[0], self.goal
        scatter = ""
        if self.advice.goal.kind == "new_test":
            scatter = " This band contains test-to-test scatter, which no further test can reduce."
        if best.reduction < LITTLE:
            return (
                f"No test on this list is expected to narrow {goal} by more than "
                f"{100 * LITTLE:.0f} %: the tests are enough for this goal.{scatter}"
            )
        test = self.candidate(best.candidate)
        text = f"One test at {test} is expected to narrow {goal} by {in_percent(best)}"
        again = next((row for row in self.advice if row.repeat), None)
        if again is not None and again is not best:
            old = self.candidate(again.candidate)
            text += f"; repeating {old} by {in_percent(again)}"
        elif again is best:
            text += "; that repeats a test that was made"
        enough, steps = "", [t.reduction for t in self.advice.together]
        if len(steps) > TOGETHER:
            after = max(100 * (steps[TOGETHER] - steps[TOGETHER - 1]), 0.5)
            enough = (
                f"After {_COUNT[TOGETHER]} more tests no further test on this list gains more than "
                f"{after:.2g} % of today's width."
            )
        return f"{text}. {enough}{scatter}"

    @property
    def together(self) -> list[str]:
        """The best two and three tests together, a sentence each."""
        sentences = []
        for together in self.advice.together[1:TOGETHER]:
            tests = "; ".join(self.candidate(c) for c in together.candidates)
            count = _COUNT[len(together.candidates)]
            sentences.append(f"The best {count} together, {in_percent(together)}: {tests}.")
        return sentences

    def rows(self) -> list[dict[str, str | float]]:
        """Rows of the table, the best first, and then what the limits rule out; by column."""
        axes, (by, name) = self.system.axes, self.system.of_actuation(self.unit)
        entries: list[tuple[Candidate, AdviceRow | None, str]] = [
            (r.candidate, r, "") for r in self.advice
        ]
        entries += [(candidate, None, why) for candidate, why in self.advice.ruled_out]
        devices = any(candidate.device for candidate, _, _ in entries)
        rows = []
        for candidate, score, why in entries:
            row: dict[str, str | float] = {
                "candidate": self.candidate(candidate),
                "expected_reduction": score.reduction if score else math.nan,
                "error": score.error if score else math.nan,
                "cost_h": candidate.cost,
                "reduction_per_h": score.per_hour if score else math.nan,
                "information_nat": score.information if score else math.nan,
                "information_error": score.information_error if score else math.nan,
            }
            if axes.actuated:
                row[f"actuation_{name}"] = candidate.actuation * by
            if axes.timed:
                row["frequency_Hz"] = candidate.frequency
            amplitude = candidate.amplitude * self.system.factor("in")
            row |= {
                self.system.column("amplitude", "in"): amplitude,
                "cycles": candidate.cycles,
                "waveform": candidate.waveform,
                "repeats_a_test": "" if score is None else "yes" if score.repeat else "no",
                "ruled_out_by": why,
            }
            rows.append(row | {"device": candidate.device} if devices else row)
        return rows

    def content(self) -> dict[str, Any]:
        """Everything of the self.advice, for JSON."""
        factor = self.system.factor(self.advice.unit)
        return {
            "goal": self.goal,
            "unit": self.system.unit(self.advice.unit),
            "width_now": self.advice.width * factor,
            "draws": self.advice.draws,
            "sentence": self.sentence,
            "remarks": list(self.advice.remarks),
            "candidates": self.rows(),
            "together": [
                {
                    "candidates": [self.candidate(c) for c in together.candidates],
                    "expected_reduction": together.reduction,
                    "error": together.error,
                    "information_nat": together.information,
                    "cost_h": sum(c.cost for c in together.candidates),
                }
                for together in self.advice.together[:TOGETHER]
            ],
            "curve": [
                {"tests": number, "expected_width": float(width) * factor}
                for number, width in enumerate(self.advice.curve[: CURVE + 1])
            ],
        }

    def shown(self, most: int) -> list[tuple[str, ...]]:
        """Cells of the first rows, and of the best repeat, as a terminal shows them."""
        chosen = list(self.advice[:most])
        again = next((row for row in self.advice if row.repeat), None)
        if again is not None and again not in chosen:
            chosen.append(again)
        return [
            (
                self.candidate(row.candidate),
                in_percent(row),
                f"{row.cost:.2f}",
                f"{100 * row.per_hour:.1f} %",
                f"{row.information:.3f} ± {row.information_error:.3f}",
                "yes" if row.repeat else "",
            )
            for row in chosen
        ]
