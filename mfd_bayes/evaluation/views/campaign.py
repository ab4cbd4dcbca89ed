"""The whole report of a campaign."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mfd_bayes.evaluation.views.check import Check
from mfd_bayes.evaluation.views.judgement import Judgement
from mfd_bayes.evaluation.views.law import LawChoice, LawView
from mfd_bayes.evaluation.views.test import Row, ScoreRow, TestView
from mfd_bayes.planning.study import Advice
from mfd_bayes.runs.scores import ComparisonRow
from mfd_bayes.runs.tested_range import Span
from mfd_bayes.runs.unit_system import SYSTEMS, System
from mfd_bayes.runs.verdict import Finding, Use


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
    sentence : str
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
    remarks : tuple of str
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
    """

    title: str
    verdict: Use
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
