"""Draws of one test: priors and posteriors, pairs, ranks of chains, residuals; and the truth."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from mfd_bayes.evaluation.checks import INFORMED
from mfd_bayes.evaluation.views import Array, Marginal, Rows, TestView
from mfd_bayes.reporting import colours
from mfd_bayes.reporting.figures import style as look
from mfd_bayes.reporting.symbols import Symbols
from mfd_bayes.runs.unit_system import System

CORNER_DRAWS, CORNER_QUANTITIES = 2000, 8
RANKS = 10
"""Bins of a rank plot."""
STAGES = {2: "stick", 4: "gap", 3: "build-up", 1: "slip"}
"""Stages in their order within a stroke."""

_COLUMNS = 4
_PLAIN = "{x:.4g}"  # of tick labels
_BLUE = colours.BANDS["observation"][1]


def _small_panels(title: str, number: int) -> tuple[Figure, list[Axes]]:
    """Panels in four columns; fixed margins are much faster than the constrained layout."""
    columns = min(_COLUMNS, number)
    rows = -(-number // columns)
    height = 1.4 * rows + 0.75
    figure = look.new_figure(10, height, layout="none")
    above = 1.0 - 0.08 / height
    figure.suptitle(title, x=0.01, y=above, ha="left", va="top")
    edges = {"left": 0.065, "right": 0.985, "top": 1 - 0.55 / height, "bottom": 0.65 / height}
    figure.subplots_adjust(**edges, wspace=0.28, hspace=0.75)
    return figure, [figure.add_subplot(rows, columns, at + 1) for at in range(number)]


@look.style()
def draw_ranks(
    title: str, marginals: Sequence[Marginal], chains: int, symbols: Symbols
) -> Figure | None:
    """Histogram of the ranks of each chain's draws among all draws, one panel per quantity.

    The lines of chains that agree stay near 1. None where nothing was sampled in several chains.
    """
    shown = [m for m in marginals if np.ptp(m.posterior) > 0]
    if chains < 2 or not shown:
        return None
    figure, panels = _small_panels(title, len(shown))
    for axes, marginal in zip(panels, shown, strict=True):
        for heights, colour in zip(rank_heights(marginal, chains), _cycle(chains), strict=True):
            axes.stairs(heights, np.linspace(0, 1, RANKS + 1), color=colour, linewidth=1.0)
        axes.axhline(1.0, color=colours.DATA, linewidth=0.6)
        axes.set_title(symbols.in_figure(marginal.name), fontsize=8)
        axes.set_ylim(0.0, max(2.0, axes.get_ylim()[1]))
        axes.set_xlim(0.0, 1.0)
        axes.tick_params(labelsize=7)
    figure.supxlabel("rank among the draws of all chains, as a share", fontsize=8, y=0.01)
    return figure


def rank_heights(marginal: Marginal, chains: int) -> Array:
    """Density of the ranks of each chain, (chain, `RANKS`); 1 where chains agree.

    The draws of a marginal stand chain by chain.
    """
    ranks = marginal.posterior.argsort(kind="stable").argsort() / marginal.posterior.size
    parts = np.array_split(ranks, chains)
    counts = [np.histogram(part, RANKS, (0.0, 1.0), density=True)[0] for part in parts]
    return np.array(counts)


def _cycle(number: int) -> list[str]:
    return [colours.CHAINS[i % len(colours.CHAINS)] for i in range(number)]


@look.style()
def draw_marginals(title: str, marginals: Sequence[Marginal], symbols: Symbols) -> Figure | None:
    """Densities of priors and posteriors, each scaled to its peak; skewed priors logarithmic.

    None where there are none.
    """
    if not marginals:
        return None
    figure, panels = _small_panels(title, len(marginals))
    for axes, marginal in zip(panels, marginals, strict=True):
        _draw_marginal(axes, marginal, symbols)
    handles = [
        Patch(facecolor="#dddddd", edgecolor=colours.PRIOR, label="prior"),
        Patch(facecolor=_BLUE, edgecolor=colours.POSTERIOR, label="posterior"),
    ]
    figure.legend(handles=handles, loc="upper right", ncols=2)
    return figure


def _draw_marginal(axes: Axes, marginal: Marginal, symbols: Symbols) -> None:
    prior, posterior = marginal.prior, marginal.posterior
    low, high = np.quantile(prior, [0.005, 0.995])
    low, high = min(low, posterior.min()), max(high, posterior.max())
    # a uniform prior is wide too, but belongs on a linear axis
    skewed = np.median(prior) - low < 0.5 * (high - np.median(prior))
    logarithmic = bool(min(prior.min(), posterior.min()) > 0 and high > 20.0 * low and skewed)
    space = np.geomspace if logarithmic else np.linspace
    for draws, face, edge in (
        (prior, "#dddddd", colours.PRIOR),
        (posterior, _BLUE, colours.POSTERIOR),
    ):
        first, last = np.quantile(draws, [0.002, 0.998])
        if not last > first:
            axes.axvline(first, color=edge)
            continue
        heights, edges = np.histogram(draws, space(first, last, 31))
        axes.stairs(heights / heights.max(), edges, fill=True, facecolor=face, alpha=0.75)
        axes.stairs(heights / heights.max(), edges, color=edge, linewidth=0.9)
    if logarithmic:
        axes.set_xscale("log")
    if high > low:
        axes.set_xlim(low, high)
    axes.set_ylim(0, 1.08)
    axes.set_yticks([])  # only relative heights matter
    axes.spines["left"].set_visible(False)
    axes.xaxis.set_minor_locator(NullLocator())
    steps = (1.0, 3.0) if high < 300.0 * low else (1.0,)
    logs = LogLocator(subs=steps, numticks=6)
    axes.xaxis.set_major_locator(logs if logarithmic else MaxNLocator(4))
    axes.xaxis.set_major_formatter(_PLAIN)
    axes.set_xlabel(symbols.label(marginal.name, marginal.unit), fontsize=8)
    axes.tick_params(labelsize=7)
    if marginal.contraction < INFORMED:
        axes.set_title("not informed by the data", fontsize=7.5, color=colours.VERMILLION)


@look.style()
def draw_corner(
    title: str, marginals: Sequence[Marginal], names: Sequence[str], symbols: Symbols
) -> Figure | None:
    """Pairs of quantities: contours of 39, 86 and 95 % of the draws, 95 % intervals dashed.

    Draws of the marginals belong together by their number. At most eight quantities are
    drawn, the first ones of `names`; None where fewer than two have draws that vary.
    """
    by_name = {m.name: m for m in marginals}
    chosen = [by_name[name] for name in names if name in by_name]
    chosen = [m for m in chosen if np.ptp(m.posterior) > 1e-12 * np.max(np.abs(m.posterior))]
    chosen = chosen[:CORNER_QUANTITIES]
    number = len(chosen)
    if number < 2 or len(chosen[0].posterior) <= CORNER_QUANTITIES:
        return None
    matplotlib.rcParams["axes.grid"] = False
    size = max(1.15 * number, 4.0)
    figure = look.new_figure(size, size, layout="none")
    figure.suptitle(title, x=0.01, y=0.985, ha="left")
    edges = {"left": 0.12, "bottom": 0.11, "right": 0.985, "top": 0.945}
    grid = figure.add_gridspec(number, number, wspace=0.05, hspace=0.05, **edges)
    stride = -(-len(chosen[0].posterior) // CORNER_DRAWS)
    draws = [marginal.posterior[::stride] for marginal in chosen]
    labels = [symbols.label(marginal.name, marginal.unit) for marginal in chosen]
    for row in range(number):
        for column in range(row + 1):
            axes = figure.add_subplot(grid[row, column])
            if row == column:
                _draw_histogram(axes, draws[row])
            else:
                _draw_contours(axes, draws[column], draws[row])
            last, first = row == number - 1, column == 0 and row > 0
            axes.xaxis.set_major_locator(MaxNLocator(3, prune="both") if last else NullLocator())
            axes.yaxis.set_major_locator(MaxNLocator(3, prune="both") if first else NullLocator())
            axes.tick_params(labelsize=7, labelrotation=45)
            if last:
                axes.set_xlabel(labels[column], fontsize=8)
                axes.xaxis.set_label_coords(0.5, -0.48)
            if first:
                axes.set_ylabel(labels[row], fontsize=8)
                axes.yaxis.set_label_coords(-0.48, 0.5)
    return figure


def _draw_histogram(axes: Axes, draws: Array) -> None:
    heights, edges = np.histogram(draws, 16)
    axes.stairs(heights, edges, color=colours.POSTERIOR)
    for quantile in np.quantile(draws, (0.025, 0.975)):
        axes.axvline(quantile, color=colours.POSTERIOR, linestyle="dashed")
    axes.set(xlim=(edges[0], edges[-1]), ylim=(0, 1.1 * heights.max()))


def _draw_contours(axes: Axes, across: Array, up: Array) -> None:
    _hist2d()(
        across,
        up,
        ax=axes,
        bins=16,
        smooth=0.8,
        color=colours.POSTERIOR,
        levels=(0.393, 0.865, 0.95),
        plot_datapoints=False,
        plot_density=False,
        fill_contours=True,
        no_fill_contours=True,  # no white background
    )


@cache
def _hist2d() -> Callable[..., None]:
    """The corner package's function, without the warnings of what it imports."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        from corner import hist2d
    drawn: Callable[..., None] = hist2d
    return drawn


@look.style()
def draw_residuals(title: str, test: TestView, system: System, symbols: Symbols) -> Figure | None:
    """Residuals of a test, in the units of `system`: by stage, along the gap, autocorrelation.

    None of a test that was not fitted.
    """
    if test.role == "validate":
        return None
    kept = slice(test.first, None)
    residual = (np.asarray(test.trace.force) - test.observation.median)[kept]
    widest = test.observation.widest
    half = 0.5 * (widest.upper - widest.lower)[kept]
    figure = look.new_figure(10, 3.4, title)
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.0, 1.6, 1.3))
    _draw_by_stage(left, residual, half, None if test.stage is None else test.stage[kept])
    residual_label = symbols.response(system, "residual")
    left.set_ylabel(residual_label)
    where, below = test.trace.displacement, symbols.motion(system)
    if test.travel is not None:
        where, below = test.travel, system.label("travel since the last slip or turn", "in")
    _draw_along(middle, where[kept], residual, half)
    middle.set(xlabel=below, ylabel=residual_label)
    _draw_autocorrelation(right, residual)
    for axes in (left, middle):
        axes.axhline(0.0, color="#888888", linewidth=0.7)
    return figure


def _draw_by_stage(axes: Axes, residual: Array, half: Array, stage: Any) -> None:
    """Boxes of the residual in each stage, with the mean half width of the 95 % band there."""
    stage = np.ones(residual.size) if stage is None else stage
    parts = [(name, stage == code) for code, name in STAGES.items() if np.any(stage == code)]
    boxes = axes.boxplot(
        [residual[there] for _, there in parts],
        whis=(2.5, 97.5),
        showfliers=False,
        patch_artist=True,
        widths=0.5,
        medianprops={"color": colours.DATA},
    )
    for box in boxes["boxes"]:
        box.set(facecolor=_BLUE, edgecolor=colours.BLUE)
    for at, (_, there) in enumerate(parts, start=1):
        width = float(half[there].mean())
        axes.hlines([-width, width], at - 0.4, at + 0.4, color=colours.VERMILLION, linestyle="--")
    names = [f"{name}\n{np.mean(there):.0%}" for name, there in parts]
    axes.set_xticks(range(1, len(parts) + 1), names)
    axes.set_title("By stage: box 50 %, whiskers 95 %\ndashed: 95 % band", fontsize=8)


def _draw_along(axes: Axes, where: Array, residual: Array, half: Array) -> None:
    """Residuals against travel, with the mean half width of the 95 % band in forty bins."""
    step = max(1, len(where) // 3000)
    axes.plot(where[::step], residual[::step], ".", color=colours.DATA, markersize=1.6, alpha=0.6)
    edges = np.unique(np.quantile(where, np.linspace(0, 1, 41)))
    at = np.clip(np.digitize(where, edges) - 1, 0, len(edges) - 2)
    count = np.bincount(at, minlength=len(edges) - 1)
    mean = np.bincount(at, half, minlength=len(edges) - 1) / np.maximum(count, 1)
    centre = 0.5 * (edges[1:] + edges[:-1])
    for sign in (-1, 1):
        line = centre[count > 0], sign * mean[count > 0]
        axes.plot(*line, color=colours.VERMILLION, linestyle="--")
    axes.set_title("Along the gap", fontsize=8)


def _draw_autocorrelation(axes: Axes, residual: Array) -> None:
    """Autocorrelation of the residual, with the 95 % band of independent noise."""
    centred = residual - residual.mean()
    lags = min(60, len(centred) // 4)
    power = float(centred @ centred) or 1.0
    values = [float(centred[lag:] @ centred[: len(centred) - lag]) / power for lag in range(lags)]
    bound = 1.96 / np.sqrt(len(centred))
    axes.axhspan(-bound, bound, color="#e6e6e6")
    axes.vlines(range(lags), 0.0, values, color=colours.BLUE, linewidth=1.0)
    axes.axhline(0.0, color="#888888", linewidth=0.7)
    axes.set(xlabel="lag, samples", ylim=(min(-0.3, *values, -bound), 1.05))
    axes.set_title("Autocorrelation\n(grey: independent noise, 95 %)", fontsize=8)


@look.style()
def draw_truth(title: str, rows: Rows, symbols: Symbols) -> Figure | None:
    """Posterior median and 95 % interval over the truth, one line per quantity and test.

    Rows without a positive truth are left out, for nothing can be divided by it; None if no
    row remains.
    """
    kept = [row for row in rows if row["truth"] > 0]
    if not kept:
        return None
    names = list(dict.fromkeys(row["name"] for row in kept))
    groups = [[row for row in kept if row["name"] == name] for name in names]
    heights = np.array([1.0 + 0.25 * len(group) for group in groups])
    ends = np.cumsum(heights)
    figure = look.new_figure(9, 1.3 + 0.12 * float(ends[-1]), title)
    axes = figure.subplots()
    for group, end, height in zip(groups, ends, heights, strict=True):
        for at, row in enumerate(group):
            colour = colours.POSTERIOR if row["inside"] else colours.TRUTH
            colour = colour if row["informed"] else colours.PRIOR
            y = end - height + 0.625 + 0.25 * at
            lower, median, upper = (row[k] / row["truth"] for k in ("lower", "median", "upper"))
            axes.plot([lower, upper], [y, y], color=colour, lw=1.2)
            marker, size = ("o", 3) if row["inside"] else ("X", 6)
            axes.plot([median], [y], marker, color=colour, ms=size)
    for end, height in zip(ends[1::2], heights[1::2], strict=True):
        axes.axhspan(end - height, end, color="#f4f4f4", zorder=0)
    axes.axvline(1.0, color=colours.DATA, linewidth=1.2, zorder=1)
    axes.set_yticks(ends - 0.5 * heights, [symbols.in_figure(name) for name in names], fontsize=9)
    axes.set_ylim(ends[-1], 0.0)
    axes.grid(visible=False, axis="y")
    informed = [row for row in kept if row["informed"]] or kept
    widest = max(
        max(r["upper"] / r["truth"], r["truth"] / max(r["lower"], 1e-12)) for r in informed
    )
    reach = float(np.clip(1.05 * widest, 1.25, 8.0))
    ticks = (0.125, 0.25, 0.5, 0.8, 1.0, 1.25, 2.0, 4.0, 8.0)
    axes.set_xscale("log")
    axes.set_xlim(1.0 / reach, reach)
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticks([tick for tick in ticks if 1 / reach <= tick <= reach])
    axes.xaxis.set_major_formatter(_PLAIN)
    axes.set_xlabel("posterior ÷ truth (1 = truth), logarithmic; bars are 95 % intervals")
    kinds = (
        (colours.POSTERIOR, "o", "interval holds the truth"),
        (colours.TRUTH, "X", "interval misses the truth"),
        (colours.PRIOR, "o", "not informed by the data"),
    )
    handles = [Line2D([], [], color=c, marker=m, ms=5, label=text) for c, m, text in kinds]
    figure.legend(handles=handles, loc="outside lower left", ncols=3)
    return figure
