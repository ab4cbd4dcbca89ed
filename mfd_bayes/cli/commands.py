"""The command line: its commands, in the order of work."""

from __future__ import annotations

import atexit
import os
import shlex
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Argument, Context, Option

from mfd_bayes.cli import console, options
from mfd_bayes.cli.console import say, show_progress
from mfd_bayes.cli.options import (
    Campaign,
    Command,
    Commands,
    Pictures,
    Replace,
    Units,
    checked_output,
    mistakes,
    path,
    resumption,
    this_command,
)
from mfd_bayes.jobs.signals import end_on_signals
from mfd_bayes.units import percent

if TYPE_CHECKING:
    from collections.abc import Callable

    from mfd_bayes.applications.prediction.command import Answer, Question


def init(
    folder: Annotated[
        Path,
        Argument(
            parser=path, help="The folder of your test files, or a campaign.toml for its priors."
        ),
    ] = Path(),
    force: Annotated[
        bool, Option("--force", help="Replace a campaign.toml or priors.toml that exists.")
    ] = False,
    building: Annotated[
        bool, Option("--building", help="Write building.toml and ground.AT2 instead.")
    ] = False,
    model: Annotated[
        str, Option("--model", help="Your own model, FILE.py:CLASS, in that folder; it is run.")
    ] = "",
) -> None:
    """Write a first campaign.toml for a folder of test files, or a first building.toml.

    Guesses columns, units, actuations and ids from the names and numbers of the
    files; what is not certain is marked "unsure" in the file, with the
    alternatives, and what is missing "FIXME". Writes FOLDER/campaign.toml, and
    FOLDER/priors.toml for a device that no shipped prior file knows: wide priors
    whose scales are read off the records. Of a campaign.toml only the latter is
    written, beside it.

    Example:
      mfd-bayes init tests
      mfd-bayes init tests/campaign.toml --force
      mfd-bayes init --building
      mfd-bayes init coupons --model steel.py:Steel
    """
    with mistakes():
        from mfd_bayes.campaign import draft as drafts
        from mfd_bayes.pipeline import init as pipeline

        if building:
            target = pipeline.init_building(folder, force=force)
            say(f"{target} and an artificial ground.AT2 written: change what is in them")
            say("look next: mfd-bayes respond --help")
            return
        if folder.suffix == ".toml":
            written, named = pipeline.init_priors(folder, model, force=force)
            say(f"{written} written: read each prior, and replace what you know better")
            if not named:
                say(f'to use it, write priors = "{written.name}" in [campaign] of {folder}')
            say(f"look next: {shlex.join(['mfd-bayes', 'prior-check', str(folder)])}")
            return
        written, draft, wrote_priors = pipeline.init(folder, model, force=force)
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


def inspect(
    file: Annotated[Path, Argument(parser=path, help="A test file or a campaign.toml.")],
    folder: Pictures = Path(),
    force: Replace = False,
    units: Units = None,
) -> None:
    """Show what was read, warn of what would spoil a fit, and draw it.

    Columns, units, rate, peaks, cycles, energy and drifts; then warnings: swapped
    signs, lags, clipping, spikes, lost samples and the like. Warnings are not
    errors: the exit code stays 0.

    Writes a PNG of every test: NAME_inspect.png, here or in the folder of -o.

    Example:
      mfd-bayes inspect test.csv
      mfd-bayes inspect campaign.toml -o looks
    """
    with mistakes():
        from mfd_bayes.pipeline import inspect as pipeline

        inspections, system = pipeline.inspect(file, folder, force=force, units=units or "")
    for inspection, picture in inspections:
        say(inspection.name)
        for key, fact in inspection.facts.items():
            say(f"  {key:21s}{fact}")
        for fault in inspection.faults:
            say(f"  {'warning':21s}{fault.name}: {fault.message.to_text(system)}")
        say(f"  {'picture':21s}{picture}")


def prior_check(
    campaign: Campaign, folder: Pictures = Path(), force: Replace = False, units: Units = None
) -> None:
    """Draw the prior predictive band of the force beside the data of every test.

    Where most of a test's force lies outside the band, the exit code is 1: it
    names the test, the prior that is most wrong and what would mend it. A test
    without actuation is only noted where others have one. Writes a PNG of every
    test: CAMPAIGN_ID_prior.png, here or in the folder of -o.

    Example:
      mfd-bayes prior-check campaign.toml
      mfd-bayes prior-check campaign.toml -o looks
    """
    with mistakes():
        from mfd_bayes.pipeline import init as pipeline

        checked = pipeline.prior_check(campaign, folder, force=force, units=units or "")
    for name, share, picture in checked.tests:
        say(f"{name}: {share:.0%} of the force inside the 95 % prior band; {picture}")
    if checked.unloaded:
        say(
            f"note: most of the force of {', '.join(checked.unloaded)} lies outside. It was "
            "measured without actuation, and the priors are of a device under actuation."
        )
    if checked.outside:
        why = f": {checked.wrong}" if checked.wrong else ""
        say(
            f"warning: most of the force of {', '.join(checked.outside)} lies outside of what the "
            f"priors allow{why}"
        )
        raise typer.Exit(1)


def calibrate(
    ctx: Context,
    campaign: options.Campaign,
    out: options.NewRunOrNone = None,
    resume: options.Resume = False,
    force: options.Force = False,
    jobs: options.Jobs = 0,
    scheduler: options.Scheduler = "",
    seed: options.Seed = 1,
    effort: options.Effort = None,
    dry_run: Annotated[bool, Option("--dry-run", help="Read and check only.")] = False,
    strict: Annotated[bool, Option("--strict", help="Exit 1 if the run is not usable.")] = False,
    quiet: options.Quiet = False,
) -> None:
    """Calibrate every test of a campaign, infer the laws, and write the report.

    Writes the run folder OUT: report.html, tables of parameters and laws (CSV,
    JSON, LaTeX), checks.csv, pictures, and a posterior.nc of every test, which
    ArviZ opens. After Ctrl-C, what is finished is kept: --resume goes on.

    Example:
      mfd-bayes calibrate campaign.toml --dry-run
      mfd-bayes calibrate campaign.toml -o out
      mfd-bayes calibrate campaign.toml -o out --resume
    """
    if out is None and not dry_run:
        raise typer.BadParameter("missing: give the run folder to write", param_hint="-o")
    with mistakes("" if dry_run else resumption()):
        from mfd_bayes.jobs.local import get_ready

        if not dry_run:
            get_ready()  # before this process imports the rest
        from mfd_bayes.pipeline import calibrate as pipeline
        from mfd_bayes.pipeline.plan import plan_campaign

        plan = plan_campaign(campaign, options.run_options(ctx, out))
        if dry_run or out is None:
            if out is not None:
                pipeline.check_dry(plan, out)
            console.print_plan(plan)
            if plan.slow:
                console.say(f"warning: {plan.slow}")
            return
        if not quiet:
            console.print_warnings(plan.manifest.warnings, plan.system)
        with show_progress(quiet=quiet) as observe:
            view = pipeline.calibrate_plan(plan, out, observe)
        console.print_end(view, out, quiet=quiet)
    if not view.whole or (strict and view.unusable):
        raise typer.Exit(1)


def check(
    out: options.Run,
    every: Annotated[bool, Option("--all", help="Show every check.")] = False,
    quiet: options.Quiet = False,
    units: options.Units = None,
    trust_model: options.TrustModel = False,
) -> None:
    """Show checks, warnings and the verdict on every test; exit 1 where the run is not usable.

    Shows how many checks of each kind passed, and every check that failed or needs
    care; --all shows every check. The verdict is "usable", "usable with care" or
    "not usable". Writes nothing; OUT/checks.csv holds every check.

    Example:
      mfd-bayes check out
      mfd-bayes check out --all
      mfd-bayes check out --quiet && echo fit to use
    """
    with mistakes():
        from mfd_bayes.pipeline import report as pipeline

        view = pipeline.check(out, units or "", trust_model=trust_model)
    if not quiet:
        console.print_checks(view, every=every)
    console.print_sentences(view)
    if view.unusable:
        raise typer.Exit(1)


def report(
    ctx: Context,
    out: options.Run,
    quiet: options.Quiet = False,
    pdf: Annotated[bool, Option("--pdf", help="Write a PDF too; needs a Chromium.")] = False,
    word: Annotated[
        bool, Option("--word", help="Write Tables I and II as tables.docx too.")
    ] = False,
    excel: Annotated[
        bool, Option("--excel", help="Write Tables I and II as tables.xlsx too.")
    ] = False,
    next_test: Annotated[
        bool, Option("--next", help="Add a section on which test to make next.")
    ] = False,
    tests: Annotated[
        list[str] | None,
        Option(help="Draw this test's pictures, in a run of more than 12; may be repeated."),
    ] = None,
    all_tests: Annotated[
        bool, Option("--all-tests", help="Draw the pictures of every test of such a run.")
    ] = False,
    at: Annotated[
        list[str] | None,
        Option(help='Add a condition to the data sheet: "500 psi, 1 in, 0.5 Hz".'),
    ] = None,
    units: options.Units = None,
    trust_model: options.TrustModel = False,
) -> None:
    """Remake the report, tables and figures of a run from what is stored, without sampling.

    Writes OUT/report.html, the tables beside it, OUT/figures and the pictures
    of every test; with --pdf OUT/report.pdf too. All are in the units of the
    campaign, or in those of --units; the page has a switch for both. In a run
    of more than 12 tests, pictures of single tests are drawn only with --tests
    or --all-tests.

    Example:
      mfd-bayes report out
      mfd-bayes report out --pdf
      mfd-bayes report out --units si --word --excel
      mfd-bayes report out --tests p500_f0.05 --tests p800_f0.05
    """
    with mistakes(this_command()):
        from mfd_bayes.pipeline import report as pipeline
        from mfd_bayes.reporting.page import Forms

        forms = options.settings(Forms, ctx)
        with show_progress(quiet=quiet) as observe:
            view = pipeline.report(
                out, observe, forms=forms, units=units or "", trust_model=trust_model
            )
        console.print_end(view, out, quiet=quiet)
    if not view.whole:
        raise typer.Exit(1)


def draws(
    out: options.Run,
    to: Annotated[Literal["csv", "parquet"], Option(help="Parquet needs the extra parquet.")],
    units: options.Units = None,
    most: Annotated[int, Option(min=0, help="Most draws kept of each test; 0 for all.")] = 0,
    trust_model: options.TrustModel = False,
) -> None:
    """Write the posterior draws of every test as one table, for other programs.

    Writes OUT/draws.csv or OUT/draws.parquet: test, chain and draw, then a column
    for each quantity with its unit in brackets, then the log densities.

    Example:
      mfd-bayes draws out --to csv
      mfd-bayes draws out --to parquet --units si
    """
    with mistakes():
        from mfd_bayes.applications.export import draws as pipeline

        written, rows = pipeline.write_draws(out, to, units or "", most, trust_model=trust_model)
    console.say(f"{written} written: {rows} draws")


def demo(
    ctx: Context,
    out: options.Run,
    quick: Annotated[bool, Option("--quick", help="Fewer draws, in a little less time.")] = False,
    jobs: options.Jobs = 0,
    scheduler: options.Scheduler = "",
    seed: options.Seed = 1,
    force: options.Force = False,
    quiet: options.Quiet = False,
) -> None:
    """Calibrate a synthetic campaign after the MFD paper's test matrix.

    Writes its CSV files and campaign.toml under OUT/campaign, an example for
    your own, calibrates them, writes OUT/report.html and compares the posterior
    with the true values.

    Example:
      mfd-bayes demo out --quick
    """
    effort = "quick" if quick else "standard"

    def resume() -> str:
        campaign, words = out / "campaign" / "campaign.toml", ["--seed", str(seed)]
        words += ["--scheduler", scheduler] if scheduler else []
        if not campaign.is_file():  # it is written last
            quicker = ["--quick"] if quick else []
            return shlex.join(["mfd-bayes", "demo", str(out), *quicker, *words, "--force"])
        run = [str(campaign), "-o", str(out), "--effort", effort]
        return shlex.join(["mfd-bayes", "calibrate", *run, *words, "--resume"])

    with mistakes(resume):
        from mfd_bayes.jobs.local import get_ready

        get_ready()
        from mfd_bayes.pipeline import calibrate as pipeline

        with show_progress(quiet=quiet) as observe:
            view = pipeline.demo(out, options.run_options(ctx, out, effort=effort), observe)
        console.print_truth(view, quiet=quiet)
        console.print_end(view, out, quiet=quiet)


# --- the commands that use a finished run

_COMPARED = "three_stage,lugre,bouc_wen,backlash"


def predict(
    ctx: Context,
    out: options.Run,
    bands: Annotated[
        Path, Option("-o", "--out", parser=options.path, help="CSV to write; PNGs beside it.")
    ],
    actuation: Annotated[
        str, Option(help='Such as "1000 psi"; needed where the tests have one.')
    ] = "",
    motion: Annotated[
        Path | None, Option(parser=options.path, help="A file with time_s and displacement_in, …")
    ] = None,
    sine: Annotated[str, Option(help='A harmonic motion instead: "1 in, 0.5 Hz, 3 cycles".')] = "",
    kind: options.Kind = "new_test",
    probability: Annotated[float, Option(help="Probability of the equal-tailed band.")] = 0.95,
    compare: Annotated[
        bool, Option("--compare", help="Compare with the force in the motion's file.")
    ] = False,
    test: Annotated[
        str, Option(metavar="ID", help="The calibrated test, for --kind this_test.")
    ] = "",
    device: Annotated[
        str,
        Option(metavar='"no. 3"', help="A device of the campaign; else a new one, if several."),
    ] = "",
    session: Annotated[
        str, Option(help="A session of the campaign; else a new one, if several.")
    ] = "",
    date: options.Date = "",
    cycles: options.Cycles = None,
    temperature: options.Temperature = "",
    whole: Annotated[
        bool, Option("--whole", help="Add a band that holds the whole history.")
    ] = False,
    explain: Annotated[bool, Option("--explain", help="Say what makes the band wide.")] = False,
    design: Annotated[
        bool, Option("--design", help="Print mean and bounding properties with λ factors.")
    ] = False,
    extrapolate: Annotated[
        bool, Option("--extrapolate", help="Predict also far outside of the tested range.")
    ] = False,
    rate: Annotated[
        str, Option(metavar='"64 Hz"', help="Thin the motion; else every sample is kept.")
    ] = "",
    given: Annotated[
        str, Option(metavar='"0 s to 3 s"', help="The time in which the file's force is used.")
    ] = "",
    after: Annotated[
        str, Option(metavar="ID", help="The test before, where the device was not reset.")
    ] = "",
    others: Annotated[
        list[Path] | None,
        Option(
            "--with",
            metavar="OUT",
            parser=options.path,
            help="Predict together with this run of another model; may be repeated.",
        ),
    ] = None,
    figures: Annotated[bool, Option("--figures/--no-figures", help="Draw the PNGs.")] = True,
    force: options.Replace = False,
    units: options.Units = None,
    quiet: options.Quiet = False,
    trust_model: options.TrustModel = False,
) -> None:
    """Predict the force of a motion at an actuation, tested or not.

    Writes the band as CSV where -o says, a PNG of the loops beside it, one of the
    history (..._history.png), and what derives from the force, such as energy and
    peaks (..._derived.csv). It warns where stroke, speed, frequency or actuation
    lie outside the tested range, or the run is not usable; far outside it
    refuses unless --extrapolate is given. --compare prints the share of the
    measured force inside the band, and keeps it in the CSV. --design prints mean
    and bounding properties (slip force, energy, peaks), for the mean property,
    this device tested again, another device and a measurement, and writes
    ..._design.csv. --explain takes some seconds. --given uses the force in a
    part of the motion's file, for the kinds new_test and observation: the band of
    the rest is narrower, and the tables and pictures mark the part. --after names
    a test of the run that was made directly before, with no reset in between: the
    motion begins where in its gap that test ended. --with names a run of the same
    tests with another model, such as compare writes: both give half of the band's
    draws, so that it holds what each of them says.

    Example:
      mfd-bayes predict out --motion quake.csv --actuation "1000 psi" -o bands.csv
      mfd-bayes predict out --sine "1in, 1Hz, 3 cycles" --actuation 1ksi -o b.csv
      mfd-bayes predict a --with b --motion quake.csv --actuation "1 ksi" -o b.csv
    """
    with mistakes():
        from mfd_bayes.applications.prediction import command as pipeline

        question = options.settings(pipeline.Question, ctx)
        answer = pipeline.predict(out, question)
    _print_answer(answer, question, quiet=quiet)


def _print_answer(answer: Answer, question: Question, *, quiet: bool) -> None:
    """Print what a prediction found, and where its tables are."""
    band = answer.band
    console.warn(map(answer.system.text, band.remarks))
    console.say(
        f"{band.interval} {percent(band.probability)} % band of kind {band.kind} "
        f"({answer.name}), from {band.source}: {question.bands}"
        f"{f' and {question.picture}' if question.figures else ''}"
    )
    if answer.compared is not None:
        console.say(answer.compared.sentence(answer.system))
        if answer.judged:
            warning = "warning: " if answer.disagrees else ""
            console.say(f"{warning}{answer.judged}", err=answer.disagrees)
    if question.explain and band.shares:
        console.print_shares(band.shares, quiet=quiet)
    if answer.design:
        console.print_design(answer.design, band.probability)
    if not quiet:
        title = answer.system.text("Derived quantities, of the damper without offset and noise")
        console.print_derived(answer.derived, band.probability, title)
        console.say(f"look next at {question.beside('derived.csv')}")


def crossvalidate(
    ctx: Context,
    campaign: options.Campaign,
    out: options.NewRun,
    by: Annotated[
        str, Option(metavar="test|level|session", help="What to leave out in turn.")
    ] = "test",
    resume: options.Resume = False,
    force: options.Force = False,
    jobs: options.Jobs = 0,
    scheduler: options.Scheduler = "",
    seed: options.Seed = 1,
    effort: options.Effort = None,
    quiet: options.Quiet = False,
) -> None:
    """Predict every part of a campaign from all the others, and score the predictions.

    Calibrates the campaign first; with --resume it takes the posteriors that
    OUT has. Then it leaves out one test, level of actuation or session after
    another and infers the population of the others. Writes
    OUT/crossvalidation.csv and the report.

    Example:
      mfd-bayes crossvalidate campaign.toml -o out --by level --resume
    """
    with mistakes(resumption()):
        from mfd_bayes.pipeline import comparison as pipeline

        run_options = options.run_options(ctx, out)
        with show_progress(quiet=quiet) as observe:
            view = pipeline.crossvalidate(campaign, out, run_options, observe)
        console.print_left_out(view, quiet=quiet)
        console.print_end(view, out, quiet=quiet)
    if not view.whole:
        raise typer.Exit(1)


def compare(
    ctx: Context,
    campaign: options.Campaign,
    out: Annotated[
        Path,
        Option("-o", "--out", parser=options.path, help="Folder of one run for each model."),
    ],
    models: Annotated[
        str | None,
        Option(help="Two or more, with commas between them.", show_default=_COMPARED),
    ] = None,
    noises: Annotated[
        str, Option(help="Compare noises too, or alone: such as ou,iid,staged.")
    ] = "",
    by: Annotated[
        str, Option(help="Leave out each test, level or session of each model's run too.")
    ] = "",
    resume: options.Resume = False,
    force: options.Force = False,
    jobs: options.Jobs = 0,
    scheduler: options.Scheduler = "",
    seed: options.Seed = 1,
    effort: options.Effort = None,
    quiet: options.Quiet = False,
) -> None:
    """Calibrate a campaign under several models or noises; say which one its records favour.

    Writes a run folder OUT/MODEL of each, and OUT/comparison.csv: how well each
    model predicts every cycle of a record from all others (PSIS-LOO), and its log
    evidence. The campaign's own model does not count. With --noises alone the campaign's model
    is calibrated with each noise, into OUT/NOISE; with both options each model
    with each noise, into OUT/MODEL_NOISE.

    Example:
      mfd-bayes compare campaign.toml -o out
      mfd-bayes compare campaign.toml -o out --models three_stage,lugre
      mfd-bayes compare campaign.toml -o out --noises ou,iid,staged
    """
    with mistakes(resumption()):
        from mfd_bayes.pipeline import comparison as pipeline

        if models is None:
            models = "" if noises else _COMPARED
        names, others = (
            tuple(name.strip() for name in text.split(",") if name.strip())
            for text in (models, noises)
        )
        run_options = options.run_options(ctx, out, noises=others)
        with show_progress(quiet=quiet) as observe:
            comparison, views = pipeline.compare(campaign, out, names, run_options, observe)
        console.print_comparison(comparison, quiet=quiet)
        for model, view in views.items():
            if scores := view.left_out:
                crps = scores.mean["crps"] * view.system.factor("kip")
                words = f"{scores.sentence} Mean CRPS {crps:.3f} {view.system.force}."
                console.say(f"{model}: {words}")
        if not quiet:
            console.say(f"look next at {out / 'comparison.csv'}")


def accept(
    ctx: Context,
    out: options.Run,
    records: Annotated[
        list[Path], typer.Argument(parser=options.path, help="Records of the devices.")
    ],
    folder: options.Folder,
    actuation: Annotated[str, Option(help='Of the records, such as "1000 psi".')] = "",
    device: Annotated[
        list[str] | None,
        Option(metavar='"no. 17"', help="The device of all records; or repeat it for each."),
    ] = None,
    limit: Annotated[
        list[str] | None,
        Option(
            metavar='slip="15 %"',
            help="Largest deviation of slip, gap, energy, …, or all; may be repeated.",
            show_default="the campaign's, else all=15 %",
        ),
    ] = None,
    session: Annotated[str, Option(help="The session in which the records were made.")] = "",
    date: options.Date = "",
    cycles: options.Cycles = None,
    temperature: options.Temperature = "",
    draws: Annotated[int, Option(min=200, max=10000)] = 1000,
    seed: options.Seed = 0,
    force: options.Replace = False,
    units: options.Units = None,
    quiet: options.Quiet = False,
    trust_model: options.TrustModel = False,
) -> None:
    """Say whether a device is like the others: accepted, rejected, or that a record cannot tell.

    Compares slip force, peak force, energy, effective stiffness and damping, gap,
    and the whole loop of a record with what the run's tests scatter. A device is
    accepted where its own level is shown to lie within the limits (two one-sided
    tests, 5 % each); it is rejected where it lies beyond one and the scatter of
    tests does not explain it (5 % false alarms, over all quantities and the whole
    batch). Writes FOLDER/acceptance.csv, a page of A4 for each device, and with
    several devices a picture. Ends with exit code 1 where a device is rejected.

    Example:
      mfd-bayes accept out no17.csv --actuation "1000 psi" --device "no. 17" -o qc
      mfd-bayes accept out new/*.csv --actuation 1ksi --limit "slip=10 %" -o qc
    """
    with mistakes():
        from mfd_bayes.applications.acceptance import command as pipeline

        devices, pages = pipeline.accept_records(out, options.settings(pipeline.Inspection, ctx))
    console.warn(remark for each in devices for remark in each.remarks)
    if not quiet:
        for each in devices:
            heads = ["effect, %", "90 % interval", "limit, %", "percentile", "p", "verdict"]
            rows = [
                (f"{row['quantity']} {row['direction']}".strip(), *console.effect_cells(row))
                for _, row in each.rows.iterrows()
            ]
            console.print_rows(f"{each.device}: {each.verdict}", ["quantity", *heads], rows)
    for each in devices:
        console.say(f"{each.device}: {each.sentence}")
    if not quiet:
        console.say(f"look next at {pages[0]}")
    if any(each.verdict == "rejected" for each in devices):
        raise typer.Exit(1)


def next_test(
    ctx: Context,
    out: options.Run,
    goal: Annotated[
        str, Option(help='What to know better: "energy at 1000 psi, 0.5 Hz, 1 in".')
    ] = "",
    candidates: Annotated[
        str, Option(help='Tests to choose from: "500|1350 psi, 0.5 Hz, 1 in", or a file.')
    ] = "",
    limits: Annotated[str, Option(help='Of the actuator: "10 in/s, 6 in, 20 kip".')] = "",
    table: Annotated[
        Path | None,
        Option(
            "-o",
            "--out",
            parser=options.path,
            help="CSV to write; JSON and PNG beside it.",
            show_default="OUT/next.csv",
        ),
    ] = None,
    draft: Annotated[
        Path | None,
        Option(
            "--write",
            parser=options.path,
            metavar="FILE.toml",
            help="Draft the next entries of campaign.toml.",
        ),
    ] = None,
    tests: Annotated[int, Option(min=1, max=3, help="How many tests --write drafts.")] = 1,
    draws: Annotated[
        int, Option(min=200, help="Draws of the posterior that are simulated.")
    ] = 2000,
    seed: options.Seed = 0,
    force: options.Replace = False,
    units: options.Units = None,
    quiet: options.Quiet = False,
    trust_model: options.TrustModel = False,
) -> None:
    """Say which test to make next: by how much each narrows a band or an interval.

    Simulates every candidate from the posterior and finds how much narrower the
    goal's band would be once it is calibrated. Writes OUT/next.csv, next.json
    and next.png. Goals: band (the default, over the campaign's range), energy,
    peak, peak_fwd, peak_bwd, slip, each "at" some tests; gap; "slope of Fc_fwd";
    "exponent of Fc_fwd". A test in words has an actuation, a frequency, an
    amplitude (half the stroke), and may have cycles, a waveform (sine, triangle)
    and its cost as a time; semicolons are between tests, and bars between
    values. Goal, candidates and limits can also stand in the table "goal" of the
    campaign file.

    Example:
      mfd-bayes next out
      mfd-bayes next out --goal "band at 1000 psi, 0.5 Hz, 1 in"
    """
    with mistakes():
        from mfd_bayes.applications.next_test import command as pipeline

        best, files = pipeline.run_next(out, options.settings(pipeline.Wish, ctx))
    console.warn(best.advice.remarks)
    if not quiet:
        heads = ["narrows by", "hours", "per hour", "information, nat", "repeats"]
        title = "How much the best candidates are expected to narrow the goal"
        console.print_rows(title, ["test", *heads], best.shown(10))
    console.say(best.sentence)
    if not quiet:
        for sentence in best.together:
            console.say(sentence)
        console.say(f"look next at {' and '.join(map(str, files[:1] + files[2:]))}")


def respond(
    ctx: Context,
    out: options.Run,
    building: Annotated[
        Path, Option(parser=options.path, help="The building file; see init --building.")
    ],
    grounds: Annotated[
        list[str],
        Option("--ground", help="Ground motion, .AT2 or CSV; several by several --ground."),
    ],
    folder: options.Folder,
    sweep: Annotated[
        str, Option(metavar="RANGE", help='actuation="500 psi to 1500 psi in 8 steps".')
    ] = "",
    quantity: Annotated[
        Literal["drift", "acceleration"],
        Option("--minimise", help="What the sweep makes small."),
    ] = "drift",
    goal: Annotated[
        Literal["mean", "q90", "passing"],
        Option(
            "--by", help="By its mean, its 90 % quantile, or the probability to exceed its limit."
        ),
    ] = "mean",
    kind: Annotated[
        Literal["new_test", "mean"],
        Option(help="With each damper's scatter from test to test, or without."),
    ] = "new_test",
    draws: Annotated[int, Option(min=10, max=5000)] = 300,
    scale: Annotated[
        float | None, Option(help="Factor of every ground motion.", show_default="1")
    ] = None,
    unit: Annotated[str, Option(metavar='"cm/s^2"', help="Unit of files that do not say it.")] = "",
    peak: Annotated[
        str, Option(metavar='"0.3 g"', help="Scale every ground motion to this peak.")
    ] = "",
    tolerance: Annotated[
        float, Option(help="Largest error of a draw's peak drift, as a share.")
    ] = 0.01,
    jobs: options.Jobs = 0,
    seed: options.Seed = 1,
    units: options.Units = None,
    force: options.Replace = False,
    quiet: options.Quiet = False,
    trust_model: options.TrustModel = False,
) -> None:
    """Compute a building's response to earthquakes, with this device as its dampers.

    Every draw of the dampers goes through a nonlinear time-history analysis. Writes
    FOLDER/report.html with the drift profile and its bands, histories, loops and
    limits, and the tables peaks.csv, limits.csv, draws.csv, peaks.tex and
    response.json. A step file without its step is given as FILE:0.01s. Files that
    are numbers alone are taken to be in g; FILE:0.01s:cm/s^2 says otherwise. A scaled
    peak above 5 g or below 0.0001 g is refused, as is one above 2 g without a unit.

    Example:
      mfd-bayes respond out --building b.toml --ground quake.AT2 -o response

    With --sweep actuation="500 psi to 1500 psi" it compares actuations.
    """
    with mistakes():
        from mfd_bayes.applications.buildings import command as pipeline

        prepared = pipeline.prepare(out, options.settings(pipeline.Query, ctx))
        for ground in () if quiet else prepared.grounds:
            console.say(ground.words)
        with show_progress(quiet=quiet) as observe:
            view = pipeline.run_respond(prepared, observe)
    console.warn(view.remarks)
    for sentence in view.verdict:
        console.say(sentence)
    if view.sweep:
        console.say(view.sweep)
    if not quiet:
        console.say(f"look next at {folder / 'report.html'}")


def export(
    ctx: Context,
    out: options.Run,
    to: Annotated[Literal["quofem", "opensees", "csv"], Option(help="Who is to read it.")],
    folder: options.Folder = Path("export"),
    actuation: Annotated[
        str, Option(help='Such as "1000 psi"; the middle of the tests\' by default.')
    ] = "",
    draws: Annotated[int, Option(min=10, max=20000)] = 1000,
    seed: options.Seed = 1,
    force: options.Replace = False,
    extrapolate: Annotated[
        bool, Option("--extrapolate", help="Export also far outside of the tested range.")
    ] = False,
    trust_model: options.TrustModel = False,
) -> None:
    """Write joint samples of a new device's parameters for other programs.

    quofem: a column per variable without a header, grouped so that correlations are
    kept, and dakotaTab.out. opensees: a material fitted to predicted loops, with its
    misfit. csv: one table with names and units. All are in kip, in and ksi, those of a
    model of your own in its units, which about.json has. Outside of the tested
    actuations it warns, far outside it refuses.

    Example:
      mfd-bayes export out --to quofem --actuation "1000 psi" -o samples
    """
    with mistakes():
        from mfd_bayes.applications.export import samples as pipeline

        sentences, remarks = pipeline.export(out, options.settings(pipeline.Export, ctx))
    console.warn(remarks)
    for sentence in sentences:
        console.say(sentence)


def serve(
    source: Annotated[
        str, Argument(metavar="MODEL|OUT", help="A model, as in a campaign file, or a run folder.")
    ],
    port: Annotated[int, Option(min=0, max=65535, help="0 for any that is free.")] = 4242,
    motion: Annotated[
        Path | None, Option(parser=options.path, help="A model's motion: a file, or --sine.")
    ] = None,
    sine: Annotated[str, Option(help='Such as "1 in, 0.5 Hz, 3 cycles".')] = "",
    actuation: Annotated[str, Option(help='Of a model, such as "1000 psi".')] = "",
    trust_model: options.TrustModel = False,
) -> None:
    """Serve a model, or a run's log posterior, to other programs, as UM-Bridge has it.

    Any program for uncertainty quantification that speaks this protocol over HTTP
    can call it, on this machine. OUT serves "posterior": sampled coordinates in,
    log density out; "values": their parameters; and "forward": parameters in, force
    of the test's motion out. A model serves "forward" for a motion that you give.
    Names and units are printed. Writes nothing; a model in a file is run.

    Example:
      mfd-bayes serve out --port 4242
      mfd-bayes serve lugre --sine "1 in, 0.5 Hz, 3 cycles"
      mfd-bayes serve my_damper.py:Viscous --motion quake.csv --actuation "1 ksi"
    """
    with mistakes():
        from mfd_bayes.applications.export import server as pipeline

        pipeline.serve(source, port, motion, sine, actuation, console.say, trust_model=trust_model)


def watch(
    ctx: typer.Context,
    record: Annotated[
        Path, Argument(parser=options.path, help="The file of the test; it may still grow.")
    ],
    run: Annotated[
        Path, Option("--run", metavar="OUT", parser=options.path, help="The run of this device.")
    ],
    actuation: Annotated[str, Option(help='Such as "1000 psi".')] = "",
    session: Annotated[str, Option(help="Of the test, where the campaign has sessions.")] = "",
    device: Annotated[str, Option(help="A device of the campaign; else a new one.")] = "",
    date: options.Date = "",
    cycles: options.Cycles = None,
    temperature: options.Temperature = "",
    narrowing: Annotated[
        str, Option(metavar='"2 %"', help="Enough where one more cycle narrows no interval so far.")
    ] = "2 %",
    wait: Annotated[
        str, Option(metavar='"10 s"', help="End when the file has not grown for so long.")
    ] = "10 s",
    trust_model: options.TrustModel = False,
) -> None:
    """Follow a test while it runs: a line for each cycle, and when the test is long enough.

    Prints and writes no file. Each line has the slip forces and the gap of this
    test, with intervals of 95 % and their place among new tests of the run's
    device, and by how much one more cycle would narrow the interval of the
    device's property. What tests of one device scatter stays, however long a test
    is: a test is long enough when one more cycle would narrow no interval by 2 %.

    Example:
      mfd-bayes watch record.csv --run out --actuation "1000 psi"
    """
    with mistakes():
        from mfd_bayes.applications.watch import command as pipeline

        for cycle in pipeline.watch(run, options.settings(pipeline.Watched, ctx)):
            console.say(cycle.sentence)


# --- the command line

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",  # keeps the lines of examples apart
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Bayesian calibration, with honest uncertainty, of variable-friction dampers with a gap.",
    epilog="New here? mfd-bayes demo out --quick takes a few minutes; each command has --help.",
)

_PANELS: dict[str, tuple[tuple[Callable[..., None], str], ...]] = {
    "Look at your data": (
        (init, "complete campaign.toml where it is marked, then mfd-bayes inspect campaign.toml"),
        (inspect, "mfd-bayes prior-check campaign.toml, or mfd-bayes calibrate --help"),
        (prior_check, "mfd-bayes calibrate campaign.toml -o out"),
    ),
    "Calibrate": (
        (calibrate, "open out/report.html, then mfd-bayes check out"),
        (check, "mfd-bayes predict --help, or mfd-bayes calibrate --help if a check failed"),
        (report, "open out/report.html, then mfd-bayes check out"),
    ),
    "Predict and compare": (
        (predict, "look at bands.png, then mfd-bayes crossvalidate --help"),
        (accept, "print and file FOLDER/DEVICE.html; test a rejected device again"),
        (crossvalidate, "open out/report.html, then mfd-bayes compare --help"),
        (compare, "open out/MODEL/report.html of the model that is favoured"),
        (draws, "read the table with pandas, R or another program; or mfd-bayes predict --help"),
        (watch, "stop the test, add it to campaign.toml, and calibrate again"),
        (next_test, "make the test, add it to campaign.toml, and calibrate again"),
        (respond, "open FOLDER/report.html, then mfd-bayes export --help"),
        (export, "read about.json in the folder, beside the samples"),
        (serve, "in Python: umbridge.HTTPModel(URL, 'posterior')([q])"),
    ),
    "See it work on synthetic data": (
        (demo, "open out/report.html, then mfd-bayes inspect test.csv with a file of yours"),
    ),
}
"""Panels of the help: their commands, and what to do after each."""

for _panel, _commands in _PANELS.items():
    for _command, _next in _commands:
        _name = "next" if _command is next_test else None  # next is a word of Python
        app.command(_name, cls=Command, rich_help_panel=_panel, epilog=f"Next: {_next}")(_command)


def _version(show: bool) -> None:
    if show:
        from mfd_bayes import __version__

        typer.echo(f"mfd-bayes {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Bayesian calibration, with honest uncertainty, of variable-friction dampers with a gap."""


def main() -> None:
    """Run the command line."""
    settle_environment()
    with end_on_signals(), checked_output():
        app(prog_name="mfd-bayes")


def settle_environment() -> None:
    """Make what libraries read from the environment the same for everybody.

    One thread for each matrix, for those here are small; figures without a screen, for a notebook
    may have set a backend of its own; and a folder for caches where the home cannot be written to.
    Processes that are started inherit it.
    """
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # before numpy is imported
    os.environ["MPLBACKEND"] = "agg"
    if not os.access(os.environ.get("HOME", ""), os.W_OK):
        own = tempfile.mkdtemp(prefix="mfd-bayes-")
        atexit.register(shutil.rmtree, own, ignore_errors=True)
        for name in ("MPLCONFIGDIR", "XDG_CACHE_HOME"):
            os.environ.setdefault(name, own)
