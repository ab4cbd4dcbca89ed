"""Conformity of tests with a standard, requirement by requirement: meets, fails, not tested.

Values are those that the records measured. Beside each verdict on a limit stands the probability
that the device meets it: the share of the posterior's draws of the same motion that do. Draws of
cycles and of a test's mean have the scatter from test to test and the noise of a measurement, as
the measured ones do; a change with the rate is that of the mean property.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np

from mfd_bayes.applications.properties.harmonic import (
    Array,
    Condition,
    HarmonicTest,
    levels_of,
    same,
)
from mfd_bayes.campaign.schema import DesignTable
from mfd_bayes.campaign.standard import ProtocolStep, Requirement, Standard
from mfd_bayes.evaluation.measurement import gains_of
from mfd_bayes.population.design import same_level
from mfd_bayes.records.cycles import DeviceProperty, cycle_values, quantities
from mfd_bayes.records.loops import find_loops
from mfd_bayes.runs.run import Run, prediction_conditions
from mfd_bayes.units import parse_actuation, parse_quantity

DRAWS = 400  # of the motion of each test
PARTIAL = 0.1  # of a cycle, that a record may lack at its ends
DEGREES = 2.0  # °C; tests whose temperatures differ by less are at the same
NOTHING = float("nan")
NO_TESTS = "no test is harmonic"


class Conformity(StrEnum):
    """Whether a requirement is met."""

    MEETS = "meets"
    FAILS = "fails"
    NOT_TESTED = "not tested"


@dataclass(frozen=True, kw_only=True)
class ConformityRow:
    """A verdict on a requirement; on a quantity and a test where it is about these.

    `cycle` is 0 for the test as a whole: its value is that of the cycle that deviates most. `value`
    and `limit` are shares. `probability` is NaN where the posterior does not tell.
    """

    clause: str
    requirement: str
    verdict: Conformity
    quantity: str = ""
    direction: str = ""
    test: str = ""
    cycle: int = 0
    value: float = NOTHING
    limit: float = NOTHING
    probability: float = NOTHING
    note: str = ""


@dataclass(frozen=True, eq=False)
class Predicted:
    """Draws of the properties of a test's motion, by `DeviceProperty.key`.

    `observed` are of a measurement, for each of the L cycles at full stroke, (n, L), with the
    instruments' gains; `mean` of the mean property, the same draws of the device for every motion,
    (m,).
    """

    observed: Mapping[str, Array] = field(default_factory=dict)
    mean: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class DeviceEvidence:
    """What a standard is compared with: harmonic tests, what is predicted of them, the design.

    `words` writes a condition in the reader's units. `follows_temperature` says whether the laws of
    the run know of the temperature, so that their draws may be asked for its effect.
    """

    tests: Sequence[HarmonicTest]
    design: DesignTable
    predicted: Mapping[str, Predicted] = field(default_factory=dict)
    words: Callable[[Condition], str] = str
    follows_temperature: bool = False

    @property
    def period(self) -> float | None:
        """Period of the building, s."""
        return parse_quantity(self.design.T1, "time") if self.design.T1 else None

    @property
    def largest(self) -> float | None:
        """Largest displacement of the device from its middle, in."""
        return parse_quantity(self.design.mce, "displacement") if self.design.mce else None

    def observed(self, test: HarmonicTest, item: DeviceProperty) -> Array | None:
        """Draws of a property in each cycle of a measurement of a test, (n, L); None of none."""
        return self.predicted.get(test.name, Predicted()).observed.get(item.key)

    def groups(self, differing: str) -> list[list[HarmonicTest]]:
        """Tests that differ in the "frequency" or in the "temperature" alone."""
        groups: list[list[HarmonicTest]] = []
        for test in self.tests:
            for group in groups:
                if _alike(group[0], test, differing):
                    group.append(test)
                    break
            else:
                groups.append([test])
        several = []
        for group in groups:
            frequencies = [test.condition.frequency for test in group]
            if differing == "temperature":
                temperatures = [test.temperature for test in group]
                if np.ptp(temperatures) > DEGREES:
                    several.append(group)
            elif not all(same(frequency, frequencies[0]) for frequency in frequencies):
                several.append(group)
        return several


def _alike(test: HarmonicTest, other: HarmonicTest, differing: str) -> bool:
    a, b = test.condition, other.condition
    alike = test.device == other.device and test.session == other.session
    alike &= same_level(a.actuation, b.actuation) and same(a.stroke, b.stroke)
    if differing == "temperature":
        both = np.isfinite(test.temperature) and np.isfinite(other.temperature)
        return alike and same(a.frequency, b.frequency) and bool(both)
    temperatures = {t.temperature for t in (test, other) if np.isfinite(t.temperature)}
    return alike and len(temperatures) < 2


def predictions(run: Run, tests: Sequence[HarmonicTest]) -> dict[str, Predicted]:
    """Draws of the motion of each test of a run, by the test's name."""
    of_tests, gains = {}, gains_of(run, DRAWS)
    for test in tests:
        assert test.trace is not None  # of a run, which has the motion of every test
        motion = replace(test.trace, force=None)
        strong = find_loops(motion).strong
        how: dict[str, Any] = prediction_conditions(run, test.name) | {"draws": DRAWS}
        values = {
            kind: cycle_values(motion, run.predict(motion, kind, **how).draws)
            for kind in ("observation", "mean")
        }
        of_tests[test.name] = Predicted(
            gains.applied({key: each[:, strong] for key, each in values["observation"].items()}),
            {key: each[:, strong].mean(axis=1) for key, each in values["mean"].items()},
        )
    return of_tests


def conformity(standard: Standard, evidence: DeviceEvidence) -> tuple[ConformityRow, ...]:
    """Verdicts on all requirements of a standard, in its order."""
    rows: list[ConformityRow] = []
    for requirement in standard.requirement:
        rows += _STATISTICS[requirement.statistic](requirement, evidence)
    return tuple(rows)


def summary(rows: Iterable[ConformityRow]) -> tuple[ConformityRow, ...]:
    """The worst row of each requirement and quantity, of the tests as wholes.

    A test that does not show a quantity counts only where none does. The steps of a sequence are
    one row: how many were made, and the first that was not.
    """
    groups: dict[tuple[str, str, str], list[ConformityRow]] = {}
    for row in rows:
        if not row.cycle:
            groups.setdefault((row.clause, row.requirement, row.quantity), []).append(row)
    worst = []
    for (*_, quantity), group in groups.items():
        if not quantity:
            lacking = [row for row in group if row.verdict != Conformity.MEETS]
            row = (lacking or group)[0]
            if len(group) > 1:
                made = f"{len(group) - len(lacking)} of {len(group)} steps made at every level"
                row = replace(row, note=f"{made}; {row.note}" if lacking else made)
            worst.append(row)
            continue
        shown = [row for row in group if row.verdict != Conformity.NOT_TESTED] or group
        fails = [row for row in shown if row.verdict == Conformity.FAILS] or shown
        worst.append(max(fails, key=lambda row: np.nan_to_num(abs(row.value), nan=-1.0)))
    return tuple(worst)


# --- the statistics


def over_mean(values: Array) -> Array:
    """Deviation of each value, (…, L), from their mean, as a share."""
    return np.asarray(values / values.mean(axis=-1, keepdims=True) - 1.0)


def over_third(values: Array) -> Array:
    """Deviation of each cycle from the second on, (…, L − 1), from the third, as a share."""
    return np.asarray(values[..., 1:] / values[..., 2:3] - 1.0)


def _items(requirement: Requirement) -> Iterable[tuple[DeviceProperty, float]]:
    """Properties that a requirement limits, with their limits."""
    for name, limit in requirement.limits.items():
        for item in quantities()[name]:
            yield item, limit


def _verdict(value: float, limit: float) -> Conformity:
    if not np.isfinite(value):
        return Conformity.NOT_TESTED
    return Conformity.MEETS if abs(value) <= limit else Conformity.FAILS


def _share_within(draws: Array, limit: float) -> float:
    """Share of draws, (n, …), all of whose values lie within a limit; NaN where most are none."""
    flat = draws.reshape(len(draws), -1)
    usable = np.all(np.isfinite(flat), axis=1)
    if usable.mean() < 0.5:
        return NOTHING
    return float(np.mean(np.all(np.abs(flat[usable]) <= limit, axis=1)))


def _row(requirement: Requirement, **values: Any) -> ConformityRow:
    return ConformityRow(clause=requirement.clause, requirement=requirement.requirement, **values)


def _row_of(requirement: Requirement, item: DeviceProperty, **values: Any) -> ConformityRow:
    return _row(requirement, quantity=item.quantity, direction=item.direction, **values)


def _untested(requirement: Requirement, item: DeviceProperty, **values: Any) -> ConformityRow:
    return _row_of(requirement, item, verdict=Conformity.NOT_TESTED, **values)


def _of_cycles(requirement: Requirement, evidence: DeviceEvidence) -> Iterable[ConformityRow]:
    """Each cycle against the mean of its test, or against the third."""
    third = requirement.statistic == "cycle over third"
    fewest, first, deviations = (3, 2, over_third) if third else (2, 1, over_mean)
    if not evidence.tests:
        for item, limit in _items(requirement):
            yield _untested(requirement, item, limit=limit, note=NO_TESTS)
    for test in evidence.tests:
        for item, limit in _items(requirement):
            row: dict[str, Any] = {"test": test.name, "limit": limit}
            values = test.values(item)
            if values.size < fewest or not np.all(np.isfinite(values)):
                note = f"{values.size} full cycles, {fewest} are needed"
                if values.size >= fewest:
                    note = "the record does not show it in every cycle"
                yield _untested(requirement, item, note=note, **row)
                continue
            each, draws = deviations(values), evidence.observed(test, item)
            drawn = np.full((1, each.size), NOTHING)
            if draws is not None and draws.shape[1] == values.size:
                drawn = deviations(draws)
            worst = int(np.abs(each).argmax())
            note = f"cycle {worst + first} of {values.size}"
            if item.name == "post_slip_stiffness":
                note += _little(test, item)
            yield _row_of(
                *(requirement, item),
                verdict=_verdict(each[worst], limit),
                value=float(each[worst]),
                probability=_share_within(drawn, limit),
                note=note,
                **row,
            )
            for k, value in enumerate(each.tolist()):
                yield _row_of(
                    *(requirement, item),
                    verdict=_verdict(value, limit),
                    cycle=k + first,
                    value=value,
                    probability=_share_within(drawn[:, k], limit),
                    **row,
                )


def _little(test: HarmonicTest, item: DeviceProperty) -> str:
    """What a share of a stiffness after slip that is almost zero tells."""
    secant = test.values(quantities()["effective_stiffness"][0]).mean()
    share = abs(test.values(item).mean() / secant)
    return f"; it is {share:.0%} of the effective stiffness" if share < 0.2 else ""


def _target(requirement: Requirement, evidence: DeviceEvidence) -> Iterable[ConformityRow]:
    return (row for row, _ in _over_target(requirement, evidence))


def _over_target(
    requirement: Requirement, evidence: DeviceEvidence
) -> Iterable[tuple[ConformityRow, DeviceProperty]]:
    """Mean of each test at the actuation and the displacement of the target over the target."""
    design = evidence.design
    tests = list(evidence.tests)
    if design.actuation:
        level, _ = parse_actuation(design.actuation)
        tests = [test for test in tests if same_level(test.condition.actuation, level)]
    if evidence.largest:
        tests = [test for test in tests if same(test.condition.stroke, evidence.largest)]
    for item, limit in _items(requirement):
        target = design.target_of(item)
        if target is None or not tests:
            note = f"state target.{item.quantity} in [design]"
            if target is not None:
                note = "no test at the actuation and the displacement of the target"
            yield _untested(requirement, item, limit=limit, note=note), item
            continue
        limit, value = target.tolerance or limit, target.internal(item.unit)
        for test in tests:
            ratio = float(test.values(item).mean()) / value - 1.0
            draws = evidence.observed(test, item)
            means = np.full(1, NOTHING) if draws is None else draws.mean(axis=1) / value - 1.0
            row = _row_of(
                *(requirement, item),
                verdict=_verdict(ratio, limit),
                test=test.name,
                value=ratio,
                limit=limit,
                probability=_share_within(means, limit),
            )
            yield row, item


def _supply(requirement: Requirement, evidence: DeviceEvidence) -> Iterable[ConformityRow]:
    """Mean of each device over the target, else over the mean of all devices."""
    for row, item in _over_target(requirement, evidence):
        if evidence.design.target_of(item):
            yield row
    for item, limit in _items(requirement):
        if evidence.design.target_of(item):
            continue
        by_device: dict[str, list[float]] = {}
        for test in evidence.tests:
            alike = [other for other in evidence.tests if _same_condition(test, other)]
            if len({other.device for other in alike}) < 2:
                continue  # a device alone does not deviate from itself
            mean = float(np.mean([other.values(item).mean() for other in alike]))
            share = float(test.values(item).mean()) / mean - 1.0
            by_device.setdefault(test.device, []).append(share)
        if len(by_device) < 2:
            note = f"state target.{item.quantity} in [design], or test two devices alike"
            yield _untested(requirement, item, limit=limit, note=note)
            continue
        for device, shares in by_device.items():
            value = float(np.mean(shares))
            yield _row_of(
                *(requirement, item),
                verdict=_verdict(value, limit),
                test=device or "(no name)",
                value=value,
                limit=limit,
                note="over the mean of all devices",
            )


def _same_condition(test: HarmonicTest, other: HarmonicTest) -> bool:
    a, b = test.condition, other.condition
    return (
        same_level(a.actuation, b.actuation)
        and same(a.stroke, b.stroke)
        and same(a.frequency, b.frequency)
    )


def changes(
    evidence: DeviceEvidence, item: DeviceProperty, differing: str
) -> list[tuple[list[HarmonicTest], Array, Array]]:
    """Of tests that differ in one condition alone: the tests, each one's mean over that of all.

    The deviations are measured, (k,), and drawn, (n, k): NaN where the posterior does not tell.
    """
    of_groups = []
    for group in evidence.groups(differing):
        means = np.array([float(test.values(item).mean()) for test in group])
        drawn = [evidence.predicted.get(t.name, Predicted()).mean.get(item.key) for t in group]
        knows = differing != "temperature" or evidence.follows_temperature
        draws = np.full((1, len(group)), NOTHING)
        if knows and all(each is not None for each in drawn):
            draws = np.stack([np.asarray(each) for each in drawn], axis=1)
        of_groups.append((group, over_mean(means), over_mean(draws)))
    return of_groups


def _with_condition(differing: str) -> Any:
    """Statistic of the change between tests that differ in one condition alone."""

    def rows(requirement: Requirement, evidence: DeviceEvidence) -> Iterable[ConformityRow]:
        for item, limit in _items(requirement):
            groups = changes(evidence, item, differing)
            if not groups:
                note = f"no two tests differ in the {differing} alone: make one again at another"
                yield _untested(requirement, item, limit=limit, note=note)
            for group, measured, draws in groups:
                worst = int(np.abs(measured).argmax())
                yield _row_of(
                    *(requirement, item),
                    verdict=_verdict(float(measured[worst]), limit),
                    test=group[worst].name,
                    value=float(measured[worst]),
                    limit=limit,
                    probability=_share_within(draws, limit),
                    note=f"of {', '.join(test.name for test in group)}",
                )

    return rows


def _ageing(requirement: Requirement, evidence: DeviceEvidence) -> Iterable[ConformityRow]:
    for item, limit in _items(requirement):
        note = "test a device after artificial ageing"
        yield _untested(requirement, item, limit=limit, note=note)


def missing_steps(
    requirement: Requirement, evidence: DeviceEvidence
) -> list[tuple[ProtocolStep, list[Condition]]]:
    """Steps of a sequence, each with the conditions under which it was not made.

    A frequency of NaN is any.
    """
    largest, period = evidence.largest, evidence.period
    assert largest is not None
    steps = []
    for step in requirement.steps:
        amplitude, hertz = step.amplitude * largest, step.hertz(period)
        lacking = []
        for level in levels_of(evidence.tests):
            made = any(
                same_level(test.condition.actuation, level)
                and same(test.condition.stroke, amplitude)
                and (hertz is None or same(test.condition.frequency, hertz))
                and test.made >= step.cycles - PARTIAL
                for test in evidence.tests
            )
            if not made:
                lacking.append(Condition(level, amplitude, NOTHING if hertz is None else hertz))
        steps.append((step, lacking))
    return steps


def _unstated(requirement: Requirement, evidence: DeviceEvidence) -> str:
    """What of the design a sequence needs and is not stated."""
    needed = {"mce": evidence.largest is None}
    needed["T1"] = evidence.period is None and any(step.frequency for step in requirement.steps)
    names = [name for name, lacks in needed.items() if lacks]
    return f"state {' and '.join(names)} in [design]" if names else ""


def rate_change(requirement: Requirement, evidence: DeviceEvidence) -> float:
    """Largest measured change of the quantities with the rate, as a share; NaN if not tested.

    It is the largest mean of tests that differ in the frequency alone over the smallest, less 1.
    """
    sizes = [
        float((1.0 + measured).max() / (1.0 + measured).min() - 1.0)
        for name in requirement.rate_quantities
        for item in quantities()[name]
        for _, measured, _ in changes(evidence, item, "frequency")
    ]
    return max(sizes, default=NOTHING)


def _sequence(requirement: Requirement, evidence: DeviceEvidence) -> Iterable[ConformityRow]:
    """Each step of a sequence, at every level of actuation that was tested."""
    reason = _unstated(requirement, evidence)
    if reason := reason or ("" if evidence.tests else NO_TESTS):
        yield _row(requirement, verdict=Conformity.NOT_TESTED, note=reason)
        return
    if requirement.rate_limit is not None:
        change = rate_change(requirement, evidence)
        if not change > requirement.rate_limit:
            verdict, note = Conformity.MEETS, f"not asked for: the largest change is {change:.1%}"
            if not np.isfinite(change):
                verdict, note = Conformity.NOT_TESTED, "no two tests differ in the frequency alone"
            limit = requirement.rate_limit
            yield _row(requirement, verdict=verdict, note=note, value=change, limit=limit)
            return
    levels = len(levels_of(evidence.tests))
    for step, missing in missing_steps(requirement, evidence):
        words = f"{step.amplitude:g} of mce, {step.cycles} cycles"
        words += f", {step.frequency}" if step.frequency else ""
        verdict, note = Conformity.MEETS, words
        if missing:
            verdict = Conformity.NOT_TESTED
            note = f"{words}: missing at {len(missing)} of {levels} levels, first "
            note += evidence.words(missing[0])
        made = 1.0 - len(missing) / levels
        yield _row(requirement, verdict=verdict, note=note, value=made)


def _devices(requirement: Requirement, evidence: DeviceEvidence) -> Iterable[ConformityRow]:
    """So many devices were tested; one that fails is told by what it fails."""
    count = len({test.device for test in evidence.tests})
    note = f"{count} of {requirement.devices} devices tested"
    verdict = Conformity.MEETS if count >= requirement.devices else Conformity.NOT_TESTED
    yield _row(requirement, verdict=verdict, note=note)


def _production(requirement: Requirement, evidence: DeviceEvidence) -> Iterable[ConformityRow]:
    steps = "; ".join(
        f"{step.cycles} cycles at {step.amplitude:g} of mce" for step in requirement.steps
    )
    share = (
        "every device" if requirement.share == 1.0 else f"{requirement.share:.0%} of the devices"
    )
    number = f", {requirement.devices} at least" if requirement.devices else ""
    note = f"test {share} of the supply{number} ({steps}), and compare: mfd-bayes accept"
    yield _row(requirement, verdict=Conformity.NOT_TESTED, note=note)


_STATISTICS: Mapping[str, Callable[[Requirement, DeviceEvidence], Iterable[ConformityRow]]] = {
    "cycle over mean": _of_cycles,
    "cycle over third": _of_cycles,
    "mean over target": _target,
    "supply": _supply,
    "change with rate": _with_condition("frequency"),
    "change with temperature": _with_condition("temperature"),
    "change with age": _ageing,
    "sequence": _sequence,
    "devices": _devices,
    "production": _production,
}
