"""Every figure. Only these files import matplotlib and corner, so import them late."""

from mfd_bayes.reporting.figures.campaign import OF_TEST, draw_shared, draw_test
from mfd_bayes.reporting.figures.inspection import draw_inspection
from mfd_bayes.reporting.figures.laws import draw_laws
from mfd_bayes.reporting.figures.loops import draw_history, draw_loops, draw_overview
from mfd_bayes.reporting.figures.posteriors import (
    draw_chains,
    draw_corner,
    draw_marginals,
    draw_truth,
)
from mfd_bayes.reporting.figures.residuals import draw_residuals
from mfd_bayes.reporting.figures.style import to_png

__all__ = [
    "OF_TEST",
    "draw_chains",
    "draw_corner",
    "draw_history",
    "draw_inspection",
    "draw_laws",
    "draw_loops",
    "draw_marginals",
    "draw_overview",
    "draw_residuals",
    "draw_shared",
    "draw_test",
    "draw_truth",
    "to_png",
]
