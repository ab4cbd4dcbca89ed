"""The commands up to a calibrated run: from init to the report, and the demo."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Context, Option

from mfd_bayes.cli import console, options
from mfd_bayes.cli.console import say, show_progress
from mfd_bayes.cli.options import (
    Campaign,
    Pictures,
    Replace,
    Units,
    mistakes,
    path,
    resumption,
    this_command,
)


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
        from mfd_bayes.pipeline import calibrate as pipeline

        view = pipeline.check(out, units or "")
    if not quiet:
        console.print_checks(view, every=every)
    console.print_sentences(view)
    if view.unusable:
        raise typer.Exit(1)


def report(
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
        from mfd_bayes.pipeline import calibrate as pipeline
        from mfd_bayes.reporting.page import Forms

        chosen, conditions = tuple(tests or ()), tuple(at or ())
        forms = Forms(pdf, word, excel, next_test, chosen, all_tests, conditions)
        with show_progress(quiet=quiet) as observe:
            view = pipeline.report(out, observe, forms=forms, units=units or "")
        console.print_end(view, out, quiet=quiet)
    if not view.whole:
        raise typer.Exit(1)


def draws(
    out: options.Run,
    to: Annotated[Literal["csv", "parquet"], Option(help="Parquet needs the extra parquet.")],
    units: options.Units = None,
    most: Annotated[int, Option(min=0, help="Most draws kept of each test; 0 for all.")] = 0,
) -> None:
    """Write the posterior draws of every test as one table, for other programs.

    Writes OUT/draws.csv or OUT/draws.parquet: test, chain and draw, then a column
    for each quantity with its unit in brackets, then the log densities.

    Example:
      mfd-bayes draws out --to csv
      mfd-bayes draws out --to parquet --units si
    """
    with mistakes():
        from mfd_bayes.pipeline import calibrate as pipeline

        written, rows = pipeline.write_draws(out, to, units or "", most)
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
        from mfd_bayes.pipeline import plan as pipeline

        if building:
            target = pipeline.init_building(folder, force=force)
            say(f"{target} and an artificial ground.AT2 written: change what is in them")
            say("look next: mfd-bayes respond --help")
            return
        if folder.suffix == ".toml":
            written, named = pipeline.init_priors(folder, force=force)
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
        if draft.own:
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
        from mfd_bayes.pipeline import plan as pipeline

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
        from mfd_bayes.pipeline import plan as pipeline

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
