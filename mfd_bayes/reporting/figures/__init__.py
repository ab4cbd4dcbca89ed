"""Every figure. Only these files import matplotlib and corner, so import them late."""

from mfd_bayes.reporting.figures.loops import draw_history, draw_inspection, draw_loops, to_png
from mfd_bayes.reporting.figures.report import (
    OF_TEST,
    draw_batch,
    draw_next,
    draw_shared,
    draw_test,
)

__all__ = [
    "OF_TEST",
    "draw_batch",
    "draw_history",
    "draw_inspection",
    "draw_loops",
    "draw_next",
    "draw_shared",
    "draw_test",
    "to_png",
]
