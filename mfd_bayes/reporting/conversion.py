"""The two systems of units that a report is written in, and how one becomes the other."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from typing import TypeVar

from mfd_bayes.assessment.views import (
    CampaignView,
    DerivedRow,
    Fan,
    Interval,
    LawView,
    Marginal,
    Row,
    TestView,
    TruthRow,
)
from mfd_bayes.errors import UnitError
from mfd_bayes.records.trace import Trace
from mfd_bayes.units import convert, factor

_METRIC = {"kip": "kN", "in": "mm", "ksi": "MPa"}
_TOKEN = re.compile(r"[A-Za-z]+")
_FIGURES = ("mean", "sd", "lower", "median", "upper", "measured", "truth")

AnyRow = TypeVar("AnyRow", Row, DerivedRow, TruthRow)


@dataclass(frozen=True)
class System:
    """Units of a report.

    Attributes
    ----------
    name : {"us", "si"}
    title : str
    length, force, pressure : str
    """

    name: str
    title: str
    length: str
    force: str
    pressure: str

    @property
    def velocity(self) -> str:
        """Unit of velocities."""
        return f"{self.length}/s"

    def unit(self, internal: str) -> str:
        """Unit that stands for an internal one: "kip/in" is "kN/mm" in the metric system."""
        if self.name == "us":
            return internal
        return _TOKEN.sub(lambda word: _METRIC.get(word[0], word[0]), internal)

    def factor(self, internal: str) -> float:
        """Factor from an internal unit to the one that stands for it."""
        return _factor(internal, self.unit(internal))

    def actuation(self, trace: Trace, unit: str) -> str:
        """Actuation of a trace in words; `unit` is the internal one, "ksi" or "kip"."""
        level = trace.reference_actuation
        if self.name == "us":
            text = f"{1000 * level:.4g} {'psi' if unit == 'ksi' else 'lbf'}"
        else:
            text = f"{level * self.factor(unit):.4g} {self.unit(unit)}"
        return f"{text} (mean of a history)" if trace.varying else text


US = System("us", "kip and in", "in", "kip", "ksi")
SI = System("si", "kN and mm", "mm", "kN", "MPa")
SYSTEMS = (US, SI)


def system_of(units: Iterable[str]) -> System:
    """System of the units of length that the records were measured in; most records decide."""
    metric = sum(1 if _is_metric(unit) else -1 for unit in units)
    return SI if metric > 0 else US


def shown_in(view: CampaignView) -> System:
    """System whose units the figures of a report are in: the campaign's own."""
    return SI if view.metric else US


def in_system(view: CampaignView, system: System) -> CampaignView:
    """Show a report, whose figures are in internal units, in those of a system.

    The texts of checks and the scores, which the page gives in both systems, stay as they are.
    """
    if system is US:
        return view
    unit = view.actuation_unit
    return replace(
        view,
        tests=tuple(convert_test(test, system, unit) for test in view.tests),
        laws=tuple(_law(law, system, unit) for law in view.laws),
        law_rows=tuple(_row(row, system) for row in view.law_rows),
        truth=tuple(_row(row, system) for row in view.truth),
        actuation_unit=system.unit(unit),
    )


@cache
def _factor(unit: str, target: str) -> float:
    return 1.0 if unit == target else convert(unit, target)


def _is_metric(unit: str) -> bool:
    """Whether a unit of length is a power of ten of a metre."""
    try:
        metres = factor(unit, "displacement") * 0.0254
    except UnitError:
        return False
    return any(abs(metres / 10.0**power - 1.0) < 1e-9 for power in range(-9, 4))


def convert_test(test: TestView, system: System, actuation_unit: str) -> TestView:
    """Show one test, as `in_system` does a report; `actuation_unit` is the internal one."""
    if system is US:
        return test
    length, force = system.factor("in"), system.factor("kip")
    trace = test.trace
    units = {marginal.name: marginal.unit for marginal in test.marginals}
    return replace(
        test,
        actuation=system.actuation(trace, actuation_unit),
        trace=replace(
            trace,
            displacement=trace.displacement * length,
            velocity=trace.velocity * length,
            force=None if trace.force is None else trace.force * force,
            hysteresis=trace.hysteresis * length,
        ),
        travel=None if test.travel is None else test.travel * length,
        device=None if test.device is None else _fan(test.device, force),
        observation=_fan(test.observation, force),
        rows=tuple(_row(row, system) for row in test.rows),
        derived=tuple(_row(row, system) for row in test.derived),
        marginals=tuple(_marginal(marginal, system) for marginal in test.marginals),
        chains={
            name: draws * system.factor(units.get(name, "1")) for name, draws in test.chains.items()
        },
    )


def _law(law: LawView, system: System, actuation_unit: str) -> LawView:
    by, along = system.factor(law.unit), system.factor(actuation_unit)
    return replace(
        law,
        unit=system.unit(law.unit),
        actuation=law.actuation * along,
        median=_fan(law.median, by),
        new_test=_fan(law.new_test, by),
        tested=tuple((n, at * along, a * by, b * by, c * by) for n, at, a, b, c in law.tested),
    )


def _fan(fan: Fan, by: float) -> Fan:
    intervals = (Interval(i.probability, i.lower * by, i.upper * by) for i in fan.intervals)
    return Fan(fan.kind, fan.median * by, tuple(intervals))


def _row(row: AnyRow, system: System) -> AnyRow:
    by = system.factor(row.unit)
    figures = {name: getattr(row, name) * by for name in _FIGURES if hasattr(row, name)}
    return replace(row, unit=system.unit(row.unit), **figures)


def _marginal(marginal: Marginal, system: System) -> Marginal:
    by = system.factor(marginal.unit)
    return replace(
        marginal,
        unit=system.unit(marginal.unit),
        prior=marginal.prior * by,
        posterior=marginal.posterior * by,
    )
