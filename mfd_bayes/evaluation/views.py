"""What a report shows, as plain frozen data: computed here, drawn in `reporting`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.identifiability import Identifiability
from mfd_bayes.messages import Message, Quantity, Writer
from mfd_bayes.planning.study import Advice
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.scores import ComparisonRow
from mfd_bayes.runs.tested_range import Span
from mfd_bayes.runs.unit_system import SYSTEMS, System
from mfd_bayes.runs.verdict import Finding, Use, Verdict

if TYPE_CHECKING:
    from mfd_bayes.evaluation.drift import DriftRow

Array = NDArray[np.float64]

FREE_EXPONENT = "exponent if the law were a power law"
"""Name of the check that the tests do not contradict a proportional law."""

CONTRACTION = "prior variance removed"
PRIOR_SENSITIVITY = "sensitivity to the prior"
LIKELIHOOD_SENSITIVITY = "sensitivity to the likelihood"
DIRECTIONS = "directions informed"
TRADE_OFFS = "rank correlation of two parameters"
PREDICTIVE = "posterior predictive"
LOOP_ESTIMATE = "estimate from the loop"
COVERAGE = "share of samples inside a band"
LENGTH = "autocorrelation times kept"
MODES = "modes found"
IDENTIFIABILITY = (CONTRACTION, PRIOR_SENSITIVITY, LIKELIHOOD_SENSITIVITY, DIRECTIONS, TRADE_OFFS)
"""Names of the checks of what the data inform; beyond its limit such a check is a note."""


@dataclass(frozen=True)
class Check:
    """One comparison of a value with what is expected of it.

    Attributes
    ----------
    test : str
        A test's id, or "population".
    check : str
        Such as "R-hat" or "posterior predictive".
    feature : str
        The parameter, or the feature of the record, that is checked.
    observed : float
    expected : float
        The limit of a diagnostic, or the value that the model expects.
    unit : str
        Internal unit of both.
    difference : float
        Expected less observed, as a share of what is measured; NaN where it is not said.
    tolerance : float
        The difference up to which nobody minds; NaN where there is none.
    p_value : float
        Posterior predictive; NaN where there is none.
    status : Verdict
    note : str
        What a reader must know besides, such as both ends of an interval.
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
        if self.check == COVERAGE:
            return Message(
                f"{{feature}}: {self.observed:.0%} of the samples are inside",
                {"feature": self.feature},
            )
        values: dict[str, Quantity | str] = {"feature": self.feature, "note": self.note}
        for name, value in (("observed", self.observed), ("expected", self.expected)):
            has_unit = self.unit not in ("1", "dimensionless")
            values[name] = Quantity.of(value, unit=self.unit) if has_unit else f"{value:.3g}"
        if self.check == PREDICTIVE:
            return Message("{feature} {observed} where {expected} is expected", values)
        values |= {"check": self.check, "limit": self.limit}
        return Message("{check} of {feature}: {observed} ({limit})", values)


_LIMITS = {
    "R-hat": "<= {:g}",
    "bulk ESS": ">= {:g}",
    "tail ESS": ">= {:g}",
    LENGTH: ">= {:g}",
    CONTRACTION: ">= {:g}",
    DIRECTIONS: ">= {:g}",
    TRADE_OFFS: "within ±{:g}",
    PRIOR_SENSITIVITY: "<= {:.2g}",
    LIKELIHOOD_SENSITIVITY: "> {:.2g}",
    FREE_EXPONENT: "interval holds {:g}",
    MODES: "{:g}",
}


@dataclass(frozen=True)
class Judgement:
    """What a test may be used for, and why.

    Attributes
    ----------
    reasons : tuple of Message
        The worst first; empty where there are none.
    misfit : float
        By which tests are ranked, the largest first; 1 is a miss as large as its tolerance.
    wrong : bool
        Whether something is wrong with its record or its fit, and not only with its sampling.
    notes : tuple of Message
        What a reader must know besides, which is no reason for distrust.
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
    warning to the reader, such as that the data do not inform the quantity. `other_noises` is the
    quantity under other noises, where the choice of the noise decides it. `joint_lower`,
    `joint_median` and `joint_upper` are the same three quantiles in the joint posterior of all
    tests, which predictions use; NaN where it has none. `disagrees` says that both
    intervals do not overlap, and the medians are far apart.
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
    other_noises: tuple[NoiseRow, ...] = ()
    joint_lower: float = float("nan")
    joint_median: float = float("nan")
    joint_upper: float = float("nan")
    disagrees: bool = False


@dataclass(frozen=True)
class DerivedRow:
    """A property of a test, in `unit`.

    `role` is the test's, or the kind of a prediction. `lower` and `upper` bound an equal-tailed
    interval. `measured` is the value of the record as recorded, NaN where it has none. Of tests,
    and of predictions of kind "observation", both have offset and noise; peaks are always those
    that a load cell would see. `missed` says that the measured value is outside, extreme, and
    farther from the median than its tolerance. `note` gives the number of full cycles.
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
    missed: bool = False


@dataclass(frozen=True)
class LoopEstimate:
    """A figure that a plain rule reads off a test's loop, `value` in `unit`.

    `lower`, `median` and `upper` are 2.5 %, 50 % and 97.5 % quantile of the same rule's figures on
    replicated records. `missed` says that the value is outside, and farther from the median than
    the tolerance, a share.
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
    loop_estimates : tuple of LoopEstimate
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
    loop_estimates: tuple[LoopEstimate, ...] = ()
    noises: tuple[NoiseRow, ...] = ()
    modes: tuple[Mapping[str, float], ...] = ()
    begun: str = ""


@dataclass(frozen=True, eq=False)
class LawView:
    """A quantity against actuation: its law with bands, and the tests' own posteriors.

    Attributes
    ----------
    law : str
        The law's name, or the weights of several laws.
    actuation : (m,), ksi or kip
    device : Fan
        Of the mean property: the device at each actuation, by its law and the effect of the level,
        without scatter from test to test.
    new_test : Fan
        Of one more test, with that scatter.
    tested : tuple of (str, float, float, float, float)
        Id, actuation, and 2.5 %, 50 % and 97.5 % quantile of each test's posterior.
    """

    name: str
    unit: str
    law: str
    actuation: Array
    device: Fan
    new_test: Fan
    tested: tuple[tuple[str, float, float, float, float], ...]


@dataclass(frozen=True)
class LawScoreRow:
    """How well one law predicts a quantity at levels that were left out.

    Attributes
    ----------
    chosen : bool
        Whether the campaign uses this law.
    elpd, elpd_se : float
        Log predictive density, summed over levels, and its standard error.
    difference, difference_se : float
        Elpd minus that of the best law, and its standard error, paired over levels.
    weight : float
        Stacking weight.
    pareto_k : float
        Of the score's importance weights; above 0.7 it cannot be trusted.
    """

    quantity: str
    law: str
    chosen: bool
    elpd: float
    elpd_se: float
    difference: float
    difference_se: float
    weight: float
    pareto_k: float = float("nan")


@dataclass(frozen=True)
class LawChoice:
    """The laws of one quantity, best first, and a sentence that says which predicts best."""

    quantity: str
    rows: tuple[LawScoreRow, ...]
    sentence: str


@dataclass(frozen=True)
class LeftOutRow:
    """Scores of one test that was predicted without its part of the campaign; in kip.

    `fitted_width` and `fitted_crps` are those of the same test's own posterior, which has
    seen its force; the ratios are the prediction's figure over the fitted one. `whole_95` is 1
    where the 95 % band of the whole history holds the whole force, else 0; NaN where unknown.
    """

    part: str
    subject: str
    coverage_50: float
    coverage_90: float
    coverage_95: float
    width_95: float
    interval_score: float
    crps: float
    rrse: float
    fitted_width: float
    fitted_crps: float
    width_ratio: float
    crps_ratio: float
    whole_95: float = float("nan")


@dataclass(frozen=True)
class LeftOutView:
    """Cross-validation of a campaign: each part predicted from all the others.

    Attributes
    ----------
    by : {"test", "level", "session"}
        What a part is.
    mean : LeftOutRow
        Mean of each column over the tests.
    sentence : str
        The result in words.
    """

    by: str
    rows: tuple[LeftOutRow, ...]
    mean: LeftOutRow
    sentence: str


@dataclass(frozen=True)
class TruthRow:
    """The true value of a synthetic test's quantity, and its posterior."""

    subject: str
    name: str
    unit: str
    truth: float
    lower: float
    median: float
    upper: float
    inside: bool
    informed: bool


@dataclass(frozen=True, eq=False)
class CampaignView:
    """The whole report.

    Attributes
    ----------
    verdict : Use
        What the run may be used for.
    sentences : tuple of Message
        The verdict with its reasons, the worst first.
    actuation_unit : {"ksi", "kip"}
    failures : mapping of str to str
        Tests without a posterior, and why.
    law_rows : tuple of Row
        Table II: slopes, intercepts, shapes, and the scatter of each quantity.
    common : tuple of str
        Quantities that have one value for all tests.
    truth : tuple of TruthRow
        Empty for real tests.
    provenance : mapping of str to str
        Command, seed, versions and hashes of the inputs.
    remarks : tuple of Message
        Sentences that a reader must know.
    law_choices : tuple of LawChoice
        Of each quantity that follows the actuation; empty where levels are too few.
    left_out : LeftOutView or None
        None where the campaign was not cross-validated.
    comparison : tuple of ComparisonRow
        Models that were compared on this campaign; empty where none were.
    comparison_sentence : str
        Result of that comparison.
    judgements : tuple of Judgement
        What each calibrated test may be used for, the one to believe least first.
    warnings : tuple of Finding
        What records and results gave cause to warn of.
    metric : bool
        Whether the records, and so the report, are in metric units.
    systems : pair of System
        Customary and metric units of the page, fit for the size of the device's forces.
    tested : tuple of Span
        Smallest and largest stroke, speed, frequency and actuation of the calibrated tests.
    next_test : Advice or None
        Which test to make next, where it was asked for.
    drifts : tuple of DriftRow
        What follows a date, a count of cycles or a temperature.
    """

    title: str
    verdict: Use
    sentences: tuple[Message, ...]
    actuation_unit: str
    tests: tuple[TestView, ...]
    failures: Mapping[str, str]
    laws: tuple[LawView, ...]
    law_rows: tuple[Row, ...]
    checks: tuple[Check, ...]
    scores: tuple[ScoreRow, ...]
    truth: tuple[TruthRow, ...]
    provenance: Mapping[str, str]
    remarks: tuple[Message, ...]
    common: tuple[str, ...] = ()
    law_choices: tuple[LawChoice, ...] = ()
    left_out: LeftOutView | None = None
    comparison: tuple[ComparisonRow, ...] = ()
    comparison_sentence: str = ""
    judgements: tuple[Judgement, ...] = ()
    warnings: tuple[Finding, ...] = ()
    metric: bool = False
    systems: tuple[System, System] = SYSTEMS
    tested: tuple[Span, ...] = ()
    next_test: Advice | None = None
    drifts: tuple[DriftRow, ...] = ()
