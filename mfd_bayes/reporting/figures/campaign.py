"""All figures of a report."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from types import MappingProxyType

from matplotlib.figure import Figure

from mfd_bayes.evaluation.views import CampaignView, Fan, TestView
from mfd_bayes.reporting.conversion import convert_test, in_system, shown_in
from mfd_bayes.reporting.figures.laws import draw_laws
from mfd_bayes.reporting.figures.loops import Marks, draw_history, draw_loops, draw_overview
from mfd_bayes.reporting.figures.next_test import draw_next
from mfd_bayes.reporting.figures.panels import Sheets
from mfd_bayes.reporting.figures.posteriors import (
    draw_chains,
    draw_corner,
    draw_marginals,
    draw_truth,
)
from mfd_bayes.reporting.figures.residuals import draw_residuals
from mfd_bayes.reporting.figures.style import to_png
from mfd_bayes.reporting.figures.tested import draw_tested
from mfd_bayes.runs.unit_system import System

_FIGURES_HELD = 8
_SHEETS = Sheets()  # of this process: each figure is a PNG before the next is drawn


def draw_shared(view: CampaignView) -> Iterator[tuple[str, bytes]]:
    """PNGs of the figures that show all tests together, one at a time, each with its key.

    Keys are "overview", "tested", "next", "laws" and "truth"; what has nothing to show is left out.
    """
    return _pngs(shared_figures(view))


def draw_test(test: TestView, system: System, actuation_unit: str) -> Iterator[tuple[str, bytes]]:
    """PNGs of the figures of one test, one at a time, each with its key.

    Keys are "tests/ID/" and one of `OF_TEST`; a figure with nothing to show is left out. The
    test and `actuation_unit` are in internal units, the figures in those of `system`.
    """
    return _pngs(figures_of_test(convert_test(test, system, actuation_unit), system, _SHEETS))


def shared_figures(view: CampaignView) -> Iterator[tuple[str, Figure]]:
    """Figures that show all tests together, each with its key."""
    system = shown_in(view)
    if view.tests:
        shown = in_system(view, system).tests
        yield "overview", draw_overview("Measured loops over 50 and 95 % bands", shown, system)
        del shown
    tested = draw_tested(view, system)
    if tested is not None:
        yield "tested", tested
    if view.next_test is not None:
        yield "next", draw_next(view.next_test, system, view.actuation_unit, "Which test next")
    view = in_system(replace(view, tests=()), system)
    drawn = {
        "laws": draw_laws(
            "How the parameters follow the actuation", view.laws, view.actuation_unit
        ),
        "truth": draw_truth("Posterior against the known truth", view.truth),
    }
    yield from ((key, figure) for key, figure in drawn.items() if figure is not None)


def _pngs(drawn: Iterable[tuple[str, Figure]]) -> Iterator[tuple[str, bytes]]:
    with _collecting_rarely():
        for number, (key, figure) in enumerate(drawn, start=1):
            yield key, to_png(figure)
            if number % _FIGURES_HELD == 0:
                gc.collect()
        gc.collect()


@contextmanager
def _collecting_rarely() -> Iterator[None]:
    """Switch automatic garbage collection off, and leave out what is there already.

    Matplotlib's many small objects trigger it so often that it takes a quarter of the time.
    """
    enabled = gc.isenabled()
    gc.disable()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        if enabled:
            gc.enable()


def figures_of_test(
    test: TestView, system: System, sheets: Sheets | None = None
) -> Iterator[tuple[str, Figure]]:
    """Figures of one test in the units of a system, each with its key; new ones without sheets."""
    for name, draw in OF_TEST.items():
        with sheets.in_use() if sheets else nullcontext():
            figure = draw(test, system)
        if figure is not None:
            yield f"tests/{test.id}/{name}", figure


def _title(test: TestView) -> str:
    return f"{test.id}, {test.actuation}"


def _fans(test: TestView) -> list[Fan]:
    return [fan for fan in (test.observation, test.device) if fan is not None]


def _loops(test: TestView, system: System) -> Figure:
    return draw_loops(_title(test), test.trace, _fans(test), system)


def _history(test: TestView, system: System) -> Figure:
    return draw_history(_title(test), test.trace, _fans(test), system, Marks(test.first))


def _residuals(test: TestView, system: System) -> Figure | None:
    if test.role == "validate":
        return None
    return draw_residuals(f"{_title(test)}: residuals of the fit", test, system)


def _corner(test: TestView, system: System) -> Figure | None:
    return draw_corner(f"{_title(test)}: joint posterior", test.marginals, test.corner)


def _chains(test: TestView, system: System) -> Figure | None:
    if not test.chains:
        return None
    units = {row.name: row.unit for row in test.rows}
    units |= {marginal.name: marginal.unit for marginal in test.marginals}
    return draw_chains(f"{_title(test)}: chains", test.chains, units)


def _marginals(test: TestView, system: System) -> Figure | None:
    if not test.marginals:
        return None
    return draw_marginals(f"{_title(test)}: priors and posteriors", test.marginals)


OF_TEST: Mapping[str, Callable[[TestView, System], Figure | None]] = MappingProxyType(
    {
        "loops": _loops,
        "history": _history,
        "residuals": _residuals,
        "corner": _corner,
        "trace": _chains,
        "marginals": _marginals,
    }
)
"""Figures of a test by the names of their files; one with nothing to show is None."""
