"""A campaign into a run folder: every test's posterior, then the population of tests."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from mfd_bayes.calibration.effort import find_effort
from mfd_bayes.errors import FitError, StoreError
from mfd_bayes.plan import Options, Plan, plan_campaign
from mfd_bayes.population.hierarchy import infer, pool
from mfd_bayes.population.marginal import summarize
from mfd_bayes.population.standing import free_exponents
from mfd_bayes.population.storage import save_population
from mfd_bayes.run import Run, TestResult, load_result
from mfd_bayes.store import MANIFEST, read_json, save_trace, write_bytes, write_json
from mfd_bayes.task import Outcome, Step, Task, calibrate_test

Observe = Callable[[Step], None]

_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
_RESULTS = ("population.nc", "parameters.csv", "laws.csv", "checks.csv", "scores.csv")
_OUTPUTS = (*_RESULTS, "report.html", "campaign.toml", "priors.toml", MANIFEST)


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
    plan = plan_campaign(path, options)
    plan.manifest.update(extra or {})
    _prepare_folder(plan, out, options)
    manifest = plan.manifest
    write_bytes(out / "campaign.toml", plan.campaign.path.read_bytes())
    write_bytes(out / "priors.toml", plan.priors.path.read_bytes())
    write_json(out / MANIFEST, manifest)
    for name, trace in plan.held_out.items():
        save_trace(out / "tests" / name / "record.nc", trace, {})
        manifest["tests"][name]["status"] = "held out"
    todo = [t for t in plan.tasks if not (out / "tests" / t.id / "posterior.nc").is_file()]
    began = time.perf_counter()
    for outcome in _run_tasks(todo, out, options, observe):
        manifest["tests"][outcome.id] |= _entry(outcome)
        write_json(out / MANIFEST, manifest)
    for task in plan.tasks:
        if task not in todo:
            manifest["tests"][task.id]["status"] = "done"
    manifest["seconds"] = manifest.get("seconds", 0.0) + time.perf_counter() - began
    return _pool_tests(plan, out, options)


def _entry(outcome: Outcome) -> dict[str, Any]:
    entry: dict[str, Any] = {"status": outcome.status, "seconds": outcome.seconds}
    return entry | ({"error": outcome.error} if outcome.error else {})


def _pool_tests(plan: Plan, out: Path, options: Options) -> Run:
    """Infer the population from the stored posteriors, and finish the manifest."""
    results: dict[str, TestResult] = {}
    for task in plan.tasks:
        file = out / "tests" / task.id / "posterior.nc"
        if file.is_file():
            results[task.id] = load_result(task.id, file, plan.priors)
    if not results:
        errors = {e["error"] for e in plan.manifest["tests"].values() if e.get("error")}
        raise FitError(f"no test could be calibrated: {'; '.join(sorted(errors))}")
    some = next(iter(results.values())).posterior
    levels = [test.trace.reference_actuation for test in results.values()]
    pooling = pool(plan.priors, some.names, levels, plan.manifest["settings"]["laws"])
    summaries = []
    for test, level in zip(results.values(), levels, strict=True):
        values = test.stored.values()
        coordinates = [some.priors[n].coordinate(values[n]) for n in pooling.names]
        summaries.append(summarize(pooling, level, np.stack(coordinates, axis=1)))
    population = infer(
        pooling,
        summaries,
        some.priors,
        plan.campaign.actuation_unit,
        find_effort(options.effort),
        np.random.default_rng([options.seed, 0]),
    )
    save_population(out / "population.nc", population)
    manifest = plan.manifest
    manifest["free_exponents"] = free_exponents(
        pooling,
        summaries,
        some.priors,
        find_effort("quick"),
        np.random.default_rng([options.seed, 1]),
    )
    manifest["status"] = "finished"
    manifest["finished"] = datetime.now(UTC).isoformat(timespec="seconds")
    write_json(out / MANIFEST, manifest)
    return Run(out, manifest, plan.priors, results, plan.held_out)


def _prepare_folder(plan: Plan, out: Path, options: Options) -> None:
    """Make the folder, or check that it may be finished or replaced."""
    if options.resume and options.force:
        raise StoreError("give either --resume or --force, not both")
    try:
        if not out.exists() or _is_free(plan, out):
            out.mkdir(parents=True, exist_ok=True)
            return
    except OSError as error:
        raise StoreError(f"cannot make the run folder {out}: {error.strerror}") from error
    if not (options.resume or options.force):
        raise StoreError(f"{out} exists: give --resume to finish it or --force to replace it")
    if options.force:
        discard(out)
        return
    before = read_json(out / MANIFEST)
    for key in ("settings", "inputs", "seed", "effort", "versions"):
        changed = _changes(before.get(key), json.loads(json.dumps(plan.manifest[key])))
        if changed is not None:
            raise StoreError(
                f"{out} cannot be resumed: {key}{changed} changed since it was started; "
                "give --force to start again"
            )
    for part in out.rglob(".*.part"):  # what a killed process was writing
        part.unlink(missing_ok=True)
    _keep(plan.manifest, before)


def _keep(manifest: dict[str, Any], before: dict[str, Any]) -> None:
    """Take over from an earlier session what this one will not find out again."""
    manifest |= {key: before[key] for key in ("truth", "started") if key in before}
    manifest["seconds"] = before.get("seconds") or 0.0
    for name, entry in before.get("tests", {}).items():
        if entry.get("status") == "done":
            manifest["tests"][name] |= entry


def _is_free(plan: Plan, out: Path) -> bool:
    """Whether a folder is empty, or holds nothing but the campaign itself."""
    return out.is_dir() and all(entry.resolve() == plan.campaign.folder for entry in out.iterdir())


def _changes(old: object, new: object) -> str | None:
    """Which entries differ, in brackets; "" for a plain value, None where all are the same."""
    if old == new:
        return None
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return ""
    names = [key for key in {**old, **new} if old.get(key) != new.get(key)]
    return f" ({', '.join(map(str, names))})"


def discard(out: Path) -> None:
    """Remove what a run wrote, and nothing else.

    Raises
    ------
    StoreError
        When the folder is not a run folder.
    """
    if not (out / MANIFEST).is_file():
        raise StoreError(f"{out} exists and is not a run folder: it has no {MANIFEST}")
    for name in ("tests", "figures"):
        shutil.rmtree(out / name, ignore_errors=True)
    for name in _OUTPUTS:
        (out / name).unlink(missing_ok=True)


def _run_tasks(
    tasks: list[Task], out: Path, options: Options, observe: Observe
) -> Iterator[Outcome]:
    """Calibrate tests in this process, or in several; yields outcomes as they come."""
    jobs = min(options.jobs or os.cpu_count() or 1, max(1, len(tasks)))
    if jobs == 1:
        for task in tasks:
            yield calibrate_test(task, out, observe)
        return
    for name in _THREADS:  # read by numpy when a process starts
        os.environ.setdefault(name, "1")
    context = multiprocessing.get_context("spawn")
    with ExitStack() as stack:
        with _deaf():
            steps = stack.enter_context(context.Manager()).Queue()
            pool_ = stack.enter_context(ProcessPoolExecutor(jobs, mp_context=context))
            waiting = {pool_.submit(calibrate_test, task, out, steps.put) for task in tasks}
        try:
            while waiting:
                done, waiting = wait(waiting, timeout=0.2)
                while not steps.empty():
                    observe(steps.get())
                for future in done:
                    yield future.result()
        except BaseException:
            for process in list((pool_._processes or {}).values()):
                process.terminate()
            pool_.shutdown(wait=False, cancel_futures=True)
            raise


@contextmanager
def _deaf() -> Iterator[None]:
    """Ignore Ctrl-C while processes start, which inherit that: this one is to stop them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
