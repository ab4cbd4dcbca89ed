"""The commands that the command line calls; most have a file of their own in this folder."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from mfd_bayes.campaign.draft import doubts, gaps, lacks_priors
from mfd_bayes.campaign.synthetic import write_campaign
from mfd_bayes.errors import StoreError
from mfd_bayes.evaluation import fails, is_whole
from mfd_bayes.evaluation.views import (
    CampaignView,
)
from mfd_bayes.jobs.job import Step
from mfd_bayes.jobs.local import check_workers
from mfd_bayes.pipeline.calibration import calibrate_locked, check_dry, working_in
from mfd_bayes.pipeline.comparison import compare
from mfd_bayes.pipeline.crossvalidation import crossvalidate
from mfd_bayes.pipeline.draws import write_draws
from mfd_bayes.pipeline.next_test import Wish, next_test
from mfd_bayes.pipeline.plan import Options, Plan, plan_campaign
from mfd_bayes.pipeline.prediction import predict
from mfd_bayes.pipeline.preparation import (
    init,
    init_priors,
    inspect,
    needs_priors,
    prior_check,
)
from mfd_bayes.pipeline.question import Question
from mfd_bayes.pipeline.ready import get_ready
from mfd_bayes.pipeline.report import check, left_out_shown, report, write_report
from mfd_bayes.reporting.publish import Forms
from mfd_bayes.runs.folder import check_links, discard
from mfd_bayes.runs.lock import OWNER, alone_in
from mfd_bayes.runs.manifest import Truth, read_begun
from mfd_bayes.runs.paths import MANIFEST
from mfd_bayes.store.files import PART, is_part, remove_file

__all__ = [
    "Forms",
    "Options",
    "Question",
    "Step",
    "Wish",
    "calibrate_campaign",
    "calibrate_plan",
    "check",
    "check_dry",
    "compare",
    "crossvalidate",
    "demo",
    "doubts",
    "effort_of",
    "fails",
    "gaps",
    "init",
    "init_priors",
    "inspect",
    "is_whole",
    "lacks_priors",
    "left_out_shown",
    "needs_priors",
    "next_test",
    "plan_campaign",
    "predict",
    "prior_check",
    "report",
    "write_draws",
]

Observe = Callable[[Step], None]

_OF_DEMO = re.compile(r"campaign\.toml|p\d+_f[\d.]+\.csv|\..+\.part")
"""Names of the files of a demo's campaign."""


def calibrate_campaign(
    campaign: Path, out: Path, options: Options, observe: Observe
) -> CampaignView:
    """Calibrate a campaign into a folder and write its report.

    Raises
    ------
    MfdError
        When an input cannot be used; nothing is written then.
    """
    get_ready()
    return calibrate_plan(plan_campaign(campaign, options), out, observe)


def calibrate_plan(plan: Plan, out: Path, observe: Observe) -> CampaignView:
    """Calibrate a campaign that was planned, and whose warnings were shown, and write its report.

    Raises
    ------
    MfdError
        When the folder cannot be used; nothing is written then.
    """
    with working_in(plan, out):
        run = calibrate_locked(plan, out, observe)
        return write_report(run, observe, jobs=plan.options.jobs)


def demo(out: Path, options: Options, observe: Observe) -> CampaignView:
    """Write a synthetic campaign under OUT/campaign, calibrate it, and report on it.

    Raises
    ------
    StoreError
        When the folder exists and is not to be replaced.
    """
    get_ready()
    check_workers(options)
    check_links(out, ["campaign"])
    used = out.exists() and (not out.is_dir() or any(out.iterdir()))
    if used and not options.force:
        raise StoreError(f"{out} exists: give --force to replace it")
    with alone_in(out):
        if used and not _is_begun(out):
            discard(out)
        _remove_begun(out / "campaign")
        truth = write_campaign(out / "campaign", options.seed)
        options = replace(options, force=False, resume=False)
        plan = plan_campaign(out / "campaign" / "campaign.toml", options)
        manifest = plan.manifest.changed(truth=Truth(**truth))
        run = calibrate_locked(replace(plan, manifest=manifest), out, observe)
        return write_report(run, observe, jobs=options.jobs)


def _is_begun(out: Path) -> bool:
    """Whether a folder holds nothing but a demo's campaign, whole or not: no run was begun."""
    campaign = out / "campaign"
    others = [path for path in out.iterdir() if path != campaign]
    return (
        campaign.is_dir()
        and all(p.name == OWNER or is_part(p, MANIFEST) or is_part(p, OWNER) for p in others)
        and all(path.is_file() and _OF_DEMO.fullmatch(path.name) for path in campaign.iterdir())
    )


def _remove_begun(campaign: Path) -> None:
    """Remove a demo's campaign file, which is written last, and files that are partly written."""
    for path in (campaign / "campaign.toml", *campaign.glob(f".*{PART}")):
        remove_file(path)


def effort_of(out: Path, asked: str | None, *, resume: bool) -> str:
    """The given effort, else that of the run which is resumed, else "standard".

    Parameters
    ----------
    out : Path
        A run folder, or one that holds a run folder for each model.
    """
    if asked is not None:
        return asked
    found = sorted(out.glob(f"*/{MANIFEST}"))
    for path in [out / MANIFEST, *found] if resume else ():
        if path.is_file():
            return read_begun(path.parent).effort.name
    return "standard"
