"""Which test to make next: expected gain over actuation and frequency, and over further tests."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from mfd_bayes.planning.study import Advice
from mfd_bayes.reporting import colours
from mfd_bayes.reporting.figures import style as look
from mfd_bayes.runs.unit_system import System

_MAP = "YlGnBu"


@look.style()
def draw_next(advice: Advice, system: System, unit: str, title: str) -> Figure:
    """Candidates by actuation and frequency, coloured by gain, and the curve of the width."""
    figure = look.new_figure(8.6, 3.6)
    figure.suptitle(title, x=0.01, ha="left", wrap=True, fontsize=9)
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    _draw_candidates(figure, left, advice, (system, unit))
    _draw_curve(right, advice, system)
    return figure


def _draw_candidates(figure: Figure, axes: Axes, advice: Advice, units: tuple[System, str]) -> None:
    """The best of the candidates at each actuation and frequency."""
    system, unit = units
    by, name = system.of_actuation(unit)
    best: dict[tuple[float, float], float] = {}
    for row in advice:
        key = row.candidate.actuation * by, row.candidate.frequency
        best[key] = max(best.get(key, 0.0), 100.0 * row.reduction)
    across, up = np.array(list(best)).T
    gains = np.array(list(best.values()))
    shown = axes.scatter(
        across, up, c=gains, s=130, cmap=_MAP, vmin=0.0, edgecolors="#888888", linewidths=0.5
    )
    first = advice[0].candidate
    axes.scatter(
        *([first.actuation * by], [first.frequency]),
        s=240,
        facecolors="none",
        edgecolors=colours.DATA,
        linewidths=1.6,
        label="best",
    )
    axes.scatter(
        [test.actuation * by for test in advice.tests],
        [test.frequency for test in advice.tests],
        marker="x",
        s=28,
        color="#c0392b",
        zorder=4,
        label="tests made",
    )
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.yaxis.set_minor_formatter(ScalarFormatter())
    axes.set_xlabel(f"actuation, {name}")
    axes.set_ylabel("frequency, Hz")
    axes.set_title("Expected reduction, best amplitude", fontweight="normal", fontsize=9)
    axes.margins(0.12)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)
    figure.colorbar(shown, ax=axes, label="%")


def _draw_curve(axes: Axes, advice: Advice, system: System) -> None:
    """Expected width against the number of further tests, with 95 % intervals."""
    curve = advice.curve * system.factor(advice.unit)
    errors = [0.0, *(1.96 * t.gain.error for t in advice.together)]
    arms = curve[0] * np.array(errors)
    axes.errorbar(
        np.arange(curve.size), curve, arms, fmt="o-", color=colours.DATA, markersize=4, capsize=2
    )
    axes.set_ylim(0.0, 1.1 * float(np.max(curve + arms)))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("further tests, the best together")
    axes.set_ylabel(f"expected width, {system.unit(advice.unit)}")
    axes.set_title("When it is enough", fontweight="normal", fontsize=9)
