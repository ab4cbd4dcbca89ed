"""Preparation of a calibration: a first campaign file, and checks of records and priors."""

from __future__ import annotations

from pathlib import Path

from mfd_bayes.assessment.prior_check import prior_fan, share_inside
from mfd_bayes.assessment.zeros import zero_sentences
from mfd_bayes.calibration.prior_files import load_priors
from mfd_bayes.campaign.draft import Draft, campaign_text, draft_campaign
from mfd_bayes.campaign.file import load_campaign
from mfd_bayes.errors import CampaignError, RecordError
from mfd_bayes.pipeline.outputs import Output, check_outputs, is_picture, write_picture
from mfd_bayes.pipeline.plan import Plan, layout_of
from mfd_bayes.records.declared import contradictions
from mfd_bayes.records.faults import find_faults
from mfd_bayes.records.inspection import Inspection, inspect_record, same_record
from mfd_bayes.records.record import read_record
from mfd_bayes.records.trace import Trace
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
        campaign = load_campaign(path)
        gap = load_priors(campaign.priors, campaign.folder).gap
        found = [
            (inspect_record(t.id, t.read(), gap), f"{path.stem}_{t.id}") for t in campaign.tests
        ]
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


def find_warnings(plan: Plan) -> list[tuple[str, str]]:
    """Faults that would spoil the fit of a test, for all tests of a campaign: test id and sentence.

    And what tests at zero actuation do not tell, for "laws". The plan must hold the records.
    """
    gap = plan.priors.gap
    found: list[tuple[str, str]] = []
    known: dict[str, Trace] = {}
    for test in plan.campaign.tests:
        trace = plan.records[test.id].trace()
        faults = (*contradictions(plan.records[test.id], trace), *find_faults(trace, gap))
        found += [(test.id, fault.sentence) for fault in faults]
        twin = next((name for name, other in known.items() if same_record(trace, other)), None)
        if twin is not None:
            found.append((test.id, f"same record as {twin}: it would count twice"))
        known[test.id] = trace
    layout = layout_of(plan.tasks, plan.manifest.settings)
    sentences = zero_sentences(layout, [task.id for task in plan.tasks])
    return found + [("laws", sentence) for sentence in sentences]


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
