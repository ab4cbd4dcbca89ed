"""A first campaign file for a folder of test files."""

from mfd_bayes.campaign.draft.draft import Draft, draft_campaign
from mfd_bayes.campaign.draft.text import campaign_text, doubts, gaps, lacks_priors, own_priors

__all__ = [
    "Draft",
    "campaign_text",
    "doubts",
    "draft_campaign",
    "gaps",
    "lacks_priors",
    "own_priors",
]
