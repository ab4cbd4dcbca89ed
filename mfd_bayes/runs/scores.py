"""Scores of predictions and the comparison of models, as a run stores them.

`evaluation` computes them from a run. They stand here because the manifest holds them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from mfd_bayes.errors import StoreError
from mfd_bayes.store.files import read_json
from mfd_bayes.store.schema import AtLeastOne, Figure, Index, Part, Three, check

PartKind = Literal["test", "level", "session"]
"""What is left out of a campaign at a time."""


@dataclass(frozen=True)
class Score:
    """How well the draws of a predicted force met the force of one record."""

    coverage: Three
    """Share of samples inside the equal-tailed bands of `COVERAGES`."""
    width: Figure
    """Mean width of the 95 % band, kip."""
    interval_score: Figure
    """Mean interval score of the 95 % band, kip (Gneiting and Raftery, 2007): its width, and 40
    times how far the force lies outside."""
    crps: Figure
    """Mean continuous ranked probability score, kip."""
    rrse: Figure
    """Root relative squared error of the median."""


@dataclass(frozen=True)
class Prediction:
    """How a test was predicted from a campaign without its part."""

    part: str
    test: str
    score: Score
    """Of bands of kind "observation"."""
    fitted: Score
    """Of the test's own posterior."""
    whole: bool | None = None
    """Whether the whole force is inside the 95 % band of whole histories."""


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
    log_evidence, log_evidence_se, evidence_k : float
        Log of likelihood times prior, integrated (the sum over tests); its standard error, and the
        Pareto k of its importance weights.
    evidence_trusted : bool
        Whether these two are small enough.
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
    log_evidence: Figure
    log_evidence_se: Figure
    evidence_k: Figure
    evidence_trusted: bool


@dataclass(frozen=True)
class Comparison:
    """Models of one campaign, compared: rows of every test, then of all; best model first.

    The sentence says which model the records favour, and whether its check figures speak
    against it.
    """

    rows: tuple[ComparisonRow, ...]
    sentence: str


class _StoredPredictions(Part):
    key: dict[str, Any]
    predictions: AtLeastOne[Prediction]


def read_predictions_of(path: Path, tests: Iterable[str]) -> tuple[Prediction, ...]:
    """Stored predictions of the tests of a part that was left out; StoreError where it is none."""
    predictions = check(_StoredPredictions, read_json(path), path).predictions
    stored = [prediction.test for prediction in predictions]
    if stored != list(tests):
        raise StoreError(f"{path} holds predictions of {', '.join(stored)[:200]}, not of its part")
    return predictions
