"""The commands that look at data before a calibration: init, inspect, prior-check.

What a test file, or every test of a campaign, holds, and what would spoil a fit; what the priors
allow beside it; and a first campaign, prior or building file, written for what is there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mfd_bayes.calibration.posterior import WRITTEN, Posterior, PriorFile, load_priors
from mfd_bayes.campaign.campaign import Campaign, load_campaign
from mfd_bayes.campaign.draft import Draft, campaign_text, draft_campaign, own_priors, priors_text
from mfd_bayes.errors import CampaignError, MfdError, RecordError
from mfd_bayes.evaluation.scores import fan_of
from mfd_bayes.evaluation.views import Fan
from mfd_bayes.friction.model import Model
from mfd_bayes.messages import Message
from mfd_bayes.pipeline.plan import faults_for, findings_together, gap_of, tested_of
from mfd_bayes.records.data_quality import Inspection, inspect_record
from mfd_bayes.records.loops import Scales, scales_of
from mfd_bayes.records.record import Record, read_record
from mfd_bayes.records.trace import Trace
from mfd_bayes.response.building import example_building
from mfd_bayes.response.ground import example_ground
from mfd_bayes.runs.folder import check_outputs
from mfd_bayes.runs.unit_system import System, named_system, system_of
from mfd_bayes.store.files import write_bytes, write_text
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
        title = f"{inspection.name}: as read"
        figure = draw_inspection(title, inspection.trace, inspection.faults, system)
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


PRIOR_DRAWS = 400

MOST = 0.5
"""Share of a test's force inside the 95 % prior band below which its priors are wrong."""


@dataclass(frozen=True)
class PriorCheck:
    """What the priors of a campaign allow."""

    tests: tuple[tuple[str, float, Path], ...]
    unloaded: tuple[str, ...]
    outside: tuple[str, ...]
    wrong: str


def prior_check(path: Path, folder: Path, *, force: bool = False, units: str = "") -> PriorCheck:
    """Prior predictive loops compared with the data of every test, with a PNG each in `folder`.

    With `force`, a PNG that exists is replaced.
    """
    from mfd_bayes.reporting.figures import draw_loops, to_png

    campaign = load_campaign(path)
    priors = load_priors(campaign.priors, campaign.folder, campaign.force_model)
    pictures = {test.id: folder / f"{path.stem}_{test.id}_prior.png" for test in campaign.tests}
    inputs = [path, *(test.path for test in campaign.tests)]
    check_outputs(pictures.values(), inputs, force=force)
    records = {test.id: test.read() for test in campaign.tests}
    system = system_of_records(records.values(), units)
    shares, traces = {}, {}
    for name, record in records.items():
        traces[name] = trace = record.trace(campaign.rate, gap=gap_of(campaign.force_model, priors))
        if trace.force is None:
            raise RecordError(f"test {name!r} of {path} has no force to compare with")
        fan = prior_fan(campaign, priors, trace)
        figure = draw_loops(f"{name}: data over what the priors allow", trace, [fan], system)
        write_bytes(pictures[name], to_png(figure))
        shares[name] = share_inside(fan, trace)
    still = [name for name, trace in traces.items() if trace.reference_actuation == 0.0]
    noted = still if len(still) < len(traces) else []
    missed = [name for name, share in shares.items() if share < MOST]
    outside = tuple(name for name in missed if name not in noted)
    misfit = most_wrong(priors, campaign.force_model, [traces[name] for name in outside])
    return PriorCheck(
        tuple((name, share, pictures[name]) for name, share in shares.items()),
        tuple(name for name in missed if name in noted),
        outside,
        misfit.sentence(system) if misfit else "",
    )


@dataclass(frozen=True)
class Misfit:
    """A prior's median, `expected`, and what a record shows, `observed`, in `unit`.

    `away` is their distance in standard deviations of the prior, `source` where the figure is read.
    """

    quantity: str
    unit: str
    expected: float
    observed: float
    away: float
    source: str

    def sentence(self, system: System) -> str:
        """What is wrong with the prior, and what would mend it."""
        value = system.words([self.observed], self.unit, 3)
        return (
            f"the prior most wrong is that of {self.quantity}: its median is "
            f"{system.words([self.expected], self.unit, 3)}, and {self.source} is {value}, "
            f"{self.away:.2g} of its standard deviations away; give it a median of about {value}, "
            "or let mfd-bayes init write priors.toml from the records"
        )


def prior_fan(campaign: Campaign, priors: PriorFile, trace: Trace) -> Fan:
    """Bands of the force under the prior, without noise, for a test's motion."""
    posterior = Posterior(trace, priors, campaign.noise, campaign.force_model)
    drawn = posterior.draw_prior(np.random.default_rng(0), PRIOR_DRAWS)
    return fan_of("prior", posterior.force(drawn) + drawn["offset"][:, None])


def share_inside(fan: Fan, trace: Trace) -> float:
    """Share of the samples whose force is inside the widest band."""
    force, widest = np.asarray(trace.force), fan.widest
    return float(np.mean((force >= widest.lower) & (force <= widest.upper)))


def most_wrong(priors: PriorFile, model: Model, traces: Sequence[Trace]) -> Misfit | None:
    """The prior of a model that is farthest from what records show, by its own spread.

    None where the records show no scales, or no prior can be compared with one.
    """
    scales = [own for trace in traces if (own := scales_of(trace)) is not None]
    misfits = (misfit for own in scales for misfit in _misfits(priors, own, model.standard_names))
    return max(misfits, key=lambda misfit: misfit.away, default=None)


def _misfits(priors: PriorFile, scales: Scales, names: frozenset[str]) -> Iterator[Misfit]:
    """Each prior that a record shows something of, beside it."""
    slip = ("kip", scales.force, "the plateau of the loop")
    rise = ("kip/in", scales.build_up, "the slope at which the force comes back")
    shown = {
        **dict.fromkeys(("Fc_fwd", "Fc_bwd", "Fy_fwd", "Fy_bwd"), slip),
        "sigma0": ("kip/in", scales.unloading, "the slope after a reversal"),
        **dict.fromkeys(("k3", "k", "k_fwd", "k_bwd"), rise),
        "d2": ("in", 0.5 * scales.length, "half the travel until the force has come back"),
    }
    for name, (unit, value, source) in shown.items():
        prior = priors.parameters.get(name)
        if prior is None or name not in names:
            continue
        drawn = prior.draw(np.random.default_rng(0), 1001)
        middle, at = prior.typical, value
        if prior.on_half_line:
            drawn, middle = np.log(drawn), float(np.log(middle))
            at = float(np.log(value)) if value > 0.0 else np.nan
        spread = float(np.std(drawn))
        if spread > 0.0 and np.isfinite(at):
            yield Misfit(name, unit, prior.typical, value, abs(at - middle) / spread, source)


def init(folder: Path, model: str = "", *, force: bool = False) -> tuple[Path, Draft, bool]:
    """Path and content of a first campaign.toml, written for the test files in a folder.

    Also returns whether priors.toml was written too: always for a user's own model,
    "file.py:Class", else where no shipped file knows such a device.
    """
    path, priors = folder / "campaign.toml", folder / WRITTEN
    _check_new([path], force=force)
    draft = draft_campaign(folder, model)
    text = own_priors(draft)
    if text is not None:
        _check_new([priors], force=force)
        write_text(priors, text)
    write_text(path, campaign_text(draft))
    return path, draft, text is not None


def init_priors(path: Path, *, force: bool = False) -> tuple[Path, bool]:
    """Path of a prior file beside a campaign, its scales read off the campaign's records.

    Also returns whether the campaign names it already.
    """
    campaign = load_campaign(path)
    written = campaign.folder / WRITTEN
    _check_new([written], force=force)
    records = {test.id: test.read() for test in campaign.tests if test.role == "calibrate"}
    scales = {name: scales_of(record.trace()) for name, record in records.items()}
    known = {name: scale for name, scale in scales.items() if scale is not None}
    if not known:
        raise CampaignError(f"no test of {path} has a force, so it shows no scales of priors")
    force_unit, length = (_usual_unit(records.values(), r) for r in ("force", "displacement"))
    write_text(written, priors_text(known, force_unit, length))
    return written, campaign.priors == WRITTEN


def init_building(path: Path, *, force: bool = False) -> Path:
    """Write a first building file, and an artificial ground motion, ground.AT2, beside it.

    Its actuation is one of the campaign beside it, if there is any.
    """
    target = path / "building.toml" if path.is_dir() or path.suffix != ".toml" else path
    ground, text = target.with_name("ground.AT2"), example_building()
    _check_new([target, ground], force=force)
    try:
        tests = load_campaign(target.with_name("campaign.toml")).tests
    except MfdError:  # none, or one that is not complete
        tests = ()
    if levels := [test.actuation for test in tests if test.actuation]:
        text = text.replace('"1000 psi"', f'"{levels[len(levels) // 2]}"')
    write_text(target, text)
    write_text(ground, example_ground())
    return target


def _check_new(paths: Iterable[Path], *, force: bool) -> None:
    for path in paths:
        if path.exists() and not force:
            raise CampaignError(f"{path} exists: give --force to replace it")


def _usual_unit(records: Iterable[Record], role: str) -> str:
    """Unit that most records have for a role."""
    units = [record.columns[role][1] for record in records if role in record.columns]
    return Counter(units).most_common(1)[0][0]
