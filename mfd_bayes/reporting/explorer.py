"""The interactive plot of the tests' loops, drawn by bokeh in the browser, and its data."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from mfd_bayes.evaluation.views import CampaignView, TestView
from mfd_bayes.reporting.colours import BANDS, DATA, SKY

FEWEST, MOST, ALL = 300, 1500, 250_000
"""Fewest and most samples of a test in the plot, and of all together, some 8 MB."""


@dataclass(frozen=True)
class Explorer:
    """The parts of the interactive plot.

    Attributes
    ----------
    library : str
        BokehJS.
    item : str
        JSON of the plot, without data.
    data : str
        JSON of the tests: little-endian float32 arrays in base64, in internal units.
    """

    library: str
    item: str
    data: str


def explore(view: CampaignView) -> Explorer:
    """Interactive loop and history of the tests of a report, one test at a time."""
    from bokeh.embed import json_item
    from bokeh.resources import Resources

    library = "\n".join(Resources(mode="inline", components=["bokeh"], minified=True).js_raw)
    most = max(FEWEST, min(MOST, ALL // max(1, len(view.tests))))
    data = {
        "systems": {
            s.name: {
                "length": "" if s.length == "1" else s.length,
                "force": s.force,
                "by": [s.factor("in"), s.factor("kip")],
                "names": [s.axes.name("displacement"), s.axes.name("force")],
                "labels": {
                    "x": s.label("displacement", "in"),
                    "t": "time, s" if s.axes.timed else "sample",
                    "y": s.label("force", "kip"),
                },
            }
            for s in view.systems
        },
        "tests": [_packed(test, view, most) for test in view.tests],
    }
    # bokeh's numbers of models grow from call to call: here they begin at 1001
    numbers: dict[str, str] = {}
    item = re.sub(
        r'"p\d+"',
        lambda match: numbers.setdefault(match[0], f'"p{1001 + len(numbers)}"'),
        script_json(json_item(_layout())),
    )
    safe = library.replace("</", "<\\/").replace("<!--", "<\\!--")
    return Explorer(safe, item, script_json(data))


def script_json(value: object) -> str:
    """JSON that cannot close the script element around it."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")


def _packed(test: TestView, view: CampaignView, most: int) -> dict[str, Any]:
    """A test with evenly spaced samples, and all turning points unless they are too many."""
    trace, fan = test.trace, test.observation
    at = np.linspace(0, trace.samples - 1, min(trace.samples, most)).astype(np.intp)
    if trace.turning_points.size < most // 4:
        at = np.union1d(at, trace.turning_points)
    widest = fan.widest
    none = np.full(trace.samples, np.nan)
    arrays = {
        "time": trace.time,
        "displacement": trace.displacement,
        "force": none if trace.force is None else trace.force,
        "median": fan.median,
        "lower": widest.lower,
        "upper": widest.upper,
    }
    stage = np.zeros(trace.samples) if test.stage is None else test.stage
    unit = view.actuation_unit
    return {
        "name": {s.name: f"{test.id}, {s.actuation(trace, unit)}" for s in view.systems},
        "fitted": test.role != "validate",
        "stage": "".join(str(int(code)) for code in stage[at]),
    } | {
        name: base64.b64encode(values[at].astype("<f4").tobytes()).decode("ascii")
        for name, values in arrays.items()
    }


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
    _, band, median = BANDS["observation"]
    # Along a loop the two edges go round the inside in opposite senses, so it stays empty; where
    # opposite branches overlap they cancel too, and the edges alone show the band.
    plot.varea(along, "lower", "upper", source=source, fill_color=band, fill_alpha=0.7)
    for edge in ("lower", "upper") if along == "x" else ():
        plot.line(along, edge, source=source, color=SKY, line_width=0.5)
    plot.line(along, "median", source=source, color=median, line_width=1.6)
    plot.line(along, "force", source=source, color=DATA, line_width=1.2)
    dots = plot.scatter(along, "force", source=source, size=7, alpha=0.0, line_alpha=0.0)
    dots.hover_glyph = None
    plot.add_tools(HoverTool(renderers=[dots], name=f"hover-{along}", mode="mouse"))
    plot.toolbar.logo = None
    return plot
