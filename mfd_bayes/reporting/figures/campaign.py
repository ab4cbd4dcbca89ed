"""All figures of a report."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

from matplotlib.figure import Figure

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
from mfd_bayes.reporting.systems import SI, US, System, in_system
from mfd_bayes.reporting.views import CampaignView, Fan, TestView

_FIGURES_HELD = 8


def draw_all(view: CampaignView) -> dict[str, bytes]:
    """PNG of every figure, by the key that the page knows it under.

    Keys are "overview", "laws", "truth", and "tests/ID/loops", "…/history", "…/residuals",
    "…/corner", "…/trace", "…/marginals"; a figure with nothing to show is left out.
    """
    pictures: dict[str, bytes] = {}
    with _collecting_rarely():
        for key, figure in figures(view):
            pictures[key] = to_png(figure)
            if len(pictures) % _FIGURES_HELD == 0:
                gc.collect()
    return pictures


def figures(view: CampaignView) -> Iterator[tuple[str, Figure]]:
    """Every figure with its key, one at a time so that they need not all be held."""
    system = SI if view.metric else US
    view = in_system(view, system)
    if view.tests:
        yield "overview", draw_overview("Measured loops over 50 and 95 % bands", view.tests, system)
    drawn = {
        "laws": draw_laws(
            "How the parameters follow the actuation", view.laws, view.actuation_unit
        ),
        "truth": draw_truth("Posterior against the known truth", view.truth),
    }
    yield from ((key, figure) for key, figure in drawn.items() if figure is not None)
    for test in view.tests:
        for name, figure in _of_test(test, system):
            yield f"tests/{test.id}/{name}", figure


@contextmanager
def _collecting_rarely() -> Iterator[None]:
    """No garbage collection on its own: matplotlib's many small objects set it off all the time.

    It would take a quarter of the time that the figures take.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _of_test(test: TestView, system: System) -> Iterator[tuple[str, Figure]]:
    title = f"{test.id}, {test.actuation}"
    fans: list[Fan] = [fan for fan in (test.observation, test.device) if fan is not None]
    yield "loops", draw_loops(title, test.trace, fans, system)
    yield "history", draw_history(title, test.trace, fans, test.first, system)
    if test.role != "validate":
        yield "residuals", draw_residuals(f"{title}: what the fit leaves over", test, system)
    corner = draw_corner(f"{title}: joint posterior", test.marginals, test.corner)
    if corner is not None:
        yield "corner", corner
    if test.chains:
        units = {row.name: row.unit for row in test.rows}
        units |= {marginal.name: marginal.unit for marginal in test.marginals}
        yield "trace", draw_chains(f"{title}: chains", test.chains, units)
    if test.marginals:
        yield "marginals", draw_marginals(f"{title}: priors and posteriors", test.marginals)
