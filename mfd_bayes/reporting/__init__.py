"""Figures, tables and the page; draws what it is given."""
