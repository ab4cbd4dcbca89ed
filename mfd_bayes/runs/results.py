"""What a run keeps of its validation: scores of predictions, and the comparison of models.

These stand here and not in `validation`, which computes them from a run: the run's manifest stores
them, and a run may not know what is computed from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mfd_bayes.store.schema import AtLeastOne, Figure, Index, Three

PartKind = Literal["test", "level", "session"]
"""What is left out of a campaign at a time."""


@dataclass(frozen=True)
class Score:
    """How well the draws of a predicted force met the force of one record.

    Attributes
    ----------
    coverage : tuple of three floats
        Share of samples inside the equal-tailed bands of `COVERAGES`.
    width : float, kip
        Mean width of the 95 % band.
    interval_score : float, kip
        Mean interval score of the 95 % band (Gneiting and Raftery, 2007): its width, and 40
        times how far the force lies outside.
    crps : float, kip
        Mean continuous ranked probability score.
    rrse : float
        Root relative squared error of the median.
    """

    coverage: Three
    width: Figure
    interval_score: Figure
    crps: Figure
    rrse: Figure


@dataclass(frozen=True)
class Prediction:
    """How a test was predicted from a campaign without its part.

    Attributes
    ----------
    part, test : str
    score : Score
        Of bands of kind "observation".
    fitted : Score
        Of the test's own posterior.
    whole : bool or None
        Whether the whole force is inside the 95 % band of whole histories; None where an earlier
        version left it out.
    """

    part: str
    test: str
    score: Score
    fitted: Score
    whole: bool | None = None


@dataclass(frozen=True)
class CampaignCrossValidation:
    """Predictions of every test of a campaign, each from the parts that the test is not in."""

    by: PartKind
    predictions: AtLeastOne[Prediction]


@dataclass(frozen=True)
class ComparisonRow:
    """How well a model predicts the cycles of a test, or of all tests, that it has not seen.

    Attributes
    ----------
    subject, model : str
    cycles : int
    elpd, elpd_se : float
        Expected log predictive density of all cycles, and its standard error: over tests where
        there are several, over cycles of one.
    p_loo : float
        Effective number of parameters.
    worst_k, bad : float
        Largest Pareto k of PSIS, and the share of cycles in which it is too large for it.
    unsettled : float
        Share of cycles in which k is too large also after they were computed anew.
    difference, difference_se : float
        Elpd less that of the best model, and its standard error, paired over cycles.
    rrse : float
        Root relative squared error of the posterior median, of the record that it has seen.
    """

    subject: str
    model: str
    cycles: Index
    elpd: Figure
    elpd_se: Figure
    p_loo: Figure
    worst_k: Figure
    bad: Figure
    unsettled: Figure
    difference: Figure
    difference_se: Figure
    rrse: Figure


@dataclass(frozen=True)
class Comparison:
    """Models of one campaign, compared.

    Attributes
    ----------
    rows : tuple of ComparisonRow
        Of every test, then of all; best model first.
    sentence : str
        Which model the records favour, and whether its check figures speak against it.
    """

    rows: tuple[ComparisonRow, ...]
    sentence: str
