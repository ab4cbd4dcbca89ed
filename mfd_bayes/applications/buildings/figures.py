"""The response of a building: the building itself, drift profile, histories, loops and sweep."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from mfd_bayes.applications.buildings.building import Building
from mfd_bayes.applications.buildings.response import Response, Sweep
from mfd_bayes.reporting.figures import new_figure, style
from mfd_bayes.reporting.symbols import BANDS, ORANGE, VERMILLION, plain
from mfd_bayes.runs.unit_system import UnitSystem
from mfd_bayes.units import GRAVITY

Array = NDArray[np.float64]

_WIDE, _NARROW, _MIDDLE = BANDS["new_test"]
_BARE, _PLAIN = "#777777", ORANGE
DAMPERS = 12  # most loops that are drawn


@style()
def draw_building(building: Building, system: UnitSystem) -> Figure:
    """The building to scale, with its dampers."""
    heights = np.where(np.isfinite(building.heights), building.heights, 144.0)
    level = np.concatenate([[0.0], np.cumsum(heights)])
    width = max(1.2 * float(heights.mean()), 0.25 * float(level[-1]))
    figure = new_figure(4.2, float(np.clip(1.2 + 4.2 * level[-1] / (2.2 * width), 2.4, 8.0)))
    axes = figure.add_subplot()
    axes.plot([-0.2 * width, 1.2 * width], [0, 0], color="#333333", lw=2)
    for low, high in pairwise(level):
        axes.plot([0, 0, width, width], [low, high, high, low], color="#333333", lw=1.6)
    for i in range(len(heights)):
        weight = building.mass[i, i] * GRAVITY * system.factor("kip")
        note = f"{weight:.3g} {system.force}"
        axes.text(1.06 * width, level[i + 1], note, va="center", fontsize=8)
    for floors, count in Counter((d.lower, d.upper) for d in building.devices).items():
        low, high = (float(level[floor]) for floor in floors)
        axes.plot([0, width], [low, high], color=_MIDDLE, lw=1.4)
        x, y, size = 0.5 * width, 0.5 * (low + high), 0.12 * width
        axes.add_patch(
            Rectangle((x - size, y - size / 2), 2 * size, size, facecolor=_WIDE, edgecolor=_MIDDLE)
        )
        text = "damper" if count == 1 else f"{count} dampers"
        axes.text(x, y + 0.8 * size, text, ha="center", va="bottom", fontsize=8, color=_MIDDLE)
    axes.set_aspect("equal")
    axes.set_xlim(-0.25 * width, 1.6 * width)
    axes.axis("off")
    return figure


def _quantiles(values: Array) -> Array:
    """2.5, 25, 50, 75 and 97.5 % quantile of draws (n, …); NaN where every draw ran away."""
    if not len(values):
        return np.full((5, *values.shape[1:]), np.nan)
    return np.asarray(np.quantile(values, [0.025, 0.25, 0.5, 0.75, 0.975], axis=0))


@style()
def draw_profile(response: Response, system: UnitSystem) -> Figure:
    """Storey drift and floor acceleration against height, with bands, for each ground motion."""
    grounds, building = response.grounds, response.building
    figure = new_figure(8.4, 0.6 + 3.0 * len(grounds))
    grid = figure.subplots(len(grounds), 2, squeeze=False)
    ratios = bool(np.all(np.isfinite(building.heights)))
    drift_by = 100.0 / building.heights if ratios else np.full(1, system.factor("in"))
    drift = f"largest storey drift, {'% of height' if ratios else system.length}"
    limits, flat = building.limits, np.full(1, 1.0 / GRAVITY)
    top = None if limits.drift is None or not ratios else 100.0 * limits.drift
    limit_g = None if limits.acceleration is None else limits.acceleration / GRAVITY
    measures = (
        ("drift", drift_by, drift, top),
        ("acceleration", flat, "largest floor acceleration, g", limit_g),
    )
    for g, pair in enumerate(grid):
        for axes, (name, factor, label, limit) in zip(pair, measures, strict=True):
            quantiles = _quantiles(factor * getattr(response, name)[response.usable(g), g])
            storeys = np.arange(1, quantiles.shape[1] + 1)
            for low, high, colour in ((0, 4, _WIDE), (1, 3, _NARROW)):
                size = quantiles[high] - quantiles[low]
                axes.barh(storeys, size, left=quantiles[low], height=0.86, color=colour)
            axes.plot(
                quantiles[2],
                storeys,
                "|",
                color=_MIDDLE,
                ms=16,
                mew=2,
                label="median; 50, 95 % bands",
            )
            bare, friction = (
                factor * getattr(r, name)[0, g] for r in (response.bare, response.plain)
            )
            axes.plot(bare, storeys, "o", color=_BARE, ms=4, label="without dampers")
            axes.plot(friction, storeys, "s", color=_PLAIN, ms=4, label="plain friction")
            for end, mark in (("lower", "<"), ("upper", ">")):
                bound = response.references.get(end)
                if bound is not None and not bound.unstable[0, g]:
                    peaks, words = factor * getattr(bound, name)[0, g], f"all at the {end} bound"
                    axes.plot(peaks, storeys, mark, color=_MIDDLE, mfc="none", ms=6, label=words)
            if limit is not None:
                axes.axvline(limit, color=VERMILLION, linestyle="--")
            axes.set_xlabel(label)
            axes.set_yticks(storeys)
            axes.set_xlim(left=0.0)
        pair[0].set_ylabel("storey")
        pair[0].set_title(plain(grounds[g].name))
    grid[0, 1].legend(loc="best")
    return figure


@style()
def draw_histories(response: Response, ground: int, system: UnitSystem) -> Figure:
    """Drift of every storey against time, with bands, and that without dampers behind."""
    values = response.histories[ground][response.usable(ground)]
    storeys, time = values.shape[2], response.grounds[ground].time
    figure = new_figure(10, 0.8 + 1.5 * storeys)
    grid = figure.subplots(storeys, 1, squeeze=False, sharex=True)[:, 0]
    pick = slice(None, None, max(1, time.size // 2500))
    factor = system.factor("in")
    for i, axes in enumerate(grid[::-1]):
        low, _, middle, _, high = factor * _quantiles(values[:, pick, i])
        bare = factor * response.bare.histories[ground][0, pick, i]
        axes.plot(time[pick], bare, color="#bbbbbb", lw=0.7)
        axes.fill_between(time[pick], low, high, color=_NARROW, lw=0.4)
        axes.plot(time[pick], middle, color=_MIDDLE, lw=0.8)
        axes.set_ylabel(f"storey {i + 1}, {system.length}")
    grid[-1].set_xlabel("time, s")
    grid[-1].margins(x=0.005)
    name = plain(response.grounds[ground].name)
    grid[0].set_title(f"Storey drift, {name}: median and 95 % band; grey: without dampers")
    return figure


@style()
def draw_damper_loops(response: Response, ground: int, system: UnitSystem) -> Figure:
    """Force against travel of the dampers, of some draws."""
    travels, forces = response.travels[ground], response.forces[ground]
    count = min(travels.shape[2], DAMPERS)
    columns = min(4, max(count, 1))
    rows = -(-count // columns)
    figure = new_figure(max(2.6 * columns, 5.0), 2.5 * rows + 0.3)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    length, force = system.factor("in"), system.factor("kip")
    for j, axes in enumerate(grid.flat):
        if j >= count:
            axes.set_visible(False)
            continue
        for k in range(min(len(travels), 4)):
            colour = _MIDDLE if k == 0 else _NARROW
            path = travels[k, :, j] * length, forces[k, :, j] * force
            axes.plot(*path, color=colour, lw=0.5, zorder=3 - (k > 0))
        axes.set_title(plain(response.building.devices[j].name), fontsize=8)
        if j + columns >= count:
            axes.set_xlabel(f"travel, {system.length}")
        if j % columns == 0:
            axes.set_ylabel(f"force, {system.force}")
    return figure


@style()
def draw_sweep(sweep: Sweep, system: UnitSystem) -> Figure:
    """Largest drift and acceleration against the actuation, with bands and the best one."""
    figure = new_figure(8.4, 3.2)
    level_factor, unit = system.of_actuation(sweep.unit)
    names = {"drift": (system.factor("in"), system.length), "acceleration": (1.0, "g")}
    for axes, (name, (factor, of)) in zip(figure.subplots(1, 2), names.items(), strict=True):
        flat = factor * sweep.values[name].reshape(len(sweep.levels), -1)
        q, levels = _quantiles(flat.T), level_factor * sweep.levels
        axes.fill_between(levels, q[0], q[4], color=_WIDE)
        axes.fill_between(levels, q[1], q[3], color=_NARROW)
        axes.plot(levels, q[2], color=_MIDDLE)
        axes.set(xlabel=f"actuation, {unit}", ylabel=f"largest {name}, {of}")
        if name == sweep.quantity:
            axes.axvspan(
                level_factor * sweep.interval[0],
                level_factor * sweep.interval[1],
                color="#f6e3c0",
                zorder=0,
            )
            if np.isfinite(sweep.best):  # not where levels are best alike
                axes.axvline(level_factor * sweep.best, color=ORANGE, lw=1.4)
        axes.set_ylim(bottom=0.0)
    return figure


def figures_of(
    response: Response, sweep: Sweep | None, system: UnitSystem
) -> Sequence[tuple[str, Figure]]:
    """Every figure of a response by its name."""
    figures = [("building", draw_building(response.building, system))]
    figures.append(("profile", draw_profile(response, system)))
    for g in range(len(response.grounds)):
        figures.append((f"history_{g + 1}", draw_histories(response, g, system)))
        if response.dampers.count:
            figures.append((f"loops_{g + 1}", draw_damper_loops(response, g, system)))
    if sweep is not None:
        figures.append(("sweep", draw_sweep(sweep, system)))
    return figures
