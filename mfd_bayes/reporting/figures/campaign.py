"""The figures of a report, by their keys; and those that show all tests together."""

from __future__ import annotations

import gc
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from mfd_bayes.reporting import symbols as colours
from mfd_bayes.reporting.conversion import convert_law, convert_rows, convert_test
from mfd_bayes.reporting.figures import agg as look
from mfd_bayes.reporting.figures.loops import draw_history, draw_loops, draw_overview
from mfd_bayes.reporting.figures.posteriors import (
    draw_corner,
    draw_marginals,
    draw_ranks,
    draw_residuals,
    draw_truth,
)
from mfd_bayes.reporting.symbols import Symbols, plain
from mfd_bayes.units import percent

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mfd_bayes.evaluation.views import Array, CampaignView, LawView, TestView
    from mfd_bayes.friction.model import Model
    from mfd_bayes.planning.study import Advice
    from mfd_bayes.runs.unit_system import System

OF_TEST = ("loops", "history", "residuals", "marginals", "corner", "ranks")
"""Figures of a test by the names of their files; one with nothing to show is left out."""

_MEDIAN = "#4db894"


def draw_shared(view: CampaignView) -> Iterator[tuple[str, bytes]]:
    """PNGs of the figures that show all tests together, one at a time, each with its key.

    Keys are "overview", "laws", "truth" and "next"; what has nothing to show is left out.
    """
    return _pngs(shared_figures(view))


def draw_test(
    test: TestView, system: System, actuation_unit: str, model: Model | None = None
) -> Iterator[tuple[str, bytes]]:
    """PNGs of the figures of one test, one at a time, each with its key.

    Keys are "tests/ID/" and one of `OF_TEST`; a figure with nothing to show is left out. The
    test and `actuation_unit` are in internal units, the figures in those of `system`.
    """
    return _pngs(figures_of_test(test, system, actuation_unit, model))


def shared_figures(view: CampaignView) -> Iterator[tuple[str, Figure]]:
    """Figures that show all tests together, each with its key."""
    system, unit, symbols = view.system, view.actuation_unit, Symbols(view.model)
    if view.tests:
        tests = [convert_test(test, system, unit) for test in view.tests]
        title = "Measured loops over their bands"
        yield "overview", draw_overview(title, tests, system, unit, symbols)
    if view.laws:
        laws = [convert_law(law, system, unit) for law in view.laws]
        title = "Quantities against the actuation"
        yield "laws", draw_laws(title, laws, system.unit(unit), symbols)
    truth = convert_rows(view.truth, system)
    figure = draw_truth("Posterior against the known truth", truth, symbols)
    if figure is not None:
        yield "truth", figure
    if view.next_test is not None:
        yield "next", draw_next(view.next_test, system, unit, "Which test next")


def figures_of_test(
    test: TestView, system: System, actuation_unit: str, model: Model | None = None
) -> Iterator[tuple[str, Figure]]:
    """Figures of one test in the units of a system, each with its key."""
    t, names = convert_test(test, system, actuation_unit), Symbols(model)
    title, drawn = f"{t.id}, {t.actuation}", t.marginals
    motion = title, t.trace, [f for f in (t.observation, t.device) if f is not None], system, names
    figures: dict[str, Callable[[], Figure | None]] = {
        "loops": lambda: draw_loops(*motion),
        "history": lambda: draw_history(*motion, t.first),
        "residuals": lambda: draw_residuals(f"{title}: residuals", t, system, names),
        "marginals": lambda: draw_marginals(f"{title}: priors and posteriors", drawn, names),
        "corner": lambda: draw_corner(f"{title}: joint posterior", drawn, t.corner, names),
        "ranks": lambda: draw_ranks(f"{title}: ranks of each chain", drawn, t.chains, names),
    }
    for name in OF_TEST:
        figure = figures[name]()
        if figure is not None:
            yield f"tests/{test.id}/{name}", figure


def _pngs(drawn: Iterable[tuple[str, Figure]]) -> Iterator[tuple[str, bytes]]:
    """PNGs of figures; Matplotlib's many small objects would call the collector too often."""
    enabled = gc.isenabled()
    gc.disable()
    gc.freeze()
    try:
        for key, figure in drawn:
            yield key, look.to_png(figure)
            gc.collect()
    finally:
        gc.unfreeze()
        if enabled:
            gc.enable()


@look.style()
def draw_laws(title: str, laws: Sequence[LawView], actuation_unit: str, symbols: Symbols) -> Figure:
    """One panel per law: the mean property with its bands, and the tests' 95 % intervals."""
    columns = min(3, len(laws))
    rows = -(-len(laws) // columns)
    figure = look.new_figure(max(4.0 * columns, 5.5), 2.75 * rows + 0.8, title)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat[len(laws) :]:
        axes.set_visible(False)
    for axes, law in zip(grid.flat, laws, strict=False):
        _draw_law(axes, law, symbols)
        axes.set_xlabel(plain(f"actuation, {actuation_unit}"))
    handles, texts = grid.flat[0].get_legend_handles_labels()
    figure.legend(handles, texts, loc="outside lower left", ncols=4)
    return figure


def _draw_law(axes: Axes, law: LawView, symbols: Symbols) -> None:
    wide, _, dark = colours.BANDS["new_test"]
    for fan, colour in ((law.new_test, wide), (law.device, _MEDIAN)):
        edges = fan.widest.lower, fan.widest.upper
        name = f"{colours.BAND_NAMES[fan.kind]}, {percent(fan.widest.probability)} %"
        axes.fill_between(law.actuation, *edges, color=colour, linewidth=0, label=name)
    axes.plot(law.actuation, law.device.median, color=dark, label="best estimate")
    if law.tested:
        _, at, lower, median, upper = (np.asarray(part) for part in zip(*law.tested, strict=True))
        arms = np.maximum(0.0, [median - lower, upper - median])
        shown: dict[str, Any] = {"fmt": "o", "color": colours.DATA, "markersize": 3}
        axes.errorbar(spread(at), median, arms, label="tests, 95 %", linewidth=0.9, **shown)
    axes.set_title(f"{symbols.in_figure(law.name)}: {plain(law.law)}")
    axes.set_ylabel(symbols.label(law.name, law.unit))
    axes.set_ylim(*_limits(law))
    axes.margins(x=0.0)
    if any(test[1] == 0 for test in law.tested):  # room for tests at zero, side by side
        axes.set_xlim(left=-0.03 * law.actuation[-1])


def spread(actuation: Array) -> Array:
    """Actuations of tests moved apart at each level, (n,), so that no bar hides another.

    All of them stay nearer to their own level than to the next one.
    """
    span = max(float(np.ptp(actuation)), 1e-3 * float(np.max(np.abs(actuation))))
    levels = np.unique(actuation)
    room = 0.5 * float(np.min(np.diff(levels), initial=span))
    shifted = actuation.astype(np.float64)
    for level in levels:
        same = np.flatnonzero(actuation == level)
        step = min(0.012 * span, room / max(1, same.size - 1))
        shifted[same] += step * (np.arange(same.size) - 0.5 * (same.size - 1))
    return shifted


def _limits(law: LawView) -> tuple[float, float]:
    """Vertical limits that hold tests and best estimate; the wide band may go beyond them."""
    tops = [float(np.max(law.device.median)), *(t[4] for t in law.tested)]
    bottoms = [float(np.min(law.device.median)), *(t[2] for t in law.tested)]
    for interval in law.new_test.intervals:
        tops.append(min(float(np.max(interval.upper)), 2.0 * max(tops)))
        bottoms.append(float(np.min(interval.lower)))
    low, high = min(bottoms), max(tops)
    margin = 0.05 * (high - low) or 0.1
    return (0.0 if 0 <= low < 0.5 * high else low - margin), high + margin


@look.style()
def draw_next(advice: Advice, system: System, unit: str, title: str) -> Figure:
    """Candidates by actuation and frequency, coloured by gain, and the curve of the width."""
    figure = look.new_figure(8.6, 3.6)
    figure.suptitle(title, x=0.01, ha="left", wrap=True, fontsize=9)
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    by, name = system.of_actuation(unit)
    gains: dict[tuple[float, float], float] = {}  # of the best amplitude
    for row in advice:
        place = row.candidate.actuation * by, row.candidate.frequency
        gains[place] = max(gains.get(place, 0.0), 100.0 * row.reduction)
    look_of: dict[str, Any] = {"s": 130, "cmap": "YlGnBu", "vmin": 0.0, "edgecolors": "#888888"}
    places = np.array(list(gains)).T
    shown = left.scatter(*places, c=list(gains.values()), linewidths=0.5, **look_of)
    first = advice[0].candidate
    ring: dict[str, Any] = {"mfc": "none", "mec": colours.DATA, "mew": 1.6, "ms": 15}
    left.plot(first.actuation * by, first.frequency, "o", label="best", **ring)
    made = [(test.actuation * by, test.frequency) for test in advice.tests]
    left.plot(*np.reshape(made, (-1, 2)).T, "x", color="#c0392b", ms=5, label="tests made")
    left.set_yscale("log")
    left.yaxis.set_major_formatter(ScalarFormatter())
    left.yaxis.set_minor_formatter(ScalarFormatter())
    left.set(xlabel=f"actuation, {name}", ylabel="frequency, Hz")
    left.set_title("Expected reduction, best amplitude")
    left.margins(0.12)
    left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)
    figure.colorbar(shown, ax=left, label="%")
    curve = advice.curve * system.factor(advice.unit)
    arms = curve[0] * np.array([0.0, *(1.96 * t.error for t in advice.together)])
    steps = np.arange(curve.size)
    right.errorbar(steps, curve, arms, fmt="o-", color=colours.DATA, markersize=4, capsize=2)
    right.set_ylim(0.0, 1.1 * float(np.max(curve + arms)))
    right.xaxis.set_major_locator(MaxNLocator(integer=True))
    right.set_xlabel("further tests, the best together")
    right.set_ylabel(f"expected width, {system.unit(advice.unit)}")
    right.set_title("When it is enough")
    return figure
