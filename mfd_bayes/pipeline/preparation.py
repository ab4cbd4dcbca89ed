"""Preparation of a calibration: a first campaign file, and checks of records and priors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from mfd_bayes.calibration.prior_files import WRITTEN, load_priors
from mfd_bayes.campaign.campaign import load_campaign
from mfd_bayes.campaign.draft import (
    Draft,
    campaign_text,
    draft_campaign,
    own_priors,
)
from mfd_bayes.campaign.draft.priors import Units, priors_text
from mfd_bayes.errors import CampaignError, RecordError
from mfd_bayes.evaluation.prior_check import MOST, most_wrong, prior_fan, share_inside
from mfd_bayes.messages import Message
from mfd_bayes.pipeline.findings import findings_together, tested_of
from mfd_bayes.pipeline.outputs import check_outputs
from mfd_bayes.records.cross_checks import Tested
from mfd_bayes.records.loop_features import scales_of
from mfd_bayes.records.loops import find_loops
from mfd_bayes.records.record import Record, read_record
from mfd_bayes.records.summary import Inspection, inspect_record
from mfd_bayes.reporting.conversion import convert_fan, convert_trace
from mfd_bayes.runs.unit_system import System, named_system, system_of
from mfd_bayes.store.files import write_bytes, write_text
from mfd_bayes.units import split_quantity


def init(folder: Path, *, force: bool = False) -> tuple[Path, Draft]:
    """Path and content of a first campaign.toml, written for the test files in a folder.

    Raises
    ------
    MfdError
        When the folder holds no test, or a campaign.toml and `force` is not given; nothing is
        written then.
    """
    path, priors = folder / "campaign.toml", folder / WRITTEN
    _check_new(path, force=force)
    draft = draft_campaign(folder)
    if (text := own_priors(draft)) is not None:
        _check_new(priors, force=force)
        write_text(priors, text)
    write_text(path, campaign_text(draft))
    return path, draft


def needs_priors(draft: Draft) -> bool:
    """Whether priors were written for a draft, since no shipped file knows such a device."""
    return own_priors(draft) is not None


def init_priors(path: Path, *, force: bool = False) -> tuple[Path, bool]:
    """Path of a prior file beside a campaign, its scales read off the campaign's records.

    Also returns whether the campaign names it already.

    Raises
    ------
    MfdError
        When the campaign or a record cannot be used, or there is a priors.toml and `force` is not
        given; nothing is written then.
    """
    campaign = load_campaign(path)
    written = campaign.folder / WRITTEN
    _check_new(written, force=force)
    tests = {test.id: test.read() for test in campaign.tests if test.role == "calibrate"}
    found = {
        name: scales
        for name, record in tests.items()
        if (scales := scales_of(record.trace())) is not None
    }
    if not found:
        raise CampaignError(f"no test of {path} has a force, so it shows no scales of priors")
    units = Units(*(_usual(tests.values(), role) for role in ("force", "displacement")))
    write_text(written, priors_text(found, units))
    return written, campaign.priors == WRITTEN


def _check_new(path: Path, *, force: bool) -> None:
    if path.exists() and not force:
        raise CampaignError(f"{path} exists: give --force to replace it")


def _usual(records: Iterable[Record], role: str) -> str:
    """Unit that most records have for a role."""
    units = [record.columns[role][1] for record in records if role in record.columns]
    return Counter(units).most_common(1)[0][0]


def inspect(
    path: Path, folder: Path, *, force: bool = False, units: str = ""
) -> tuple[list[tuple[Inspection, Path]], System]:
    """Inspection of a test file, or of every test of a campaign, and its PNG in `folder`.

    Its facts are in the units of a system, "us" or "si"; by default the records' own. That system
    is returned too: in it the messages of faults are written. With `force`, a PNG that exists is
    replaced.

    Raises
    ------
    MfdError
        When the file cannot be read or used.
    """
    if path.suffix.lower() == ".toml":
        inspected, records = inspect_campaign(path)
        found = [(one, f"{path.stem}_{one.name}") for one in inspected]
    else:
        records = [read_record(path)]
        found = [(inspect_record(path.name, records[0]), path.stem)]
    system = system_of_records(records, units)
    from mfd_bayes.reporting.figures import draw_inspection, to_png

    places = [folder / f"{name}_inspect.png" for _, name in found]
    check_outputs(places, [path], force=force)
    pictures = []
    for (inspection, _), record, picture in zip(found, records, places, strict=True):
        title = f"{inspection.name}: as read"
        inspection = _reworded(inspection, record, system)
        trace = convert_trace(inspection.trace, system)
        figure = draw_inspection(title, trace, find_loops(trace), inspection.faults, system)
        write_bytes(picture, to_png(figure))
        pictures.append((inspection, picture))
    return pictures, system


def _reworded(inspection: Inspection, record: Record, system: System) -> Inspection:
    """The inspection of a record, its facts in the units of a system."""
    facts = {
        name: Message("{text}", {"text": fact.to_text(system.words)})
        for name, fact in inspection.facts.items()
    }
    if record.actuation_unit is not None:  # of the value itself: a rounded one is not 7 bar
        level = system.actuation(inspection.trace, record.actuation_unit)
        facts["actuation"] = Message("{text}", {"text": level})
    return replace(inspection, facts=facts)


def system_of_records(records: Iterable[Record], units: str = "") -> System:
    """System of units of a name, else the one that fits the records' own units and sizes."""
    known = list(records)
    own = system_of(
        (r.columns["displacement"][1] for r in known),
        (r.force for r in known),
        (
            split_quantity(r.given_actuation)[1]
            if r.given_actuation
            else r.columns.get("actuation", ("", ""))[1]
            for r in known
        ),
    )
    return named_system(units, own)


def inspect_campaign(path: Path) -> tuple[list[Inspection], list[Record]]:
    """Inspections of the tests of a campaign, with what their comparison shows; their records."""
    campaign = load_campaign(path)
    found: list[Inspection] = []
    tested: list[Tested] = []
    records = [test.read() for test in campaign.tests]
    priors = load_priors(campaign.priors, campaign.folder)
    for test, record in zip(campaign.tests, records, strict=True):
        found.append(_followed(inspect_record(test.id, record, priors.gap), test.after))
        if (one := tested_of(test, record, found[-1].trace)) is not None:
            tested.append(one)
    together = findings_together(tested, priors, campaign.model)
    return [
        replace(one, faults=(*one.faults, *(f for name, f in together if name == one.name)))
        for one in found
    ], records


def _followed(inspection: Inspection, after: str) -> Inspection:
    """The inspection of a test with the test that it follows, if it does."""
    if not after:
        return inspection
    follows = Message("test {after}, without a reset", {"after": after})
    return replace(inspection, facts={**inspection.facts, "follows": follows})


@dataclass(frozen=True)
class PriorCheck:
    """What the priors of a campaign allow.

    Attributes
    ----------
    tests : tuple of (test's id, share of the measured force inside the 95 % prior band, picture)
    unloaded : tuple of str
        Tests without actuation of whose force most lies outside, where others have one: the priors
        are of a device under actuation, and need not fit them.
    outside : tuple of str
        The other tests of whose force most lies outside.
    wrong : str
        Which prior is most wrong and what would mend it, by the tests outside; empty without any.
    """

    tests: tuple[tuple[str, float, Path], ...]
    unloaded: tuple[str, ...]
    outside: tuple[str, ...]
    wrong: str


def prior_check(path: Path, folder: Path, *, force: bool = False, units: str = "") -> PriorCheck:
    """Prior predictive loops compared with the data of every test, with a PNG each in `folder`.

    With `force`, a PNG that exists is replaced.

    Raises
    ------
    MfdError
        When the campaign, its priors or a record cannot be used.
    """
    campaign = load_campaign(path)
    priors = load_priors(campaign.priors, campaign.folder)
    from mfd_bayes.reporting.figures import draw_loops, to_png

    places = {test.id: folder / f"{path.stem}_{test.id}_prior.png" for test in campaign.tests}
    inputs = [path, *(test.path for test in campaign.tests)]
    check_outputs(places.values(), inputs, force=force)
    found, traces = [], {}
    records = {test.id: test.read() for test in campaign.tests}
    system = system_of_records(records.values(), units)
    for test in campaign.tests:
        trace = records[test.id].trace(campaign.rate, gap=priors.gap)
        if trace.force is None:
            raise RecordError(f"test {test.id!r} of {path} has no force to compare with")
        fan = prior_fan(campaign, priors, trace)
        shown = convert_trace(trace, system), [convert_fan(fan, system.factor("kip"))]
        figure = draw_loops(f"{test.id}: data over what the priors allow", *shown, system)
        write_bytes(places[test.id], to_png(figure))
        share = share_inside(fan, trace)
        found.append((test.id, share, places[test.id]))
        traces[test.id] = trace
    still = [name for name, trace in traces.items() if trace.reference_actuation == 0.0]
    noted = still if len(still) < len(traces) else []
    missed = [name for name, share, _ in found if share < MOST]
    unloaded = tuple(name for name in missed if name in noted)
    outside = tuple(name for name in missed if name not in noted)
    misfit = most_wrong(priors, campaign.model, [traces[name] for name in outside])
    return PriorCheck(tuple(found), unloaded, outside, misfit.sentence(system) if misfit else "")
