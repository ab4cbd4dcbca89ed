"""Every figure. Only these files import matplotlib and corner, so import them late."""

from mfd_bayes.reporting.figures.loops import (
    OF_TEST,
    draw_batch,
    draw_history,
    draw_inspection,
    draw_loops,
    draw_next,
    draw_shared,
    draw_test,
    to_png,
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
