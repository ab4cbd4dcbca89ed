"""A campaign under several models or noises, compared."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from mfd_bayes.errors import StoreError
from mfd_bayes.evaluation.crossvalidate import Candidate, candidates, check_cycles, compare_runs
from mfd_bayes.evaluation.views import LeftOutView
from mfd_bayes.jobs.job import State, Step
from mfd_bayes.pipeline.calibrate import Observe, calibrate_locked, working_in
from mfd_bayes.pipeline.crossvalidate import check_parts, leave_out_parts
from mfd_bayes.pipeline.outputs import check_outputs
from mfd_bayes.pipeline.plan import Options, Plan, plan_campaign
from mfd_bayes.pipeline.report import left_out_shown, write_report
from mfd_bayes.reporting.tables import comparison_csv
from mfd_bayes.runs.folder import alone_in
from mfd_bayes.runs.manifest import Comparison
from mfd_bayes.runs.run import Run
from mfd_bayes.store.files import write_text


def compare(
    campaign: Path, out: Path, models: Sequence[str], options: Options, observe: Observe
) -> tuple[Comparison, dict[str, tuple[LeftOutView, str]]]:
    """Calibrate a campaign under several models or noises, and compare what they predict."""
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
        left_out: dict[str, tuple[LeftOutView, str]] = {}
        for model, run in runs.items():
            run = run.rewrite(comparison=comparison)
            view = write_report(run, _observer_of(model, observe), jobs=options.jobs)
            shown, force = left_out_shown(view)
            if options.by and shown:
                left_out[model] = shown, force
    return comparison, left_out


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
