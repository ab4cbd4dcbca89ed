"""Records as they were read, and what would spoil a fit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mfd_bayes.calibration.priors import PriorFile, load_priors
from mfd_bayes.campaign.campaign import Campaign, Test, load_campaign
from mfd_bayes.evaluation.summary import zero_pressure_sentences
from mfd_bayes.friction.model import Model
from mfd_bayes.messages import Message
from mfd_bayes.population.design import Design, complete_laws
from mfd_bayes.population.inference import actuation_varies
from mfd_bayes.records.cross_checks import Tested, compare_tests
from mfd_bayes.records.data_quality import SPOILED, Fault, Inspection, inspect_record
from mfd_bayes.records.record import Record, read_record
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.findings import Finding
from mfd_bayes.runs.folder import check_outputs
from mfd_bayes.runs.unit_system import UnitSystem, named_system, system_of
from mfd_bayes.store.files import write_bytes
from mfd_bayes.units import split_quantity

WIDE, NARROW = 6.0, 1.0 / 12.0
"""A gap wider or narrower than the priors' typical one by these factors is in another unit."""

FAR = 3.5
"""A slip force is beyond the priors by this many of their standard deviations."""


def gap_of(model: Model, priors: PriorFile) -> float | None:
    """Typical width of the gap, in; None of a user's own model that has no gap."""
    return None if model.source and not model.has_gap else priors.gap


def inspect_test(
    campaign: Campaign, test: Test, record: Record, gap: float | None
) -> tuple[Inspection, list[Tested]]:
    """What a record shows by itself, and as it is compared with the others if it has a force.

    What a fault of the record spoils is not compared. A force that leads or lags the turns of the
    motion is no fault by a user's own model: that may be what it describes.
    """
    inspection = inspect_record(test.id, record, gap)
    if campaign.force_model.source:
        faults = tuple(fault for fault in inspection.faults if fault.name != "lag")
        inspection = replace(inspection, faults=faults)
    trace = inspection.trace
    if trace.force is None:
        return inspection, []
    tested = Tested.of(test.id, record, trace, test.actuation or "")
    if SPOILED.intersection(fault.name for fault in inspection.faults):
        tested = replace(tested, steady=False)
    return inspection, [tested]


def findings_together(
    tests: Sequence[Tested], priors: PriorFile, model: Model
) -> list[tuple[str, Fault]]:
    """What the comparison of tests with each other, and with the priors of a model, shows."""
    gap = priors.gap if model.has_gap else None
    faults = compare_tests(tests, same_motion=not model.standard_names)
    named = {name for name, fault in faults if fault.name != "duplicate"}
    if not model.standard_names:  # its parameters may have the names of others
        return faults
    prior_faults = [
        (t.id, fault) for t in tests if t.id not in named for fault in _beyond(t, priors, gap)
    ]
    return [*faults, *prior_faults]


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
    all_faults = [*faults, *_of_settings(campaign, design, calibrated)]
    findings = [Finding(name, fault.name, fault.message) for name, fault in all_faults]
    law_findings = [
        Finding("laws", "zero actuation", Message("{text}", {"text": sentence}))
        for sentence in zero_pressure_sentences(design, [*calibrated])
    ]
    return (*findings, *law_findings)


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
    forces = [name for name in model.slip_forces if design.laws.get(name) != "proportional"]
    for name, trace in tests.items():
        if actuation_varies(design, model, trace):
            changes = Fault.of(
                "actuation history",
                "its actuation changes: its own posterior takes friction in proportion to it, "
                f"whatever the law of {' and '.join(forces)}; the laws learn from it only the slip "
                "force at its mean actuation",
            )
            yield name, changes


def laws_without(model: Model, laws: Mapping[str, str]) -> list[str]:
    """Names whose law was given by the campaign, and which the model lacks."""
    sources = {
        source for name, source in model.laws_from.items() if laws.get(name) == laws.get(source)
    }
    law_names = {*model.laws, *model.shared_laws, *sources}
    model_laws = {name: law for name, law in laws.items() if name in law_names}
    lacking = []
    for name, law in laws.items():
        if name not in model_laws and complete_laws(model_laws).get(name, law) != law:
            lacking.append(name)
            model_laws[name] = law  # others that follow it were not given
    return lacking


def _beyond(test: Tested, priors: PriorFile, gap: float | None) -> Iterator[Fault]:
    """Gap and slip force that no device of the priors has: a unit, or another priors file."""
    width, slip = test.features["gap"], test.features["slip"]
    if not test.steady:
        return
    hint = "check its unit, or give priors that fit the device"
    if gap is not None and np.isfinite(width) and not NARROW < width / gap < WIDE:
        yield Fault.of(
            "beyond the priors",
            f"the loop's gap of {{value}} is {width / gap:.2g} times the one that the priors "
            f"expect ({{expected}}): the displacement is probably in another unit; {hint}",
            value=(width, "in"),
            expected=(gap, "in"),
        )
    prior = priors.parameters.get("Fc_fwd")
    if prior is None or prior.family != "lognormal" or not slip > 0.0:
        return
    ratio = slip / prior.figures["median"]
    if abs(np.log(ratio)) > FAR * prior.figures["sigma"] and test.level > 0.0:
        yield Fault.of(
            "beyond the priors",
            f"the loop's slip force of {{value}} is {ratio:.2g} times the one that the priors "
            f"expect ({{expected}}): the force is probably in another unit; {hint}",
            value=(slip, "kip"),
            expected=(prior.figures["median"], "kip"),
        )


# --- what is looked at before a calibration


def inspect(
    path: Path, folder: Path, *, force: bool = False, units: str = ""
) -> tuple[list[tuple[Inspection, Path]], UnitSystem]:
    """Inspection of a test file, or of every test of a campaign, and its PNG in `folder`.

    Its facts are in the units of a system, "us" or "si"; by default the records' own. That system
    is returned too: in it the messages of faults are written. With `force`, a PNG that exists is
    replaced.
    """
    if path.suffix.lower() == ".toml":
        inspections, records = inspect_campaign(path)
        names = [f"{path.stem}_{inspection.name}" for inspection in inspections]
    else:
        records = [read_record(path)]
        inspections, names = [inspect_record(path.name, records[0])], [path.stem]
    system = system_of_records(records, units)
    from mfd_bayes.reporting.figures import draw_inspection, to_png

    pictures = [folder / f"{name}_inspect.png" for name in names]
    check_outputs(pictures, [path], force=force)
    converted = [
        _to_units(inspection, record, system)
        for inspection, record in zip(inspections, records, strict=True)
    ]
    for inspection, picture in zip(converted, pictures, strict=True):
        title = f"{inspection.name}: as read"
        figure = draw_inspection(title, inspection.trace, inspection.faults, system)
        write_bytes(picture, to_png(figure))
    return list(zip(converted, pictures, strict=True)), system


def inspect_campaign(path: Path) -> tuple[list[Inspection], list[Record]]:
    """Inspections of the tests of a campaign, with what their comparison shows; their records."""
    campaign = load_campaign(path)
    records = [test.read() for test in campaign.tests]
    priors = load_priors(campaign.priors, campaign.folder, campaign.force_model)
    gap, inspections, tested = gap_of(campaign.force_model, priors), [], []
    for test, record in zip(campaign.tests, records, strict=True):
        inspection, compared = inspect_test(campaign, test, record, gap)
        tested += compared
        if test.after:
            follows = Message("test {after}, without a reset", {"after": test.after})
            inspection = replace(inspection, facts={**inspection.facts, "follows": follows})
        inspections.append(inspection)
    together = findings_together(tested, priors, campaign.force_model)
    return [
        replace(i, faults=(*i.faults, *(fault for name, fault in together if name == i.name)))
        for i in inspections
    ], records


def system_of_records(records: Iterable[Record], units: str = "") -> UnitSystem:
    """System of units of a name, else the one that fits the records' own units and sizes."""
    records = list(records)
    record_system = system_of(
        (record.columns["displacement"][1] for record in records),
        (record.force for record in records),
        (
            split_quantity(record.given_actuation)[1]
            if record.given_actuation
            else record.columns.get("actuation", ("", ""))[1]
            for record in records
        ),
        records[0].axes,
        (record.columns["force"][1] for record in records if "force" in record.columns),
    )
    return named_system(units, record_system)


def _to_units(inspection: Inspection, record: Record, system: UnitSystem) -> Inspection:
    """The inspection of a record, its facts in the units of a system."""
    facts = {
        system.text(name): Message("{text}", {"text": fact.to_text(system)})
        for name, fact in inspection.facts.items()
    }
    if (
        "actuation" in facts and record.actuation_unit is not None
    ):  # of the value itself: a rounded one is not 7 bar
        level = system.actuation(inspection.trace, record.actuation_unit)
        facts["actuation"] = Message("{text}", {"text": level})
    return replace(inspection, facts=facts)
