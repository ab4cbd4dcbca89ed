"""What a report shows, as plain frozen data: computed in `assessment`, drawn in `reporting`."""

from mfd_bayes.evaluation.views.campaign import CampaignView, LeftOutRow, LeftOutView, TruthRow
from mfd_bayes.evaluation.views.check import (
    CONTRACTION,
    COVERAGE,
    DIRECTIONS,
    FREE_EXPONENT,
    IDENTIFIABILITY,
    LIKELIHOOD_SENSITIVITY,
    NOISE,
    PREDICTIVE,
    PRIOR_SENSITIVITY,
    READING,
    TRADE_OFFS,
    Check,
)
from mfd_bayes.evaluation.views.judgement import Judgement
from mfd_bayes.evaluation.views.law import LawChoice, LawScoreRow, LawView
from mfd_bayes.evaluation.views.test import (
    Array,
    DerivedRow,
    Fan,
    Interval,
    Marginal,
    NoiseRow,
    ReadingRow,
    Row,
    ScoreRow,
    TestView,
)

__all__ = [
    "CONTRACTION",
    "COVERAGE",
    "DIRECTIONS",
    "FREE_EXPONENT",
    "IDENTIFIABILITY",
    "LIKELIHOOD_SENSITIVITY",
    "NOISE",
    "PREDICTIVE",
    "PRIOR_SENSITIVITY",
    "READING",
    "TRADE_OFFS",
    "Array",
    "CampaignView",
    "Check",
    "DerivedRow",
    "Fan",
    "Interval",
    "Judgement",
    "LawChoice",
    "LawScoreRow",
    "LawView",
    "LeftOutRow",
    "LeftOutView",
    "Marginal",
    "NoiseRow",
    "ReadingRow",
    "Row",
    "ScoreRow",
    "TestView",
    "TruthRow",
]
