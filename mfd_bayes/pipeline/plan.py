"""A campaign, read and checked as a whole before anything is written; what its records show.

The commands that look at data before a calibration stand here too: `init`, `inspect` and
`prior-check`.
"""

from __future__ import annotations

import hashlib
import platform
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import version
from pathlib import Path

import numpy as np

from mfd_bayes.calibration.diagnostics import find_effort
from mfd_bayes.calibration.posterior import WRITTEN, Posterior, PriorFile, load_priors
from mfd_bayes.calibration.result import Task
from mfd_bayes.campaign.campaign import Campaign, Test, load_campaign
from mfd_bayes.campaign.draft import (
    Draft,
    campaign_text,
    draft_campaign,
    has_own_parameters,
    own_priors,
    priors_of_model,
    priors_text,
    ranges_of,
)
from mfd_bayes.campaign.schema import CampaignFile, NoiseName
from mfd_bayes.errors import CampaignError, FitError, MfdError, RecordError, hash_file
from mfd_bayes.evaluation.summary import zero_pressure_sentences
from mfd_bayes.evaluation.views import Fan, fan_of
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.models import file_of
from mfd_bayes.jobs.job import State
from mfd_bayes.jobs.local import Workplace
from mfd_bayes.messages import Message
from mfd_bayes.population.design import Design, complete_laws, design_of
from mfd_bayes.population.inference import swings
from mfd_bayes.records.cross_checks import Tested, compare_tests
from mfd_bayes.records.data_quality import (
    SPOILED,
    Fault,
    Inspection,
    inspect_record,
)
from mfd_bayes.records.loops import Scales, measured_cycles, scales_of
from mfd_bayes.records.record import Record, read_record
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.symbols import check_symbols
from mfd_bayes.response.building import example_building
from mfd_bayes.response.ground import example_ground
from mfd_bayes.runs.folder import (
    FORMAT,
    MANIFEST,
    Entry,
    Finding,
    Manifest,
    Status,
    check_outputs,
    check_readable,
    posterior_of,
    read_begun,
    this_machine,
    with_keys,
)
from mfd_bayes.runs.tested_range import conditions_of
from mfd_bayes.runs.unit_system import System, named_system, system_of
from mfd_bayes.store.files import write_bytes, write_text
from mfd_bayes.units import split_quantity

WIDE, NARROW = 6.0, 1.0 / 12.0
"""A gap wider or narrower than the priors' typical one by these factors is in another unit."""

FAR = 3.5
"""A slip force is beyond the priors by this many of their standard deviations."""


def gap_of(model: Model, priors: PriorFile) -> float | None:
    """Typical width of the gap, in; None of a user's own model that has no gap."""
    return None if model.source and not model.has_gap else priors.gap


def look_at(
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
    found = compare_tests(tests, same_motion=not model.standard_names)
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
    if abs(np.log(ratio)) > FAR * prior.figures["spread"] and test.level > 0.0:
        yield Fault.of(
            "beyond the priors",
            f"the loop's slip force of {{value}} is {ratio:.2g} times the one that the priors "
            f"expect ({{expected}}): the force is probably in another unit; {hint}",
            value=(slip, "kip"),
            expected=(prior.figures["median"], "kip"),
        )


_VERSIONED = ("mfd_bayes", "numpy", "scipy", "emcee", "arviz", "pandas", "xarray")


@dataclass(frozen=True, kw_only=True)
class Options(Workplace):
    """How a campaign is calibrated, and where."""

    effort: str = "standard"
    seed: int = 1
    resume: bool = False
    force: bool = False
    command: str = ""
    model: str | None = None
    noise: NoiseName | None = None
    by: str = ""
    noises: tuple[str, ...] = ()


# forces that a test needs at the standard effort, draws that are timed, and minutes for a test
# from which a model is called slow
FORCES, DRAWS, LONG = 50_000, 48, 5.0


def effort_of(out: Path, effort: str | None, *, resume: bool) -> str:
    """The given effort, else that of the run which is resumed, else "standard".

    `out` is a run folder, or one that holds a run folder for each model.
    """
    if effort is not None:
        return effort
    for path in [out / MANIFEST, *sorted(out.glob(f"*/{MANIFEST}"))] if resume else ():
        if path.is_file():
            return read_begun(path.parent).effort.name
    return "standard"


@dataclass(frozen=True, eq=False)
class Plan:
    """A campaign, read and checked, before anything is written."""

    campaign: Campaign
    options: Options
    priors: PriorFile
    tasks: tuple[Task, ...]
    held_out: Mapping[str, Trace]
    manifest: Manifest

    @property
    def system(self) -> System:
        """System of units of the records, of the size of their forces."""
        return self.manifest.system

    @cached_property
    def slow(self) -> str:
        """A sentence where a user's own model takes long; empty where it does not."""
        model = self.campaign.force_model
        if not model.own:
            return ""
        posterior = self.tasks[0].posterior()
        q = posterior.coordinates(posterior.draw_prior(np.random.default_rng(0), DRAWS))
        began = time.perf_counter()
        posterior.log_prob(q)
        seconds = (time.perf_counter() - began) / DRAWS
        minutes = FORCES * seconds / 60.0
        if minutes < LONG:
            return ""
        return (
            f"{model.where} is slow: a force of {posterior.trace.samples} samples takes "
            f"{1e3 * seconds:.2g} ms, and a test needs some {FORCES}, {minutes:.0f} minutes of a "
            "processor; let force compute all rows of theta at once, with NumPy"
        )


def plan_campaign(path: Path, options: Options) -> Plan:
    """Plan of a campaign, after all checks; nothing is written."""
    campaign = load_campaign(path, options.model, options.noise)
    if campaign.force_model.source:
        check_symbols(campaign.force_model)
    under = campaign.folder, campaign.force_model
    priors = load_priors(campaign.priors, *under, of_others=campaign.replaced)
    gap = gap_of(campaign.force_model, priors)
    settings = campaign.settings
    inputs = {campaign.path.name: hash_file(campaign.path)}
    inputs[f"priors/{priors.path.name}"] = hash_file(priors.path)
    if campaign.model_file is not None:
        inputs[file_of(campaign.model)] = hash_file(campaign.model_file)
    tasks, held_out, entries, faults, tested = [], {}, {}, [], []
    for test in campaign.tests:
        record = _read(campaign, test)
        trace = record.trace(campaign.rate, gap=gap)
        entries[test.id] = _entry(campaign, test, record, trace)
        inputs[_inside(campaign, test)] = record.sha256
        inspection, compared = look_at(campaign, test, record, gap)
        faults += [(test.id, fault) for fault in inspection.faults]
        tested += compared
        if test.role == "validate":
            held_out[test.id] = trace
        else:
            tasks.append(_task(campaign, priors, test, trace, options))
    faults += findings_together(tested, priors, campaign.force_model)
    design = planned_design(tasks, settings)
    manifest = Manifest(
        title=campaign.title,
        status=Status.RUNNING,
        format=FORMAT,
        effort=find_effort(options.effort),
        priors=f"{priors.title} ({priors.path.name})",
        settings=settings,
        inputs=inputs,
        tests=entries,
        axes=campaign.axes,
        warnings=findings_of(faults, campaign, design, {task.id: task.trace for task in tasks}),
        command=options.command.encode(errors="backslashreplace").decode(),  # any path's name
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        seed=options.seed,
        versions={"python": platform.python_version()} | {n: version(n) for n in _VERSIONED},
        platform=platform.platform(),
        machines=(this_machine(),),
        files={},
    )
    manifest = with_keys(manifest, priors)
    check_readable(manifest)
    return Plan(campaign, options, priors, tuple(tasks), held_out, manifest)


def _inside(campaign: Campaign, test: Test) -> str:
    """Path of a test's file relative to its campaign's folder, with slashes."""
    return test.path.relative_to(campaign.folder).as_posix()


def planned_design(tasks: Sequence[Task], settings: CampaignFile) -> Design:
    """Design of the population of the tests to calibrate."""
    some = tasks[0]
    posterior = some.posterior()
    names = posterior.names
    if "noise_sd" not in names:
        raise CampaignError(
            f"noise_sd is fixed in {some.priors.path.name}: the population of tests needs a prior "
            "of it, such as a narrow lognormal"
        )
    inference = settings.inference("quick", ())
    under = [inference.setting(task.id, task.trace) for task in tasks]
    laws, dependence = settings.laws, settings.dependence
    return design_of(some.priors, names, under, laws, dependence, posterior.model)


def _read(campaign: Campaign, test: Test) -> Record:
    record, force = test.read(), test.axes.response.name
    if record.force is None:
        raise CampaignError(
            f"test {test.id!r} of {campaign.path} has no {force}: name its column in [columns]"
        )
    if not np.any(record.force):
        raise CampaignError(
            f"the {force} of test {test.id!r} of {campaign.path} is zero throughout"
        )
    return record


def _entry(campaign: Campaign, test: Test, record: Record, trace: Trace) -> Entry:
    before, after = record.around(trace, campaign.since(test))
    measured = measured_cycles(record.trace())
    assert measured is not None  # a test has a force
    entry = Entry(
        role=test.role,
        status=State.WAITING,
        samples=trace.samples,
        rate=(trace.samples - 1) / float(trace.time[-1] - trace.time[0]),
        record_rate=record.rate,
        unit=record.columns["displacement"][1],
        response_unit=record.columns["force"][1],
        conditions=conditions_of(trace),
        peak_force=float(np.max(np.abs(np.asarray(trace.force)))),
        derived=record.derived,
        measured=measured.to_content(),
    )
    return entry.model_copy(update={"before": before, "after": after}) if test.window else entry


def _task(
    campaign: Campaign,
    priors: PriorFile,
    test: Test,
    trace: Trace,
    options: Options,
) -> Task:
    """Job that calibrates a test, of whose prior some draws must give a usable force."""
    digest = hashlib.sha256(test.id.encode()).digest()
    task = Task(
        id=test.id,
        file=posterior_of(test.id),
        trace=trace,
        priors=priors,
        model=campaign.force_model if campaign.force_model.source else campaign.model,
        noise=campaign.noise,
        start=campaign.settings.campaign.start,
        effort=options.effort,
        seed=(options.seed, int.from_bytes(digest[:8], "big")),
        checks_noise=campaign.settings.checks_noise(options.effort),
    )
    posterior = task.posterior()
    drawn = posterior.draw_prior(np.random.default_rng(0), 64)
    if not np.any(np.isfinite(posterior.log_prob(posterior.coordinates(drawn)))):
        raise FitError(
            f"the priors of {priors.path.name} have no mass at any start for test {test.id!r}: "
            "none of 64 prior draws gives a usable force"
        )
    return task


# --- what is looked at before a calibration


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
    gap, inspections, tested = gap_of(campaign.force_model, priors), [], []
    for test, record in zip(campaign.tests, records, strict=True):
        inspection, compared = look_at(campaign, test, record, gap)
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
    slip = ("kip", scales.force, "the slip force of the loop")
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

    Also returns whether priors.toml was written too: where the units are known, for a user's own
    model, "file.py:Class", and for a device that no shipped file knows.
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


def init_priors(path: Path, model: str = "", *, force: bool = False) -> tuple[Path, bool]:
    """Path of a prior file beside a campaign, its scales read off the campaign's records.

    It is for the campaign's model, or another one. Also returns whether the campaign names it
    already.
    """
    campaign = load_campaign(path, model or None)
    written = campaign.folder / WRITTEN
    _check_new([written], force=force)
    records = {test.id: test.read() for test in campaign.tests if test.role == "calibrate"}
    if has_own_parameters(campaign.force_model) and records:
        text = priors_of_model(campaign.force_model, [ranges_of(r) for r in records.values()])
    else:
        scales = {name: scales_of(record.trace()) for name, record in records.items()}
        known = {name: scale for name, scale in scales.items() if scale is not None}
        if not known:
            raise CampaignError(f"no test of {path} has a force, so it shows no scales of priors")
        force_unit, length = (_usual_unit(records.values(), r) for r in ("force", "displacement"))
        text = priors_text(known, force_unit, length)
    write_text(written, text)
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
