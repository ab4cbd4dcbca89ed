"""Scores, checks, tables, the data sheet and the verdict of a finished run."""
