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
from mfd_bayes.records.inspection import Inspection, inspect_record
from mfd_bayes.records.record import read_record
from mfd_bayes.records.together import Tested
from mfd_bayes.store.files import write_bytes, write_text


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


def inspect(path: Path, folder: Path) -> list[tuple[Inspection, Path]]:
    """Inspection of a test file, or of every test of a campaign, and its PNG in `folder`.

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

    pictures = []
    for inspection, name in found:
        picture = folder / f"{name}_inspect.png"
        title = f"{inspection.name}: as read"
        figure = draw_inspection(title, inspection.trace, inspection.loops, inspection.faults)
        write_bytes(picture, to_png(figure))
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


def prior_check(path: Path, folder: Path) -> list[tuple[str, float, Path]]:
    """Prior predictive loops compared with the data of every test, with a PNG each in `folder`.

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

    found = []
    for test in campaign.tests:
        trace = test.read().trace(campaign.rate, gap=priors.gap)
        if trace.force is None:
            raise RecordError(f"test {test.id!r} of {path} has no force to compare with")
        fan = prior_fan(campaign, priors, trace)
        picture = folder / f"{path.stem}_{test.id}_prior.png"
        figure = draw_loops(f"{test.id}: data over what the priors allow", trace, [fan])
        write_bytes(picture, to_png(figure))
        found.append((test.id, share_inside(fan, trace), picture))
    return found
