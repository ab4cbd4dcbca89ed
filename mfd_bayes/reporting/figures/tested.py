"""What was tested: stroke, speed and frequency of the tests against actuation."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from mfd_bayes.evaluation.views import CampaignView
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting import colours
from mfd_bayes.reporting.figures import style as look
from mfd_bayes.runs.tested_range import Span, conditions
from mfd_bayes.runs.unit_system import System

_FRAME = "#d9efe6"


@look.style()
def draw_tested(view: CampaignView, system: System) -> Figure | None:
    """A panel for stroke, speed and frequency: every test by its actuation, and the tested range.

    The view is in internal units. None where no actuation is known.
    """
    spans = {span.name: span for span in view.tested}
    level = spans.pop("actuation", None)
    if level is None or not spans:
        return None
    figure = look.new_figure(3.1 * len(spans), 2.9)
    figure.suptitle("Tested range", x=0.01, ha="left")
    panels = figure.subplots(1, len(spans), squeeze=False)[0]
    for axes, span in zip(panels, spans.values(), strict=True):
        _draw(axes, view, (level, span), system)
    handles, texts = panels[0].get_legend_handles_labels()
    figure.legend(handles, texts, loc="outside lower left", ncols=3)
    return figure


def _draw(axes: Axes, view: CampaignView, spans: tuple[Span, Span], system: System) -> None:
    (left, right), (low, high) = (_ends(span, system) for span in spans)
    size = right - left, high - low
    frame = Rectangle(
        (left, low), *size, facecolor=_FRAME, edgecolor="#4db894", label="tested range"
    )
    axes.add_patch(frame)
    for role, face, name in (
        ("calibrate", colours.DATA, "calibrated"),
        ("validate", "white", "held out"),
    ):
        points = [p for t in view.tests if t.role == role and (p := _point(t.trace, view, spans))]
        if points:
            by = [system.factor(span.unit) for span in spans]
            across, up = ([by[i] * point[i] for point in points] for i in (0, 1))
            edge = colours.DATA
            axes.scatter(across, up, s=22, facecolors=face, edgecolors=edge, zorder=3, label=name)
    axes.set_xlabel(f"actuation, {system.unit(spans[0].unit)}")
    axes.set_ylabel(f"{spans[1].name}, {system.unit(spans[1].unit)}")
    axes.set_xlim(0.0, 1.12 * max(right, *axes.get_xlim()))
    axes.set_ylim(0.0, 1.12 * max(high, *axes.get_ylim()))


def _ends(span: Span, system: System) -> tuple[float, float]:
    by = system.factor(span.unit)
    return span.lowest * by, span.highest * by


def _point(trace: Trace, view: CampaignView, spans: tuple[Span, Span]) -> tuple[float, ...] | None:
    """Values of two conditions of a test; None where one is not known."""
    found = {span.name: span.highest for span in conditions(trace, view.actuation_unit)}
    values = tuple(found[span.name] for span in spans if span.name in found)
    return values if len(values) == len(spans) else None
