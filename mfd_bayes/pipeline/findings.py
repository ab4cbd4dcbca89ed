"""Warnings about the records of a campaign: each by itself, against the others and the priors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from mfd_bayes.calibration.priors import PriorFile
from mfd_bayes.campaign.campaign import Campaign, Test
from mfd_bayes.evaluation.summary import zero_pressure_sentences
from mfd_bayes.friction.model import Model
from mfd_bayes.messages import Message
from mfd_bayes.population.design import Design
from mfd_bayes.population.inference import swings
from mfd_bayes.population.laws import complete_laws
from mfd_bayes.records.cross_checks import Tested, compare_tests
from mfd_bayes.records.data_quality import Fault, contradictions, find_faults
from mfd_bayes.records.record import Record
from mfd_bayes.records.trace import Trace, without_spikes
from mfd_bayes.runs.verdict import Finding

WIDE, NARROW = 6.0, 1.0 / 12.0
"""A gap wider or narrower than the priors' typical one by these factors is in another unit."""

FAR = 3.5
"""A slip force is beyond the priors by this many of their standard deviations."""


def gap_of(model: Model, priors: PriorFile) -> float | None:
    """Typical width of the gap, in; None of a user's own model that has no gap."""
    return None if model.source and not model.has_gap else priors.gap


def faults_of(
    record: Record, trace: Trace, campaign: Campaign, gap: float | None
) -> tuple[Fault, ...]:
    """Faults that a record shows by itself; the trace has every sample."""
    faults = faults_for(campaign.force_model, find_faults(trace, gap))
    return (*contradictions(record, without_spikes(trace)), *faults)


def faults_for(model: Model, faults: Iterable[Fault]) -> tuple[Fault, ...]:
    """Those of a record's faults that are faults by a model.

    A force that leads or lags the turns of the motion is none by a user's own: that may be what it
    describes.
    """
    return tuple(fault for fault in faults if not (model.source and fault.name == "lag"))


def tested_of(test: Test, record: Record, trace: Trace) -> Tested | None:
    """A test as it is compared with the others; None without a force."""
    if trace.force is None:
        return None
    return Tested.of(test.id, record, trace, test.actuation or "")


def findings_together(
    tests: Sequence[Tested], priors: PriorFile, model: Model
) -> list[tuple[str, Fault]]:
    """What the comparison of tests with each other, and with the priors of a model, shows."""
    gap = priors.gap if model.has_gap else None
    found = compare_tests(tests)
    named = {name for name, fault in found if fault.name != "duplicate"}
    if not model.standard_names:  # its parameters may have the names of others
        return found
    beyond = [
        (t.id, fault) for t in tests if t.id not in named for fault in _beyond(t, priors, gap)
    ]
    return [*found, *beyond]


def findings_of(
    faults: Sequence[tuple[str, Fault]],
    campaign: Campaign,
    design: Design,
    calibrated: Mapping[str, Trace],
) -> tuple[Finding, ...]:
    """All warnings before a calibration.

    They are faults, what a campaign asks for and the calibration does not do, and what tests at
    zero actuation do not tell.
    """
    every = [*faults, *_of_settings(campaign, design, calibrated)]
    found = [Finding(name, fault.name, fault.message) for name, fault in every]
    told = [
        Finding("laws", "zero actuation", Message("{text}", {"text": sentence}))
        for sentence in zero_pressure_sentences(design, [*calibrated])
    ]
    return (*found, *told)


def _of_settings(
    campaign: Campaign, design: Design, tests: Mapping[str, Trace]
) -> Iterator[tuple[str, Fault]]:
    """What a campaign asks for that the calibration of its tests does not do."""
    model, settings = campaign.force_model, campaign.settings
    if lacking := laws_without(model, settings.laws):
        unused_laws = Fault.of(
            "laws",
            f"[laws] names {' and '.join(lacking)}, which the model {model.name} does not have: it "
            "is not used",
        )
        yield "laws", unused_laws
    unused = [name for name in settings.dependence if name not in design.names]
    if unused:
        dependence = Fault.of(
            "dependence",
            f"[dependence] names {' and '.join(unused)}, which the tests of the model "
            f"{model.name} do not share: it is not used",
        )
        yield "laws", dependence
    other = [name for name in model.slip_forces if design.laws.get(name) != "proportional"]
    for name, trace in tests.items():
        if swings(design, model, trace):
            changes = Fault.of(
                "actuation history",
                "its actuation changes: its own posterior takes friction in proportion to it, "
                f"whatever the law of {' and '.join(other)}; the laws learn from it only the slip "
                "force at its mean actuation",
            )
            yield name, changes


def laws_without(model: Model, laws: Mapping[str, str]) -> list[str]:
    """Names whose law was given by the campaign, and which the model lacks."""
    taken = {other for name, other in model.laws_from.items() if laws.get(name) == laws.get(other)}
    used = {*model.laws, *model.tied_laws, *taken}
    given = {name: law for name, law in laws.items() if name in used}
    found = []
    for name, law in laws.items():
        if name not in given and complete_laws(given).get(name, law) != law:
            found.append(name)
            given[name] = law  # others that follow it were not given
    return found


def _beyond(test: Tested, priors: PriorFile, gap: float | None) -> Iterator[Fault]:
    """Gap and slip force that no device of the priors has: a unit, or another priors file."""
    read = test.features
    if read is None:
        return
    hint = "check its unit, or give priors that fit the device"
    if gap is not None and np.isfinite(read.gap) and not NARROW < read.gap / gap < WIDE:
        yield Fault.of(
            "beyond the priors",
            f"the loop's gap of {{value}} is {read.gap / gap:.2g} times the one that the priors "
            f"expect ({{expected}}): the displacement is probably in another unit; {hint}",
            value=(read.gap, "in"),
            expected=(gap, "in"),
        )
    prior = priors.parameters.get("Fc_fwd")
    if prior is None or prior.family != "lognormal" or not read.plateau > 0.0:
        return
    ratio = read.plateau / prior.figures["median"]
    if abs(np.log(ratio)) > FAR * prior.figures["spread"] and test.level > 0.0:
        yield Fault.of(
            "beyond the priors",
            f"the loop's slip force of {{value}} is {ratio:.2g} times the one that the priors "
            f"expect ({{expected}}): the force is probably in another unit; {hint}",
            value=(read.plateau, "kip"),
            expected=(prior.figures["median"], "kip"),
        )
