"""The commands that look at data and calibrate: what they do, and what they print."""

from __future__ import annotations

import math
import shlex
import textwrap
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import typer

from mfd_bayes.console import clean, figures, print_rows, say
from mfd_bayes.jobs.progress import show_progress
from mfd_bayes.messages import counted
from mfd_bayes.options import this_command
from mfd_bayes.pipeline.options import (
    COMPARED,
    CalibrateOptions,
    CheckOptions,
    CompareOptions,
    CrossvalidateOptions,
    DemoOptions,
    InitOptions,
    InspectOptions,
    PriorCheckOptions,
    ReportOptions,
    RunOptions,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mfd_bayes.evaluation.assessment import Assessment, Check
    from mfd_bayes.evaluation.views import CampaignView
    from mfd_bayes.runs.findings import Finding
    from mfd_bayes.runs.unit_system import UnitSystem

WIDTH, LINES = 100, 10
"""Most columns and lines of the end of a run."""

Calibration = TypeVar("Calibration", bound=RunOptions)


def run_init(options: InitOptions) -> None:
    """Write a first campaign or building file, and say what is to be done with it."""
    from mfd_bayes.campaign import draft as drafts
    from mfd_bayes.pipeline import init

    folder, force = options.folder, options.force
    if options.building:
        target = init.init_building(folder, force=force)
        say(f"{target} and an artificial ground.AT2 written: change what is in them")
        say("look next: mfd-bayes respond --help")
        return
    if folder.suffix == ".toml":
        written, named = init.init_priors(folder, options.model, force=force)
        say(f"{written} written: read each prior, and replace what you know better")
        if not named:
            say(f'to use it, write priors = "{written.name}" in [campaign] of {folder}')
        say(f"look next: {shlex.join(['mfd-bayes', 'prior-check', str(folder)])}")
        return
    written, draft, wrote_priors = init.init(folder, options.model, force=force)
    missing = drafts.gaps(draft)
    for name, reason in draft.left_out:
        say(f"left out: {name}: {reason}")
    for doubt in drafts.doubts(draft):
        say(f"unsure: {doubt}")
    for gap in missing:
        say(f"FIXME: {gap}")
    if draft.own and wrote_priors:
        say("priors: priors.toml was written; its sizes are guesses, from those of the records")
    elif wrote_priors:
        say(
            "priors: no shipped file knows such a device; wide ones were written to "
            f"{written.with_name('priors.toml')}, their scales read off the records"
        )
    left_out = f"{len(draft.left_out)} left out" if draft.left_out else "none left out"
    say(f"{written} written: tests {len(draft.tests)}, {left_out}")
    if missing:
        say("warning: complete what is marked FIXME before you calibrate")
    if drafts.lacks_priors(draft):
        command = shlex.join(["mfd-bayes", "init", str(written)])
        say(f"then: {command}, which writes priors.toml")
    elif not missing:
        say(f"look next: {shlex.join(['mfd-bayes', 'inspect', str(written)])}")


def run_inspect(options: InspectOptions) -> None:
    """Draw records, and print what was read and what would spoil a fit."""
    from mfd_bayes.pipeline.inspect import inspect

    inspections, system = inspect(
        options.file, options.folder, force=options.force, units=options.units
    )
    for inspection, picture in inspections:
        say(inspection.name)
        for key, fact in inspection.facts.items():
            say(f"  {key:21s}{fact}")
        for fault in inspection.faults:
            say(f"  {'warning':21s}{fault.name}: {fault.message.to_text(system)}")
        say(f"  {'picture':21s}{picture}")


def run_prior_check(options: PriorCheckOptions) -> None:
    """Draw what the priors allow; exit code 1 where most of a test's force lies outside."""
    from mfd_bayes.pipeline.init import prior_check

    checked = prior_check(
        options.campaign, options.folder, force=options.force, units=options.units
    )
    for name, share, picture in checked.tests:
        say(f"{name}: {share:.0%} of the force inside the 95 % prior band; {picture}")
    if checked.unloaded:
        say(
            f"note: most of the force of {', '.join(checked.unloaded)} lies outside. It was "
            "measured without actuation, and the priors are of a device under actuation."
        )
    if checked.outlying:
        why = f": {checked.wrong}" if checked.wrong else ""
        say(
            f"warning: most of the force of {', '.join(checked.outlying)} lies outside of what the "
            f"priors allow{why}"
        )
        raise typer.Exit(1)


def run_calibrate(options: CalibrateOptions) -> None:
    """Calibrate a campaign, or with --dry-run print what that would do."""
    out = options.out
    if out is None and not options.dry_run:
        raise typer.BadParameter("missing: give the run folder to write", param_hint="-o")
    from mfd_bayes.jobs.local import get_ready

    if not options.dry_run:
        get_ready()  # before this process imports the rest
    from mfd_bayes.pipeline.calibrate import calibrate_plan, check_dry
    from mfd_bayes.pipeline.plan import plan_campaign

    plan = plan_campaign(options.campaign, _complete(options, out))
    if options.dry_run or out is None:
        if out is not None:
            check_dry(plan, out)
        lengths = {task.id: task.trace.samples for task in plan.tasks}
        tests = [f"{name} ({counted(n, 'sample')})" for name, n in lengths.items()]
        say(f"{plan.campaign.path} is fine: would calibrate {', '.join(tests)}")
        say(f"and predict {', '.join(plan.held_out) or 'nothing'}; nothing was written")
        if order := plan.manifest.settings.order:
            follow = (f"{name} after {other}" for name, other in order.items())
            say(f"without a reset: {', '.join(follow)}")
        _print_warnings(plan.manifest.warnings, plan.system)
        if plan.slow:
            say(f"warning: {plan.slow}")
        return
    if not options.quiet:
        _print_warnings(plan.manifest.warnings, plan.system)
    with show_progress(quiet=options.quiet) as observe:
        view = calibrate_plan(plan, out, observe)
    _print_end(view, out, quiet=options.quiet)
    if not view.whole or (options.strict and view.unusable):
        raise typer.Exit(1)


def _complete(options: Calibration, out: Path | None) -> Calibration:
    """The options with this command, and with the effort of the run that is resumed."""
    from mfd_bayes.pipeline.plan import effort_of

    effort = options.effort
    if out is not None:
        effort = effort_of(out, effort, resume=options.resume)
    return replace(options, effort=effort, command=this_command())


def run_check(options: CheckOptions) -> None:
    """Print checks and verdict of a run; exit code 1 where it is not usable."""
    from mfd_bayes.pipeline.check import check

    assessment, system = check(options.out, options.units, trust_model=options.trust_model)
    if not options.quiet:
        if options.every:
            heads = ("test", "check", "feature", "observed", "expected", "status")
            rows = [
                (
                    *(c.test, c.check, c.feature, _figure(system, c.observed, c.unit)),
                    *(_expected(system, c), c.status),
                )
                for c in assessment.checks
            ]
            print_rows("Checks", heads, rows, folded=len(heads))
        for line in _missed_lines(assessment, system):
            say(line)
    for sentence in assessment.sentences:
        say(sentence.to_text(system))
    if assessment.unusable:
        raise typer.Exit(1)


def run_report(options: ReportOptions) -> None:
    """Make the report of a run once more; exit code 1 where a test is missing."""
    from mfd_bayes.pipeline.report import report

    with show_progress(quiet=options.quiet) as observe:
        view = report(options, observe)
    _print_end(view, options.out, quiet=options.quiet)
    if not view.whole:
        raise typer.Exit(1)


def run_crossvalidate(options: CrossvalidateOptions) -> None:
    """Predict every part of a campaign from all others; exit code 1 where a test is missing."""
    from mfd_bayes.pipeline.comparison import crossvalidate

    complete = _complete(options, options.out)
    with show_progress(quiet=options.quiet) as observe:
        view = crossvalidate(options.campaign, options.out, options.by, complete, observe)
    _print_left_out(view, quiet=options.quiet)
    _print_end(view, options.out, quiet=options.quiet)
    if not view.whole:
        raise typer.Exit(1)


def run_compare(options: CompareOptions) -> None:
    """Calibrate a campaign under several models or noises, and print which is favoured."""
    from mfd_bayes.pipeline.comparison import compare

    models, noises = (
        tuple(name.strip() for name in text.split(",") if name.strip())
        for text in (options.models or ("" if options.noises else COMPARED), options.noises)
    )
    complete = _complete(options, options.out)
    with show_progress(quiet=options.quiet) as observe:
        comparison, views = compare(
            *(options.campaign, options.out, models, noises, options.by, complete, observe)
        )
    heads = ("model", "cycles", "elpd ± se", "p_loo", "worst k", "k > 0.7", "difference ± se")
    rows = [
        (
            *(r.subject, r.model, r.cycles, f"{r.elpd:.1f} ± {r.elpd_se:.1f}", f"{r.p_loo:.1f}"),
            *(f"{r.worst_k:.2f}", f"{r.bad:.0%} → {r.unsettled:.0%}"),  # by PSIS → computed again
            *(f"{r.difference:.1f} ± {r.difference_se:.1f}", f"{r.rrse:.3f}"),
            f"{r.log_evidence:.2f} ± {r.log_evidence_se:.2f}"
            f"{'' if r.evidence_trusted else ', do not trust'}",
        )
        for r in comparison.rows
    ]
    if not options.quiet:
        title = "Each cycle predicted from all others (leave-one-cycle-out)"
        print_rows(title, ("test    ", *heads, "RRSE", "log evidence ± se"), rows)
    say(comparison.sentence)
    if comparison.sheet:
        say(comparison.sheet.sentence)
    for model, view in views.items():
        if scores := view.left_out:
            crps = scores.mean["crps"] * view.system.factor("kip")
            words = f"{scores.sentence} Mean CRPS {crps:.3f} {view.system.force}."
            say(f"{model}: {words}")
    if not options.quiet:
        say(f"look next at {options.out / 'comparison.csv'}")


def run_demo(options: DemoOptions) -> None:
    """Calibrate a synthetic campaign, and print its posterior beside the truth."""
    from mfd_bayes.jobs.local import get_ready

    get_ready()
    from mfd_bayes.pipeline.calibrate import demo

    calibration = RunOptions(
        force=options.force,
        jobs=options.jobs,
        scheduler=options.scheduler,
        seed=options.seed,
        effort=options.effort,
        command=this_command(),
    )
    with show_progress(quiet=options.quiet) as observe:
        view = demo(options.out, calibration, observe)
    heads = ("test", "quantity", "unit", "truth", "2.5 %", "50 %", "97.5 %", "inside", "data")
    rows = [
        (
            *(row["test"], row["name"], row["unit"]),
            *figures(row[key] for key in ("truth", "lower", "median", "upper")),
            "yes" if row["inside"] else "NO",
            "informed" if row["informed"] else "prior only",
        )
        for row in view.truth
    ]
    if not options.quiet:
        title = "Truth against posterior (95 % equal-tailed interval)"
        print_rows(title, heads, rows, folded=2)
    informed = [row for row in view.truth if row["informed"]]
    hits = sum(row["inside"] for row in informed)
    say(
        f"truth inside the 95 % interval for {hits} of {len(informed)} quantities that the "
        f"data inform ({hits / max(len(informed), 1):.1%})"
    )
    _print_end(view, options.out, quiet=options.quiet)


def _print_warnings(warnings: Iterable[Finding], system: UnitSystem) -> None:
    """Print what was found that a reader must know, a line each, in the units of a system."""
    for finding in warnings:
        say(f"warning: {finding.subject}: {finding.message.to_text(system)}")


def _print_left_out(view: CampaignView, *, quiet: bool) -> None:
    """Print how well each part left out was predicted, if it was; quiet: a summary."""
    scores, by = view.left_out, view.system.factor("kip")
    if scores is None:
        return
    parts = ["left out"] if scores.by != "test" else []
    rows = [
        (
            *(r["test"], *([r["part"]] if parts else [])),
            *(f"{100 * r[f'coverage_{share}']:.1f}" for share in (50, 90, 95)),
            *(
                f"{by * r['width_95']:.3f} ({by * r['fitted_width']:.3f})",
                f"{r['width_ratio']:.2f}",
            ),
            f"{by * r['interval_score']:.3f}",
            f"{by * r['crps']:.3f} ({by * r['fitted_crps']:.3f})",
            *(f"{r['crps_ratio']:.2f}", f"{r['rrse']:.3f}"),
        )
        for r in (*scores.rows, scores.mean)
    ]
    if not quiet:
        heads = ["50 %", "90 %", "95 %", "width (fitted)", "×", "interval", "CRPS (fitted)", "×"]
        title = f"Each test predicted without its {scores.by}, scores in {view.system.force}"
        print_rows(title, ["test", *parts, *heads, "RRSE"], rows[:-1], last=rows[-1])
    say(scores.sentence)


def _missed_lines(assessment: Assessment, system: UnitSystem) -> list[str]:
    """What misses: warnings, checks that fail or are missed, and tests that are not just usable."""
    from mfd_bayes.runs.findings import CheckStatus, Fitness

    return [
        *(f"warning: {f.subject}: {f.message.to_text(system)}" for f in assessment.warnings),
        *(
            f"{c.status}: {c.test}: {c.message.to_text(system)}"
            for c in assessment.checks
            if c.status in (CheckStatus.FAIL, CheckStatus.WARNING)
        ),
        *(
            f"{j.use}: {j.subject}: {j.to_text(system)}"
            for j in assessment.judgements
            if j.use != Fitness.USABLE
        ),
    ]


def _figure(system: UnitSystem, value: float, unit: str) -> str:
    """A value in the units of a system."""
    if unit in ("1", "dimensionless"):
        return f"{value:.4g}"
    return system.words([value], unit)


def _expected(system: UnitSystem, check: Check) -> str:
    """What passes a check, with its tolerance where it has one."""
    dimensionless = check.unit in ("1", "dimensionless")
    limit = check.limit if dimensionless else _figure(system, check.expected, check.unit)
    return f"{limit} ({check.tolerance:.0%})" if math.isfinite(check.tolerance) else limit


def _print_end(view: CampaignView, out: Path, *, quiet: bool) -> None:
    """Print the verdict of a run, what misses, and where to look; quiet: the verdict alone.

    These are at most `LINES` lines of at most `WIDTH` columns; `mfd-bayes check` has the rest.
    """
    system = view.system
    text = " ".join(sentence.to_text(system) for sentence in view.sentences)
    text = clean(f"{view.verdict.upper()}: {text}")
    lines = LINES if quiet else 4
    verdict = textwrap.wrap(text, WIDTH, max_lines=lines, placeholder=" …", break_on_hyphens=False)
    for line in verdict:
        say(line)
    if quiet:
        return
    missed, room = _missed_lines(view, system), LINES - len(verdict) - 2
    for line in missed[:room]:
        say(textwrap.shorten(clean(line), WIDTH, placeholder=" …"))
    more = f"{len(missed) - room} more, and " if len(missed) > room else ""
    say(f"{more}every check: {shlex.join(['mfd-bayes', 'check', str(out)])}")
    say(f"look next at {out / 'report.html'}")
