"""A campaign, read and checked as a whole before anything is written."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from mfd_bayes.calibration.effort import find_effort
from mfd_bayes.calibration.prior_files import PriorFile, load_priors
from mfd_bayes.calibration.task import Task
from mfd_bayes.campaign.file import Campaign, Test, load_campaign
from mfd_bayes.campaign.schema import ModelName
from mfd_bayes.errors import CampaignError, FitError
from mfd_bayes.friction import models
from mfd_bayes.jobs.dispatch import Workplace
from mfd_bayes.jobs.job import State
from mfd_bayes.population.laws import default_laws
from mfd_bayes.population.layout import lay_out
from mfd_bayes.population.setting import setting_of
from mfd_bayes.records.record import Record, hash_file
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.folder import posterior_of
from mfd_bayes.runs.manifest import FORMAT

_VERSIONED = ("mfd_bayes", "numpy", "scipy", "emcee", "arviz", "pandas", "xarray")


@dataclass(frozen=True, kw_only=True)
class Options(Workplace):
    """How a campaign is calibrated, and where.

    Attributes
    ----------
    effort : {"quick", "standard", "thorough"}
    seed : int
    resume, force : bool
        What to do with a folder that exists: finish it, or replace it.
    command : str
        Kept for the record.
    model : {"three_stage", "lugre", "bouc_wen"}, optional
        Instead of the campaign's own.
    """

    effort: str = "standard"
    seed: int = 1
    resume: bool = False
    force: bool = False
    command: str = ""
    model: ModelName | None = None


@dataclass(frozen=True, eq=False)
class Plan:
    """A campaign, read and checked, before anything is written.

    Attributes
    ----------
    campaign : Campaign
    priors : PriorFile
    tasks : tuple of Task
        One for each test to calibrate.
    held_out : mapping of str to Trace
    manifest : dict
        What is known before the first draw.
    """

    campaign: Campaign
    priors: PriorFile
    tasks: tuple[Task, ...]
    held_out: Mapping[str, Trace]
    manifest: dict[str, Any]


def plan_campaign(path: Path, options: Options) -> Plan:
    """Everything that can be wrong with a campaign, checked; nothing is written.

    Raises
    ------
    MfdError
        When the campaign, its priors or one of its records cannot be used.
    """
    campaign = load_campaign(path, options.model)
    priors = load_priors(campaign.priors, campaign.folder)
    effort = find_effort(options.effort)
    laws = _laws(campaign)
    traces, measured, inputs = {}, {}, {campaign.path.name: hash_file(campaign.path)}
    inputs[f"priors/{priors.path.name}"] = hash_file(priors.path)
    for test in campaign.tests:
        record = _read(campaign, test)
        traces[test.id] = record.trace(campaign.rate, gap=priors.gap)
        measured[test.id] = _measured(record, traces[test.id])
        inputs[test.path.relative_to(campaign.folder).as_posix()] = record.sha256
    tasks = tuple(
        _task(campaign, priors, test, traces[test.id], options)
        for test in campaign.tests
        if test.role == "calibrate"
    )
    names = tasks[0].posterior().names
    sessions = {test.id: test.session for test in campaign.tests}
    under = [setting_of(task.trace, sessions[task.id]) for task in tasks]
    lay_out(priors, names, under, laws, campaign.dependence)
    settings = {
        "model": campaign.model,
        "noise": campaign.noise,
        "start": campaign.start,
        "priors": f"{priors.title} ({priors.path.name})",
        "laws": laws,
        "dependence": campaign.dependence,
        "rate": campaign.rate,
        "area": campaign.area,
        "actuation_unit": campaign.actuation_unit,
        "tests": {
            test.id: {
                "file": test.path.relative_to(campaign.folder).as_posix(),
                "actuation": test.actuation,
                "fit": test.window,
                "session": test.session,
                "columns": {role: list(column) for role, column in test.columns.items()},
            }
            for test in campaign.tests
        },
    }
    manifest = {
        "status": "running",
        "format": FORMAT,
        "title": campaign.title,
        "command": options.command,
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "seed": options.seed,
        "effort": {"name": options.effort, **asdict(effort)},
        "settings": settings,
        "inputs": inputs,
        "versions": {"python": platform.python_version()} | {n: version(n) for n in _VERSIONED},
        "platform": platform.platform(),
        "tests": {
            test.id: {"role": test.role, "status": State.WAITING, **measured[test.id]}
            for test in campaign.tests
        },
        "files": {},  # hashes, as files are written
    }
    held_out = {t.id: traces[t.id] for t in campaign.tests if t.role == "validate"}
    return Plan(campaign, priors, tasks, held_out, manifest)


def _laws(campaign: Campaign) -> dict[str, str]:
    """Law of each quantity that follows the actuation."""
    laws = campaign.laws
    for model in models.MODELS.values():
        for name, followed in model.tied_laws.items():
            if laws[name] != laws[followed]:
                raise CampaignError(
                    f"laws.{name} in {campaign.path} must be that of {followed} "
                    f"({laws[followed]!r}), since {name} follows {followed}; got {laws[name]!r}"
                )
    return {name: laws[name] for name in default_laws()}


def _read(campaign: Campaign, test: Test) -> Record:
    record = test.read()
    if record.force is None:
        raise CampaignError(
            f"test {test.id!r} of {campaign.path} has no force: name its column in [columns]"
        )
    if not np.any(record.force):
        raise CampaignError(f"the force of test {test.id!r} of {campaign.path} is zero throughout")
    return record


def _measured(record: Record, trace: Trace) -> dict[str, float | str]:
    """Samples of the fit, its rate and the record's, Hz, and the record's unit of length."""
    rate = (trace.samples - 1) / float(trace.time[-1] - trace.time[0])
    unit = record.columns["displacement"][1]
    return {"samples": trace.samples, "rate": rate, "record_rate": record.rate, "unit": unit}


def _task(
    campaign: Campaign, priors: PriorFile, test: Test, trace: Trace, options: Options
) -> Task:
    digest = hashlib.sha256(test.id.encode()).digest()
    task = Task(
        id=test.id,
        file=posterior_of(test.id),
        trace=trace,
        priors=priors,
        model=campaign.model,
        noise=campaign.noise,
        start=campaign.start,
        effort=options.effort,
        seed=(options.seed, int.from_bytes(digest[:8], "big")),
    )
    posterior = task.posterior()
    drawn = posterior.draw_prior(np.random.default_rng(0), 64)
    if not np.any(np.isfinite(posterior.log_prob(posterior.coordinates(drawn)))):
        raise FitError(
            f"the priors of {priors.path.name} have no mass at any start for test {test.id!r}: "
            "none of 64 prior draws gives a usable force"
        )
    return task
