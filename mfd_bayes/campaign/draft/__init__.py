"""A first campaign file for a folder of test files."""

from mfd_bayes.campaign.draft.draft import Draft, draft_campaign
from mfd_bayes.campaign.draft.writing import (
    OWN_PRIORS,
    campaign_text,
    doubts,
    gaps,
    own_priors,
)

__all__ = [
    "OWN_PRIORS",
    "Draft",
    "campaign_text",
    "doubts",
    "draft_campaign",
    "gaps",
    "own_priors",
]
