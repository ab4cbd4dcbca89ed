"""What a report shows, as plain data: it is computed elsewhere, and only drawn here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mfd_bayes.calibration.identifiability import Identifiability
from mfd_bayes.records.trace import Trace

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
    verdict : {"pass", "fail", "note"}
    """

    subject: str
    name: str
    target: str
    value: float
    limit: str
    verdict: str


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
    """How a record's observation bands met its force; width and CRPS in kip."""

    subject: str
    role: str
    coverage_50: float
    coverage_90: float
    coverage_95: float
    width_95: float
    crps: float
    rrse: float


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


@dataclass(frozen=True, eq=False)
class LawView:
    """A quantity against actuation: the law's median with its bands, and the tests.

    Attributes
    ----------
    name, unit, law : str
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
    verdict : {"pass", "fail"}
    sentence : str
        The verdict with its reason.
    actuation_unit : {"ksi", "kip"}
    tests : tuple of TestView
    failures : mapping of str to str
        Tests without a posterior, and why.
    laws : tuple of LawView
    law_rows : tuple of Row
        Table II: slopes, intercepts, shapes, and the scatter of each group.
    checks : tuple of Check
    scores : tuple of ScoreRow
    truth : tuple of TruthRow
        Empty for real tests.
    provenance : mapping of str to str
    remarks : tuple of str
        What a reader must know, in sentences.
    """

    title: str
    verdict: str
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
