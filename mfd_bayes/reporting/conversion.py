"""Numbers of a report in the units of a system, from those in internal units."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, TypeVar

from mfd_bayes.axes import Axes
from mfd_bayes.evaluation.views import (
    CampaignView,
    Fan,
    LawView,
    LeftOutRow,
    LeftOutView,
    TestView,
)
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.unit_system import US, System

if TYPE_CHECKING:
    import pandas as pd

_OF_UNIT = frozenset(
    {
        *("mean", "sd", "lower", "median", "upper", "measured", "truth", "nominal", "value"),
        *("q2.5", "q50", "q97.5", "other_q2.5", "other_q50", "other_q97.5", "loop_estimate"),
        *("smallest", "largest", "prior", "posterior", "measured_low", "measured_high"),
        *("observed", "expected", "joint_q2.5", "joint_q50", "joint_q97.5"),
    }
)
"""Fields of a row, and columns of a table, that are in the unit that the row names."""

_SCORES = ("width_95", "interval_score", "crps", "fitted_width", "fitted_crps")

_ENDINGS = {"_kip": "kip", "_in": "in", "_in_per_s": "in/s"}
"""Internal units at the ends of columns' names."""

AnyRow = TypeVar("AnyRow")


def system_of(view: CampaignView) -> System:
    """System of units of the figures and tables of a report: by default the campaign's own."""
    return view.systems[view.metric]


def to_units(frame: pd.DataFrame, system: System) -> pd.DataFrame:
    """A table in the units of a system.

    A column `unit` is the unit of the numbers in its row; other columns have theirs at the end of
    their name, "width_95_kip", or in brackets, "Fc_fwd [kip]".
    """
    if system == US:
        return frame
    shown, axes = frame.copy(), system.axes
    for name in ("quantity", "feature", "condition", "note"):
        if name in frame and not axes.of_damper:
            shown[name] = [_renamed(v, axes) for v in frame[name]]
    if "unit" in frame:
        by = frame["unit"].map(system.factor)
        for name in _OF_UNIT.intersection(frame.columns):
            shown[name] = frame[name] * by
        shown["unit"] = frame["unit"].map(system.unit)
    names = {}
    for name in frame.columns:
        ending = next((end for end in _ENDINGS if str(name).endswith(end)), "")
        if ending:
            unit = _ENDINGS[ending]
            names[name] = system.column(str(name).removesuffix(ending), unit)
        elif str(name).endswith("]"):
            what, _, unit = name[:-1].rpartition(" [")
            names[name] = f"{what} [{system.unit(unit)}]"
        else:
            continue
        shown[name] = frame[name] * system.factor(unit)
    shown = shown.rename(columns=names)
    if axes.timed:
        return shown
    lost = [n for n in shown if n == "frequency_Hz" or "in_per_s" in str(n)]
    lost += [n for n in names.values() if n == system.column("velocity", "in/s")]
    return shown.drop(columns=lost).rename(columns={"time_s": "sample"})


def _renamed(words: Any, axes: Axes) -> Any:
    """Words of the package in the names of a model's axes; a parameter's name stays."""
    if words == "peak_force":
        return f"peak_{axes.response.name}"
    is_ours = isinstance(words, str) and (" " in words or words == "stroke")
    return axes.text(words) if is_ours else words


def convert_row(row: AnyRow, system: System) -> AnyRow:
    """A dataclass with a field `unit`, in the units of a system."""
    made: Any = row
    by = system.factor(made.unit)
    values: dict[str, Any] = {
        f.name: getattr(made, f.name) * by for f in fields(made) if f.name in _OF_UNIT
    }
    converted: AnyRow = replace(made, unit=system.unit(made.unit), **values)
    return converted


def convert_trace(trace: Trace, system: System) -> Trace:
    """A trace in the units of a system; its actuation stays."""
    length, force = system.factor("in"), system.factor("kip")
    return replace(
        trace,
        displacement=trace.displacement * length,
        velocity=trace.velocity * length,
        force=None if trace.force is None else trace.force * force,
        hysteresis=trace.hysteresis * length,
    )


def convert_fan(fan: Fan, by: float) -> Fan:
    """A fan times a factor."""
    intervals = (replace(i, lower=i.lower * by, upper=i.upper * by) for i in fan.intervals)
    return Fan(fan.kind, fan.median * by, tuple(intervals))


def convert_law(law: LawView, system: System, actuation_unit: str) -> LawView:
    """A law in the units of a system; `actuation_unit` is the internal one."""
    by, along = system.factor(law.unit), system.factor(actuation_unit)
    return replace(
        law,
        unit=system.unit(law.unit),
        actuation=law.actuation * along,
        device=convert_fan(law.device, by),
        new_test=convert_fan(law.new_test, by),
        tested=tuple((n, at * along, a * by, b * by, c * by) for n, at, a, b, c in law.tested),
    )


def convert_test(test: TestView, system: System, actuation_unit: str) -> TestView:
    """What the figures of a test show, in the units of a system."""
    if system == US:
        return test
    force = system.factor("kip")
    return replace(
        test,
        actuation=system.actuation(test.trace, actuation_unit),
        trace=convert_trace(test.trace, system),
        travel=None if test.travel is None else test.travel * system.factor("in"),
        device=None if test.device is None else convert_fan(test.device, force),
        observation=convert_fan(test.observation, force),
        marginals=tuple(convert_row(marginal, system) for marginal in test.marginals),
    )


def convert_scores(scores: LeftOutView, by: float) -> LeftOutView:
    """Scores of what was left out times a factor: those that are forces."""

    def converted(row: LeftOutRow) -> LeftOutRow:
        return replace(row, **{name: by * getattr(row, name) for name in _SCORES})

    rows = tuple(converted(row) for row in scores.rows)
    return replace(scores, rows=rows, mean=converted(scores.mean))
