"""Bands, checks, tables and the verdict of a finished run."""

from mfd_bayes.evaluation.shown import is_whole
from mfd_bayes.evaluation.verdict import assess, fails, verdicts

__all__ = ["assess", "fails", "is_whole", "verdicts"]
