"""Cross-validation of a campaign: each part is predicted from all others."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from mfd_bayes.evaluation.crossvalidate import fold_id, folds_of, part_kind, parts_of, run_folds
from mfd_bayes.evaluation.views import CampaignView
from mfd_bayes.jobs.job import State, Step
from mfd_bayes.pipeline.calibrate import Observe, calibrate_locked, working_in
from mfd_bayes.pipeline.plan import Options, Plan, plan_campaign
from mfd_bayes.pipeline.report import write_report
from mfd_bayes.population.design import setting_of
from mfd_bayes.runs.folder import remove_partial_files
from mfd_bayes.runs.manifest import CampaignCrossValidation
from mfd_bayes.runs.run import Run


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
