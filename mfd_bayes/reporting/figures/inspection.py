"""A record as it was read, with its loops and its faults."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from mfd_bayes.reporting import symbols
from mfd_bayes.reporting.figures import agg as look
from mfd_bayes.reporting.figures.loops import POINTS, clock, thinned
from mfd_bayes.runs.unit_system import US, System

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mfd_bayes.evaluation.views import Array
    from mfd_bayes.records.data_quality import Fault
    from mfd_bayes.records.loops import Loops
    from mfd_bayes.records.trace import Trace

_SIGNS = ("v", "o", "s", "D", "P", "X", "^", "*")
_COLOURS = (
    *(symbols.VERMILLION, symbols.BLUE, symbols.GREEN),
    *(symbols.PURPLE, symbols.ORANGE, symbols.SKY),
)
_MARKS = 60  # more of one kind would hide the curve


@look.style()
def draw_inspection(
    title: str, trace: Trace, loops: Loops, faults: Sequence[Fault] = (), system: System = US
) -> Figure:
    """Loop, displacement and force over time, and energy per cycle of a record at its own rate.

    Faults are marked at their samples, if they have any, and named below the panels. Without
    a force there is only the displacement. Trace and loops are in the units of `system`.
    """
    figure, x, time = look.new_figure(10, 5.6, title), trace.displacement, trace.time
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
        loop.plot(x[::step], trace.force[::step], color=symbols.DATA, linewidth=0.5)
        loop.set(xlabel=system.label("displacement", "in"), ylabel=system.label("force", "kip"))
        loop.set_title(system.text("Force–displacement"))
        history.sharex(place)
        history.plot(*thinned(time, trace.force), color=symbols.DATA, linewidth=0.6)
        history.set(xlabel=clock(trace), ylabel=system.label("force", "kip"))
        history.set_title("Force")
        _draw_energy(panels["energy"], loops, system)
    turns = trace.turning_points
    place.plot(*thinned(time, x), color="#555555", linewidth=0.8)
    place.plot(time[turns], x[turns], ".", color="#999999", markersize=3)
    place.set(ylabel=system.label("displacement", "in"), xlabel=clock(trace))
    place.set_title(f"Displacement, {turns.size} turning points")
    place.margins(x=0.01, y=0.12)  # space for the marks at the turns
    handles, looks = [], zip(cycle(_SIGNS), cycle(_COLOURS), strict=False)
    for fault in faults:  # one without samples has no mark
        sign, colour = next(looks) if fault.samples.size else ("", symbols.DATA)
        at = fault.samples[:: max(1, -(-fault.samples.size // _MARKS))]
        mark: dict[str, Any] = {
            "marker": sign,
            "mfc": "none",
            "mec": colour,
            "mew": 1.1,
            "ms": 5,
            "ls": "",
        }
        for axes, across, up in curves if at.size else ():
            axes.plot(across[at], up[at], **mark)
        handles.append(Line2D([], [], label=f"warning: {fault.name}", **mark))
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
    faces = [symbols.BLUE if strong else "white" for strong in loops.strong]
    axes.scatter(number, loops.energy, s=16, c=faces, edgecolors=symbols.BLUE, linewidths=0.8)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
