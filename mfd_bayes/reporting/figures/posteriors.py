"""Draws of parameters: chains, priors and posteriors, pairs, and the truth."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cache

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from mfd_bayes.evaluation.checks import INFORMED
from mfd_bayes.evaluation.views import Array, Marginal, TruthRow
from mfd_bayes.reporting import colours
from mfd_bayes.reporting.figures import style as look
from mfd_bayes.reporting.figures.panels import COLUMNS, in_rows, of_pairs
from mfd_bayes.reporting.symbols import in_figure, label, plain

CORNER_DRAWS = 2000
CORNER_QUANTITIES = 8
_STEPS = 300  # of a chain: a screen cannot show more
_LOG_RANGE = 20.0
_PLAIN = "{x:.4g}"  # of tick labels
_BINS = 16
_QUANTILES = (0.025, 0.975)
_PAIR = {
    "bins": _BINS,
    "smooth": 0.8,
    "color": colours.POSTERIOR,
    "levels": (0.393, 0.865, 0.95),
    "plot_datapoints": False,
    "plot_density": False,
    "fill_contours": True,
    "no_fill_contours": True,  # no white background
}
_LABELS = 0.48  # distance from a panel of pairs, of its size
_CLIP = 8.0  # largest ratio to the truth on the axis


@look.style()
def draw_corner(title: str, marginals: Sequence[Marginal], names: Sequence[str]) -> Figure | None:
    """Pairs of quantities: contours of 39, 86 and 95 % of the draws, 95 % intervals dashed.

    Draws of the marginals belong together by their number. At most eight quantities are
    drawn, the first ones of `names`; None where fewer than two have draws that vary.
    """
    chosen = _varying(marginals, names)
    if len(chosen) < 2:
        return None
    matplotlib.rcParams["axes.grid"] = False
    figure, panels = of_pairs(title, len(chosen))
    stride = -(-len(chosen[0].posterior) // CORNER_DRAWS)
    draws = [marginal.posterior[::stride] for marginal in chosen]
    pairs = [(row, column) for row in range(len(chosen)) for column in range(row + 1)]
    for axes, (row, column) in zip(panels, pairs, strict=True):
        _draw_pair(axes, draws[column], draws[row])
        places = {"last": row == len(chosen) - 1, "first": column == 0}
        _outer_labels(axes, chosen[column], chosen[row], **places)
    return figure


@look.style()
def draw_chains(title: str, chains: Mapping[str, Array], units: Mapping[str, str]) -> Figure:
    """Each sampled quantity along the run, one colour per chain, (chain, draw) each."""
    figure, panels = in_rows("chains", title, len(chains))
    for at, (axes, (name, values)) in enumerate(zip(panels, chains.items(), strict=True)):
        step = max(1, values.shape[1] // _STEPS)
        draws = np.arange(0, values.shape[1], step)
        for chain, colour in zip(values, _cycle(len(values)), strict=True):
            axes.plot(draws, chain[::step], color=colour, linewidth=0.6, antialiased=False)
        axes.set_title(label(name, units.get(name, "")), fontsize=8, fontweight="normal")
        axes.tick_params(labelsize=7)
        axes.margins(x=0.01)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_formatter(_PLAIN)
        if at + COLUMNS < len(panels):
            axes.tick_params(labelbottom=False)
    figure.supxlabel("kept step of the sampler (mean over walkers)", fontsize=8, y=0.01)
    return figure


@look.style()
def draw_marginals(title: str, marginals: Sequence[Marginal]) -> Figure:
    """Densities of priors and posteriors, each scaled to its peak; wide ranges logarithmic."""
    figure, panels = in_rows("marginals", title, len(marginals))
    for axes, marginal in zip(panels, marginals, strict=True):
        _draw_marginal(axes, marginal)
    handles = [
        Patch(facecolor="#dddddd", edgecolor=colours.PRIOR, label="prior"),
        Patch(
            facecolor=colours.BANDS["observation"][1],
            edgecolor=colours.POSTERIOR,
            label="posterior",
        ),
    ]
    figure.legend(handles=handles, loc="upper right", ncols=2)
    return figure


@look.style()
def draw_truth(title: str, rows: Sequence[TruthRow]) -> Figure | None:
    """Posterior median and 95 % interval over the truth, one line per quantity and test.

    Rows without a positive truth are left out, for nothing can be divided by it; None if no
    row remains.
    """
    kept = [row for row in rows if row.truth > 0]
    if not kept:
        return None
    names = list(dict.fromkeys(row.name for row in kept))
    groups = [[row for row in kept if row.name == name] for name in names]
    heights = np.array([1.0 + 0.45 * len(group) for group in groups])
    ends = np.cumsum(heights)
    figure = look.new_figure(9, 1.3 + 0.15 * float(ends[-1]))
    figure.suptitle(plain(title), x=0.01, ha="left")
    axes = figure.subplots()
    for group, end, height in zip(groups, ends, heights, strict=True):
        for at, row in enumerate(group):
            _draw_ratio(axes, row, end - height + 0.725 + 0.45 * at)
    for end, height in zip(ends[1::2], heights[1::2], strict=True):
        axes.axhspan(end - height, end, color="#f4f4f4", zorder=0)
    axes.axvline(1.0, color=colours.DATA, linewidth=1.2, zorder=1)
    symbols = [in_figure(name) for name in names]
    axes.set_yticks(ends - 0.5 * heights, symbols, fontsize=9)
    axes.set_ylim(ends[-1], 0.0)
    axes.grid(visible=False, axis="y")
    _ratio_axis(axes, kept)
    _truth_legend(figure)
    return figure


@cache
def _hist2d() -> Callable[..., None]:
    """The corner package's function, without the warnings of what it imports."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        from corner import hist2d
    drawn: Callable[..., None] = hist2d
    return drawn


def _draw_pair(axes: Axes, across: Array, up: Array) -> None:
    """Contours of two quantities; the histogram of one where both are the same."""
    if across is not up:
        _hist2d()(across, up, ax=axes, **_PAIR)
        return
    heights, edges = np.histogram(across, _BINS)
    axes.stairs(heights, edges, color=colours.POSTERIOR)
    for quantile in np.quantile(across, _QUANTILES):
        axes.axvline(quantile, color=colours.POSTERIOR, linestyle="dashed")
    axes.set(xlim=(edges[0], edges[-1]), ylim=(0, 1.1 * heights.max()))


def _outer_labels(
    axes: Axes, beside: Marginal, below: Marginal, *, last: bool, first: bool
) -> None:
    """Ticks and labels at the left and the bottom only: drawing ticks takes most of the time."""
    axes.xaxis.set_major_locator(MaxNLocator(3, prune="both") if last else NullLocator())
    named = first and beside is not below
    axes.yaxis.set_major_locator(MaxNLocator(3, prune="both") if named else NullLocator())
    axes.tick_params(labelsize=7, labelrotation=45)
    if last:
        axes.set_xlabel(label(beside.name, beside.unit), fontsize=8)
        axes.xaxis.set_label_coords(0.5, -_LABELS)
    if named:
        axes.set_ylabel(label(below.name, below.unit), fontsize=8)
        axes.yaxis.set_label_coords(-_LABELS, 0.5)


def _varying(marginals: Sequence[Marginal], names: Sequence[str]) -> list[Marginal]:
    by_name = {m.name: m for m in marginals}
    found = [by_name[name] for name in names if name in by_name]
    found = [m for m in found if np.ptp(m.posterior) > 1e-12 * np.max(np.abs(m.posterior))]
    found = [m for m in found if len(m.posterior) == len(found[0].posterior)]
    enough = bool(found) and len(found[0].posterior) > CORNER_QUANTITIES
    return found[:CORNER_QUANTITIES] if enough else []


def _cycle(number: int) -> list[str]:
    return [colours.CHAINS[i % len(colours.CHAINS)] for i in range(number)]


def _draw_marginal(axes: Axes, marginal: Marginal) -> None:
    both = np.concatenate([marginal.prior, marginal.posterior])
    low, high = np.quantile(marginal.prior, [0.005, 0.995])
    low = min(low, marginal.posterior.min())
    high = max(high, marginal.posterior.max())
    # a uniform prior is wide too, but belongs on a linear axis: only skewed ones are logarithmic
    skewed = np.median(marginal.prior) - low < 0.5 * (high - np.median(marginal.prior))
    logarithmic = bool(both.min() > 0 and high > _LOG_RANGE * low and skewed)
    if logarithmic:
        axes.set_xscale("log")
    _draw_density(axes, marginal.prior, logarithmic, "#dddddd", colours.PRIOR)
    blue = colours.BANDS["observation"][1]
    _draw_density(axes, marginal.posterior, logarithmic, blue, colours.POSTERIOR)
    if high > low:
        axes.set_xlim(low, high)
    axes.set_ylim(0, 1.08)
    axes.set_xlabel(label(marginal.name, marginal.unit), fontsize=8)
    axes.tick_params(labelsize=7)
    look.no_ticks(axes)
    _few_ticks(axes, logarithmic)
    if marginal.contraction < INFORMED:
        axes.set_title("not informed by the data", fontsize=7.5, color=colours.VERMILLION)


def _few_ticks(axes: Axes, logarithmic: bool) -> None:
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_locator(MaxNLocator(4))
    if logarithmic:
        low, high = axes.get_xlim()
        steps = (1.0, 3.0) if high < 300.0 * low else (1.0,)
        axes.xaxis.set_major_locator(LogLocator(subs=steps, numticks=6))
    axes.xaxis.set_major_formatter(_PLAIN)


def _draw_density(axes: Axes, draws: Array, logarithmic: bool, face: str, edge: str) -> None:
    low, high = np.quantile(draws, [0.002, 0.998])
    if not high > low:
        axes.axvline(low, color=edge)
        return
    edges = np.geomspace(low, high, 31) if logarithmic else np.linspace(low, high, 31)
    heights, _ = np.histogram(draws, edges)
    axes.stairs(heights / heights.max(), edges, fill=True, facecolor=face, alpha=0.75)
    axes.stairs(heights / heights.max(), edges, color=edge, linewidth=0.9)


def _draw_ratio(axes: Axes, row: TruthRow, at: float) -> None:
    colour = (
        colours.PRIOR if not row.informed else colours.POSTERIOR if row.inside else colours.TRUTH
    )
    axes.plot([row.lower / row.truth, row.upper / row.truth], [at, at], color=colour, lw=1.2)
    marker = "o" if row.inside else "X"
    axes.plot([row.median / row.truth], [at], marker, color=colour, ms=3 if row.inside else 6)


def _ratio_axis(axes: Axes, rows: Sequence[TruthRow]) -> None:
    told = [row for row in rows if row.informed] or list(rows)
    widest = max(max(row.upper / row.truth, row.truth / max(row.lower, 1e-12)) for row in told)
    reach = float(np.clip(1.05 * widest, 1.25, _CLIP))
    axes.set_xscale("log")
    axes.set_xlim(1.0 / reach, reach)
    ticks = [
        t for t in (0.125, 0.25, 0.5, 0.8, 1.0, 1.25, 2.0, 4.0, 8.0) if 1 / reach <= t <= reach
    ]
    axes.xaxis.set_major_locator(NullLocator())
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticks(ticks)
    axes.xaxis.set_major_formatter(_PLAIN)
    axes.set_xlabel("posterior ÷ truth (1 = truth), logarithmic; bars are 95 % intervals")


def _truth_legend(figure: Figure) -> None:
    kinds = (
        (colours.POSTERIOR, "o", "interval holds the truth"),
        (colours.TRUTH, "X", "interval misses the truth"),
        (colours.PRIOR, "o", "not informed by the data"),
    )
    handles = [Line2D([], [], color=c, marker=m, ms=5, label=text) for c, m, text in kinds]
    figure.legend(handles=handles, loc="outside lower left", ncols=3)
