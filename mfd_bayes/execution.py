"""A campaign into a run folder: every test's posterior, then the population of tests."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mfd_bayes.calibration.quantities import UNITS
from mfd_bayes.calibration.result import TestResult, load_result
from mfd_bayes.errors import FitError, StoreError
from mfd_bayes.jobs.dispatch import check_workers, run_jobs
from mfd_bayes.jobs.job import Outcome, Progress, Step
from mfd_bayes.plan import Options, Plan, plan_campaign
from mfd_bayes.population.inference import pool_tests
from mfd_bayes.population.storage import save_pooled, save_population
from mfd_bayes.runs.lock import OWNER, alone_in
from mfd_bayes.runs.manifest import FOLDERS, check_links, check_stored, hash_stored, read_begun
from mfd_bayes.runs.run import POPULATION, PRIORS, Run, pooled_of, posterior_of, record_of
from mfd_bayes.store.files import MANIFEST, is_part, sweep, write_bytes, write_json
from mfd_bayes.store.netcdf import save_trace

Observe = Callable[[Step], None]

_TABLES = (
    *("parameters.csv", "derived.csv", "laws.csv", "law_scores.csv", "checks.csv", "scores.csv"),
    *("parameters.json", "laws.json", "parameters.tex", "laws.tex"),
    "crossvalidation.csv",
)
_OUTPUTS = ("population.nc", *_TABLES, "report.html", "report.pdf", "campaign.toml", "priors.toml")
_STORED = (posterior_of, pooled_of, record_of)
_POPULATION = ("law_scores", "free_exponents", "dependence_scores", "population_sampler")
"""What the manifest holds of the population."""
_TOLD = 10
"""Most entries that are told to differ."""
_DISCARDED = f".{MANIFEST}.discarded"


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
        before = prepare_folder(plan, out, options)
        try:
            anew = _calibrate_tests(plan, out, options, observe)
            results = _results(plan, out)
            if anew or not _keep_population(plan, out, before):
                _pool_tests(plan, out, results, options, observe)
            return _finish(plan, out, results)
        finally:
            sweep(out)


def _calibrate_tests(plan: Plan, out: Path, options: Options, observe: Observe) -> bool:
    """Store the posterior of every test that has none yet; whether there was one to do."""
    manifest = plan.manifest
    write_json(out / MANIFEST, manifest)  # before all else: it makes the folder a run's
    write_bytes(out / "campaign.toml", plan.campaign.path.read_bytes())
    write_bytes(out / "priors.toml", plan.priors.path.read_bytes())
    for name, trace in plan.held_out.items():
        save_trace(out / "tests" / name / "record.nc", trace, {})
        manifest["tests"][name]["status"] = "held out"
    todo = [t for t in plan.tasks if not (out / "tests" / t.id / "posterior.nc").is_file()]
    for task in plan.tasks:
        if task not in todo:
            manifest["tests"][task.id]["status"] = "done"
            observe(Step(task.id, "kept"))
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
        file = out / "tests" / task.id / "posterior.nc"
        if file.is_file():
            found[task.id] = load_result(task.id, file, plan.priors)
    if not found:
        errors = {e["error"] for e in plan.manifest["tests"].values() if e.get("error")}
        raise FitError(f"no test could be calibrated: {'; '.join(sorted(errors))}")
    return found


def _keep_population(plan: Plan, out: Path, before: Mapping[str, Any]) -> bool:
    """Take over the population of a run that was finished, where it has one."""
    if before.get("status") != "finished" or not (out / "population.nc").is_file():
        return False
    keys = [key for key in (*_POPULATION, "crossvalidation") if key in before]
    plan.manifest.update({key: before[key] for key in keys})
    return set(_POPULATION) <= set(keys)


def _pool_tests(
    plan: Plan, out: Path, results: Mapping[str, TestResult], options: Options, observe: Observe
) -> None:
    """Infer the population from the stored posteriors."""
    manifest, began = plan.manifest, time.perf_counter()
    observe(Step("population", "comparing laws"))
    pooled = pool_tests(
        results,
        plan.priors,
        manifest["settings"],
        options.effort,
        (options.seed, 0),
        lambda progress: observe(Step("population", "sampling", progress)),
        jobs=options.processes,
    )
    inference = pooled.inference
    population = inference.population
    for name, draws in zip(results, inference.tests, strict=True):
        file = out / "tests" / name / "pooled.nc"
        save_pooled(file, population.pooling, draws, UNITS, name)
    save_population(out / "population.nc", population)
    manifest["law_scores"] = [asdict(score) for score in pooled.scores]
    manifest["free_exponents"] = pooled.exponents
    manifest["dependence_scores"] = [asdict(score) for score in pooled.dependence]
    manifest["population_sampler"] = {
        "accepted": inference.accepted,
        "sweeps": inference.sweeps,
    }
    seconds, worst = time.perf_counter() - began, population.convergence
    manifest["seconds"] += seconds
    steps = inference.sweeps, inference.sweeps
    progress = Progress(*steps, worst.worst_r_hat, worst.worst_ess, seconds)
    observe(Step("population", "done", progress))


def _finish(plan: Plan, out: Path, results: Mapping[str, TestResult]) -> Run:
    manifest = plan.manifest
    names = [path(test) for test in manifest["tests"] for path in _STORED]
    manifest["files"] = hash_stored(out, [PRIORS, POPULATION, *names])
    manifest["status"] = "finished"
    manifest["finished"] = datetime.now(UTC).isoformat(timespec="seconds")
    write_json(out / MANIFEST, manifest)
    return Run(out, manifest, plan.priors, results, plan.held_out)


def prepare_folder(plan: Plan, out: Path, options: Options) -> dict[str, Any]:
    """Check that a folder may be begun, finished or replaced; leave in it what is kept.

    What the plan's manifest keeps of an earlier session is added to it.

    Returns
    -------
    dict
        Manifest of the run that is gone on with, or empty.

    Raises
    ------
    StoreError
        When the folder may not be begun, or holds something else than this plan's run.
    """
    check_links(out)
    if _is_free(plan, out):
        return {}
    if not (options.resume or options.force):
        raise StoreError(f"{out} exists: give --resume to finish it or --force to replace it")
    if options.force or (out / _DISCARDED).exists():
        discard(out)
        return {}
    try:
        before = read_begun(out)
    except StoreError as error:
        raise StoreError(
            f"{out} cannot be resumed: {error}; give --force to start again"
        ) from error
    for key in ("settings", "inputs", "seed", "effort", "versions"):
        changed = _changes(before.get(key), json.loads(json.dumps(plan.manifest[key])))
        if changed is not None:
            raise StoreError(
                f"{out} cannot be resumed: {key}{changed} changed since it was started; "
                "give --force to start again"
            )
    _keep(plan.manifest, before)
    plan.manifest["files"] = _kept_files(plan.manifest["tests"], out, before.get("files") or {})
    return before


def _keep(manifest: dict[str, Any], before: dict[str, Any]) -> None:
    """Take over from an earlier session what this one will not find out again."""
    manifest |= {key: before[key] for key in ("truth", "started") if key in before}
    manifest["seconds"] = before.get("seconds") or 0.0
    for name, entry in before["tests"].items():
        if name in manifest["tests"] and entry["status"] == "done":
            manifest["tests"][name] |= {k: entry[k] for k in ("status", "seconds") if k in entry}


def _kept_files(tests: Iterable[str], out: Path, digests: Mapping[str, str]) -> dict[str, str]:
    """Hashes of the posteriors that are gone on with, after a look whether they still hold.

    Of other files none is kept, nor of one that is gone: they are written anew, and before
    their hashes, so that a kill in between would leave a file that is not that of its hash.
    """
    names = [name for name in map(posterior_of, tests) if (out / name).is_file()]
    for name in (*names, *([POPULATION] if (out / POPULATION).is_file() else [])):
        check_stored(out, name, digests)
    return {name: digests[name] for name in names if name in digests}


def _is_free(plan: Plan, out: Path) -> bool:
    """Whether a folder holds nothing but the campaign itself, or what was to be its manifest."""
    return all(
        entry.resolve() == plan.campaign.folder
        or entry.name == OWNER
        or is_part(entry, MANIFEST)
        or is_part(entry, OWNER)
        for entry in out.iterdir()
    )


def _changes(old: object, new: object) -> str | None:
    """Which entries differ, in brackets; "" for a plain value, None where all are the same."""
    if old == new:
        return None
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return ""
    names = [key for key in {**old, **new} if old.get(key) != new.get(key)]
    told = ", ".join(name[:60] for name in names[:_TOLD])
    return f" ({told}{', and more' if len(names) > _TOLD else ''})"


def discard(out: Path) -> None:
    """Remove what a run wrote, and nothing else; what is begun is known for such until its end.

    Raises
    ------
    StoreError
        When the folder is not a run folder, or something in it cannot be removed.
    """
    check_links(out)
    begun = out / _DISCARDED
    try:
        if (out / MANIFEST).is_file():
            (out / MANIFEST).replace(begun)
        elif not begun.exists():
            raise StoreError(f"{out} exists and is not a run folder: it has no {MANIFEST}")
        sweep(out)
        for name in FOLDERS:
            if (out / name).exists():
                shutil.rmtree(out / name)
        for name in _OUTPUTS:
            (out / name).unlink(missing_ok=True)
        begun.unlink()
    except OSError as error:
        raise StoreError(f"cannot remove {error.filename}: {error.strerror}") from error
