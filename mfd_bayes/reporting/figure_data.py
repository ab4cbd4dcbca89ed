"""The numbers behind every figure as CSV texts, in the units of the figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from mfd_bayes.evaluation.views import Array, CampaignView, Fan, TestView, TruthRow
from mfd_bayes.population.settings import KIND_NAMES
from mfd_bayes.reporting.conversion import convert_test, in_system, shown_in
from mfd_bayes.reporting.tables import csv_text, next_csv
from mfd_bayes.runs.tested_range import conditions
from mfd_bayes.runs.unit_system import US, System
from mfd_bayes.units import percent

DRAWS = 2000
"""Most draws in the table of a joint posterior."""

STEPS = 300
"""Most steps of each chain in its table."""

LOOP = 400
"""Most samples of each loop in the overview's table; a test's own table holds all."""

_LEVELS = np.array([0.005, 0.025, *np.arange(0.05, 0.96, 0.05), 0.975, 0.995])

_TABLES = {
    "loops": "record",
    "history": "record",
    "residuals": "record",
    "corner": "draws",
    "trace": "chains",
    "marginals": "marginals",
}


def table_of(key: str) -> str:
    """Path from the run folder of the table behind a figure, by the figure's key."""
    folder, _, name = key.rpartition("/")
    return f"{folder}/{_TABLES[name]}.csv" if folder else f"figures/{key}.csv"


def shared_tables(view: CampaignView) -> Iterator[tuple[str, str]]:
    """Path and text of the tables behind the figures of all tests together."""
    system = shown_in(view)
    if view.tests:
        tests = (convert_test(test, system, view.actuation_unit) for test in view.tests)
        yield table_of("overview"), _overview(tests, system)
    if view.tested:
        yield table_of("tested"), _tested(view, system)
    if view.next_test is not None:
        yield table_of("next"), next_csv(view.next_test, system, view.actuation_unit)
    view = in_system(replace(view, tests=()), system)
    if view.laws:
        yield table_of("laws"), _laws(view)
    if view.truth:
        yield table_of("truth"), _truth(view.truth)


def tables_of_test(test: TestView, system: System = US) -> Iterator[tuple[str, str]]:
    """Path and text of the tables behind the figures of one test, in the units of a system."""
    home = f"tests/{test.id}"
    yield f"{home}/record.csv", _record(test, system)
    if test.marginals:
        yield f"{home}/draws.csv", _draws(test)
        yield f"{home}/marginals.csv", _marginals(test)
    if test.chains:
        yield f"{home}/chains.csv", _chains(test)


def _bands(fan: Fan, force: str, name: str = "") -> dict[str, Array]:
    """Median and bounds of a fan by column; `force` is their unit."""
    columns = {f"{name}median_{force}": fan.median}
    for interval in fan.intervals:
        share = percent(interval.probability)
        columns[f"{name}lower_{share}_{force}"] = interval.lower
        columns[f"{name}upper_{share}_{force}"] = interval.upper
    return columns


def _table(columns: dict[str, Array]) -> str:
    return csv_text(tuple(columns), zip(*columns.values(), strict=True))


def _record(test: TestView, system: System) -> str:
    """One test at every sample: motion, force, bands, residual, stage."""
    trace, length, force = test.trace, system.length, system.force
    columns: dict[str, Array] = {
        "time_s": trace.time,
        f"displacement_{length}": trace.displacement,
        f"velocity_{length}_per_s": trace.velocity,
    }
    if trace.force is not None:
        columns[f"force_{force}"] = trace.force
        columns[f"residual_{force}"] = trace.force - test.observation.median
    columns |= _bands(test.observation, force)
    if test.device is not None:
        columns |= _bands(test.device, force, "model_")
    if test.stage is not None and test.travel is not None:
        columns |= {"stage": test.stage.astype(np.float64), f"travel_{length}": test.travel}
    columns["fitted"] = (np.arange(trace.samples) >= test.first).astype(np.float64)
    if test.role == "validate":
        columns["fitted"][:] = 0.0
    return _table(columns)


def _overview(tests: Iterable[TestView], system: System) -> str:
    """Loops of all tests, thinned."""
    head: tuple[str, ...] = ()
    lines: list[tuple[str | float, ...]] = []
    for test in tests:
        trace = test.trace
        step = max(1, trace.samples // LOOP)
        force = np.full(trace.samples, np.nan) if trace.force is None else trace.force
        columns = {f"displacement_{system.length}": trace.displacement}
        columns |= {f"force_{system.force}": force} | _bands(test.observation, system.force)
        head = ("test", "role", *columns)
        rows = zip(*(column[::step] for column in columns.values()), strict=True)
        lines += [(test.id, test.role, *row) for row in rows]
    return csv_text(head, lines)


def _tested(view: CampaignView, system: System) -> str:
    """Stroke, peak speed, frequency and actuation of every test."""
    by = {span.name: system.factor(span.unit) for span in view.tested}
    units = (system.unit(span.unit).replace("/", "_per_") for span in view.tested)
    head = ("test", "role", *(f"{name}_{unit}" for name, unit in zip(by, units, strict=True)))
    lines: list[tuple[str | float, ...]] = []
    for test in view.tests:
        found = {s.name: s.highest for s in conditions(test.trace, view.actuation_unit)}
        values = (found.get(name, np.nan) * factor for name, factor in by.items())
        lines.append((test.id, test.role, *values))
    return csv_text(head, lines)


def _laws(view: CampaignView) -> str:
    """Every law's curve with its bands, and the tests beside it."""
    unit = view.actuation_unit
    head = ("quantity", "unit", "law", "what", f"actuation_{unit}", "lower", "median", "upper")
    lines: list[tuple[str | float, ...]] = []
    for law in view.laws:
        for what, fan in (
            (KIND_NAMES["device"], law.device),
            (KIND_NAMES["new_test"], law.new_test),
        ):
            widest = max(fan.intervals, key=lambda interval: interval.probability)
            curve = zip(law.actuation, widest.lower, fan.median, widest.upper, strict=True)
            about = f"{what}, {percent(widest.probability)} %"
            lines += [(law.name, law.unit, law.law, about, *point) for point in curve]
        lines += [(law.name, law.unit, law.law, f"test {n}, 95 %", *at) for n, *at in law.tested]
    return csv_text(head, lines)


def _truth(rows: Iterable[TruthRow]) -> str:
    head = ("test", "quantity", "unit", "truth", "q2.5", "q50", "q97.5", "inside", "informed")
    lines = (
        (
            *(r.subject, r.name, r.unit, r.truth, r.lower, r.median, r.upper),
            *("yes" if r.inside else "no", "yes" if r.informed else "no"),
        )
        for r in rows
    )
    return csv_text(head, lines)


def _draws(test: TestView) -> str:
    """Joint posterior draws of the sampled quantities, evenly thinned."""
    fewest = min(len(m.posterior) for m in test.marginals)
    pick = np.linspace(0, fewest - 1, min(DRAWS, fewest)).astype(np.intp)
    return _table({_named(m.name, m.unit): m.posterior[pick] for m in test.marginals})


def _marginals(test: TestView) -> str:
    """Quantiles of the prior and the posterior of each sampled quantity."""
    head = ("quantity", "unit", "of", *(f"q{100 * level:g}" for level in _LEVELS))
    lines = [
        (m.name, m.unit, of, *np.quantile(draws, _LEVELS))
        for m in test.marginals
        for of, draws in (("prior", m.prior), ("posterior", m.posterior))
    ]
    return csv_text(head, lines)


def _chains(test: TestView) -> str:
    """Mean over walkers of each sampled quantity along each chain."""
    units = {m.name: m.unit for m in test.marginals}
    some = next(iter(test.chains.values()))
    step = max(1, some.shape[1] // STEPS)
    steps = np.arange(0, some.shape[1], step)
    chain, at = np.meshgrid(np.arange(len(some)), steps, indexing="ij")
    columns = {"chain": chain.ravel().astype(np.float64), "step": at.ravel().astype(np.float64)}
    for name, values in test.chains.items():
        columns[_named(name, units.get(name, "1"))] = values[:, ::step].ravel()
    return _table(columns)


def _named(name: str, unit: str) -> str:
    return name if unit in ("", "1") else f"{name} [{unit}]"
