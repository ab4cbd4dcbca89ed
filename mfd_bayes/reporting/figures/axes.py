"""Bands and loops on Matplotlib axes, for notebooks."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from mfd_bayes.errors import ReportError
from mfd_bayes.evaluation.views import Array, Fan
from mfd_bayes.records.motion import HYSTERESIS, turning_points
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting import colours
from mfd_bayes.reporting.figures import loops
from mfd_bayes.reporting.figures import style as look
from mfd_bayes.runs.unit_system import System


def new_axes() -> Axes:
    """Axes of a new figure: pyplot's where the caller has imported it, which notebooks show."""
    pyplot: Any = sys.modules.get("matplotlib.pyplot")
    figure = look.new_figure(7, 4) if pyplot is None else pyplot.figure(figsize=(7, 4))
    axes: Axes = figure.add_subplot()
    return axes


def checked_axes(axes: Any) -> Axes:
    """The axes that are given, or those of a new figure.

    Raises
    ------
    ReportError
        When something else is given.
    """
    if axes is None:
        return new_axes()
    if not isinstance(axes, Axes):
        raise ReportError(f"axes must be axes of Matplotlib, got {axes!r}")
    return axes


def draw_band(
    axes: Axes, fan: Fan, time: Array, displacement: Array | None, system: System
) -> Axes:
    """A band in the units of a system over time, s, or over a displacement of that system."""
    if displacement is None:
        loops.draw_bands(axes, time, fan)
        axes.plot(*loops.thinned(time, fan.median), color=colours.BANDS[fan.kind][2], lw=0.9)
        return _labelled(axes, "time, s", system, fan)
    turns = turning_points(displacement, HYSTERESIS * float(np.ptp(displacement)))
    loops.draw_loop(axes, [fan], displacement, turns)
    return _labelled(axes, f"displacement, {system.length}", system, fan)


def draw_measured(axes: Axes, trace: Trace, fan: Fan, system: System) -> Axes:
    """The measured loops of a trace over a band, both in the units of a system."""
    loops.draw_loop(axes, [fan], trace.displacement, trace.turning_points, trace.force)
    return _labelled(axes, f"displacement, {system.length}", system, fan)


def _labelled(axes: Axes, below: str, system: System, fan: Fan) -> Axes:
    axes.set(xlabel=below, ylabel=f"force, {system.force}")
    axes.set_title(f"{colours.BAND_NAMES[fan.kind]}, {look.percents(fan)}", fontsize=9)
    return axes
