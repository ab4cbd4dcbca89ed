"""A report in either system of units."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

from mfd_bayes.evaluation.design import DesignRow
from mfd_bayes.evaluation.views import (
    CampaignView,
    Check,
    DerivedRow,
    Fan,
    LawView,
    LeftOutRow,
    LeftOutView,
    Marginal,
    NoiseRow,
    ReadingRow,
    Row,
    ScoreRow,
    TestView,
    TruthRow,
)
from mfd_bayes.messages import Message
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.tested_range import Span
from mfd_bayes.runs.unit_system import US, System

_FIGURES = (
    *("mean", "sd", "lower", "median", "upper", "measured", "truth", "nominal", "value"),
    *("other_lower", "other_median", "other_upper"),
)
_SCORES = ("width_95", "interval_score", "crps", "fitted_width", "fitted_crps")

AnyScores = TypeVar("AnyScores", ScoreRow, LeftOutRow)
AnyRow = TypeVar("AnyRow", Row, NoiseRow, DerivedRow, ReadingRow, TruthRow, DesignRow)


def shown_in(view: CampaignView) -> System:
    """System of units of the figures of a report: the campaign's own."""
    return view.systems[view.metric]


def in_system(view: CampaignView, system: System) -> CampaignView:
    """A report in the units of a system, from one in internal units.

    Texts of checks stay as they are, and scores too: the page shows scores in both systems.
    """
    if system == US:
        return view
    unit = view.actuation_unit
    return replace(
        view,
        tests=tuple(convert_test(test, system, unit) for test in view.tests),
        laws=tuple(_law(law, system, unit) for law in view.laws),
        law_rows=tuple(convert_row(row, system) for row in view.law_rows),
        truth=tuple(convert_row(row, system) for row in view.truth),
        actuation_unit=system.unit(unit),
    )


def in_words(view: CampaignView) -> CampaignView:
    """A report whose sentences give their figures in the units of the campaign."""
    system = shown_in(view)
    if system == US:
        return view
    say = system.reworded
    return replace(
        view,
        sentence=say(view.sentence),
        remarks=tuple(map(say, view.remarks)),
        checks=tuple(_check(check, system) for check in view.checks),
        warnings=tuple(_finding(finding, system) for finding in view.warnings),
        judgements=tuple(
            replace(j, sentence=say(j.sentence), notes=say(j.notes)) for j in view.judgements
        ),
    )


def _finding(finding: Finding, system: System) -> Finding:
    """A finding whose message is a text in the units of a system."""
    text = system.reworded(finding.message.to_text(system.words))
    return replace(finding, message=Message("{text}", {"text": text}))


def _check(check: Check, system: System) -> Check:
    """A check whose sentence, and value where it has a unit, are in the units of a system."""
    found = replace(check, target=system.reworded(check.target))
    if not check.unit:
        return found
    value = check.value * system.factor(check.unit)
    return replace(found, value=value, unit=system.unit(check.unit))


def in_tables(view: CampaignView, system: System) -> CampaignView:
    """What tables show of a report, in the units of a system: rows, scores, ranges; no traces."""
    if system == US:
        return view
    unit, force = view.actuation_unit, system.factor("kip")
    tests = tuple(
        replace(
            test,
            actuation=system.actuation(test.trace, unit),
            rows=tuple(convert_row(row, system) for row in test.rows),
            derived=tuple(convert_row(row, system) for row in test.derived),
            readings=tuple(convert_row(row, system) for row in test.readings),
            noises=tuple(convert_row(row, system) for row in test.noises),
        )
        for test in view.tests
    )
    return replace(
        view,
        tests=tests,
        law_rows=tuple(convert_row(row, system) for row in view.law_rows),
        truth=tuple(convert_row(row, system) for row in view.truth),
        scores=tuple(_scores(row, force) for row in view.scores),
        left_out=_left_out(view.left_out, force),
        tested=tuple(_span(span, system) for span in view.tested),
    )


def convert_test(test: TestView, system: System, actuation_unit: str) -> TestView:
    """A test in the units of a system; `actuation_unit` is the internal one."""
    if system == US:
        return test
    length, force = system.factor("in"), system.factor("kip")
    units = {marginal.name: marginal.unit for marginal in test.marginals}
    return replace(
        test,
        actuation=system.actuation(test.trace, actuation_unit),
        trace=convert_trace(test.trace, system),
        travel=None if test.travel is None else test.travel * length,
        device=None if test.device is None else convert_fan(test.device, force),
        observation=convert_fan(test.observation, force),
        rows=tuple(convert_row(row, system) for row in test.rows),
        derived=tuple(convert_row(row, system) for row in test.derived),
        readings=tuple(convert_row(row, system) for row in test.readings),
        noises=tuple(convert_row(row, system) for row in test.noises),
        marginals=tuple(_marginal(marginal, system) for marginal in test.marginals),
        chains={
            name: draws * system.factor(units.get(name, "1")) for name, draws in test.chains.items()
        },
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


def _law(law: LawView, system: System, actuation_unit: str) -> LawView:
    by, along = system.factor(law.unit), system.factor(actuation_unit)
    return replace(
        law,
        unit=system.unit(law.unit),
        actuation=law.actuation * along,
        device=convert_fan(law.device, by),
        new_test=convert_fan(law.new_test, by),
        tested=tuple((n, at * along, a * by, b * by, c * by) for n, at, a, b, c in law.tested),
    )


def convert_fan(fan: Fan, by: float) -> Fan:
    """A fan times a factor."""
    intervals = (replace(i, lower=i.lower * by, upper=i.upper * by) for i in fan.intervals)
    return Fan(fan.kind, fan.median * by, tuple(intervals))


def convert_row(row: AnyRow, system: System) -> AnyRow:
    """A row of a table in the units of a system."""
    by = system.factor(row.unit)
    figures: dict[str, Any] = {n: getattr(row, n) * by for n in _FIGURES if hasattr(row, n)}
    if isinstance(row, Row):
        figures["others"] = tuple(convert_row(other, system) for other in row.others)
    return replace(row, unit=system.unit(row.unit), **figures)


def _scores(row: AnyScores, by: float) -> AnyScores:
    """A row of scores times a factor: those of a length of force; shares stay."""
    return replace(row, **{name: getattr(row, name) * by for name in _SCORES if hasattr(row, name)})


def _left_out(found: LeftOutView | None, by: float) -> LeftOutView | None:
    if found is None:
        return None
    rows = tuple(_scores(row, by) for row in found.rows)
    return replace(found, rows=rows, mean=_scores(found.mean, by))


def _span(span: Span, system: System) -> Span:
    by = system.factor(span.unit)
    return replace(
        span, unit=system.unit(span.unit), lowest=span.lowest * by, highest=span.highest * by
    )


def _marginal(marginal: Marginal, system: System) -> Marginal:
    by = system.factor(marginal.unit)
    return replace(
        marginal,
        unit=system.unit(marginal.unit),
        prior=marginal.prior * by,
        posterior=marginal.posterior * by,
    )
