"""From a folder of test files to a first campaign file."""

from mfd_bayes.initiation.draft import Draft, draft_campaign
from mfd_bayes.initiation.writing import campaign_text, doubts, gaps

__all__ = ["Draft", "campaign_text", "doubts", "draft_campaign", "gaps"]
