"""Numbers of a report in the units of a system, from those in internal units."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from mfd_bayes.evaluation.views import Fan, LawView, LeftOutView, Row, Rows, TestView
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.unit_system import US, System
from mfd_bayes.units import Axes

if TYPE_CHECKING:
    import pandas as pd


_OF_UNIT = frozenset(
    {
        *("mean", "sd", "lower", "median", "upper", "measured", "truth", "nominal", "value"),
        *("q2.5", "q50", "q97.5", "other_q2.5", "other_q50", "other_q97.5", "loop_estimate"),
        *("other_lower", "other_median", "other_upper", "smallest", "largest"),
        *("measured_low", "measured_high", "observed", "expected"),
        *("joint_q2.5", "joint_q50", "joint_q97.5"),
    }
)
"""Keys of a row, and columns of a table, that are in the unit that the row names."""

_SCORES = ("width_95", "interval_score", "crps", "fitted_width", "fitted_crps")

_ENDINGS = {"_kip": "kip", "_in": "in", "_in_per_s": "in/s"}
"""Internal units at the ends of columns' names."""


def to_units(frame: pd.DataFrame, system: System) -> pd.DataFrame:
    """A table in the units of a system.

    A column `unit` is the unit of the numbers in its row; other columns have theirs at the end of
    their name: "width_95_kip".
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
            names[name] = system.column(str(name).removesuffix(ending), _ENDINGS[ending])
            shown[name] = frame[name] * system.factor(_ENDINGS[ending])
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


def convert_rows(rows: Rows, system: System) -> Rows:
    """Rows with a key `unit`, in the units of a system."""
    return tuple(
        {
            name: value * system.factor(row["unit"]) if name in _OF_UNIT else value
            for name, value in row.items()
        }
        | {"unit": system.unit(row["unit"])}
        for row in rows
    )


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
    marginals = ((m, system.factor(m.unit)) for m in test.marginals)
    return replace(
        test,
        actuation=system.actuation(test.trace, actuation_unit),
        trace=convert_trace(test.trace, system),
        travel=None if test.travel is None else test.travel * system.factor("in"),
        device=None if test.device is None else convert_fan(test.device, force),
        observation=convert_fan(test.observation, force),
        marginals=tuple(
            replace(m, unit=system.unit(m.unit), prior=m.prior * by, posterior=m.posterior * by)
            for m, by in marginals
        ),
    )


def convert_scores(scores: LeftOutView, by: float) -> LeftOutView:
    """Scores of what was left out times a factor: those that are forces."""

    def converted(row: Row) -> Row:
        return row | {name: by * row[name] for name in _SCORES}

    return replace(scores, rows=tuple(map(converted, scores.rows)), mean=converted(scores.mean))
