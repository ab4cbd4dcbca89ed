"""A report in either system of units."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from mfd_bayes.assessment.systems import SI, US, System
from mfd_bayes.assessment.views import (
    CampaignView,
    DerivedRow,
    Fan,
    Interval,
    LawView,
    Marginal,
    ReadingRow,
    Row,
    TestView,
    TruthRow,
)
from mfd_bayes.records.trace import Trace

_FIGURES = ("mean", "sd", "lower", "median", "upper", "measured", "truth", "value")

AnyRow = TypeVar("AnyRow", Row, DerivedRow, ReadingRow, TruthRow)


def shown_in(view: CampaignView) -> System:
    """System of units of the figures of a report: the campaign's own."""
    return SI if view.metric else US


def in_system(view: CampaignView, system: System) -> CampaignView:
    """A report in the units of a system, from one in internal units.

    Texts of checks stay as they are, and scores too: the page shows scores in both systems.
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


def convert_test(test: TestView, system: System, actuation_unit: str) -> TestView:
    """A test in the units of a system; `actuation_unit` is the internal one."""
    if system is US:
        return test
    length, force = system.factor("in"), system.factor("kip")
    units = {marginal.name: marginal.unit for marginal in test.marginals}
    return replace(
        test,
        actuation=system.actuation(test.trace, actuation_unit),
        trace=_trace(test.trace, length, force),
        travel=None if test.travel is None else test.travel * length,
        device=None if test.device is None else _fan(test.device, force),
        observation=_fan(test.observation, force),
        rows=tuple(_row(row, system) for row in test.rows),
        derived=tuple(_row(row, system) for row in test.derived),
        readings=tuple(_row(row, system) for row in test.readings),
        marginals=tuple(_marginal(marginal, system) for marginal in test.marginals),
        chains={
            name: draws * system.factor(units.get(name, "1")) for name, draws in test.chains.items()
        },
    )


def _trace(trace: Trace, length: float, force: float) -> Trace:
    return replace(
        trace,
        displacement=trace.displacement * length,
        velocity=trace.velocity * length,
        force=None if trace.force is None else trace.force * force,
        hysteresis=trace.hysteresis * length,
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
