"""From a finished run to what its report shows: bands, checks, tables and the verdict."""

from mfd_bayes.assessment.campaign import assess, fails

__all__ = ["assess", "fails"]
