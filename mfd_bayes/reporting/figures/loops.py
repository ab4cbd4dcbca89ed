"""Force against displacement, velocity and time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mfd_bayes.evaluation.views import Array, Fan, Interval, TestView
from mfd_bayes.records.motion import turning_points
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting import colours
from mfd_bayes.reporting.figures import style as look
from mfd_bayes.reporting.symbols import plain
from mfd_bayes.runs.unit_system import US, System

POINTS = 4000
"""Most points of a line: a screen cannot show more."""
TURNS = 24
"""Most turning points of a record that is shown in one column, without the strongest motion."""
PANELS = 60
FEW = 12
"""Most panels that are drawn four to a row; more are drawn six to a row."""
GIVEN = "#fff3d6"
"""Ground of the part of a record that a prediction was given."""
_VELOCITY_TURN = 0.02  # share of its peak-to-peak: smaller turns are noise


@look.style()
def draw_loops(title: str, trace: Trace, fans: Sequence[Fan] = (), system: System = US) -> Figure:
    """Force against displacement and against velocity, over bands.

    The fans are drawn one over the other, so the widest comes first. Trace and fans are in
    the units of `system`.
    """
    figure = look.new_figure(10, 4.3)
    figure.suptitle(plain(title), x=0.01, ha="left")
    left, right = figure.subplots(1, 2, sharey=True)
    draw_loop(left, fans, trace.displacement, trace.turning_points, trace.force)
    span = _VELOCITY_TURN * float(np.ptp(trace.velocity))
    draw_loop(right, fans, trace.velocity, turning_points(trace.velocity, span), trace.force)
    left.set(xlabel=f"displacement, {system.length}", ylabel=f"force, {system.force}")
    left.set_title("Force–displacement", fontsize=9, fontweight="normal")
    right.set(xlabel=f"velocity, {system.velocity}", ylabel=f"force, {system.force}")
    right.set_title("Force–velocity", fontsize=9, fontweight="normal")
    _legend(figure, trace, fans)
    return figure


@dataclass(frozen=True)
class Marks:
    """What is marked along the time.

    Attributes
    ----------
    first : int
        Samples before it were not fitted.
    given : (float, float), s, or None
        From and to when the force was known to the prediction.
    """

    first: int = 0
    given: tuple[float, float] | None = None


@look.style()
def draw_history(
    title: str,
    trace: Trace,
    fans: Sequence[Fan] = (),
    system: System = US,
    marks: Marks = Marks(),
) -> Figure:
    """Displacement, force with bands, and residual against time.

    The residual is the force minus the first fan's median. There is none where the force is NaN at
    a sample. Trace and fans are in the units of `system`.
    """
    first, given = marks.first, marks.given
    windows = _windows(trace)
    whole = trace.force is not None and bool(np.all(np.isfinite(trace.force)))
    rows = 3 if fans and whole else 2
    figure = look.new_figure(10, 2.6 + 0.9 * rows)
    figure.suptitle(plain(title), x=0.01, ha="left")
    heights = (1.0, 2.6, 1.5)[:rows]
    shared: dict[str, Any] = {"sharex": "col", "sharey": "row", "squeeze": False}
    grid = figure.subplots(rows, len(windows), height_ratios=heights, **shared)
    for column, window in zip(grid.T, windows, strict=True):
        _draw_column(column, trace, fans, window)
        if window.start < first:
            for axes in column:
                axes.axvspan(trace.time[window][0], trace.time[first], color="#eeeeee", zorder=0)
        if given is not None:
            for axes in column:
                _mark_given(axes, given, trace.time[window])
    _label_history(grid, system)
    _legend(figure, trace, fans, masked=first > 0, given=given is not None)
    return figure


def _label_history(grid: NDArray[np.object_], system: System) -> None:
    force = system.force
    texts = (f"displ., {system.length}", f"force, {force}", f"residual, {force}")
    for axes, text in zip(grid[:, 0], texts, strict=False):
        axes.set_ylabel(text)
    if grid.shape[1] > 1:
        grid[0, 1].set_title("Strongest motion", fontsize=9, fontweight="normal")
        grid[0, 0].set_title("Whole record", fontsize=9, fontweight="normal")


@look.style()
def draw_overview(title: str, tests: Sequence[TestView], system: System = US) -> Figure:
    """Force–displacement loops of up to sixty tests, as small multiples."""
    shown = tests[:PANELS]
    columns = min(4 if len(shown) <= FEW else 6, max(1, len(shown)))
    rows = max(1, -(-len(shown) // columns))
    figure = look.new_figure(max(2.6 * columns, 6.0), 2.35 * rows + 0.7)
    more = "" if len(tests) == len(shown) else f" (first {PANELS} of {len(tests)} tests)"
    figure.suptitle(f"{plain(title)}{more}", x=0.01, ha="left")
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for at, (axes, test) in enumerate(zip(grid.flat, shown, strict=False)):
        _draw_panel(axes, test)
        if at + columns >= len(shown):
            axes.set_xlabel(f"displacement, {system.length}")
        if at % columns == 0:
            axes.set_ylabel(f"force, {system.force}")
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    if shown:
        _legend(figure, shown[0].trace, [shown[0].observation])
    return figure


def stretches(turns: NDArray[np.intp], samples: int) -> list[slice]:
    """Stretches of motion from one turning point to the next, both included."""
    ends = [0, *turns.tolist(), samples - 1]
    return [slice(a, b + 1) for a, b in pairwise(ends) if b > a]


def _draw_panel(axes: Axes, test: TestView) -> None:
    held_out = test.role == "validate"
    trace, fan = test.trace, test.observation
    for interval, colour in look.shades(fan):
        _fill(axes, trace.displacement, interval, trace.turning_points, colour)
    if trace.force is not None:
        _line(axes, trace.displacement, trace.force)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    colour = colours.VALIDATE if held_out else colours.DATA
    name = f"{plain(test.id)}\n{plain(test.actuation)}, "
    name += "predicted, not fitted" if held_out else "fitted"
    axes.set_title(name, fontsize=8, color=colour, fontweight="normal")
    if held_out:
        for spine in axes.spines.values():
            spine.set(edgecolor=colours.VALIDATE, linewidth=1.3, visible=True)


def draw_loop(
    axes: Axes,
    fans: Sequence[Fan],
    abscissa: Array,
    turns: NDArray[np.intp],
    force: Array | None = None,
) -> None:
    """Draw a force, or else the first fan's median, over bands against any abscissa, (T,)."""
    for fan in fans:
        for interval, colour in look.shades(fan):
            _fill(axes, abscissa, interval, turns, colour)
    if force is not None:
        _line(axes, abscissa, force)
    elif fans:
        _line(axes, abscissa, fans[0].median, colours.BANDS[fans[0].kind][2])


def _fill(
    axes: Axes, abscissa: Array, interval: Interval, turns: NDArray[np.intp], colour: str
) -> None:
    """Fill a band for each stretch of motion; one outline of a whole loop would fill its inside."""
    step = max(1, abscissa.size // POINTS)
    outlines = []
    for part in stretches(turns, abscissa.size):
        pick = np.unique(np.append(np.arange(part.start, part.stop, step), part.stop - 1))
        lower = np.column_stack([abscissa[pick], interval.lower[pick]])
        upper = np.column_stack([abscissa[pick], interval.upper[pick]])
        outlines.append(np.concatenate([lower, upper[::-1]]))
    # the thin edge shows a narrow band where the force is steep
    bands = PolyCollection(outlines, facecolors=colour, edgecolors=colour, linewidths=0.8)
    axes.add_collection(bands)
    axes.autoscale_view()


def _line(axes: Axes, abscissa: Array, force: Array, colour: str = colours.DATA) -> None:
    step = max(1, abscissa.size // POINTS)
    axes.plot(abscissa[::step], force[::step], color=colour, linewidth=0.6)


def _windows(trace: Trace) -> list[slice]:
    """The whole record and, if it is long, six strokes around its largest displacement."""
    whole = slice(0, trace.samples)
    turns = trace.turning_points
    if turns.size <= TURNS:
        return [whole]
    largest = int(np.argmax(np.abs(trace.displacement)))
    at = int(np.clip(np.searchsorted(turns, largest), 3, turns.size - 4))
    return [whole, slice(int(turns[at - 3]), int(turns[at + 3]) + 1)]


def _draw_column(column: NDArray[np.object_], trace: Trace, fans: Sequence[Fan], at: slice) -> None:
    time = trace.time[at]
    zero = np.zeros(trace.samples)
    step = max(1, time.size // POINTS)
    column[0].plot(time[::step], trace.displacement[at][::step], color="#555555", linewidth=0.8)
    for fan in fans:
        draw_bands(column[1], time, fan, at, zero)
    if trace.force is not None:
        column[1].plot(*thinned(time, trace.force[at]), color=colours.DATA, linewidth=0.6)
    if len(column) > 2 and trace.force is not None:
        draw_bands(column[2], time, fans[0], at, fans[0].median)
        residual = (trace.force - fans[0].median)[at]
        column[2].plot(*thinned(time, residual), color=colours.DATA, linewidth=0.6)
        column[2].axhline(0.0, color=colours.BANDS[fans[0].kind][2], linewidth=0.8)
    column[-1].set_xlabel("time, s")
    column[-1].margins(x=0.005)


def draw_bands(
    axes: Axes, time: Array, fan: Fan, at: slice = slice(None), base: Array | float = 0.0
) -> None:
    """Fill the bands of a fan, less a base, (T,), over a window of time."""
    step = max(1, time.size // POINTS)
    edges = np.arange(0, time.size, step)
    for interval, colour in look.shades(fan):
        lower = np.minimum.reduceat((interval.lower - base)[at], edges)
        upper = np.maximum.reduceat((interval.upper - base)[at], edges)
        axes.fill_between(time[edges], lower, upper, facecolor=colour, edgecolor=colour, lw=0.6)


def thinned(time: Array, values: Array) -> tuple[Array, Array]:
    """A line with at most `POINTS` points, with every extreme."""
    step = time.size // (POINTS // 2)
    if step < 2:
        return time, values
    edges = np.arange(0, time.size, step)
    low, high = np.minimum.reduceat(values, edges), np.maximum.reduceat(values, edges)
    return np.repeat(time[edges], 2), np.column_stack([low, high]).ravel()


def _mark_given(axes: Axes, given: tuple[float, float], time: Array) -> None:
    """Shade the given part of a panel of these times, and draw its end."""
    begin, end = max(given[0], float(time[0])), min(given[1], float(time[-1]))
    if begin < end:
        axes.axvspan(begin, end, color=GIVEN, zorder=0)
        axes.axvline(end, color=colours.DATA, linewidth=0.8, linestyle="--")


def _legend(
    figure: Figure,
    trace: Trace,
    fans: Sequence[Fan],
    *,
    masked: bool = False,
    given: bool = False,
) -> None:
    handles: list[Line2D | Patch] = []
    if trace.force is not None:
        handles.append(Line2D([], [], color=colours.DATA, linewidth=0.9, label="measured"))
    for fan in fans:
        wide, narrow, _ = colours.BANDS[fan.kind]
        text = f"{colours.BAND_NAMES[fan.kind]}, {look.percents(fan)}"
        handles.append(Patch(facecolor=narrow, edgecolor=wide, linewidth=3, label=text))
    if masked:
        handles.append(Patch(facecolor="#eeeeee", label="not fitted"))
    if given:
        handles.append(Patch(facecolor=GIVEN, label="given to the prediction"))
    if handles:
        figure.legend(handles=handles, loc="outside lower left", ncols=4)
