"""Figures of a report."""

from __future__ import annotations

import io
import logging
import os
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import cycle, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mfd_bayes.errors import ReportError
from mfd_bayes.evaluation.scores import Interval, QuantileBand, Rows
from mfd_bayes.evaluation.views import INFORMED, Array, CampaignView, LawView, Marginal, TestView
from mfd_bayes.population.design import SAME_LEVEL
from mfd_bayes.records.data_quality import Fault
from mfd_bayes.records.loops import Loops, find_loops
from mfd_bayes.records.trace import HYSTERESIS, Trace, turning_points
from mfd_bayes.reporting.symbols import (
    BAND_NAMES,
    BANDS,
    BLUE,
    CHAINS,
    DATA,
    GREEN,
    ORANGE,
    POSTERIOR,
    PRIOR,
    PURPLE,
    SKY,
    TRUTH,
    VALIDATE,
    VERMILLION,
    Symbols,
    plain,
)
from mfd_bayes.runs.tested_range import conditions_of
from mfd_bayes.runs.unit_system import US, UnitSystem
from mfd_bayes.store.netcdf import import_arviz
from mfd_bayes.units import percent


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
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

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
    image = Image.frombuffer("RGBA", size, canvas.buffer_rgba()).convert("RGB")
    quantized = image.quantize(256, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    packed = io.BytesIO()
    quantized.save(packed, "png", compress_level=6)
    return packed.getvalue()


def shades(fan: QuantileBand) -> Iterator[tuple[Interval, str]]:
    """Intervals of a fan, widest first, each with its colour."""
    wide, narrow, _ = BANDS[fan.kind]
    ordered = sorted(fan.intervals, key=lambda i: (not i.simultaneous, -i.probability))
    for index, interval in enumerate(ordered):
        yield interval, wide if index == 0 else narrow


def percents(fan: QuantileBand) -> str:
    """Probabilities of a fan's intervals: "50 and 95 %"."""
    chances = sorted(i.probability for i in fan.intervals if not i.simultaneous)
    pale = "; pale: of the whole history" if any(i.simultaneous for i in fan.intervals) else ""
    return " and ".join(percent(chance) for chance in chances) + f" %{pale}"


# --- force against displacement, velocity and time

POINTS = 4000
"""Most points of a line: a screen cannot show more."""
TURNS = 24
"""Most turning points of a record that is shown in one column, without the strongest motion."""
PANELS = 60
"""Most panels of an overview."""
_NOT_FITTED, _GIVEN = "#eeeeee", "#fff3d6"


def in_units(
    system: UnitSystem, trace: Trace, fans: Sequence[QuantileBand]
) -> tuple[Trace, list[QuantileBand]]:
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
    title: str, trace: Trace, fans: Sequence[QuantileBand] = (), system: UnitSystem = US
) -> Figure:
    """Force against displacement and against velocity, over bands, the widest fan first."""
    trace, fans = in_units(system, trace, fans)
    figure = new_figure(10, 4.3, title)
    loop_axes, *velocity_axes = figure.subplots(
        1, 2 if trace.timed else 1, sharey=True, squeeze=False
    )[0]
    _draw_loop(loop_axes, fans, trace.displacement, trace.turning_points, trace.force)
    loop_axes.set(xlabel=system.label("displacement", "in"), ylabel=system.label("force", "kip"))
    loop_axes.set_title(system.text("Force–displacement"))
    for axes in velocity_axes:
        span = 0.02 * float(np.ptp(trace.velocity))  # smaller turns are noise
        _draw_loop(axes, fans, trace.velocity, turning_points(trace.velocity, span), trace.force)
        axes.set(xlabel=system.label("velocity", "in/s"), ylabel=system.label("force", "kip"))
        axes.set_title(system.text("Force–velocity"))
    _legend(figure, fans, trace.force is not None)
    return figure


@style()
def draw_history(
    title: str,
    trace: Trace,
    fans: Sequence[QuantileBand] = (),
    system: UnitSystem = US,
    start: int = 0,
    given: tuple[float, float] | None = None,
) -> Figure:
    """Displacement, force with bands, and residual against time.

    The residual is the force minus the first fan's median. There is none where the force is NaN at
    a sample. A long record has a second column with its strongest motion. Shaded: samples before
    `start`, which were not fitted, and the times, s, between which the force was `given` to the
    prediction.
    """
    trace, fans = in_units(system, trace, fans)
    is_complete = trace.force is not None and bool(np.all(np.isfinite(trace.force)))
    rows = 3 if fans and is_complete else 2
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
            if start > 0:
                axes.axvspan(trace.time[0], trace.time[start], color=_NOT_FITTED, zorder=0)
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
    shades = {"not fitted": _NOT_FITTED} if start > 0 else {}
    shades |= {"given to the prediction": _GIVEN} if given is not None else {}
    _legend(figure, fans, trace.force is not None, shades)
    return figure


@style()
def draw_overview(
    title: str, tests: Sequence[TestView], system: UnitSystem = US, actuation_unit: str = "ksi"
) -> Figure:
    """Loops of up to sixty tests over their bands: rows are frequencies, columns actuations.

    Where the grid would be mostly empty, as of earthquake records, the tests follow each other by
    actuation and frequency.
    """
    panel_tests = tests[:PANELS]
    places, rows, columns = _places(panel_tests)
    figure = new_figure(max(2.5 * columns, 6.0), 2.2 * rows + 0.7)
    suffix = "" if len(tests) == len(panel_tests) else f" (first {PANELS} of {len(tests)} tests)"
    figure.suptitle(f"{plain(title)}{suffix}", x=0.01, ha="left")
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axes in grid.flat:
        axes.set_visible(False)
    for (row, column), test in zip(places, panel_tests, strict=True):
        axes = grid[row, column]
        axes.set_visible(True)
        _draw_panel(axes, test, system, system.actuation(test.trace, actuation_unit))
        if (row + 1, column) not in places:
            axes.set_xlabel(system.label("displacement", "in"))
        if (row, column - 1) not in places:
            axes.set_ylabel(system.label("force", "kip"))
            axes.tick_params(labelleft=True)
    if panel_tests:
        _legend(figure, [panel_tests[0].observation], True)
    return figure


def _places(tests: Sequence[TestView]) -> tuple[list[tuple[int, int]], int, int]:
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
    rows = {key: index for index, key in enumerate(sorted(set(keys)))}
    if len(rows) * len(steps) <= 2 * len(tests):
        places = [(rows[key], index) for key, index in zip(keys, column.tolist(), strict=True)]
        return places, len(rows), len(steps)
    order = np.lexsort((np.array(frequencies), column)).argsort()
    wide = min(5, len(tests))
    return [divmod(int(index), wide) for index in order], -(-len(tests) // wide), wide


def _draw_panel(axes: Axes, test: TestView, system: UnitSystem, actuation: str) -> None:
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
    fan: QuantileBand,
    time: Array,
    displacement: Array | None,
    system: UnitSystem,
    force: Array | None = None,
) -> Axes:
    """Axes with a band in the units of a system over time, s, or over a displacement, in.

    Over it are its median, or a measured force. `axes` are None for those of a new figure.
    """
    factor, fan = system.factor("kip"), fan.times(system.factor("kip"))
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
        _draw_loop(axes, [fan], displacement, turns, None if force is None else force * factor)
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
    fans: Sequence[QuantileBand],
    abscissa: Array,
    turns: NDArray[np.intp],
    force: Array | None,
) -> None:
    """Draw a force, or else the first fan's median, over bands against any abscissa, (T,).

    A band is filled for each stretch of motion: one outline of a loop would fill its inside.
    """
    step = max(1, abscissa.size // POINTS)
    for fan in fans:
        for interval, colour in shades(fan):
            outlines = []
            for segment in stretches(turns, abscissa.size):
                pick = np.append(np.arange(segment.start, segment.stop, step), segment.stop - 1)
                lower_edge = np.column_stack([abscissa[pick], interval.lower[pick]])
                upper_edge = np.column_stack([abscissa[pick], interval.upper[pick]])
                outlines.append(np.concatenate([lower_edge, upper_edge[::-1]]))
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
    index = int(np.clip(np.searchsorted(turns, largest), 3, turns.size - 4))
    return [slice(0, trace.samples), slice(int(turns[index - 3]), int(turns[index + 3]) + 1)]


def _draw_bands(
    axes: Axes,
    time: Array,
    fan: QuantileBand,
    window: slice = slice(None),
    base: Array | float = 0.0,
) -> None:
    """Fill the bands of a fan, less a base, (T,), over a window of time."""
    for interval, colour in shades(fan):
        times, lower = thinned(time, (interval.lower - base)[window])
        _, upper = thinned(time, (interval.upper - base)[window])
        axes.fill_between(times, lower, upper, facecolor=colour, edgecolor=colour, lw=0.6)


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
    fans: Sequence[QuantileBand],
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
    title: str, trace: Trace, faults: Sequence[Fault] = (), system: UnitSystem = US
) -> Figure:
    """Loop, displacement and force over time, and energy per cycle of a record at its own rate.

    Faults are marked at their samples, if they have any, and named below the panels. Without
    a force there is only the displacement.
    """
    trace, _ = in_units(system, trace, ())
    figure, x, time = new_figure(10, 5.6, title), trace.displacement, trace.time
    curves: list[tuple[Axes, Array, Array]]
    if trace.force is None:
        displacement_axes = figure.subplots()
        curves = [(displacement_axes, time, x)]
    else:
        panels = figure.subplot_mosaic(
            [["loop", "displacement"], ["loop", "force"], ["energy", "force"]],
            width_ratios=(1.0, 1.35),
        )
        loop, displacement_axes, history = (
            panels[name] for name in ("loop", "displacement", "force")
        )
        curves = [
            (loop, x, trace.force),
            (displacement_axes, time, x),
            (history, time, trace.force),
        ]
        step = max(1, trace.samples // (2 * POINTS))
        loop.plot(x[::step], trace.force[::step], color=DATA, linewidth=0.5)
        loop.set(xlabel=system.label("displacement", "in"), ylabel=system.label("force", "kip"))
        loop.set_title(system.text("Force–displacement"))
        history.sharex(displacement_axes)
        history.plot(*thinned(time, trace.force), color=DATA, linewidth=0.6)
        history.set(xlabel=clock(trace), ylabel=system.label("force", "kip"))
        history.set_title("Force")
        _draw_energy(panels["energy"], find_loops(trace), system)
    turns = trace.turning_points
    displacement_axes.plot(*thinned(time, x), color="#555555", linewidth=0.8)
    displacement_axes.plot(time[turns], x[turns], ".", color="#999999", markersize=3)
    displacement_axes.set(ylabel=system.label("displacement", "in"), xlabel=clock(trace))
    displacement_axes.set_title(f"Displacement, {turns.size} turning points")
    displacement_axes.margins(x=0.01, y=0.12)  # space for the marks at the turns
    looks, handles = zip(cycle(_SIGNS), cycle(_COLOURS), strict=False), []
    for fault in faults:  # one without samples has no mark
        sign, colour = next(looks) if fault.samples.size else ("", DATA)
        indices = fault.samples[:: max(1, -(-fault.samples.size // _MARKS))]
        mark: dict[str, Any] = {"marker": sign, "mfc": "none", "mec": colour, "mew": 1.1, "ms": 5}
        for axes, abscissae, ordinates in curves:
            axes.plot(
                abscissae[indices],
                ordinates[indices],
                ls="",
                label=f"warning: {fault.name}",
                **mark,
            )
        handles.append(axes.lines[-1])
    if handles:
        figure.legend(handles=handles, loc="outside lower left", ncols=4)
    return figure


def _draw_energy(axes: Axes, loops: Loops, system: UnitSystem) -> None:
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


CORNER_DRAWS, CORNER_QUANTITIES = 2000, 8
# --- what was learned: the draws of each test, the truth, the laws, the next test

RANKS = 10
"""Bins of a rank plot."""
STAGES = {2: "stick", 4: "gap", 3: "build-up", 1: "slip"}
"""Stages in their order within a stroke."""

COLUMNS = 4
"""Columns of small panels."""

_PLAIN = "{x:.4g}"  # of tick labels
_BLUE = BANDS["observation"][1]


def _small_panels(title: str, number: int) -> tuple[Figure, list[Axes]]:
    """Panels in `COLUMNS` columns; fixed margins are much faster than the constrained layout."""
    columns = min(COLUMNS, number)
    rows = -(-number // columns)
    height = 1.4 * rows + 0.75
    figure = new_figure(10, height, layout="none")
    figure.suptitle(title, x=0.01, y=1.0 - 0.08 / height, ha="left", va="top")
    edges = {"left": 0.065, "right": 0.985, "top": 1 - 0.55 / height, "bottom": 0.65 / height}
    figure.subplots_adjust(**edges, wspace=0.28, hspace=0.75)
    panels = [figure.add_subplot(rows, columns, index + 1) for index in range(number)]
    for axes in panels:
        axes.tick_params(labelsize=7)
    return figure, panels


@style()
def draw_ranks(
    title: str, marginals: Sequence[Marginal], chains: int, symbols: Symbols
) -> Figure | None:
    """Histogram of the ranks of each chain's draws among all draws, one panel per quantity.

    The lines of chains that agree stay near 1. None where nothing was sampled in several chains.
    """
    sampled = [m for m in marginals if np.ptp(m.posterior) > 0]
    if chains < 2 or not sampled:
        return None
    figure, panels = _small_panels(title, len(sampled))
    for axes, marginal in zip(panels, sampled, strict=True):
        ranks = marginal.posterior.argsort(kind="stable").argsort() / marginal.posterior.size
        for chain, chain_ranks in enumerate(np.array_split(ranks, chains)):
            heights, edges = np.histogram(chain_ranks, RANKS, (0.0, 1.0), density=True)
            axes.stairs(heights, edges, color=CHAINS[chain % len(CHAINS)])
        axes.axhline(1.0, color=DATA, linewidth=0.6)
        axes.set_title(symbols.in_figure(marginal.name), fontsize=8)
    top = max(2.0, *(axes.get_ylim()[1] for axes in panels))
    columns = min(COLUMNS, len(panels))
    for number, axes in enumerate(panels):  # labels at the edges only: to draw them takes long
        axes.set(xlim=(0.0, 1.0), ylim=(0.0, top), xticks=(0.0, 0.5, 1.0))
        is_low, is_left = number >= len(panels) - columns, number % columns == 0
        axes.tick_params(labelbottom=is_low, labelleft=is_left)
    figure.supxlabel("rank among the draws of all chains, as a share", fontsize=8, y=0.01)
    return figure


@style()
def draw_marginals(title: str, marginals: Sequence[Marginal], symbols: Symbols) -> Figure | None:
    """Densities of priors and posteriors, each scaled to its peak; skewed priors logarithmic.

    None where there are none.
    """
    if not marginals:
        return None
    figure, panels = _small_panels(title, len(marginals))
    looks = ("#dddddd", PRIOR), (_BLUE, POSTERIOR)
    for axes, marginal in zip(panels, marginals, strict=True):
        samples = marginal.prior, marginal.posterior
        low, high = np.quantile(marginal.prior, [0.005, 0.995])
        low, high = min(low, samples[1].min()), max(high, samples[1].max())
        # a uniform prior is wide too, but belongs on a linear axis
        skewed = np.median(samples[0]) - low < 0.5 * (high - np.median(samples[0]))
        logarithmic = bool(min(map(np.min, samples)) > 0 and high > 20.0 * low and skewed)
        for draws, (face, edge) in zip(samples, looks, strict=True):
            lowest, highest = np.quantile(draws, [0.002, 0.998])
            if highest > lowest:
                bins = (np.geomspace if logarithmic else np.linspace)(lowest, highest, 31)
                heights = np.histogram(draws, bins)[0]
                heights = heights / heights.max()
                axes.stairs(heights, bins, fill=True, facecolor=face, alpha=0.75)
                axes.stairs(heights, bins, color=edge, linewidth=0.9)
            else:
                axes.axvline(lowest, color=edge)
        if high > low:
            axes.set(xlim=(low, high), xscale="log" if logarithmic else "linear")
        axes.set(ylim=(0, 1.08), yticks=[])  # only relative heights matter
        axes.spines["left"].set_visible(False)
        steps = (1.0, 3.0) if high < 300.0 * low else (1.0,)
        logs = LogLocator(subs=steps, numticks=6)
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_locator(logs if logarithmic else MaxNLocator(4))
        axes.xaxis.set_major_formatter(_PLAIN)
        axes.set_xlabel(symbols.label(marginal.name, marginal.unit), fontsize=8)
        if marginal.contraction < INFORMED:
            axes.set_title("not informed by the data", fontsize=7.5, color=VERMILLION)
    names = zip(looks, ("prior", "posterior"), strict=True)
    handles = [Patch(facecolor=face, edgecolor=edge, label=name) for (face, edge), name in names]
    figure.legend(handles=handles, loc="upper right", ncols=2)
    return figure


@style()
def draw_corner(
    title: str, marginals: Sequence[Marginal], names: Sequence[str], symbols: Symbols
) -> Figure | None:
    """Pairs of quantities: contours of 39, 86 and 95 % of the draws, 95 % intervals dashed.

    Draws of the marginals belong together by their number. At most eight quantities are
    drawn, the first ones of `names`; None where fewer than two have draws that vary.
    """
    by_name = {m.name: m for m in marginals}
    quantities = [by_name[name] for name in names if name in by_name]
    quantities = [
        m for m in quantities if np.ptp(m.posterior) > 1e-12 * np.max(np.abs(m.posterior))
    ]
    quantities = quantities[:CORNER_QUANTITIES]
    if len(quantities) < 2 or len(quantities[0].posterior) <= CORNER_QUANTITIES:
        return None
    import_arviz()  # corner would import it with bokeh and numba, which takes longer
    from corner import corner

    size = max(1.15 * len(quantities), 4.0)
    figure = new_figure(size, size, layout="none")
    stride = -(-len(quantities[0].posterior) // CORNER_DRAWS)
    options: dict[str, Any] = {"plot_datapoints": False, "plot_density": False}
    corner(
        np.column_stack([m.posterior[::stride] for m in quantities]),
        bins=16,
        smooth=0.8,
        color=POSTERIOR,
        labels=[symbols.label(m.name, m.unit) for m in quantities],
        label_kwargs={"fontsize": 8},
        labelpad=0.12,
        max_n_ticks=3,
        quantiles=(0.025, 0.975),
        levels=(0.393, 0.865, 0.95),
        fill_contours=True,
        no_fill_contours=True,  # no white background
        fig=figure,
        **options,
    )
    figure.suptitle(title, x=0.01, y=0.985, ha="left")
    figure.subplots_adjust(left=0.13, bottom=0.13, right=0.985, top=0.945)
    for axes in figure.axes:
        axes.grid(visible=False)
        axes.tick_params(labelsize=7)
    return figure


@style()
def draw_residuals(title: str, test: TestView, system: UnitSystem) -> Figure | None:
    """Residuals of a test: by stage, along the gap, autocorrelation.

    None of a test that was not fitted.
    """
    if test.role == "validate":
        return None
    window = slice(test.first, None)
    trace, (observation,) = in_units(system, test.trace, [test.observation])
    residual = (np.asarray(trace.force) - observation.median)[window]
    half = 0.5 * (observation.widest.upper - observation.widest.lower)[window]
    figure = new_figure(10, 3.4, title)
    stage_axes, travel_axes, lag_axes = figure.subplots(1, 3, width_ratios=(1.0, 1.6, 1.3))
    _draw_by_stage(stage_axes, residual, half, None if test.stage is None else test.stage[window])
    abscissa, label = trace.displacement, "displacement"
    if test.travel is not None:
        abscissa, label = test.travel * system.factor("in"), "travel since the last slip or turn"
    _draw_along(travel_axes, abscissa[window], residual, half)
    travel_axes.set_xlabel(system.label(label, "in"))
    lags, bound = min(60, len(residual) // 4), 1.96 / np.sqrt(len(residual))
    lag_axes.axhspan(-bound, bound, color="#e6e6e6")
    lag_axes.acorr(residual - residual.mean(), maxlags=lags - 1, color=BLUE, linewidth=1.0)
    lag_axes.set(xlabel="lag, samples", xlim=(-1, lags))
    lag_axes.set_title("Autocorrelation\n(grey: independent noise, 95 %)", fontsize=8)
    for axes in (stage_axes, travel_axes):
        axes.set_ylabel(system.label("residual", "kip"))
        axes.axhline(0.0, color="#888888", linewidth=0.7)
    return figure


def _draw_by_stage(axes: Axes, residual: Array, half: Array, stage: Any) -> None:
    """Boxes of the residual in each stage, with the mean half width of the 95 % band there."""
    stage = np.ones(residual.size) if stage is None else stage
    masks = {name: stage == code for code, name in STAGES.items() if np.any(stage == code)}
    axes.boxplot(
        [residual[mask] for mask in masks.values()],
        tick_labels=[f"{name}\n{np.mean(mask):.0%}" for name, mask in masks.items()],
        whis=(2.5, 97.5),
        showfliers=False,
        patch_artist=True,
        widths=0.5,
        medianprops={"color": DATA},
        boxprops={"facecolor": _BLUE, "edgecolor": BLUE},
    )
    for position, mask in enumerate(masks.values(), start=1):
        width = float(half[mask].mean())
        axes.hlines(
            [-width, width], position - 0.4, position + 0.4, color=VERMILLION, linestyle="--"
        )
    axes.set_title("By stage: box 50 %, whiskers 95 %\ndashed: 95 % band", fontsize=8)


def _draw_along(axes: Axes, travel: Array, residual: Array, half: Array) -> None:
    """Residuals against travel, with the mean half width of the 95 % band in forty bins."""
    step = max(1, len(travel) // 3000)
    axes.plot(travel[::step], residual[::step], ".", color=DATA, markersize=1.6, alpha=0.6)
    edges = np.unique(np.quantile(travel, np.linspace(0, 1, 41)))
    if edges.size > 1:
        sums = np.histogram(travel, edges, weights=half)[0]
        mean = sums / np.maximum(np.histogram(travel, edges)[0], 1)
        lines = np.column_stack([-mean, mean])
        axes.plot(0.5 * (edges[1:] + edges[:-1]), lines, color=VERMILLION, linestyle="--")
    axes.set_title("Along the gap", fontsize=8)


@style()
def draw_truth(title: str, rows: Rows, symbols: Symbols) -> Figure | None:
    """Posterior median and 95 % interval over the truth, one line per quantity and test.

    Rows without a positive truth are left out, for nothing can be divided by it; None if no
    row remains.
    """
    valid_rows = [row for row in rows if row["truth"] > 0]
    if not valid_rows:
        return None
    names = list(dict.fromkeys(row["name"] for row in valid_rows))
    figure = new_figure(9, 1.3 + 0.12 * (len(names) + 0.25 * len(valid_rows)), title)
    axes = figure.subplots()
    kinds = {
        (True, True): (POSTERIOR, "o", 3, "interval holds the truth"),
        (True, False): (TRUTH, "X", 6, "interval misses the truth"),
        (False, True): (PRIOR, "o", 3, "not informed by the data"),
        (False, False): (PRIOR, "X", 6, ""),
    }
    reach, end, middles = 1.25, 0.0, []
    for number, name in enumerate(names):
        name_rows = [row for row in valid_rows if row["name"] == name]
        begin, end = end, end + 1.0 + 0.25 * len(name_rows)
        middles.append(0.5 * (begin + end))
        if number % 2:
            axes.axhspan(begin, end, color="#f4f4f4", zorder=0)
        for y, row in enumerate(name_rows):
            colour, marker, size, _ = kinds[bool(row["informed"]), bool(row["inside"])]
            lower, median, upper = (row[k] / row["truth"] for k in ("lower", "median", "upper"))
            axes.plot([lower, upper], [begin + 0.625 + 0.25 * y] * 2, color=colour, lw=1.2)
            axes.plot([median], [begin + 0.625 + 0.25 * y], marker, color=colour, ms=size)
            if row["informed"]:
                reach = max(reach, 1.05 * upper, 1.05 / max(lower, 0.1))
    axes.axvline(1.0, color=DATA, linewidth=1.2, zorder=1)
    axes.set_yticks(middles, [symbols.in_figure(name) for name in names], fontsize=9)
    axes.set_ylim(end, 0.0)
    axes.grid(visible=False, axis="y")
    reach = min(reach, 8.0)
    axes.set(xscale="log", xlim=(1.0 / reach, reach))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticks(
        [t for t in (0.125, 0.25, 0.5, 0.8, 1.0, 1.25, 2.0, 4.0, 8.0) if 1 / reach <= t <= reach]
    )
    axes.xaxis.set_major_formatter(_PLAIN)
    axes.set_xlabel("posterior ÷ truth (1 = truth), logarithmic; bars are 95 % intervals")
    legend = [kind for kind in kinds.values() if kind[3]]
    handles = [Line2D([], [], color=c, marker=m, ms=5, label=text) for c, m, _, text in legend]
    figure.legend(handles=handles, loc="outside lower left", ncols=3)
    return figure


OF_TEST = ("loops", "history", "residuals", "marginals", "corner", "ranks")
"""Figures of a test by the names of their files; one with nothing to show is left out."""

_MEDIAN = "#4db894"


def draw_shared(view: CampaignView) -> Iterator[tuple[str, Figure]]:
    """Figures that show all tests together, each with its key; without what has nothing to show."""
    system, unit, symbols = view.system, view.actuation_unit, Symbols(view.model)
    if view.tests:
        title = "Measured loops over their bands"
        yield "overview", draw_overview(title, view.tests, system, unit)
    if view.laws:
        title = "Quantities against the actuation"
        yield "laws", draw_laws(title, view.laws, system, unit, symbols)
    figure = draw_truth("Posterior against the known truth", view.truth, symbols)
    if figure is not None:
        yield "truth", figure


def draw_test(test: TestView, view: CampaignView) -> Iterator[tuple[str, Figure]]:
    """Figures of one test in the units of its report, each with its key, "tests/ID/loops".

    One with nothing to show is left out.
    """
    names, system = Symbols(view.model), view.system
    title = f"{test.id}, {system.actuation(test.trace, view.actuation_unit)}"
    motion = title, test.trace, [f for f in (test.observation, test.device) if f is not None]
    marginals = [
        Marginal(m.name, system.unit(m.unit), m.prior * factor, m.posterior * factor, m.contraction)
        for m in test.marginals
        for factor in [system.factor(m.unit)]
    ]
    figures = (
        draw_loops(*motion, system),
        draw_history(*motion, system, test.first),
        draw_residuals(f"{title}: residuals", test, system),
        draw_marginals(f"{title}: priors and posteriors", marginals, names),
        draw_corner(f"{title}: joint posterior", marginals, test.corner, names),
        draw_ranks(f"{title}: ranks of each chain", marginals, test.chains, names),
    )
    for name, figure in zip(OF_TEST, figures, strict=True):
        if figure is not None:
            yield f"tests/{test.id}/{name}", figure


@style()
def draw_laws(
    title: str, laws: Sequence[LawView], system: UnitSystem, actuation_unit: str, symbols: Symbols
) -> Figure:
    """One panel per law: the mean property with its bands, and the tests' 95 % intervals."""
    columns = min(3, len(laws))
    rows = -(-len(laws) // columns)
    figure = new_figure(max(4.0 * columns, 5.5), 2.75 * rows + 0.8, title)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat[len(laws) :]:
        axes.set_visible(False)
    for axes, law in zip(grid.flat, laws, strict=False):
        _draw_law(axes, law, system.factor(law.unit), system.factor(actuation_unit))
        axes.set_title(f"{symbols.in_figure(law.name)}: {plain(law.law)}")
        axes.set_ylabel(symbols.label(law.name, system.unit(law.unit)))
        axes.set_xlabel(plain(f"actuation, {system.unit(actuation_unit)}"))
    handles, texts = grid.flat[0].get_legend_handles_labels()
    figure.legend(handles, texts, loc="outside lower left", ncols=4)
    return figure


def _draw_law(axes: Axes, law: LawView, factor: float, actuation_factor: float) -> None:
    """A law in other units: its quantity times a factor, and its actuation times another."""
    actuation, device, again = (
        law.actuation * actuation_factor,
        law.device.times(factor),
        law.new_test.times(factor),
    )
    wide, _, dark = BANDS["new_test"]
    for fan, colour in ((again, wide), (device, _MEDIAN)):
        edges = fan.widest.lower, fan.widest.upper
        name = f"{BAND_NAMES[fan.kind]}, {percent(fan.widest.probability)} %"
        axes.fill_between(actuation, *edges, color=colour, linewidth=0, label=name)
    axes.plot(actuation, device.median, color=dark, label="best estimate")
    curves = [device.median]
    if law.tested:
        levels, *bounds = (np.array(column) for column in list(zip(*law.tested, strict=True))[1:])
        lower, median, upper = (factor * bound for bound in bounds)
        arms = np.maximum(0.0, [median - lower, upper - median])
        look_of: dict[str, Any] = {"fmt": "o", "color": DATA, "markersize": 3}
        axes.errorbar(
            spread(levels * actuation_factor), median, arms, label="tests, 95 %", lw=0.9, **look_of
        )
        curves += [lower, upper]
    low, high = (float(end(np.concatenate(curves))) for end in (np.min, np.max))
    low = min(low, float(np.min(again.widest.lower)))
    high = max(high, min(float(np.max(again.widest.upper)), 2.0 * high))  # it may go beyond
    margin = 0.05 * (high - low) or 0.1
    axes.set_ylim(0.0 if 0.0 <= low < 0.5 * high else low - margin, high + margin)
    at_zero = any(test[1] == 0.0 for test in law.tested)  # these stand side by side
    axes.set_xlim(-0.03 * actuation[-1] if at_zero else actuation[0], actuation[-1])


def spread(actuation: Array) -> Array:
    """Actuations of tests moved apart at each level, (n,), so that no bar hides another.

    All of them stay nearer to their own level than to the next one.
    """
    span = max(float(np.ptp(actuation)), 1e-3 * float(np.max(np.abs(actuation))))
    levels = np.unique(actuation)
    room = 0.5 * float(np.min(np.diff(levels), initial=span))
    shifted = actuation.astype(np.float64)
    for level in levels:
        indices = np.flatnonzero(actuation == level)
        step = min(0.012 * span, room / max(1, indices.size - 1))
        shifted[indices] += step * (np.arange(indices.size) - 0.5 * (indices.size - 1))
    return shifted
