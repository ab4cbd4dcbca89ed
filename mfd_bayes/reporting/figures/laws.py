"""Quantities against actuation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mfd_bayes.evaluation.views import Fan, LawView
from mfd_bayes.reporting import colours
from mfd_bayes.reporting.figures import style as look
from mfd_bayes.reporting.symbols import in_figure, label, plain
from mfd_bayes.runs.unit_system import PRESSURES
from mfd_bayes.units import percent

_ACTUATION = {
    "ksi": "pressure, ksi",
    **{unit: f"pressure, {unit}" for unit in ("MPa", *PRESSURES)},
    "kip": "band tension, kip",
    "kN": "band tension, kN",
}
_MEDIAN = "#4db894"


@look.style()
def draw_laws(title: str, laws: Sequence[LawView], actuation_unit: str) -> Figure | None:
    """One panel per law: the mean property with its bands, and the tests' 95 % intervals.

    None where there is no law.
    """
    if not laws:
        return None
    columns = min(2, len(laws))
    rows = -(-len(laws) // columns)
    figure = look.new_figure(max(3.4 * columns, 5.5), 2.75 * rows + 0.8)
    figure.suptitle(plain(title), x=0.01, ha="left")
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes, law in zip(grid.flat, laws, strict=False):
        _draw_law(axes, law)
        axes.set_xlabel(_ACTUATION.get(actuation_unit, plain(f"actuation, {actuation_unit}")))
    for axes in grid.flat[len(laws) :]:
        axes.set_visible(False)
    handles, texts = grid.flat[0].get_legend_handles_labels()
    figure.legend(handles, texts, loc="outside lower left", ncols=4)
    return figure


def _draw_law(axes: Axes, law: LawView) -> None:
    wide, _, dark = colours.BANDS["new_test"]
    _fill(axes, law, law.new_test, wide, colours.BAND_NAMES["new_test"])
    _fill(axes, law, law.device, _MEDIAN, colours.BAND_NAMES["device"])
    axes.plot(law.actuation, law.device.median, color=dark, label="best estimate")
    if law.tested:
        _, at, lower, median, upper = zip(*law.tested, strict=True)
        middle = np.asarray(median)
        arms = np.maximum(0.0, [middle - np.asarray(lower), np.asarray(upper) - middle])
        axes.errorbar(
            *(_apart(np.asarray(at)), middle, arms),
            fmt="o",
            color=colours.DATA,
            markersize=3,
            linewidth=0.9,
            label="tests, 95 %",
        )
    axes.set_title(f"{in_figure(law.name)}: {plain(law.law)}", fontweight="normal", fontsize=9)
    axes.set_ylabel(label(law.name, law.unit))
    axes.set_ylim(*_limits(law))
    axes.margins(x=0.0)
    if any(test[1] == 0 for test in law.tested):  # room for tests at zero, side by side
        axes.set_xlim(left=-0.03 * law.actuation[-1])


def _fill(axes: Axes, law: LawView, fan: Fan, colour: str, name: str) -> None:
    widest = max(fan.intervals, key=lambda interval: interval.probability, default=None)
    if widest is not None:
        text = f"{name}, {percent(widest.probability)} %"
        axes.fill_between(
            law.actuation, widest.lower, widest.upper, color=colour, linewidth=0, label=text
        )


def _apart(actuation: np.ndarray) -> np.ndarray:
    """Actuations of the tests, moved apart at each level so that no bar hides another.

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
