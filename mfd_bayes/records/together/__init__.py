"""Tests compared with each other: duplicates, signs, units, and laws of what a loop shows."""

from mfd_bayes.records.together.compared import compare_tests
from mfd_bayes.records.together.tested import Tested

__all__ = ["Tested", "compare_tests"]
