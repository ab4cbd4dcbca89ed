"""Preparation of a calibration: a first campaign file, and checks of records and priors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mfd_bayes.assessment.prior_check import prior_fan, share_inside
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.campaign.draft import Draft, campaign_text, draft_campaign
from mfd_bayes.campaign.file import load_campaign
from mfd_bayes.errors import CampaignError, RecordError
from mfd_bayes.pipeline.findings import findings_together, tested_of
from mfd_bayes.pipeline.outputs import Output, check_outputs, is_picture, write_picture
from mfd_bayes.records.inspection import Inspection, inspect_record
from mfd_bayes.records.record import read_record
from mfd_bayes.records.together import Tested
from mfd_bayes.reporting.conversion import convert_fan, convert_trace
from mfd_bayes.runs.systems import system_of
from mfd_bayes.store.files import write_text


def init(folder: Path, *, force: bool = False) -> tuple[Path, Draft]:
    """Path and content of a first campaign.toml, written for the test files in a folder.

    Raises
    ------
    MfdError
        When the folder holds no test, or a campaign.toml and `force` is not given; nothing is
        written then.
    """
    path = folder / "campaign.toml"
    if path.exists() and not force:
        raise CampaignError(f"{path} exists: give --force to replace it")
    draft = draft_campaign(folder)
    write_text(path, campaign_text(draft))
    return path, draft


def inspect(path: Path, folder: Path, *, force: bool = False) -> list[tuple[Inspection, Path]]:
    """Inspection of a test file, or of every test of a campaign, and its PNG in `folder`.

    With `force`, a file of another program in the place of a PNG is replaced.

    Raises
    ------
    MfdError
        When the file cannot be read or used.
    """
    if path.suffix.lower() == ".toml":
        found = [(one, f"{path.stem}_{one.name}") for one in inspect_campaign(path)]
    else:
        found = [(inspect_record(path.name, read_record(path)), path.stem)]
    from mfd_bayes.reporting.figures import draw_inspection, to_png

    places = [folder / f"{name}_inspect.png" for _, name in found]
    check_outputs([Output(place, is_picture) for place in places], [path], force=force)
    pictures = []
    for (inspection, _), picture in zip(found, places, strict=True):
        title = f"{inspection.name}: as read"
        figure = draw_inspection(title, inspection.trace, inspection.loops, inspection.faults)
        write_picture(picture, to_png(figure))
        pictures.append((inspection, picture))
    return pictures


def inspect_campaign(path: Path) -> list[Inspection]:
    """Inspections of the tests of a campaign, with what their comparison shows."""
    campaign = load_campaign(path)
    priors = load_priors(campaign.priors, campaign.folder)
    found: list[Inspection] = []
    tested: list[Tested] = []
    for test in campaign.tests:
        record = test.read()
        found.append(inspect_record(test.id, record, priors.gap))
        if (one := tested_of(test, record, found[-1].trace)) is not None:
            tested.append(one)
    together = findings_together(tested, priors, campaign.model)
    return [
        replace(one, faults=(*one.faults, *(f for name, f in together if name == one.name)))
        for one in found
    ]


def prior_check(path: Path, folder: Path, *, force: bool = False) -> list[tuple[str, float, Path]]:
    """Prior predictive loops compared with the data of every test, with a PNG each in `folder`.

    With `force`, a file of another program in the place of a PNG is replaced.

    Returns
    -------
    list of (test's id, share of the measured force inside the 95 % prior band, picture)

    Raises
    ------
    MfdError
        When the campaign, its priors or a record cannot be used.
    """
    campaign = load_campaign(path)
    priors = load_priors(campaign.priors, campaign.folder)
    from mfd_bayes.reporting.figures import draw_loops, to_png

    places = {test.id: folder / f"{path.stem}_{test.id}_prior.png" for test in campaign.tests}
    outputs = [Output(place, is_picture) for place in places.values()]
    check_outputs(outputs, [path, *(test.path for test in campaign.tests)], force=force)
    found = []
    for test in campaign.tests:
        record = test.read()
        trace = record.trace(campaign.rate, gap=priors.gap)
        if trace.force is None:
            raise RecordError(f"test {test.id!r} of {path} has no force to compare with")
        fan = prior_fan(campaign, priors, trace)
        system = system_of([record.columns["displacement"][1]])
        shown = convert_trace(trace, system), [convert_fan(fan, system.factor("kip"))]
        figure = draw_loops(f"{test.id}: data over what the priors allow", *shown, system)
        write_picture(places[test.id], to_png(figure))
        found.append((test.id, share_inside(fan, trace), places[test.id]))
    return found
