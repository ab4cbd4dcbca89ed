"""What a report shows, as plain frozen data: computed in `assessment`, drawn in `reporting`."""

from mfd_bayes.assessment.views.campaign import CampaignView, LeftOutRow, LeftOutView, TruthRow
from mfd_bayes.assessment.views.check import (
    CONTRACTION,
    DIRECTIONS,
    FREE_EXPONENT,
    IDENTIFIABILITY,
    LIKELIHOOD_SENSITIVITY,
    PRIOR_SENSITIVITY,
    TRADE_OFFS,
    Check,
)
from mfd_bayes.assessment.views.law import LawChoice, LawScoreRow, LawView
from mfd_bayes.assessment.views.test import (
    Array,
    DerivedRow,
    Fan,
    Interval,
    Marginal,
    Row,
    ScoreRow,
    TestView,
)

__all__ = [
    "CONTRACTION",
    "DIRECTIONS",
    "FREE_EXPONENT",
    "IDENTIFIABILITY",
    "LIKELIHOOD_SENSITIVITY",
    "PRIOR_SENSITIVITY",
    "TRADE_OFFS",
    "Array",
    "CampaignView",
    "Check",
    "DerivedRow",
    "Fan",
    "Interval",
    "LawChoice",
    "LawScoreRow",
    "LawView",
    "LeftOutRow",
    "LeftOutView",
    "Marginal",
    "Row",
    "ScoreRow",
    "TestView",
    "TruthRow",
]
