"""What a test file, or every test of a campaign, holds, and what would spoil a fit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from mfd_bayes.calibration.priors import load_priors
from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.messages import Message
from mfd_bayes.pipeline.findings import faults_for, findings_together, gap_of, tested_of
from mfd_bayes.pipeline.outputs import check_outputs
from mfd_bayes.records.data_quality import Inspection, inspect_record
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.record import Record, read_record
from mfd_bayes.reporting.tables import convert_trace
from mfd_bayes.runs.unit_system import System, named_system, system_of
from mfd_bayes.store.files import write_bytes
from mfd_bayes.units import split_quantity


def inspect(
    path: Path, folder: Path, *, force: bool = False, units: str = ""
) -> tuple[list[tuple[Inspection, Path]], System]:
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
    shown = [
        _to_units(inspection, record, system)
        for inspection, record in zip(inspections, records, strict=True)
    ]
    for inspection, picture in zip(shown, pictures, strict=True):
        trace = convert_trace(inspection.trace, system)
        title = f"{inspection.name}: as read"
        figure = draw_inspection(title, trace, find_loops(trace), inspection.faults, system)
        write_bytes(picture, to_png(figure))
    return list(zip(shown, pictures, strict=True)), system


def inspect_campaign(path: Path) -> tuple[list[Inspection], list[Record]]:
    """Inspections of the tests of a campaign, with what their comparison shows; their records."""
    campaign = load_campaign(path)
    records = [test.read() for test in campaign.tests]
    priors = load_priors(campaign.priors, campaign.folder, campaign.force_model)
    inspections, tested = [], []
    for test, record in zip(campaign.tests, records, strict=True):
        inspection = inspect_record(test.id, record, gap_of(campaign.force_model, priors))
        inspection = replace(inspection, faults=faults_for(campaign.force_model, inspection.faults))
        compared = tested_of(test, record, inspection.trace)
        tested += [compared] if compared else []
        if test.after:
            follows = Message("test {after}, without a reset", {"after": test.after})
            inspection = replace(inspection, facts={**inspection.facts, "follows": follows})
        inspections.append(inspection)
    together = findings_together(tested, priors, campaign.force_model)
    return [
        replace(i, faults=(*i.faults, *(fault for name, fault in together if name == i.name)))
        for i in inspections
    ], records


def system_of_records(records: Iterable[Record], units: str = "") -> System:
    """System of units of a name, else the one that fits the records' own units and sizes."""
    records = list(records)
    own = system_of(
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
    return named_system(units, own)


def _to_units(inspection: Inspection, record: Record, system: System) -> Inspection:
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
