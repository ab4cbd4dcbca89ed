"""A first campaign file for a folder of test files."""

from mfd_bayes.campaign.draft.draft import (
    Draft,
    campaign_text,
    doubts,
    draft_campaign,
    gaps,
    lacks_priors,
    own_priors,
)

__all__ = [
    "Draft",
    "campaign_text",
    "doubts",
    "draft_campaign",
    "gaps",
    "lacks_priors",
    "own_priors",
]
