"""One check with its verdict, and the names of the checks that reports treat apart."""

from __future__ import annotations

from dataclasses import dataclass

from mfd_bayes.runs.verdict import Verdict

FREE_EXPONENT = "exponent if the law were a power law"
"""Name of the check that the tests do not contradict a proportional law."""

CONTRACTION = "prior variance removed"
PRIOR_SENSITIVITY = "sensitivity to the prior"
LIKELIHOOD_SENSITIVITY = "sensitivity to the likelihood"
DIRECTIONS = "directions informed"
TRADE_OFFS = "rank correlation of two parameters"
PREDICTIVE = "posterior predictive p-value"
READING = "reading off the loop"
NOISE = "noise model"
COVERAGE = "share of samples inside a band"
IDENTIFIABILITY = (CONTRACTION, PRIOR_SENSITIVITY, LIKELIHOOD_SENSITIVITY, DIRECTIONS, TRADE_OFFS)
"""Names of the checks of what the data inform; beyond its limit such a check is a note."""


@dataclass(frozen=True)
class Check:
    """One value with its limit and its verdict.

    Attributes
    ----------
    subject : str
        A test's id, or "population".
    name : str
        Such as "R-hat" or "posterior predictive p-value".
    target : str
        The parameter, or the feature of the record, that is checked.
    limit : str
        Such as "<= 1.01".
    size : float
        By how much the model misses the figure, as a share; NaN where it is not said.
    tolerance : float
        The size up to which nobody minds; NaN where there is none.
    unit : str
        Unit of the value, where it is a measured quantity.
    """

    subject: str
    name: str
    target: str
    value: float
    limit: str
    verdict: Verdict
    size: float = float("nan")
    tolerance: float = float("nan")
    unit: str = ""
