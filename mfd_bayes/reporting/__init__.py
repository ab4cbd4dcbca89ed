"""Figures, tables and pages of a report, from the views of `assessment`."""
