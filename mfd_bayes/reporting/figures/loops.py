"""Force against displacement, velocity and time: of tests, of bands, and of a record as read."""

from __future__ import annotations

import io
import logging
import os
import sys
import warnings
from contextlib import contextmanager
from dataclasses import replace
from itertools import cycle, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from PIL import Image

from mfd_bayes.errors import ReportError
from mfd_bayes.population.design import SAME_LEVEL
from mfd_bayes.records.loops import Loops, find_loops
from mfd_bayes.records.trace import HYSTERESIS, Trace, turning_points
from mfd_bayes.reporting.symbols import (
    BAND_NAMES,
    BANDS,
    BLUE,
    DATA,
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    VALIDATE,
    VERMILLION,
    plain,
)
from mfd_bayes.runs.tested_range import conditions_of
from mfd_bayes.runs.unit_system import US, System
from mfd_bayes.units import percent

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from mfd_bayes.evaluation.views import Array, Fan, Interval, TestView
    from mfd_bayes.records.data_quality import Fault


@contextmanager
def _quiet_agg() -> Iterator[None]:
    """Import with the backend Agg and without log lines; both are put back."""
    log, backend = logging.getLogger("matplotlib"), os.environ.get("MPLBACKEND")
    level = log.level
    log.setLevel(logging.ERROR)
    os.environ["MPLBACKEND"] = "agg"
    try:
        yield
    finally:
        log.setLevel(level)
        del os.environ["MPLBACKEND"]
        if backend is not None:
            os.environ["MPLBACKEND"] = backend


with _quiet_agg():
    import matplotlib
    import matplotlib.font_manager  # which may have to be made first
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

DPI = 105

_STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titleweight": "normal",
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # where Matplotlib puts it too, after it has measured all labels
    "figure.titlesize": 11,
    "figure.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#666666",
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.1,
}


@contextmanager
def style() -> Iterator[None]:
    """Draw with the report's settings of Matplotlib, not with the user's."""
    with matplotlib.rc_context(), warnings.catch_warnings():
        # a name from a file may have letters that DejaVu does not have
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield


def new_figure(width: float, height: float, title: str = "", layout: str = "constrained") -> Figure:
    """Empty figure of a size in inches, with its title at the left.

    The constrained layout cuts nothing off, but is slow with many panels.
    """
    figure = Figure(figsize=(width, height), dpi=DPI, layout=layout)  # type: ignore[arg-type]
    if title:
        figure.suptitle(plain(title), x=0.01, ha="left")
    return figure


@style()
def to_png(figure: Figure) -> bytes:
    """PNG of a figure, the same bytes each time; 256 colours make it a third of the size."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()  # once: savefig would draw twice where there is a layout
    size = canvas.get_width_height()
    drawn = Image.frombuffer("RGBA", size, canvas.buffer_rgba()).convert("RGB")
    few = drawn.quantize(256, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    packed = io.BytesIO()
    few.save(packed, "png", compress_level=6)
    return packed.getvalue()


def shades(fan: Fan) -> Iterator[tuple[Interval, str]]:
    """Intervals of a fan, widest first, each with its colour."""
    wide, narrow, _ = BANDS[fan.kind]
    ordered = sorted(fan.intervals, key=lambda i: (not i.whole, -i.probability))
    for index, interval in enumerate(ordered):
        yield interval, wide if index == 0 else narrow


def percents(fan: Fan) -> str:
    """Probabilities of a fan's intervals: "50 and 95 %"."""
    chances = sorted(i.probability for i in fan.intervals if not i.whole)
    pale = "; pale: of the whole history" if any(i.whole for i in fan.intervals) else ""
    return " and ".join(percent(chance) for chance in chances) + f" %{pale}"


POINTS = 4000
"""Most points of a line: a screen cannot show more."""
TURNS = 24
"""Most turning points of a record that is shown in one column, without the strongest motion."""
PANELS = 60
"""Most panels of an overview."""
_NOT_FITTED, _GIVEN = "#eeeeee", "#fff3d6"


def in_units(system: System, trace: Trace, fans: Sequence[Fan]) -> tuple[Trace, list[Fan]]:
    """A motion with its force, and bands of it, in the units of a system."""
    length, force = system.factor("in"), system.factor("kip")
    trace = replace(
        trace,
        displacement=trace.displacement * length,
        velocity=trace.velocity * length,
        force=None if trace.force is None else trace.force * force,
        hysteresis=trace.hysteresis * length,
    )
    return trace, [fan.times(force) for fan in fans]


@style()
def draw_loops(
    title: str,
    trace: Trace,
    fans: Sequence[Fan] = (),
    system: System = US,
) -> Figure:
    """Force against displacement and against velocity, over bands, the widest fan first."""
    trace, fans = in_units(system, trace, fans)
    figure = new_figure(10, 4.3, title)
    left, *others = figure.subplots(1, 2 if trace.timed else 1, sharey=True, squeeze=False)[0]
    _draw_loop(left, fans, trace.displacement, trace.turning_points, trace.force)
    left.set(xlabel=system.label("displacement", "in"), ylabel=system.label("force", "kip"))
    left.set_title(system.text("Force–displacement"))
    for right in others:
        span = 0.02 * float(np.ptp(trace.velocity))  # smaller turns are noise
        _draw_loop(right, fans, trace.velocity, turning_points(trace.velocity, span), trace.force)
        right.set(xlabel=system.label("velocity", "in/s"), ylabel=system.label("force", "kip"))
        right.set_title(system.text("Force–velocity"))
    _legend(figure, fans, trace.force is not None)
    return figure


@style()
def draw_history(
    title: str,
    trace: Trace,
    fans: Sequence[Fan] = (),
    system: System = US,
    first: int = 0,
    given: tuple[float, float] | None = None,
) -> Figure:
    """Displacement, force with bands, and residual against time.

    The residual is the force minus the first fan's median. There is none where the force is NaN at
    a sample. A long record has a second column with its strongest motion. Shaded: samples before
    `first`, which were not fitted, and the times, s, between which the force was `given` to the
    prediction.
    """
    trace, fans = in_units(system, trace, fans)
    whole = trace.force is not None and bool(np.all(np.isfinite(trace.force)))
    rows = 3 if fans and whole else 2
    windows = _windows(trace)
    figure = new_figure(10, 2.6 + 0.9 * rows, title)
    shared: dict[str, Any] = {"sharex": "col", "sharey": "row", "squeeze": False}
    grid = figure.subplots(rows, len(windows), height_ratios=(1.0, 2.6, 1.5)[:rows], **shared)
    for column, window in zip(grid.T, windows, strict=True):
        time = trace.time[window]
        column[0].plot(*thinned(time, trace.displacement[window]), color="#555555", linewidth=0.8)
        for fan in fans:
            _draw_bands(column[1], time, fan, window)
        if trace.force is not None:
            column[1].plot(*thinned(time, trace.force[window]), color=DATA, linewidth=0.6)
            if rows == 3:
                residual = (trace.force - fans[0].median)[window]
                _draw_bands(column[2], time, fans[0], window, fans[0].median)
                column[2].plot(*thinned(time, residual), color=DATA, linewidth=0.6)
                column[2].axhline(0.0, color=BANDS[fans[0].kind][2], linewidth=0.8)
        for axes in column:
            axes.set_xlim(time[0], time[-1])
            if first > 0:
                axes.axvspan(trace.time[0], trace.time[first], color=_NOT_FITTED, zorder=0)
            if given is not None:
                axes.axvspan(*given, color=_GIVEN, zorder=0)
                axes.axvline(given[1], color=DATA, lw=0.8, linestyle="--")
        column[-1].set_xlabel(clock(trace))
    labels = (("displ.", "in"), ("force", "kip"), ("residual", "kip"))
    for axes, label in zip(grid[:, 0], labels, strict=False):
        axes.set_ylabel(system.label(*label))
    if len(windows) > 1:
        grid[0, 0].set_title("Whole record")
        grid[0, 1].set_title("Strongest motion")
    shades = {"not fitted": _NOT_FITTED} if first > 0 else {}
    shades |= {"given to the prediction": _GIVEN} if given is not None else {}
    _legend(figure, fans, trace.force is not None, shades)
    return figure


@style()
def draw_overview(
    title: str,
    tests: Sequence[TestView],
    system: System = US,
    actuation_unit: str = "ksi",
) -> Figure:
    """Loops of up to sixty tests over their bands: rows are frequencies, columns actuations.

    Where the grid would be mostly empty, as of earthquake records, the tests follow each other by
    actuation and frequency.
    """
    shown = tests[:PANELS]
    places, rows, columns = _places(shown, actuation_unit)
    figure = new_figure(max(2.5 * columns, 6.0), 2.2 * rows + 0.7)
    more = "" if len(tests) == len(shown) else f" (first {PANELS} of {len(tests)} tests)"
    figure.suptitle(f"{plain(title)}{more}", x=0.01, ha="left")
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axes in grid.flat:
        axes.set_visible(False)
    for (row, column), test in zip(places, shown, strict=True):
        axes = grid[row, column]
        axes.set_visible(True)
        _draw_panel(axes, test, system, system.actuation(test.trace, actuation_unit))
        if (row + 1, column) not in places:
            axes.set_xlabel(system.label("displacement", "in"))
        if (row, column - 1) not in places:
            axes.set_ylabel(system.label("force", "kip"))
            axes.tick_params(labelleft=True)
    if shown:
        _legend(figure, [shown[0].observation], True)
    return figure


def _places(tests: Sequence[TestView], unit: str) -> tuple[list[tuple[int, int]], int, int]:
    """Row and column of each test, and the numbers of rows and columns."""
    levels, frequencies = [], []
    for test in tests:
        spans = conditions_of(test.trace)
        levels.append(spans.get("actuation", np.inf))
        frequencies.append(float(f"{spans.get('frequency', np.inf):.2g}"))
    steps = np.unique(levels)
    steps = steps[np.diff(steps, prepend=-np.inf) > SAME_LEVEL * np.abs(steps)]
    column = np.maximum(np.searchsorted(steps, levels, side="right") - 1, 0)
    pairs = list(zip(frequencies, column.tolist(), strict=True))
    # several tests of one condition stand one below the other
    keys = [(f, pairs[:i].count((f, c))) for i, (f, c) in enumerate(pairs)]
    rows = {key: at for at, key in enumerate(sorted(set(keys)))}
    if len(rows) * len(steps) <= 2 * len(tests):
        places = [(rows[key], at) for key, at in zip(keys, column.tolist(), strict=True)]
        return places, len(rows), len(steps)
    order = np.lexsort((np.array(frequencies), column)).argsort()
    wide = min(5, len(tests))
    return [divmod(int(at), wide) for at in order], -(-len(tests) // wide), wide


def _draw_panel(axes: Axes, test: TestView, system: System, actuation: str) -> None:
    held_out = test.role == "validate"
    colour = VALIDATE if held_out else DATA
    trace, fans = in_units(system, test.trace, [test.observation])
    _draw_loop(axes, fans, trace.displacement, trace.turning_points, trace.force)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    role = ", held out" if held_out else ""
    axes.set_title(f"{plain(test.id)}\n{plain(actuation)}{role}", fontsize=8, color=colour)
    if held_out:
        for spine in axes.spines.values():
            spine.set(edgecolor=colour, linewidth=1.3, visible=True)


def draw_band(
    axes: Any,
    fan: Fan,
    time: Array,
    displacement: Array | None,
    system: System,
    force: Array | None = None,
) -> Axes:
    """Axes with a band in the units of a system over time, s, or over a displacement, in.

    Over it are its median, or a measured force. `axes` are None for those of a new figure.
    """
    by, fan = system.factor("kip"), fan.times(system.factor("kip"))
    if axes is None:
        pyplot: Any = sys.modules.get("matplotlib.pyplot")  # its figures are shown in notebooks
        figure = new_figure(7, 4) if pyplot is None else pyplot.figure(figsize=(7, 4))
        axes = figure.add_subplot()
    if not isinstance(axes, Axes):
        raise ReportError(f"axes must be axes of Matplotlib, got {axes!r}")
    if displacement is None:
        _draw_bands(axes, time, fan)
        axes.plot(*thinned(time, fan.median), color=BANDS[fan.kind][2], lw=0.9)
        axes.set_xlabel("time, s" if system.axes.timed else "sample")
    else:
        displacement = displacement * system.factor("in")
        turns = turning_points(displacement, HYSTERESIS * float(np.ptp(displacement)))
        _draw_loop(axes, [fan], displacement, turns, None if force is None else force * by)
        axes.set_xlabel(system.label("displacement", "in"))
    axes.set_ylabel(system.label("force", "kip"))
    axes.set_title(f"{BAND_NAMES[fan.kind]}, {percents(fan)}", fontsize=9)
    return axes


def clock(trace: Trace) -> str:
    """Label of an axis of time, or of numbered samples."""
    return "time, s" if trace.timed else "sample"


def stretches(turns: NDArray[np.intp], samples: int) -> list[slice]:
    """Stretches of motion from one turning point to the next, both included."""
    ends = [0, *turns.tolist(), samples - 1]
    return [slice(a, b + 1) for a, b in pairwise(ends) if b > a]


def _draw_loop(
    axes: Axes,
    fans: Sequence[Fan],
    abscissa: Array,
    turns: NDArray[np.intp],
    force: Array | None = None,
) -> None:
    """Draw a force, or else the first fan's median, over bands against any abscissa, (T,).

    A band is filled for each stretch of motion: one outline of a loop would fill its inside.
    """
    step = max(1, abscissa.size // POINTS)
    for fan in fans:
        for interval, colour in shades(fan):
            outlines = []
            for part in stretches(turns, abscissa.size):
                pick = np.append(np.arange(part.start, part.stop, step), part.stop - 1)
                forth = np.column_stack([abscissa[pick], interval.lower[pick]])
                back = np.column_stack([abscissa[pick], interval.upper[pick]])
                outlines.append(np.concatenate([forth, back[::-1]]))
            # the thin edge shows a narrow band where the force is steep
            bands = PolyCollection(outlines, facecolors=colour, edgecolors=colour, linewidths=0.8)
            axes.add_collection(bands)
            axes.autoscale_view()
    colour = DATA
    if force is None and fans:
        force, colour = fans[0].median, BANDS[fans[0].kind][2]
    if force is not None:
        axes.plot(abscissa[::step], force[::step], color=colour, linewidth=0.6)


def _windows(trace: Trace) -> list[slice]:
    """The whole record and, if it is long, six strokes around its largest displacement."""
    turns = trace.turning_points
    if turns.size <= TURNS:
        return [slice(0, trace.samples)]
    largest = int(np.argmax(np.abs(trace.displacement)))
    at = int(np.clip(np.searchsorted(turns, largest), 3, turns.size - 4))
    return [slice(0, trace.samples), slice(int(turns[at - 3]), int(turns[at + 3]) + 1)]


def _draw_bands(
    axes: Axes, time: Array, fan: Fan, at: slice = slice(None), base: Array | float = 0.0
) -> None:
    """Fill the bands of a fan, less a base, (T,), over a window of time."""
    for interval, colour in shades(fan):
        there, lower = thinned(time, (interval.lower - base)[at])
        _, upper = thinned(time, (interval.upper - base)[at])
        axes.fill_between(there, lower, upper, facecolor=colour, edgecolor=colour, lw=0.6)


def thinned(time: Array, values: Array) -> tuple[Array, Array]:
    """A line with at most `POINTS` points, with every extreme."""
    step = time.size // (POINTS // 2)
    if step < 2:
        return time, values
    edges = np.arange(0, time.size, step)
    low, high = np.minimum.reduceat(values, edges), np.maximum.reduceat(values, edges)
    return np.repeat(time[edges], 2), np.column_stack([low, high]).ravel()


def _legend(
    figure: Figure,
    fans: Sequence[Fan],
    measured: bool,
    shades: Mapping[str, str] | None = None,
) -> None:
    handles: list[Line2D | Patch] = []
    if measured:
        handles.append(Line2D([], [], color=DATA, linewidth=0.9, label="measured"))
    for fan in fans:
        wide, narrow, _ = BANDS[fan.kind]
        text = f"{BAND_NAMES[fan.kind]}, {percents(fan)}"
        handles.append(Patch(facecolor=narrow, edgecolor=wide, linewidth=3, label=text))
    handles += [Patch(facecolor=colour, label=name) for name, colour in (shades or {}).items()]
    if handles:
        figure.legend(handles=handles, loc="outside lower left", ncols=4)


_SIGNS = ("v", "o", "s", "D", "P", "X", "^", "*")
_COLOURS = (VERMILLION, BLUE, GREEN, PURPLE, ORANGE, SKY)
_MARKS = 60  # more of one kind would hide the curve


@style()
def draw_inspection(
    title: str, trace: Trace, faults: Sequence[Fault] = (), system: System = US
) -> Figure:
    """Loop, displacement and force over time, and energy per cycle of a record at its own rate.

    Faults are marked at their samples, if they have any, and named below the panels. Without
    a force there is only the displacement.
    """
    trace, _ = in_units(system, trace, ())
    figure, x, time = new_figure(10, 5.6, title), trace.displacement, trace.time
    curves: list[tuple[Axes, Array, Array]]
    if trace.force is None:
        place = figure.subplots()
        curves = [(place, time, x)]
    else:
        panels = figure.subplot_mosaic(
            [["loop", "displacement"], ["loop", "force"], ["energy", "force"]],
            width_ratios=(1.0, 1.35),
        )
        loop, place, history = (panels[name] for name in ("loop", "displacement", "force"))
        curves = [(loop, x, trace.force), (place, time, x), (history, time, trace.force)]
        step = max(1, trace.samples // (2 * POINTS))
        loop.plot(x[::step], trace.force[::step], color=DATA, linewidth=0.5)
        loop.set(xlabel=system.label("displacement", "in"), ylabel=system.label("force", "kip"))
        loop.set_title(system.text("Force–displacement"))
        history.sharex(place)
        history.plot(*thinned(time, trace.force), color=DATA, linewidth=0.6)
        history.set(xlabel=clock(trace), ylabel=system.label("force", "kip"))
        history.set_title("Force")
        _draw_energy(panels["energy"], find_loops(trace), system)
    turns = trace.turning_points
    place.plot(*thinned(time, x), color="#555555", linewidth=0.8)
    place.plot(time[turns], x[turns], ".", color="#999999", markersize=3)
    place.set(ylabel=system.label("displacement", "in"), xlabel=clock(trace))
    place.set_title(f"Displacement, {turns.size} turning points")
    place.margins(x=0.01, y=0.12)  # space for the marks at the turns
    looks, handles = zip(cycle(_SIGNS), cycle(_COLOURS), strict=False), []
    for fault in faults:  # one without samples has no mark
        sign, colour = next(looks) if fault.samples.size else ("", DATA)
        at = fault.samples[:: max(1, -(-fault.samples.size // _MARKS))]
        mark: dict[str, Any] = {"marker": sign, "mfc": "none", "mec": colour, "mew": 1.1, "ms": 5}
        for axes, across, up in curves:
            axes.plot(across[at], up[at], ls="", label=f"warning: {fault.name}", **mark)
        handles.append(axes.lines[-1])
    if handles:
        figure.legend(handles=handles, loc="outside lower left", ncols=4)
    return figure


def _draw_energy(axes: Axes, loops: Loops, system: System) -> None:
    """Energy of each loop; loops of a ramp, with a shorter stroke, are hollow."""
    axes.set(xlabel="loop", ylabel=system.label("energy", "kip*in"))
    axes.set_title("Energy per full loop (hollow: shorter stroke)")
    axes.axhline(0.0, color="#999999", linewidth=0.7)
    if loops.energy is None or not loops.energy.size:
        axes.text(0.5, 0.5, "no full loop", transform=axes.transAxes, ha="center", va="center")
        return
    number = np.arange(1, loops.energy.size + 1)
    axes.plot(number, loops.energy, color="#bbbbbb", linewidth=0.7)
    faces = [BLUE if strong else "white" for strong in loops.strong]
    axes.scatter(number, loops.energy, s=16, c=faces, edgecolors=BLUE, linewidths=0.8)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
