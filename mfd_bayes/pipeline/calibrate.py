"""Calibration of a campaign into a run folder: every test's posterior, then the population.

And what is built on it: the report of a run, its checks and the table of its draws;
cross-validation, where each part of a campaign is predicted from all others; and the comparison of
a campaign under several models or noises.
"""

from __future__ import annotations

import io
import re
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mfd_bayes.calibration.posterior import units
from mfd_bayes.calibration.result import Task, TestResult, load_result
from mfd_bayes.campaign.synthetic import write_campaign
from mfd_bayes.errors import FitError, MfdError, ReportError, StoreError
from mfd_bayes.evaluation.crossvalidate import (
    Candidate,
    candidates,
    check_cycles,
    compare_runs,
    fold_id,
    folds_of,
    part_kind,
    parts_of,
    run_folds,
)
from mfd_bayes.evaluation.properties import datasheet, parse_condition
from mfd_bayes.evaluation.summary import assess, verdicts
from mfd_bayes.evaluation.views import IDENTIFIABILITY, CampaignView
from mfd_bayes.friction.models import file_of
from mfd_bayes.jobs.job import Progress, State, Step
from mfd_bayes.jobs.local import Workplace, check_workers, get_ready, run_jobs
from mfd_bayes.pipeline.plan import Options, Plan, plan_campaign
from mfd_bayes.population.design import setting_of
from mfd_bayes.population.inference import infer_population
from mfd_bayes.population.population import save_population
from mfd_bayes.reporting.page import PLAIN, Forms
from mfd_bayes.reporting.tables import CROSSVALIDATION, comparison_csv
from mfd_bayes.runs.folder import (
    CAMPAIGN,
    MANIFEST,
    MODEL,
    OWNER,
    POPULATION,
    PRIORS,
    CampaignCrossValidation,
    Comparison,
    Manifest,
    Status,
    Truth,
    Verdict,
    add_calibrated_model,
    alone_in,
    check_apart,
    check_free,
    check_links,
    check_outputs,
    check_places,
    discard,
    hash_stored,
    mark_pages,
    pooled_of,
    posterior_of,
    prepare_folder,
    read_manifest,
    record_of,
    remove_partial_files,
    remove_stale,
)
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.runs.unit_system import SI, System, named_system
from mfd_bayes.store.files import PART, is_part, remove_file, write_bytes, write_text
from mfd_bayes.store.netcdf import save_arrays, save_trace

if TYPE_CHECKING:
    import pandas as pd


_POPULATION = ("law_scores", "free_exponents", "dependence_scores", "population_sampler")
"""Keys of the manifest that hold results of the population."""

_OF_FINISHED = ("status", "finished", "crossvalidation", "verdicts", "machines")
"""Keys of a finished run that nothing is computed of again."""

Observe = Callable[[Step], None]


def calibrate(plan: Plan, out: Path, observe: Observe) -> Run:
    """Calibrate a campaign into a run folder, up to but not including its report."""
    with working_in(plan, out):
        return calibrate_locked(plan, out, observe)


def calibrate_plan(plan: Plan, out: Path, observe: Observe) -> CampaignView:
    """Calibrate a campaign as `calibrate` does, and write its report."""
    with working_in(plan, out):
        run = calibrate_locked(plan, out, observe)
        return write_report(run, observe, jobs=plan.options.jobs)


def demo(out: Path, options: Options, observe: Observe) -> CampaignView:
    """Write a synthetic campaign under OUT/campaign, calibrate it, and report on it."""
    check_workers(options)
    check_links(out, ["campaign"])
    used = out.exists() and (not out.is_dir() or any(out.iterdir()))
    if used and not options.force:
        raise StoreError(f"{out} exists: give --force to replace it")
    campaign = out / "campaign"
    with alone_in(out):
        if used and not _holds_a_demo_alone(out):
            discard(out)
        for path in (campaign / "campaign.toml", *campaign.glob(f".*{PART}")):
            remove_file(path)  # the campaign file is written last
        truth = write_campaign(campaign, options.seed)
        options = replace(options, force=False, resume=False)
        plan = plan_campaign(campaign / "campaign.toml", options)
        plan = replace(plan, manifest=plan.manifest.changed(truth=Truth(**truth)))
        run = calibrate_locked(plan, out, observe)
        return write_report(run, observe, jobs=options.jobs)


def _holds_a_demo_alone(out: Path) -> bool:
    """Whether a folder holds nothing but a demo's campaign, whole or not: no run was begun."""
    campaign, ours = out / "campaign", re.compile(r"campaign\.toml|p\d+_f[\d.]+\.csv|\..+\.part")
    others = [path for path in out.iterdir() if path != campaign]
    return (
        campaign.is_dir()
        and all(path.name == OWNER or is_part(path, MANIFEST) for path in others)
        and all(path.is_file() and ours.fullmatch(path.name) for path in campaign.iterdir())
    )


def check_dry(plan: Plan, out: Path) -> None:
    """Refuse a folder that `calibrate` would refuse, before anything is read in it."""
    _check_place(plan, out)
    if not (plan.options.resume or plan.options.force):
        check_free(plan.campaign.folder, out)


@contextmanager
def working_in(plan: Plan, out: Path) -> Iterator[None]:
    """Check that a plan may be carried out in a run folder, and lock it until the end."""
    _check_place(plan, out)
    check_workers(plan.options)
    with alone_in(out):
        yield


def _check_place(plan: Plan, out: Path) -> None:
    options, campaign = plan.options, plan.campaign
    if options.resume and options.force:
        raise StoreError("give either --resume or --force, not both")
    inputs = [campaign.path, plan.priors.path, *(test.path for test in campaign.tests)]
    inputs += [campaign.model_file] if campaign.model_file else []
    check_apart(out, inputs, force=options.force, resume=options.resume)


def calibrate_locked(plan: Plan, out: Path, observe: Observe) -> Run:
    """Calibrate a campaign as `calibrate` does, in a folder that `working_in` has locked."""
    own, home, options = plan.manifest, plan.campaign.folder, plan.options
    resumed = prepare_folder(own, home, out, resume=options.resume, force=options.force)
    for sentence in resumed.notes:
        observe(Step("resume", State.NOTE, message=sentence))
    if plan.campaign.model_file:
        message = f"runs {file_of(plan.campaign.model)}, the campaign's own model"
        observe(Step("model", State.NOTE, message=message))
        add_calibrated_model(plan.campaign.model_file)
    if plan.slow:
        observe(Step("model", State.NOTE, message=plan.slow))
    manifest = resumed.manifest
    todo = [task for task in plan.tasks if not (out / posterior_of(task.id)).is_file()]
    if resumed.before is not None and not todo:
        manifest = _with_population(manifest, resumed.before, out)
    try:
        if manifest.status != Status.FINISHED:
            remove_stale(out, draws=bool(todo) or not resumed.same_tests)
            mark_pages(out)
        manifest = _calibrate_tests(plan, manifest, todo, out, observe)
        model = plan.campaign.force_model
        files = {task.id: out / posterior_of(task.id) for task in plan.tasks}
        results = {
            n: load_result(n, f, plan.priors, model) for n, f in files.items() if f.is_file()
        }
        if not results:
            errors = {entry.error for entry in manifest.tests.values() if entry.error}
            raise FitError(f"no test could be calibrated: {'; '.join(sorted(errors))}")
        if manifest.status != Status.FINISHED:
            manifest = _infer_population(plan, manifest, results, out, observe)
        stored = [f(test) for test in manifest.tests for f in (posterior_of, pooled_of, record_of)]
        manifest = manifest.changed(
            files=hash_stored(out, [PRIORS, MODEL, POPULATION, *stored]),
            status=Status.FINISHED,
            finished=datetime.now(UTC).isoformat(timespec="seconds"),
        )
        manifest.write(out)
    finally:
        remove_partial_files(out)
    return Run(out, manifest, plan.priors, results, plan.held_out, trust=True)


def _with_population(manifest: Manifest, before: Manifest, out: Path) -> Manifest:
    """The manifest with the results of an earlier session that finished, else as it is.

    It is that of a finished run then: nothing is left to be computed, and where this session is
    killed, nothing is lost. Hashes of files that are written again are left out.
    """
    whole = set(_POPULATION) <= before.model_fields_set and (out / POPULATION).is_file()
    if before.status != Status.FINISHED or not whole:
        return manifest
    keys = [key for key in (*_POPULATION, *_OF_FINISHED) if key in before.model_fields_set]
    names = {POPULATION, *map(pooled_of, manifest.tests)}
    stored = {name: digest for name, digest in before.files.items() if name in names}
    return manifest.changed(**{key: getattr(before, key) for key in keys}).with_files(stored)


def _calibrate_tests(
    plan: Plan, manifest: Manifest, todo: Sequence[Task], out: Path, observe: Observe
) -> Manifest:
    """Store the posterior of every test that has none."""
    kept = [task.id for task in plan.tasks if task not in todo]
    for name in kept:
        manifest = manifest.with_test(name, status=State.DONE)
    for name in plan.held_out:
        manifest = manifest.with_test(name, status=State.HELD_OUT)
    manifest.write(out)  # first of all: a folder with a manifest is a run folder
    write_bytes(out / CAMPAIGN, plan.campaign.path.read_bytes())
    write_bytes(out / PRIORS, plan.priors.path.read_bytes())
    if file := plan.campaign.model_file:
        write_bytes(out / MODEL, file.read_bytes())
    else:
        remove_file(out / MODEL)  # of an earlier session, with another model
    for name, trace in plan.held_out.items():
        save_trace(out / record_of(name), trace, {})
    for name in kept:
        observe(Step(name, State.KEPT))
    began = time.perf_counter()
    with closing(run_jobs(todo, out, plan.options, observe)) as outcomes:
        for outcome in outcomes:
            failed = {"error": outcome.error} if outcome.error else {}
            manifest = manifest.with_test(
                outcome.id, status=outcome.status, seconds=outcome.seconds, **failed
            ).with_files(hash_stored(out, [posterior_of(outcome.id)]))
            manifest.write(out)
    return manifest.longer(time.perf_counter() - began)


def _infer_population(
    plan: Plan, manifest: Manifest, results: Mapping[str, TestResult], out: Path, observe: Observe
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
    for j, name in enumerate(results):
        save_arrays(out / pooled_of(name), inference.values(j), {"test": name}, units(model))
    save_population(out / POPULATION, inference.population)
    seconds, worst = time.perf_counter() - began, inference.population.convergence
    sweeps = inference.sweeps
    progress = Progress(sweeps, sweeps, worst.worst_r_hat, worst.worst_ess, seconds)
    observe(Step("population", State.DONE, progress))
    return manifest.longer(seconds).changed(
        law_scores=inference.scores,
        free_exponents=inference.exponents,
        dependence_scores=inference.dependence,
        population_sampler={"accepted": inference.accepted, "sweeps": sweeps},
    )


def crossvalidate(campaign: Path, out: Path, options: Options, observe: Observe) -> CampaignView:
    """Calibrate a campaign, then predict every part of it from all the others."""
    plan = plan_campaign(campaign, options)
    parts = check_parts(plan)
    for name in (*(task.id for task in plan.tasks), *map(fold_id, parts)):
        observe(Step(name, State.WAITING))
    with working_in(plan, out):
        run = leave_out_parts(calibrate_locked(plan, out, observe), options, observe)
        return write_report(run, observe, jobs=options.jobs)


def check_parts(plan: Plan) -> Collection[str]:
    """Names of the parts that will be left out; a campaign with fewer than two is refused."""
    sessions = plan.manifest.settings.sessions
    settings = {task.id: setting_of(task.trace, sessions[task.id]) for task in plan.tasks}
    return parts_of(
        settings,
        part_kind(plan.options.by),
        plan.campaign.settings.actuation_unit,
        plan.campaign.path,
    )


def leave_out_parts(run: Run, options: Options, observe: Observe) -> Run:
    """The run with predictions of every part from all others; its folder must be locked."""
    kind = part_kind(options.by)
    try:
        predictions = run_folds(run, folds_of(run, kind, options.effort), options, observe)
        return run.rewrite(crossvalidation=CampaignCrossValidation(kind, predictions))
    finally:
        remove_partial_files(run.folder)


def compare(
    campaign: Path, out: Path, models: Sequence[str], options: Options, observe: Observe
) -> tuple[Comparison, dict[str, CampaignView]]:
    """Calibrate a campaign under several models or noises, and compare what they predict.

    Returns the report of each too.
    """
    plans = _plan_models(campaign, out, candidates(models, options.noises), options)
    for model, plan in plans.items():
        for task in plan.tasks:
            observe(Step(f"{model}/{task.id}", State.WAITING))
    runs: dict[str, Run] = {}
    with ExitStack() as locks:
        locks.enter_context(alone_in(out))
        for model, plan in plans.items():
            locks.enter_context(working_in(plan, out / model))
        for model, plan in plans.items():
            observe_model = _observer_of(model, observe)
            runs[model] = calibrate_locked(plan, out / model, observe_model)
            if options.by:
                runs[model] = leave_out_parts(runs[model], plan.options, observe_model)
        observe(Step("comparison", "leaving out one cycle after another"))
        comparison = compare_runs(runs)
        write_text(out / "comparison.csv", comparison_csv(comparison.rows))
        observe(Step("comparison", State.DONE))
        views = {}
        for model, run in runs.items():
            run = run.rewrite(comparison=comparison)
            views[model] = write_report(run, _observer_of(model, observe), jobs=options.jobs)
    return comparison, views


def _plan_models(
    campaign: Path, out: Path, chosen: Sequence[Candidate], options: Options
) -> dict[str, Plan]:
    """Plan of a campaign under each candidate, checked for what the comparison needs."""
    plans: dict[str, Plan] = {}
    table, replaces = [out / "comparison.csv"], options.force or options.resume
    check_outputs(table, [campaign], force=replaces)
    for candidate in chosen:
        own = replace(options, model=candidate.model, noise=candidate.noise)
        plans[candidate.name] = plan = plan_campaign(campaign, own)
        if options.by:
            check_parts(plan)
        check_outputs(table, [t.path for t in plan.campaign.tests], force=replaces)
        for task in plan.tasks:
            check_cycles(task)
        folder = out / candidate.name
        if folder.exists() and not replaces:
            raise StoreError(
                f"{folder} exists: give --resume to finish it or --force to replace it"
            )
    return plans


def _observer_of(model: str, observe: Observe) -> Observe:
    """Observer of the steps of one model's run, which adds the model's name to theirs."""
    return lambda step: observe(replace(step, id=f"{model}/{step.id}"))


# --- the report of a run, its checks and the table of its draws


def report(
    out: Path,
    observe: Observe = lambda _: None,
    *,
    jobs: int = 0,
    forms: Forms = PLAIN,
    units: str = "",
    trust_model: bool = False,
) -> CampaignView:
    """Write the tables, figures and report of a finished run, from its stored results."""
    forms.check(tuple(read_manifest(out).tests))  # no lock for what is no finished run
    if Workplace(jobs).processes > 1:
        get_ready()
    with alone_in(out):
        check_places(out)
        run = open_run(out, trust=trust_model)
        return write_report(run, observe, jobs=jobs, forms=forms, units=units)


def write_report(
    run: Run, observe: Observe, *, jobs: int, forms: Forms = PLAIN, units: str = ""
) -> CampaignView:
    """Write the tables, figures and report of an open run, whose folder must be locked."""
    from mfd_bayes.reporting.page import publish

    try:
        at = [parse_condition(text, run.actuation_unit, run.system.axes) for text in forms.at]
    except MfdError as error:
        raise ReportError(f"--at: {error}") from error
    processes = Workplace(jobs).processes
    observe(Step("report", "checks and bands"))
    system = named_system(units, run.system)
    # once, and of these tests: what an earlier report has stored may be of others
    run = run.with_peaks()
    view = replace(assess(run, processes), metric=system.name == SI.name)
    if forms.next_test:
        observe(Step("report", "which test next"))
        view = replace(view, next_test=run.next_test())
    run = run.rewrite(verdicts=verdicts(view), warnings=view.warnings)
    if view.left_out is None:  # a table that an earlier cross-validation wrote
        (run.folder / CROSSVALIDATION).unlink(missing_ok=True)
    observe(Step("report", "data sheet"))
    sheet = datasheet(replace(run, units=system.name), at) if run.tests else None
    publish(view, run.folder, processes, observe, forms, sheet)
    return view


def check(out: Path, units: str = "", *, trust_model: bool = False) -> CampaignView:
    """Report of a finished run with the checks that `mfd-bayes check` shows; writes nothing.

    Its sentences are in the units of a system, "us" or "si"; by default the campaign's.
    """
    run = open_run(out, trust=trust_model)
    metric = named_system(units, run.system).name == SI.name
    view = assess(run)
    checks = [c for c in view.checks if c.check not in IDENTIFIABILITY or c.status != Verdict.PASS]
    return replace(view, metric=metric, checks=tuple(checks))


def write_draws(
    out: Path, to: str, units: str = "", most: int = 0, *, trust_model: bool = False
) -> tuple[Path, int]:
    """Write OUT/draws.csv or OUT/draws.parquet; returns its path and the number of rows."""
    import pandas as pd

    if to == "parquet" and find_spec("pyarrow") is None:
        raise ReportError(
            '--to parquet needs pyarrow, which is not installed: pip install "mfd_bayes[parquet]", '
            "or take --to csv"
        )
    read_manifest(out)  # a folder that is no finished run is refused before it is locked
    with alone_in(out):
        check_places(out)
        run = open_run(out, trust=trust_model)
        frame = pd.concat(draws_of(run, named_system(units, run.system), most), ignore_index=True)
        path, content = out / f"draws.{to}", io.BytesIO()
        if to == "parquet":
            frame.to_parquet(content, engine="pyarrow", index=False)
        else:
            frame.to_csv(content, index=False, float_format="%.7g", lineterminator="\n")
        write_bytes(path, content.getvalue())
        return path, len(frame)


def draws_of(run: Run, system: System, most: int = 0) -> Iterator[pd.DataFrame]:
    """Draws of every calibrated test, a table each: test, chain, draw, quantities, log densities.

    A column of a quantity is called by its name and its unit in `system`: "Fc_fwd [kN]". With
    `most`, so many draws are taken evenly out of all of them.
    """
    import pandas as pd

    for name, test in run.tests.items():
        stats = test.stored.stats
        chains, draws = stats["lp"].shape
        kept = np.arange(chains * draws)
        if 0 < most < kept.size:
            kept = np.linspace(0, kept.size - 1, most).astype(np.intp)
        frame = pd.DataFrame({"test": name, "chain": kept // draws, "draw": kept % draws})
        for quantity, values in test.stored.draws.data_vars.items():
            unit = str(values.attrs.get("units", "1"))
            head = f"{quantity} [{system.unit(unit)}]" if unit != "1" else str(quantity)
            frame[head] = values.to_numpy().reshape(-1)[kept] * system.factor(unit)
        for density in ("log_prior", "log_likelihood"):
            frame[density] = stats[density].to_numpy().reshape(-1)[kept]
        yield frame
