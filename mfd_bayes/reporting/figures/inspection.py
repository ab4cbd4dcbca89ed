"""A record as it was read, with its loops and its faults."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mfd_bayes.records.data_quality import Fault
from mfd_bayes.records.loops import Loops
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting import colours
from mfd_bayes.reporting.figures import style as look
from mfd_bayes.reporting.figures.loops import POINTS, clock, thinned
from mfd_bayes.runs.unit_system import US, System

_SIGNS = ("v", "o", "s", "D", "P", "X", "^", "*")
_COLOURS = (
    colours.VERMILLION,
    colours.BLUE,
    colours.GREEN,
    colours.PURPLE,
    colours.ORANGE,
    colours.SKY,
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
    marked = [fault for fault in faults if fault.samples.size]
    figure = look.new_figure(10, 5.6, title)
    if trace.force is None:
        _draw_displacement(figure.subplots(), trace, marked, system)
    else:
        panels = figure.subplot_mosaic(
            [["loop", "displacement"], ["loop", "force"], ["energy", "force"]],
            width_ratios=(1.0, 1.35),
            height_ratios=(1.0, 1.0, 1.0),
        )
        _draw_loop(panels["loop"], trace, marked, system)
        _draw_displacement(panels["displacement"], trace, marked, system)
        panels["force"].sharex(panels["displacement"])
        _draw_force(panels["force"], trace, marked, system)
        _draw_energy(panels["energy"], loops, system)
    _legend(figure, faults)
    return figure


def _draw_loop(axes: Axes, trace: Trace, marked: list[Fault], system: System) -> None:
    step = max(1, trace.samples // (2 * POINTS))
    x, force = trace.displacement, np.asarray(trace.force)
    axes.plot(x[::step], force[::step], color=colours.DATA, linewidth=0.5)
    axes.set(xlabel=system.label("displacement", "in"), ylabel=system.label("force", "kip"))
    axes.set_title(system.text("Force–displacement"))
    _mark(axes, x, force, marked)


def _draw_displacement(axes: Axes, trace: Trace, marked: list[Fault], system: System) -> None:
    axes.plot(*thinned(trace.time, trace.displacement), color="#555555", linewidth=0.8)
    turns = trace.turning_points
    axes.plot(trace.time[turns], trace.displacement[turns], ".", color="#999999", markersize=3)
    axes.set(ylabel=system.label("displacement", "in"), xlabel=clock(trace))
    axes.set_title(f"Displacement, {turns.size} turning points")
    axes.margins(x=0.01, y=0.12)  # space for the marks at the turns
    _mark(axes, trace.time, trace.displacement, marked)


def _draw_force(axes: Axes, trace: Trace, marked: list[Fault], system: System) -> None:
    force = np.asarray(trace.force)
    axes.plot(*thinned(trace.time, force), color=colours.DATA, linewidth=0.6)
    axes.set(xlabel=clock(trace), ylabel=system.label("force", "kip"))
    axes.set_title("Force")
    _mark(axes, trace.time, force, marked)


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
    faces = [colours.BLUE if strong else "white" for strong in loops.strong]
    axes.scatter(number, loops.energy, s=16, c=faces, edgecolors=colours.BLUE, linewidths=0.8)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))


def _mark(
    axes: Axes, abscissa: NDArray[np.float64], ordinate: NDArray[np.float64], marked: list[Fault]
) -> None:
    for number, fault in enumerate(marked):
        at = fault.samples[:: max(1, -(-fault.samples.size // _MARKS))]
        sign, colour = _look_of(number)
        axes.plot(
            *(abscissa[at], ordinate[at], sign),
            markersize=5,
            markerfacecolor="none",
            markeredgecolor=colour,
            markeredgewidth=1.1,
        )


def _legend(figure: Figure, faults: Sequence[Fault]) -> None:
    """Every fault by name; one without samples has no mark."""
    handles, number = [], 0
    for fault in faults:
        sign, colour = "", colours.DATA
        if fault.samples.size:
            sign, colour = _look_of(number)
            number += 1
        handles.append(
            Line2D(
                *([], []),
                linestyle="",
                marker=sign,
                markerfacecolor="none",
                markeredgecolor=colour,
                label=f"warning: {fault.name}",
            )
        )
    if handles:
        figure.legend(handles=handles, loc="outside lower left", ncols=4)


def _look_of(number: int) -> tuple[str, str]:
    return _SIGNS[number % len(_SIGNS)], _COLOURS[number % len(_COLOURS)]
