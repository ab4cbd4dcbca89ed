"""What is to be calibrated, read and checked: records, priors, settings and warnings."""

from __future__ import annotations

import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import cast

import numpy as np

from mfd_bayes.calibration.effort import find_effort
from mfd_bayes.calibration.priors import PriorFile, load_priors
from mfd_bayes.calibration.result import Task, seed_of
from mfd_bayes.campaign.campaign import Campaign, Test, load_campaign
from mfd_bayes.campaign.schema import CampaignFile, NoiseName
from mfd_bayes.errors import CampaignError, FitError, hash_file
from mfd_bayes.friction.models import file_of
from mfd_bayes.jobs.job import JobState
from mfd_bayes.pipeline.inspect import findings_of, findings_together, gap_of, inspect_test
from mfd_bayes.pipeline.options import Effort, RunOptions
from mfd_bayes.population.design import Design, design_of
from mfd_bayes.records.cycles import measured_cycles
from mfd_bayes.records.record import Record
from mfd_bayes.records.trace import Trace
from mfd_bayes.reporting.symbols import check_symbols
from mfd_bayes.runs.folder import MANIFEST, posterior_of
from mfd_bayes.runs.manifest import (
    FORMAT,
    Entry,
    Manifest,
    Status,
    check_readable,
    read_begun,
    this_machine,
)
from mfd_bayes.runs.resume import with_keys
from mfd_bayes.runs.tested_range import conditions_of
from mfd_bayes.runs.unit_system import UnitSystem

_VERSIONED = ("mfd_bayes", "numpy", "scipy", "emcee", "arviz", "arviz-stats", "pandas", "xarray")


# forces that a test needs at the standard effort, draws that are timed, and minutes for a test
# from which a model is called slow
FORCES, DRAWS, LONG = 50_000, 48, 5.0


def effort_of(folder: Path, effort: Effort, *, resume: bool) -> Effort:
    """The effort that was typed, else that of the run which is resumed, else "standard".

    `folder` is a run folder, or one that holds a run folder for each model.
    """
    if effort:
        return effort
    for path in [folder / MANIFEST, *sorted(folder.glob(f"*/{MANIFEST}"))] if resume else ():
        if path.is_file():
            return cast(Effort, read_begun(path.parent).effort.name)
    return "standard"


@dataclass(frozen=True, eq=False)
class Plan:
    """A campaign, read and checked, before anything is written."""

    campaign: Campaign
    options: RunOptions
    priors: PriorFile
    tasks: tuple[Task, ...]
    held_out: Mapping[str, Trace]
    manifest: Manifest

    @property
    def system(self) -> UnitSystem:
        """System of units of the records, of the size of their forces."""
        return self.manifest.system

    @cached_property
    def slow(self) -> str:
        """A sentence where a user's own model takes long; empty where it does not."""
        model = self.campaign.force_model
        if not model.own:
            return ""
        posterior = self.tasks[0].posterior()
        q = posterior.coordinates(posterior.sample_prior(DRAWS, 0))
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


def plan_campaign(
    path: Path, options: RunOptions, model: str | None = None, noise: NoiseName | None = None
) -> Plan:
    """Plan of a campaign, after all checks; nothing is written.

    By default its model and noise are the campaign's, and the effort is "standard".
    """
    options = replace(options, effort=options.effort or "standard")
    campaign = load_campaign(path, model, noise)
    if campaign.force_model.source:
        check_symbols(campaign.force_model)
    context = campaign.folder, campaign.force_model
    priors = load_priors(campaign.priors, *context, of_others=campaign.replaced)
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
        inputs[test.path.relative_to(campaign.folder).as_posix()] = record.sha256
        inspection, compared = inspect_test(campaign, test, record, gap)
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
        standard=campaign.standard,
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


def planned_design(tasks: Sequence[Task], settings: CampaignFile) -> Design:
    """Design of the population of the tests to calibrate."""
    head = tasks[0]
    posterior = head.posterior()
    names = posterior.names
    if "noise_sd" not in names:
        raise CampaignError(
            f"noise_sd is fixed in {head.priors.path.name}: the population of tests needs a prior "
            "of it, such as a narrow lognormal"
        )
    inference = settings.inference("quick", ())
    test_settings = [inference.setting(task.id, task.trace) for task in tasks]
    laws, dependence = settings.laws, settings.dependence
    return design_of(head.priors, names, test_settings, laws, dependence, posterior.model)


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
    lead, tail = record.around(trace, campaign.since(test))
    measured = measured_cycles(record.trace())
    assert measured is not None  # a test has a force
    entry = Entry(
        role=test.role,
        status=JobState.WAITING,
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
    return entry.model_copy(update={"before": lead, "after": tail}) if test.window else entry


def _task(
    campaign: Campaign, priors: PriorFile, test: Test, trace: Trace, options: RunOptions
) -> Task:
    """Job that calibrates a test, of whose prior some draws must give a usable force."""
    task = Task(
        id=test.id,
        file=posterior_of(test.id),
        trace=trace,
        priors=priors,
        model=campaign.force_model if campaign.force_model.source else campaign.model,
        noise=campaign.noise,
        initial=campaign.settings.campaign.initial,
        effort=options.effort,
        seed=(options.seed, seed_of(test.id)),
    )
    posterior = task.posterior()
    draws = posterior.sample_prior(64, 0)
    if not np.any(np.isfinite(posterior.log_prob(posterior.coordinates(draws)))):
        raise FitError(
            f"the priors of {priors.path.name} have no mass at any start for test {test.id!r}: "
            "none of 64 prior draws gives a usable force"
        )
    return task
