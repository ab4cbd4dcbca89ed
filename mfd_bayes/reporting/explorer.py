"""The interactive plot of the tests' loops, drawn by bokeh in the browser, and its data."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mfd_bayes.evaluation.views import Array, CampaignView, TestView
from mfd_bayes.reporting.colours import BANDS, DATA, SKY
from mfd_bayes.runs.unit_system import System

SAMPLES = 1500
"""Most samples of a test in the plot: a screen cannot show more."""

FEWEST = 300
"""Fewest samples of a test in the plot, however many tests there are."""

ALL = 250_000
"""Most samples of all tests together, some 8 MB, unless `FEWEST` of each are more."""

_COLUMNS = ("time", "displacement", "force", "median", "lower", "upper")


@dataclass(frozen=True)
class Explorer:
    """The parts of the interactive plot."""

    library: str
    """BokehJS."""
    item: str
    """JSON of the plot, without data."""
    data: str
    """JSON of the tests: little-endian float32 arrays in base64, in internal units."""


def explore(view: CampaignView) -> Explorer:
    """Interactive loop and history of the tests of a report, one test at a time."""
    from bokeh.embed import json_item
    from bokeh.resources import Resources

    library = "\n".join(Resources(mode="inline", components=["bokeh"], minified=True).js_raw)
    most = max(FEWEST, min(SAMPLES, ALL // max(1, len(view.tests))))
    systems = view.systems
    data = {
        "systems": {
            s.name: {"length": s.length, "force": s.force, "by": [s.factor("in"), s.factor("kip")]}
            for s in systems
        },
        "tests": [_packed(test, view.actuation_unit, most, systems) for test in view.tests],
    }
    return Explorer(_inline(library), _renumbered(_json(json_item(_layout()))), _json(data))


def _json(value: object) -> str:
    """JSON that cannot close the script element around it."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")


def _inline(script: str) -> str:
    return script.replace("</", "<\\/").replace("<!--", "<\\!--")


def _renumbered(item: str) -> str:
    """The plot with its models numbered from 1001: bokeh's numbers grow from call to call."""
    number: dict[str, str] = {}
    return re.sub(
        r'"p\d+"', lambda found: number.setdefault(found[0], f'"p{1001 + len(number)}"'), item
    )


def _packed(
    test: TestView, actuation_unit: str, most: int, systems: Sequence[System]
) -> dict[str, Any]:
    trace, fan = test.trace, test.observation
    widest = max(fan.intervals, key=lambda interval: interval.probability)
    force = np.full(trace.samples, np.nan) if trace.force is None else trace.force
    arrays = (trace.time, trace.displacement, force, fan.median, widest.lower, widest.upper)
    at = _shown(trace.samples, trace.turning_points, most)
    stage = np.zeros(trace.samples) if test.stage is None else test.stage
    packed = {name: _float32(values[at]) for name, values in zip(_COLUMNS, arrays, strict=True)}
    return {
        "name": {s.name: f"{test.id}, {s.actuation(trace, actuation_unit)}" for s in systems},
        "fitted": test.role != "validate",
        "stage": "".join(str(int(number)) for number in stage[at]),
        **packed,
    }


def _shown(samples: int, turns: np.ndarray, most: int) -> np.ndarray:
    """Numbers of the shown samples: evenly spaced, with all turning points unless too many."""
    even = np.linspace(0, samples - 1, min(samples, most)).astype(np.intp)
    return np.union1d(even, turns) if turns.size < most // 4 else even


def _float32(values: Array) -> str:
    return base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")


def _layout() -> Any:
    """A loop and a history of one data source, which the page fills."""
    from bokeh.layouts import column
    from bokeh.models import ColumnDataSource

    names = ("x", "t", "force", "median", "lower", "upper", "stage")
    source = ColumnDataSource({name: [] for name in names}, name="samples")
    plots = [_plot(along, height, source) for along, height in (("x", 420), ("t", 260))]
    return column(*plots, sizing_mode="stretch_width", name="explorer")


def _plot(along: str, height: int, source: Any) -> Any:
    """Force along the displacement "x" or the time "t", with a text at the pointer."""
    from bokeh.models import HoverTool, Range1d
    from bokeh.plotting import figure

    options: dict[str, Any] = {  # half of them are missing from bokeh's types
        "name": f"plot-{along}",
        "height": height,
        "sizing_mode": "stretch_width",
        "tools": "pan,box_zoom,wheel_zoom,reset",
        "active_drag": "box_zoom",
        "x_range": Range1d(start=0, end=1),
        "y_range": Range1d(start=0, end=1),
        "toolbar_location": "above",
        "output_backend": "canvas",
    }
    plot = figure(**options)
    _draw(plot, along, source)
    dots = plot.scatter(along, "force", source=source, size=7, alpha=0.0, line_alpha=0.0)
    dots.hover_glyph = None
    plot.add_tools(HoverTool(renderers=[dots], name=f"hover-{along}", mode="mouse"))
    plot.toolbar.logo = None
    return plot


def _draw(plot: Any, along: str, source: Any) -> None:
    _, band, median = BANDS["observation"]
    # Along a loop the two edges go round the inside in opposite senses, so it stays empty; where
    # opposite branches overlap they cancel too, and the edges alone show the band.
    plot.varea(along, "lower", "upper", source=source, fill_color=band, fill_alpha=0.7)
    if along == "x":
        for edge in ("lower", "upper"):
            plot.line(along, edge, source=source, color=SKY, line_width=0.5)
    plot.line(along, "median", source=source, color=median, line_width=1.6)
    plot.line(along, "force", source=source, color=DATA, line_width=1.2)
