"""What a report shows, in internal units: computed here, drawn and written in `reporting`.

Tables are records, one dict for each row, all with the same keys. The keys that several tables
have: `test`, `name` and `unit` of a quantity; `mean`, `sd`, and `lower`, `median` and `upper`, its
2.5 %, 50 % and 97.5 % quantile; `note`, what a reader must know of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.diagnostics import Identifiability
from mfd_bayes.friction.model import Model
from mfd_bayes.messages import Message, Quantity, Writer
from mfd_bayes.planning.study import Advice
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.manifest import Comparison, Finding, Use, Verdict
from mfd_bayes.runs.tested_range import Span
from mfd_bayes.runs.unit_system import SYSTEMS, System

if TYPE_CHECKING:
    from mfd_bayes.evaluation.laws import DriftRow

Array = NDArray[np.float64]
Row = dict[str, Any]
Rows = tuple[Row, ...]

FREE_EXPONENT = "exponent if the law were a power law"
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

_LIMITS = {
    **dict.fromkeys(("bulk ESS", "tail ESS", LENGTH, CONTRACTION, DIRECTIONS), ">= {:g}"),
    "R-hat": "<= {:g}",
    FREE_EXPONENT: "interval holds {:g}",
    MODES: "{:g}",
}


@dataclass(frozen=True)
class Check:
    """One comparison of a value with what is expected of it.

    Attributes
    ----------
    test : str
        A test's id, or "population".
    check, feature : str
        Such as "R-hat" of the parameter, or "posterior predictive" of the feature of a record.
    observed, expected : float, in `unit`
        `expected` is the limit of a diagnostic, or the value of the model.
    difference : float
        Expected less observed, as a share of what is measured.
    tolerance : float
        The difference up to which nobody minds; NaN where there is none.
    p_value : float
        Posterior predictive; NaN where there is none.
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
            return Message("{feature} {observed} where {expected} is expected", values)
        return Message(f"{self.check} of {{feature}}: {{observed}} ({self.limit})", values)


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

    Attributes
    ----------
    role : {"calibrate", "validate"}
    trace : Trace
        With its force.
    first : int
        First sample that was fitted.
    device : Fan or None
        Of this very test, without noise.
    score : record
        Coverage of the 50, 90 and 95 % bands; width, interval score and CRPS, kip; RRSE.
    rows : records
        Posterior of each quantity, with R-hat, ESS, contraction and its joint posterior with all
        tests.
    chains : int
        Number of chains.
    corner : tuple of str
        Quantities of the corner plot, in its order: those that the data inform.
    derived : records
        Properties, with those of the record as recorded; `missed`: outside, extreme, and farther
        from the median than the tolerance.
    loop_estimates : records
        What a plain rule reads off the loop, beside what it reads off replicated records.
    noises : records
        Every quantity under other noises; `decides`: the choice of the noise decides the value.
    modes : tuple of mapping
        Median of each quantity, and "share" of the draws, of each mode where there are several.
    stage, travel : (T,) or None
        Stage at each sample for the posterior medians (1 slip, 2 stick, 3 build-up, 4 gap), and
        the travel in the gap since the last slip, in; None where the model has no gap.
    shares : mapping of str to float
        What makes the band of a predicted test wide: share of each source in the variance.
    begun : str
        In words, where in its gap a predicted test begins; "" where that is unknown.
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
    """A quantity against actuation: its law with bands, and the tests' own posteriors.

    Attributes
    ----------
    law : str
        The law's name, or the weights of several laws.
    actuation : (m,), ksi or kip
    device, new_test : Fan
        Of the mean property, by law and level effect without scatter from test to test; and of one
        more test, with it.
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
class LeftOutView:
    """Cross-validation of a campaign: each part predicted from all the others.

    `rows` are the scores of each test, beside those of its own fit, and `mean` is the mean of each.
    """

    by: str
    rows: Rows
    mean: Row
    sentence: str


@dataclass(frozen=True, eq=False)
class CampaignView:
    """The whole report.

    Attributes
    ----------
    verdict : Use
        What the run may be used for.
    sentences : tuple of Message
        The verdict with its reasons, the worst first.
    failures : mapping of str to str
        Tests without a result, and why.
    law_rows : records
        Constants of the laws, their shapes, and the scatter of each quantity.
    common : tuple of str
        Quantities that have one value for all tests.
    truth : records
        True value of each quantity of a synthetic test, `inside` its interval, `informed` by data.
    remarks : tuple of Message
        What a reader must know besides.
    law_scores : records
        How well each law predicts levels that were left out, by quantity, the best first.
    law_choices : mapping of str to str
        Which law predicts each quantity best, in a sentence.
    judgements : tuple of Judgement
        What each calibrated test may be used for, the one to believe least first.
    metric : bool
        Which of both `systems` of units the report begins with.
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
