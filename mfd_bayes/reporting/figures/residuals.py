"""Residuals of a fit: by stage, along the gap, and their autocorrelation."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mfd_bayes.evaluation.views import Array, TestView
from mfd_bayes.reporting import colours
from mfd_bayes.reporting.figures import style as look
from mfd_bayes.reporting.symbols import plain
from mfd_bayes.runs.unit_system import US, System

STAGES = {2: "stick", 4: "gap", 3: "build-up", 1: "slip"}
"""Stages in their order within a stroke."""

_POINTS = 3000
_LAGS = 60


@look.style()
def draw_residuals(title: str, test: TestView, system: System = US) -> Figure:
    """Residuals of a test, in the units of `system`: by stage, along the gap, autocorrelation."""
    kept = slice(test.first, None)
    residual = (np.asarray(test.trace.force) - test.observation.median)[kept]
    half = _half_width(test)[kept]
    figure = look.new_figure(10, 3.4)
    figure.suptitle(plain(title), x=0.01, ha="left")
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.0, 1.6, 1.3))
    stage = np.ones(len(residual)) if test.stage is None else test.stage[kept]
    _by_stage(left, residual, half, stage)
    left.set_ylabel(f"residual, {system.force}")
    where, text = _along(test, system)
    _along_gap(middle, where[kept], residual, half)
    middle.set(xlabel=text, ylabel=f"residual, {system.force}")
    _autocorrelation(right, residual)
    return figure


def _half_width(test: TestView) -> Array:
    widest = max(test.observation.intervals, key=lambda interval: interval.probability)
    return 0.5 * (widest.upper - widest.lower)


def _by_stage(axes: Axes, residual: Array, half: Array, stage: NDArray[np.generic]) -> None:
    """Boxes of the residual in each stage, with the mean half width of the 95 % band there."""
    known = [(name, stage == number) for number, name in STAGES.items() if np.any(stage == number)]
    boxes = axes.boxplot(
        [residual[at] for _, at in known],
        whis=(2.5, 97.5),
        showfliers=False,
        patch_artist=True,
        widths=0.5,
        medianprops={"color": colours.DATA},
    )
    for box in boxes["boxes"]:
        box.set(facecolor=colours.BANDS["observation"][1], edgecolor=colours.BLUE)
    for at, (_, there) in enumerate(known, start=1):
        width = float(half[there].mean())
        axes.hlines([-width, width], at - 0.4, at + 0.4, color=colours.VERMILLION, linestyle="--")
    axes.set_xticks(
        range(1, len(known) + 1), [f"{name}\n{np.mean(there):.0%}" for name, there in known]
    )
    axes.axhline(0.0, color="#888888", linewidth=0.7)
    _head(axes, "By stage: box 50 %, whiskers 95 %\ndashed: 95 % band")


def _along(test: TestView, system: System) -> tuple[Array, str]:
    """Abscissa of the residuals: travel since the last slip, or displacement; with its label."""
    if test.travel is None:
        return test.trace.displacement, f"displacement, {system.length}"
    return test.travel, f"travel since the last slip or turn, {system.length}"


def _along_gap(axes: Axes, where: Array, residual: Array, half: Array) -> None:
    step = max(1, len(where) // _POINTS)
    axes.plot(where[::step], residual[::step], ".", color=colours.DATA, markersize=1.6, alpha=0.6)
    edges = np.unique(np.quantile(where, np.linspace(0, 1, 41)))
    at = np.clip(np.digitize(where, edges) - 1, 0, len(edges) - 2)
    count = np.bincount(at, minlength=len(edges) - 1)
    mean = np.bincount(at, half, minlength=len(edges) - 1) / np.maximum(count, 1)
    centre = 0.5 * (edges[1:] + edges[:-1])
    for sign in (-1, 1):
        axes.plot(
            centre[count > 0], sign * mean[count > 0], color=colours.VERMILLION, linestyle="--"
        )
    axes.axhline(0.0, color="#888888", linewidth=0.7)
    _head(axes, "Along the gap")


def _autocorrelation(axes: Axes, residual: Array) -> None:
    """Autocorrelation of the residual, with the 95 % band of independent noise."""
    centred = residual - residual.mean()
    lags = min(_LAGS, len(centred) // 4)
    power = float(centred @ centred) or 1.0
    known = [float(centred[lag:] @ centred[: len(centred) - lag]) / power for lag in range(lags)]
    bound = 1.96 / np.sqrt(len(centred))
    axes.axhspan(-bound, bound, color="#e6e6e6")
    axes.vlines(range(lags), 0.0, known, color=colours.BLUE, linewidth=1.0)
    axes.axhline(0.0, color="#888888", linewidth=0.7)
    axes.set(xlabel="lag, samples", ylim=(min(-0.3, *known, -bound), 1.05))
    _head(axes, "Autocorrelation\n(grey: independent noise, 95 %)")


def _head(axes: Axes, text: str) -> None:
    axes.set_title(text, fontsize=8, fontweight="normal")
