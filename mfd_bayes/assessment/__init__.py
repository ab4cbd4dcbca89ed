"""From a finished run to what its report shows: bands, checks, tables and the verdict."""

from mfd_bayes.assessment.verdict import assess, fails, verdicts

__all__ = ["assess", "fails", "verdicts"]
