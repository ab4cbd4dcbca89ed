"""A campaign, read and checked as a whole before anything is written; what its records show."""

from __future__ import annotations

import hashlib
import platform
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import version
from pathlib import Path

import numpy as np

from mfd_bayes.calibration.diagnostics import find_effort
from mfd_bayes.calibration.posterior import PriorFile, load_priors
from mfd_bayes.calibration.result import Task
from mfd_bayes.campaign.campaign import Campaign, Test, load_campaign
from mfd_bayes.campaign.schema import CampaignFile, NoiseName
from mfd_bayes.errors import CampaignError, FitError, hash_file
from mfd_bayes.evaluation.summary import zero_pressure_sentences
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.models import file_of
from mfd_bayes.jobs.job import State
from mfd_bayes.jobs.local import Workplace
from mfd_bayes.messages import Message
from mfd_bayes.population.design import Design, complete_laws, design_of
from mfd_bayes.population.inference import swings
from mfd_bayes.records.cross_checks import Tested, compare_tests
from mfd_bayes.records.data_quality import Fault, contradictions, find_faults
from mfd_bayes.records.loops import measured_cycles
from mfd_bayes.records.record import Record
from mfd_bayes.records.trace import Trace, without_spikes
from mfd_bayes.reporting.symbols import check_symbols
from mfd_bayes.runs.folder import MANIFEST, posterior_of
from mfd_bayes.runs.manifest import (
    FORMAT,
    Entry,
    Finding,
    Manifest,
    Status,
    check_readable,
    read_begun,
    this_machine,
    with_keys,
)
from mfd_bayes.runs.tested_range import conditions_of
from mfd_bayes.runs.unit_system import System

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
    if not test.steady:
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
        trace, whole = record.trace(campaign.rate, gap=gap), record.trace()
        entries[test.id] = _entry(campaign, test, record, trace)
        inputs[_inside(campaign, test)] = record.sha256
        faults += [(test.id, fault) for fault in faults_of(record, whole, campaign, gap)]
        compared = tested_of(test, record, whole)
        tested += [compared] if compared else []
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
