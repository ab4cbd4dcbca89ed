"""Calibration of a campaign into a run folder: every test's posterior, then the population."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from mfd_bayes.calibration.result import Task, TestResult, load_result
from mfd_bayes.campaign.synthetic import write_campaign
from mfd_bayes.errors import FitError, StoreError
from mfd_bayes.evaluation.views import CampaignView
from mfd_bayes.friction.models import file_of
from mfd_bayes.jobs.job import JobState, Observe, Progress, Step
from mfd_bayes.jobs.local import check_workers, run_jobs
from mfd_bayes.pipeline.options import RunOptions
from mfd_bayes.pipeline.plan import Plan, plan_campaign
from mfd_bayes.pipeline.report import write_report
from mfd_bayes.population.inference import infer_population
from mfd_bayes.runs.folder import (
    CAMPAIGN,
    MANIFEST,
    MODEL,
    OWNER,
    POPULATION,
    PRIORS,
    alone_in,
    check_apart,
    check_links,
    discard,
    hash_stored,
    pooled_of,
    posterior_of,
    record_of,
    remove_partial_files,
    remove_stale,
)
from mfd_bayes.runs.manifest import Manifest, Status, Truth, add_calibrated_model, mark_pages
from mfd_bayes.runs.resume import check_free, prepare_folder
from mfd_bayes.runs.run import Run
from mfd_bayes.runs.test_sequence import save_inference
from mfd_bayes.store.files import PART, is_part, remove_file, write_bytes
from mfd_bayes.store.netcdf import save_trace

_POPULATION = ("law_scores", "free_exponents", "dependence_scores", "population_sampler")
"""Keys of the manifest that hold results of the population."""

_OF_FINISHED = ("status", "finished", "crossvalidation", "verdicts", "machines")
"""Keys of a finished run that nothing is computed of again."""


def calibrate(plan: Plan, folder: Path, observe: Observe) -> Run:
    """Calibrate a campaign into a run folder, up to but not including its report."""
    with working_in(plan, folder):
        return calibrate_locked(plan, folder, observe)


def calibrate_plan(plan: Plan, folder: Path, observe: Observe) -> CampaignView:
    """Calibrate a campaign as `calibrate` does, and write its report."""
    with working_in(plan, folder):
        run = calibrate_locked(plan, folder, observe)
        return write_report(run, observe, jobs=plan.options.jobs)


def demo(folder: Path, options: RunOptions, observe: Observe) -> CampaignView:
    """Write a synthetic campaign under OUT/campaign, calibrate it, and report on it."""
    check_workers(options)
    check_links(folder, ["campaign"])
    occupied = folder.exists() and (not folder.is_dir() or any(folder.iterdir()))
    if occupied and not options.force:
        raise StoreError(f"{folder} exists: give --force to replace it")
    campaign = folder / "campaign"
    with alone_in(folder):
        if occupied and not _holds_a_demo_alone(folder):
            discard(folder)
        for path in (campaign / "campaign.toml", *campaign.glob(f".*{PART}")):
            remove_file(path)  # the campaign file is written last
        truth = write_campaign(campaign, options.seed)
        options = replace(options, force=False, resume=False)
        plan = plan_campaign(campaign / "campaign.toml", options)
        plan = replace(plan, manifest=plan.manifest.changed(truth=Truth(**truth)))
        run = calibrate_locked(plan, folder, observe)
        return write_report(run, observe, jobs=options.jobs)


def _holds_a_demo_alone(folder: Path) -> bool:
    """Whether a folder holds nothing but a demo's campaign, whole or not: no run was begun."""
    campaign, ours = folder / "campaign", re.compile(r"campaign\.toml|p\d+_f[\d.]+\.csv|\..+\.part")
    entries = [path for path in folder.iterdir() if path != campaign]
    return (
        campaign.is_dir()
        and all(path.name == OWNER or is_part(path, MANIFEST) for path in entries)
        and all(path.is_file() and ours.fullmatch(path.name) for path in campaign.iterdir())
    )


def check_dry(plan: Plan, folder: Path) -> None:
    """Refuse a folder that `calibrate` would refuse, before anything is read in it."""
    _check_place(plan, folder)
    if not (plan.options.resume or plan.options.force):
        check_free(plan.campaign.folder, folder)


@contextmanager
def working_in(plan: Plan, folder: Path) -> Iterator[None]:
    """Check that a plan may be carried out in a run folder, and lock it until the end."""
    _check_place(plan, folder)
    check_workers(plan.options)
    with alone_in(folder):
        yield


def _check_place(plan: Plan, folder: Path) -> None:
    options, campaign = plan.options, plan.campaign
    if options.resume and options.force:
        raise StoreError("give either --resume or --force, not both")
    inputs = [campaign.path, plan.priors.path, *(test.path for test in campaign.tests)]
    inputs += [campaign.model_file] if campaign.model_file else []
    check_apart(folder, inputs, force=options.force, resume=options.resume)


def calibrate_locked(plan: Plan, folder: Path, observe: Observe) -> Run:
    """Calibrate a campaign as `calibrate` does, in a folder that `working_in` has locked."""
    plan_manifest, campaign_folder, options = plan.manifest, plan.campaign.folder, plan.options
    resumed = prepare_folder(
        plan_manifest, campaign_folder, folder, resume=options.resume, force=options.force
    )
    for sentence in resumed.notes:
        observe(Step("resume", JobState.NOTE, message=sentence))
    if plan.campaign.model_file:
        message = f"runs {file_of(plan.campaign.model)}, the campaign's own model"
        observe(Step("model", JobState.NOTE, message=message))
        add_calibrated_model(plan.campaign.model_file)
    if plan.slow:
        observe(Step("model", JobState.NOTE, message=plan.slow))
    manifest = resumed.manifest
    todo = [task for task in plan.tasks if not (folder / posterior_of(task.id)).is_file()]
    if resumed.before is not None and not todo:
        manifest = _with_population(manifest, resumed.before, folder)
    try:
        if manifest.status != Status.FINISHED:
            remove_stale(folder, draws=bool(todo) or not resumed.same_tests)
            mark_pages(folder)
        manifest = _calibrate_tests(plan, manifest, todo, folder, observe)
        model = plan.campaign.force_model
        files = {task.id: folder / posterior_of(task.id) for task in plan.tasks}
        results = {
            n: load_result(n, f, plan.priors, model) for n, f in files.items() if f.is_file()
        }
        if not results:
            errors = {entry.error for entry in manifest.tests.values() if entry.error}
            raise FitError(f"no test could be calibrated: {'; '.join(sorted(errors))}")
        if manifest.status != Status.FINISHED:
            manifest = _infer_population(plan, manifest, results, folder, observe)
        stored = [f(test) for test in manifest.tests for f in (posterior_of, pooled_of, record_of)]
        manifest = manifest.changed(
            files=hash_stored(folder, [PRIORS, MODEL, POPULATION, *stored]),
            status=Status.FINISHED,
            finished=datetime.now(UTC).isoformat(timespec="seconds"),
        )
        manifest.write(folder)
    finally:
        remove_partial_files(folder)
    return Run(folder, manifest, plan.priors, results, plan.held_out, trust=True)


def _with_population(manifest: Manifest, previous: Manifest, folder: Path) -> Manifest:
    """The manifest with the results of an earlier session that finished, else as it is.

    It is that of a finished run then: nothing is left to be computed, and where this session is
    killed, nothing is lost. Hashes of files that are written again are left out.
    """
    is_complete = set(_POPULATION) <= previous.model_fields_set and (folder / POPULATION).is_file()
    if previous.status != Status.FINISHED or not is_complete:
        return manifest
    keys = [key for key in (*_POPULATION, *_OF_FINISHED) if key in previous.model_fields_set]
    names = {POPULATION, *map(pooled_of, manifest.tests)}
    stored = {name: digest for name, digest in previous.files.items() if name in names}
    return manifest.changed(**{key: getattr(previous, key) for key in keys}).with_files(stored)


def _calibrate_tests(
    plan: Plan, manifest: Manifest, todo: Sequence[Task], folder: Path, observe: Observe
) -> Manifest:
    """Store the posterior of every test that has none."""
    kept_tests = [task.id for task in plan.tasks if task not in todo]
    for name in kept_tests:
        manifest = manifest.with_test(name, status=JobState.DONE)
    for name in plan.held_out:
        manifest = manifest.with_test(name, status=JobState.HELD_OUT)
    manifest.write(folder)  # first of all: a folder with a manifest is a run folder
    write_bytes(folder / CAMPAIGN, plan.campaign.path.read_bytes())
    write_bytes(folder / PRIORS, plan.priors.path.read_bytes())
    if file := plan.campaign.model_file:
        write_bytes(folder / MODEL, file.read_bytes())
    else:
        remove_file(folder / MODEL)  # of an earlier session, with another model
    for name, trace in plan.held_out.items():
        save_trace(folder / record_of(name), trace, {})
    for name in kept_tests:
        observe(Step(name, JobState.KEPT))
    began = time.perf_counter()
    with closing(run_jobs(todo, folder, plan.options, observe)) as outcomes:
        for outcome in outcomes:
            failed = {"error": outcome.error} if outcome.error else {}
            manifest = manifest.with_test(
                outcome.id, status=outcome.status, seconds=outcome.seconds, **failed
            ).with_files(hash_stored(folder, [posterior_of(outcome.id)]))
            manifest.write(folder)
    return manifest.longer(time.perf_counter() - began)


def _infer_population(
    plan: Plan,
    manifest: Manifest,
    results: Mapping[str, TestResult],
    folder: Path,
    observe: Observe,
) -> Manifest:
    """Infer the population from the stored posteriors, and store it."""
    began, options, model = time.perf_counter(), plan.options, plan.campaign.force_model
    observe(Step("population", "comparing laws" if model.laws else "the joint fit"))
    inference = infer_population(
        results,
        plan.priors,
        manifest.settings.inference(options.effort, (options.seed, 0), options.processes),
        lambda progress: observe(Step("population", "sampling", progress)),
    )
    save_inference(folder, inference, results, model)
    seconds, worst = time.perf_counter() - began, inference.population.convergence
    sweeps = inference.sweeps
    progress = Progress(sweeps, sweeps, worst.worst_r_hat, worst.worst_ess, seconds)
    observe(Step("population", JobState.DONE, progress))
    return manifest.longer(seconds).changed(
        law_scores=inference.scores,
        free_exponents=inference.exponents,
        dependence_scores=inference.dependence,
        population_sampler={"accepted": inference.accepted, "sweeps": sweeps},
    )
