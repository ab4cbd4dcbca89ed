"""Scores, checks, tables, the data sheet and the verdict of a finished run."""

from mfd_bayes.evaluation.summary import assess, fails, is_whole, verdicts

__all__ = ["assess", "fails", "is_whole", "verdicts"]
