"""Cross-validation of a campaign, and its comparison under several models or noises."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from mfd_bayes.applications.comparison.crossvalidation import (
    fold_id,
    folds_of,
    part_kind,
    parts_of,
    run_folds,
)
from mfd_bayes.applications.comparison.datasheets import compare_sheets, sheet_frame
from mfd_bayes.applications.comparison.models import (
    ModelChoice,
    candidates,
    check_cycles,
    compare_runs,
)
from mfd_bayes.errors import FitError, StoreError
from mfd_bayes.evaluation.views import CampaignView
from mfd_bayes.jobs.job import JobState, Observe, Step
from mfd_bayes.pipeline.calibrate import calibrate_locked, working_in
from mfd_bayes.pipeline.options import RunOptions
from mfd_bayes.pipeline.plan import Plan, plan_campaign
from mfd_bayes.pipeline.report import write_report
from mfd_bayes.population.design import setting_of
from mfd_bayes.reporting.tables import comparison_csv, to_csv
from mfd_bayes.runs.folder import alone_in, check_outputs, remove_partial_files
from mfd_bayes.runs.manifest import CampaignCrossValidation, ComparedSheet, Comparison
from mfd_bayes.runs.model_average import ModelAverage
from mfd_bayes.runs.run import Run, rewrite_manifest
from mfd_bayes.store.files import write_text

SHEET = "datasheet_models.csv"  # beside comparison.csv


def crossvalidate(
    campaign: Path, folder: Path, by: str, options: RunOptions, observe: Observe
) -> CampaignView:
    """Calibrate a campaign, then predict every part of it from all the others.

    Parts are by "test", "level", "session" or "motion".
    """
    plan = plan_campaign(campaign, options)
    part_names = check_parts(plan, by)
    for name in (*(task.id for task in plan.tasks), *map(fold_id, part_names)):
        observe(Step(name, JobState.WAITING))
    with working_in(plan, folder):
        run = leave_out_parts(calibrate_locked(plan, folder, observe), by, plan.options, observe)
        return write_report(run, observe, jobs=options.jobs)


def check_parts(plan: Plan, by: str) -> Collection[str]:
    """Names of the parts that will be left out; a campaign with fewer than two is refused."""
    sessions = plan.manifest.settings.sessions
    settings = {task.id: setting_of(task.trace, sessions[task.id]) for task in plan.tasks}
    return parts_of(
        settings, part_kind(by), plan.campaign.settings.actuation_unit, plan.campaign.path
    )


def leave_out_parts(run: Run, by: str, options: RunOptions, observe: Observe) -> Run:
    """The run with predictions of every part from all others; its folder must be locked."""
    kind = part_kind(by)
    try:
        predictions = run_folds(run, folds_of(run, kind, options.effort), options, observe)
        return rewrite_manifest(run, crossvalidation=CampaignCrossValidation(kind, predictions))
    finally:
        remove_partial_files(run.folder)


def compare(
    campaign: Path,
    folder: Path,
    models: Sequence[str],
    noises: Sequence[str],
    by: str,
    options: RunOptions,
    observe: Observe,
) -> tuple[Comparison, dict[str, CampaignView]]:
    """Calibrate a campaign under several models or noises, and compare what they predict.

    With `by`, every part of each run is predicted from all its others too, as by `crossvalidate`.
    Returns the report of each too.
    """
    plans = _plan_models(campaign, folder, candidates(models, noises), by, options)
    for model, plan in plans.items():
        for task in plan.tasks:
            observe(Step(f"{model}/{task.id}", JobState.WAITING))
    runs: dict[str, Run] = {}
    with ExitStack() as locks:
        locks.enter_context(alone_in(folder))
        for model, plan in plans.items():
            locks.enter_context(working_in(plan, folder / model))
        for model, plan in plans.items():
            observe_model = _observer_of(model, observe)
            runs[model] = calibrate_locked(plan, folder / model, observe_model)
            if by:
                runs[model] = leave_out_parts(runs[model], by, plan.options, observe_model)
        observe(Step("comparison", "leaving out one cycle after another"))
        comparison = compare_runs(runs)
        observe(Step("comparison", "data sheet under each model"))
        try:
            sheet = compare_sheets(ModelAverage([run.with_peaks() for run in runs.values()]))
        except FitError as error:  # a test that could not be calibrated under every model
            sheet = ComparedSheet((), {}, f"No data sheet over models: {error}.")
        comparison = replace(comparison, sheet=sheet)
        write_text(folder / "comparison.csv", comparison_csv(comparison.rows))
        frame = sheet_frame(sheet, next(iter(runs.values())).system)
        write_text(folder / SHEET, to_csv(frame, [sheet.sentence]))
        observe(Step("comparison", JobState.DONE))
        views = {}
        for model, run in runs.items():
            run = rewrite_manifest(run, comparison=comparison)
            views[model] = write_report(run, _observer_of(model, observe), jobs=options.jobs)
    return comparison, views


def _plan_models(
    campaign: Path, root: Path, selection: Sequence[ModelChoice], by: str, options: RunOptions
) -> dict[str, Plan]:
    """Plan of a campaign under each candidate, checked for what the comparison needs."""
    plans: dict[str, Plan] = {}
    table, replaces = [root / "comparison.csv", root / SHEET], options.force or options.resume
    check_outputs(table, [campaign], force=replaces)
    for candidate in selection:
        plan = plan_campaign(campaign, options, candidate.model, candidate.noise)
        plans[candidate.name] = plan
        if by:
            check_parts(plan, by)
        check_outputs(table, [t.path for t in plan.campaign.tests], force=replaces)
        for task in plan.tasks:
            check_cycles(task)
        folder = root / candidate.name
        if folder.exists() and not replaces:
            raise StoreError(
                f"{folder} exists: give --resume to finish it or --force to replace it"
            )
    return plans


def _observer_of(model: str, observe: Observe) -> Observe:
    """Observer of the steps of one model's run, which adds the model's name to theirs."""
    return lambda step: observe(replace(step, id=f"{model}/{step.id}"))
