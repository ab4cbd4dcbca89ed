"""What a report shows, as plain data: it is computed elsewhere, and only drawn here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.identifiability import Identifiability
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.verdict import Verdict
from mfd_bayes.validation.models import ComparisonRow

Array = NDArray[np.float64]


STANDING = "exponent if the law were a power law"
"""Name of the check that a proportional law is not contradicted; it has a section of its own."""

CONTRACTION = "prior variance removed"
PRIOR_SENSITIVITY = "sensitivity to the prior"
LIKELIHOOD_SENSITIVITY = "sensitivity to the likelihood"
DIRECTIONS = "directions informed"
TRADE_OFFS = "rank correlation of two parameters"
IDENTIFIABILITY = (CONTRACTION, PRIOR_SENSITIVITY, LIKELIHOOD_SENSITIVITY, DIRECTIONS, TRADE_OFFS)
"""Names of the checks that say what the data tell; they note, and never fail."""


@dataclass(frozen=True)
class Check:
    """One check: what was found, what it may be, and the verdict.

    Attributes
    ----------
    subject : str
        A test's id, or "population".
    name : str
        Such as "R-hat" or "posterior predictive p-value".
    target : str
        The parameter or test statistic.
    value : float
    limit : str
        Such as "<= 1.01".
    verdict : Verdict
    """

    subject: str
    name: str
    target: str
    value: float
    limit: str
    verdict: Verdict


@dataclass(frozen=True)
class Row:
    """A quantity's posterior: mean, sd and equal-tailed quantiles, in `unit`.

    `contraction` is the share of the prior's variance that the data removed; `note` says
    what a reader must know, such as that the data do not inform the parameter.
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


@dataclass(frozen=True)
class DerivedRow:
    """A derived quantity: draws of the damper's force, without offset and noise, in `unit`.

    `role` is that of the test, or the kind of a prediction.
    `lower` and `upper` bound an equal-tailed interval; `measured` is what the record says of
    it, NaN where it says nothing. `note` says over how many full cycles it is; where there
    is none, all figures are NaN.
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


@dataclass(frozen=True, eq=False)
class Interval:
    """Equal-tailed band of one probability, (T,) each, kip."""

    probability: float
    lower: Array
    upper: Array


@dataclass(frozen=True, eq=False)
class Fan:
    """A median and nested bands of one kind, widest last.

    Attributes
    ----------
    kind : {"device", "new_test", "observation", "prior"}
    median : (T,), kip
    intervals : tuple of Interval
    """

    kind: str
    median: Array
    intervals: tuple[Interval, ...]


@dataclass(frozen=True)
class ScoreRow:
    """How a record's observation bands met its force; width and scores in kip."""

    subject: str
    role: str
    coverage_50: float
    coverage_90: float
    coverage_95: float
    width_95: float
    interval_score: float
    crps: float
    rrse: float


@dataclass(frozen=True)
class LeftOutRow:
    """How a test was predicted without its part of the campaign; width and scores in kip.

    Attributes
    ----------
    part, subject : str
    coverage_50, coverage_90, coverage_95, width_95, interval_score, crps, rrse : float
    fitted_width, fitted_crps : float, kip
        Of the same test's own posterior, which has seen its force.
    width_ratio, crps_ratio : float
        What is predicted over what is fitted.
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


@dataclass(frozen=True)
class LeftOutView:
    """A campaign cross-validated: every part in turn predicted from all the others.

    Attributes
    ----------
    by : {"test", "level", "session"}
    rows : tuple of LeftOutRow
    mean : LeftOutRow
        Of each column over the tests.
    sentence : str
        What that comes to.
    """

    by: str
    rows: tuple[LeftOutRow, ...]
    mean: LeftOutRow
    sentence: str


@dataclass(frozen=True, eq=False)
class Marginal:
    """A quantity's prior and posterior draws, in its unit.

    Attributes
    ----------
    name, unit : str
    prior : (m,)
    posterior : (n,)
    contraction : float
    """

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
    id : str
    role : {"calibrate", "validate"}
    actuation : str
        With its unit.
    trace : Trace
        With its force.
    first : int
        Samples before this one were left out of the fit.
    device : Fan or None
        Model and offset, without noise; None where the test was predicted.
    observation : Fan
    rows : tuple of Row
    marginals : tuple of Marginal
    chains : mapping of str to (chain, draw)
        Of the sampled quantities, for trace plots; a draw is the mean over walkers at a step.
    corner : tuple of str
        Quantities that the data inform, in the order of the corner plot.
    checks : tuple of Check
    score : ScoreRow
    identifiability : Identifiability or None
        What the data tell about the sampled quantities; None where the test was predicted.
    derived : tuple of DerivedRow
        With 95 % intervals.
    stage : (T,) int or None
        Stage that the posterior medians are in at each sample: 1 slip, 2 stick, 3 build-up;
        None where the test was predicted or the model has no gap.
    travel : (T,), in, or None
        Travel in the gap since the last slip, of the same.
    """

    __test__ = False

    id: str
    role: str
    actuation: str
    trace: Trace
    first: int
    device: Fan | None
    observation: Fan
    rows: tuple[Row, ...]
    marginals: tuple[Marginal, ...]
    chains: Mapping[str, Array]
    corner: tuple[str, ...]
    checks: tuple[Check, ...]
    score: ScoreRow
    identifiability: Identifiability | None = None
    derived: tuple[DerivedRow, ...] = ()
    stage: NDArray[np.int8] | None = None
    travel: Array | None = None


@dataclass(frozen=True, eq=False)
class LawView:
    """A quantity against actuation: the law's median with its bands, and the tests.

    Attributes
    ----------
    name, unit : str
    law : str
        Its name, or the weights of those that were compared.
    actuation : (m,), ksi or kip
    median : Fan
        Uncertainty of the median over tests.
    new_test : Fan
        With test-to-test scatter.
    tested : tuple of (str, float, float, float, float)
        Id, actuation, and the posterior's 2.5 %, 50 % and 97.5 % quantiles of each test.
    """

    name: str
    unit: str
    law: str
    actuation: Array
    median: Fan
    new_test: Fan
    tested: tuple[tuple[str, float, float, float, float], ...]


@dataclass(frozen=True)
class LawScoreRow:
    """How one law predicts a quantity at levels that were left out.

    Attributes
    ----------
    quantity, law : str
    chosen : bool
        Whether it is the campaign's law.
    elpd, elpd_se : float
        Log predictive density of all levels, and its standard error over them.
    difference, difference_se : float
        Elpd less that of the best law, and its standard error, paired over levels.
    weight : float
        Stacking weight among the laws.
    """

    quantity: str
    law: str
    chosen: bool
    elpd: float
    elpd_se: float
    difference: float
    difference_se: float
    weight: float


@dataclass(frozen=True)
class LawChoice:
    """The laws of one quantity, best first, and which of them predicts best in a sentence."""

    quantity: str
    rows: tuple[LawScoreRow, ...]
    sentence: str


@dataclass(frozen=True)
class TruthRow:
    """A synthetic truth beside its posterior."""

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
    title : str
    verdict : Verdict
        FAIL where a check failed, else PASS.
    sentence : str
        The verdict with its reason.
    actuation_unit : {"ksi", "kip"}
    tests : tuple of TestView
    failures : mapping of str to str
        Tests without a posterior, and why.
    laws : tuple of LawView
    law_rows : tuple of Row
        Table II: slopes, intercepts, shapes, and the scatter of each quantity.
    checks : tuple of Check
    scores : tuple of ScoreRow
    truth : tuple of TruthRow
        Empty for real tests.
    provenance : mapping of str to str
    remarks : tuple of str
        What a reader must know, in sentences.
    law_choices : tuple of LawChoice
        Of each quantity that follows the actuation; empty where levels are too few.
    left_out : LeftOutView or None
        None where the campaign was not cross-validated.
    comparison : tuple of ComparisonRow
        Models that were compared on this campaign, and `comparison_sentence`, what came of it;
        empty where none were.
    metric : bool
        Whether the campaign's records are in metric units, and its report so too.
    """

    title: str
    verdict: Verdict
    sentence: str
    actuation_unit: str
    tests: tuple[TestView, ...]
    failures: Mapping[str, str]
    laws: tuple[LawView, ...]
    law_rows: tuple[Row, ...]
    checks: tuple[Check, ...]
    scores: tuple[ScoreRow, ...]
    truth: tuple[TruthRow, ...]
    provenance: Mapping[str, str]
    remarks: tuple[str, ...]
    law_choices: tuple[LawChoice, ...] = ()
    left_out: LeftOutView | None = None
    comparison: tuple[ComparisonRow, ...] = ()
    comparison_sentence: str = ""
    metric: bool = False
