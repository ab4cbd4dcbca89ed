"""A campaign into a run folder: every test's posterior, then the population of tests."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mfd_bayes.calibration.quantities import units
from mfd_bayes.calibration.result import TestResult, load_result
from mfd_bayes.errors import FitError, StoreError
from mfd_bayes.jobs.dispatch import check_workers, run_jobs
from mfd_bayes.jobs.job import Outcome, Progress, State, Step
from mfd_bayes.pipeline.plan import Options, Plan, plan_campaign
from mfd_bayes.population.inference import InferenceSettings, infer_population
from mfd_bayes.population.storage import save_population, save_test_draws
from mfd_bayes.runs.folder import (
    MANIFEST,
    POPULATION,
    PRIORS,
    hash_stored,
    pooled_of,
    posterior_of,
    record_of,
    sweep,
)
from mfd_bayes.runs.lock import alone_in
from mfd_bayes.runs.resumption import prepare_folder
from mfd_bayes.runs.run import Run
from mfd_bayes.store.files import write_bytes, write_json
from mfd_bayes.store.netcdf import save_trace

Observe = Callable[[Step], None]


_POPULATION = ("law_scores", "free_exponents", "dependence_scores", "population_sampler")
"""What the manifest holds of the population."""


def calibrate(
    path: Path,
    out: Path,
    options: Options,
    observe: Observe,
    extra: Mapping[str, Any] | None = None,
) -> Run:
    """Calibrate a campaign into a run folder, up to but not including its report.

    Parameters
    ----------
    path : Path
        Campaign file.
    out : Path
        Run folder; must not exist without `resume` or `force`.
    options : Options
    observe : callable
        Told of every step of every test.
    extra : mapping, optional
        Kept in the manifest, such as a synthetic truth.

    Raises
    ------
    MfdError
        When something cannot be used; nothing is written then.
    """
    if options.resume and options.force:
        raise StoreError("give either --resume or --force, not both")
    plan = plan_campaign(path, options)
    plan.manifest.update(extra or {})
    check_workers(options)
    with alone_in(out):
        before = prepare_folder(
            plan.manifest, plan.campaign.folder, out, resume=options.resume, force=options.force
        )
        try:
            anew = _calibrate_tests(plan, out, options, observe)
            results = _results(plan, out)
            if anew or not _keep_population(plan, out, before):
                _infer_population(plan, out, results, options, observe)
            return _finish(plan, out, results)
        finally:
            sweep(out)


def _calibrate_tests(plan: Plan, out: Path, options: Options, observe: Observe) -> bool:
    """Store the posterior of every test that has none yet; whether there was one to do."""
    manifest = plan.manifest
    write_json(out / MANIFEST, manifest)  # before all else: it makes the folder a run's
    write_bytes(out / "campaign.toml", plan.campaign.path.read_bytes())
    write_bytes(out / PRIORS, plan.priors.path.read_bytes())
    for name, trace in plan.held_out.items():
        save_trace(out / record_of(name), trace, {})
        manifest["tests"][name]["status"] = State.HELD_OUT
    todo = [t for t in plan.tasks if not (out / posterior_of(t.id)).is_file()]
    for task in plan.tasks:
        if task not in todo:
            manifest["tests"][task.id]["status"] = State.DONE
            observe(Step(task.id, State.KEPT))
    began = time.perf_counter()
    with closing(run_jobs(todo, out, options, observe)) as outcomes:
        for outcome in outcomes:
            manifest["tests"][outcome.id] |= _entry(outcome)
            manifest["files"] |= hash_stored(out, [posterior_of(outcome.id)])
            write_json(out / MANIFEST, manifest)
    manifest["seconds"] = manifest.get("seconds", 0.0) + time.perf_counter() - began
    return bool(todo)


def _entry(outcome: Outcome) -> dict[str, Any]:
    entry: dict[str, Any] = {"status": outcome.status, "seconds": outcome.seconds}
    return entry | ({"error": outcome.error} if outcome.error else {})


def _results(plan: Plan, out: Path) -> dict[str, TestResult]:
    """Tests that have a posterior."""
    found: dict[str, TestResult] = {}
    for task in plan.tasks:
        file = out / posterior_of(task.id)
        if file.is_file():
            found[task.id] = load_result(task.id, file, plan.priors)
    if not found:
        errors = {e["error"] for e in plan.manifest["tests"].values() if e.get("error")}
        raise FitError(f"no test could be calibrated: {'; '.join(sorted(errors))}")
    return found


def _keep_population(plan: Plan, out: Path, before: Mapping[str, Any]) -> bool:
    """Take over the population of a run that was finished, where it has one."""
    if before.get("status") != "finished" or not (out / POPULATION).is_file():
        return False
    keys = [key for key in (*_POPULATION, "crossvalidation") if key in before]
    plan.manifest.update({key: before[key] for key in keys})
    return set(_POPULATION) <= set(keys)


def _infer_population(
    plan: Plan, out: Path, results: Mapping[str, TestResult], options: Options, observe: Observe
) -> None:
    """Infer the population from the stored posteriors."""
    manifest, began = plan.manifest, time.perf_counter()
    observe(Step("population", "comparing laws"))
    inference = infer_population(
        results,
        plan.priors,
        InferenceSettings.of(
            manifest["settings"], options.effort, (options.seed, 0), options.processes
        ),
        lambda progress: observe(Step("population", "sampling", progress)),
    )
    joint = inference.draws
    population = joint.population
    for name, draws in zip(results, joint.tests, strict=True):
        file = out / pooled_of(name)
        save_test_draws(file, population.layout, draws, units(), name)
    save_population(out / POPULATION, population)
    manifest["law_scores"] = [asdict(score) for score in inference.scores]
    manifest["free_exponents"] = inference.exponents
    manifest["dependence_scores"] = [asdict(score) for score in inference.dependence]
    manifest["population_sampler"] = {
        "accepted": joint.accepted,
        "sweeps": joint.sweeps,
    }
    seconds, worst = time.perf_counter() - began, population.convergence
    manifest["seconds"] += seconds
    steps = joint.sweeps, joint.sweeps
    progress = Progress(*steps, worst.worst_r_hat, worst.worst_ess, seconds)
    observe(Step("population", State.DONE, progress))


def _finish(plan: Plan, out: Path, results: Mapping[str, TestResult]) -> Run:
    manifest = plan.manifest
    names = [
        path(test) for test in manifest["tests"] for path in (posterior_of, pooled_of, record_of)
    ]
    manifest["files"] = hash_stored(out, [PRIORS, POPULATION, *names])
    manifest["status"] = "finished"
    manifest["finished"] = datetime.now(UTC).isoformat(timespec="seconds")
    write_json(out / MANIFEST, manifest)
    return Run(out, manifest, plan.priors, results, plan.held_out)
