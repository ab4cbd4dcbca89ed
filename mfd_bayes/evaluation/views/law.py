"""A quantity against actuation, and how well each law predicts it."""

from __future__ import annotations

from dataclasses import dataclass

from mfd_bayes.evaluation.views.test import Array, Fan


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
