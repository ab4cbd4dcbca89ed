"""Property factors λ of a standard: of cycles, of speed and of temperature, and their composition.

λ of cycles is the value of a cycle over the nominal one, the mean of the first three cycles of its
test; λ of speed and of temperature is the mean of a test over that of all tests that differ in this
alone. λ_test is their product, all maxima together and all minima together. The scatter from test
to test is none of them: the bounds of the data sheet have it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mfd_bayes.applications.properties.conformity import DeviceEvidence, changes
from mfd_bayes.applications.properties.harmonic import CYCLES, Array, HarmonicTest
from mfd_bayes.campaign.schema import DesignTable
from mfd_bayes.campaign.standard import FactorRule, Standard
from mfd_bayes.population.design import same_level
from mfd_bayes.records.cycles import DeviceProperty, quantities

NOTHING = float("nan")
TAIL = 0.025  # on each side of the posterior's interval of a factor
OF = ("slip_force", "force_at_max_displacement", "effective_stiffness", "energy")
"""Quantities that have factors."""


@dataclass(frozen=True, kw_only=True)
class Factor:
    """Smallest and largest measured factor of one kind, each with the posterior's 95 % interval."""

    smallest: float = 1.0
    largest: float = 1.0
    smallest_interval: tuple[float, float] = (NOTHING, NOTHING)
    largest_interval: tuple[float, float] = (NOTHING, NOTHING)
    tests: int = 0  # from which it was read; 0 where it was not tested

    @classmethod
    def of(cls, measured: Sequence[Array], draws: Sequence[Array]) -> Factor:
        """Of factors of several tests or groups, (k,) each, and their draws, (n, k)."""
        if not measured:
            return cls()
        values = np.concatenate(measured)
        ends = {}
        for name, pick in (("smallest", np.min), ("largest", np.max)):
            extremes = [pick(each, axis=1) for each in draws if np.all(np.isfinite(each))]
            interval = (NOTHING, NOTHING)
            if len(extremes) == len(measured):
                shortest = min(map(len, extremes))
                together = pick(np.stack([each[:shortest] for each in extremes]), axis=0)
                low, high = np.quantile(together, [TAIL, 1.0 - TAIL]).tolist()
                interval = low, high
            ends[name] = interval
        return cls(
            smallest=float(values.min()),
            largest=float(values.max()),
            smallest_interval=ends["smallest"],
            largest_interval=ends["largest"],
            tests=len(measured),
        )


@dataclass(frozen=True, kw_only=True)
class PropertyFactors:
    """λ of a quantity at a level of actuation; `lambda_min`, `lambda_max` as the standard has it.

    `composed_min` and `composed_max` are those before the standard's least and largest value; all
    four are NaN where the standard composes none.
    """

    actuation: float
    quantity: str
    direction: str
    cycles: Factor
    speed: Factor
    temperature: Factor
    test_min: float
    test_max: float
    composed_min: float = NOTHING
    composed_max: float = NOTHING
    lambda_min: float = NOTHING
    lambda_max: float = NOTHING


def property_factors(
    standard: Standard, evidence: DeviceEvidence, levels: Iterable[float]
) -> tuple[PropertyFactors, ...]:
    """Factors at levels of actuation, ksi or kip, from the harmonic tests there."""
    rows = []
    for level in levels:
        tests = [t for t in evidence.tests if same_level(t.condition.actuation, level)]
        at_level = replace(evidence, tests=tests)
        for name in OF:
            for item in quantities()[name]:
                rows.append(_factors(standard.factors, at_level, item, level))
    return tuple(rows)


def _factors(
    rule: FactorRule | None, evidence: DeviceEvidence, item: DeviceProperty, level: float
) -> PropertyFactors:
    cycles = Factor.of(*_of_cycles(evidence, item))
    others = []
    for differing in ("frequency", "temperature"):
        groups = changes(evidence, item, differing)
        others.append(Factor.of([1 + m for _, m, _ in groups], [1 + d for _, _, d in groups]))
    kinds = (cycles, *others)
    smallest = float(np.prod([kind.smallest for kind in kinds]))
    largest = float(np.prod([kind.largest for kind in kinds]))
    return PropertyFactors(
        actuation=level,
        quantity=item.quantity,
        direction=item.direction,
        cycles=cycles,
        speed=others[0],
        temperature=others[1],
        test_min=smallest,
        test_max=largest,
        **composed(rule, evidence.design, smallest, largest),
    )


def composed(
    rule: FactorRule | None, design: DesignTable, test_min: float, test_max: float
) -> Mapping[str, float]:
    """λ of tests, ageing and specification together; empty where the standard composes none."""
    if rule is None:
        return {}
    ageing, spec = design.lambda_ae, design.lambda_spec
    largest = (1.0 + rule.ageing_share * (ageing.max - 1.0)) * test_max * spec.max
    smallest = (1.0 - rule.ageing_share * (1.0 - ageing.min)) * test_min * spec.min
    return {
        "composed_min": smallest,
        "composed_max": largest,
        "lambda_min": min(smallest, rule.min_at_most),
        "lambda_max": max(largest, rule.max_at_least),
    }


def _of_cycles(evidence: DeviceEvidence, item: DeviceProperty) -> tuple[list[Array], list[Array]]:
    """Each cycle over the nominal value of its test, measured and drawn."""
    measured, draws = [], []
    for test in evidence.tests:
        values = test.values(item)
        if test.count < 2 or not np.all(np.isfinite(values)):
            continue
        measured.append(over_nominal(values))
        drawn = evidence.observed(test, item)
        draws.append(np.full((1, 1), NOTHING) if drawn is None else over_nominal(drawn))
    return measured, draws


def over_nominal(values: Array) -> Array:
    """Values of cycles, (…, L), over the mean of the first three."""
    return np.asarray(values / values[..., :CYCLES].mean(axis=-1, keepdims=True))


def nominal_of_tests(tests: Sequence[HarmonicTest], item: DeviceProperty) -> float:
    """Mean of the first three cycles of several tests, and of these; NaN without any."""
    values = [test.nominal(item) for test in tests]
    finite = [value for value in values if np.isfinite(value)]
    return float(np.mean(finite)) if finite else NOTHING
