"""The command line: arguments, progress and exit codes."""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mfd_bayes.cli import console, progress
from mfd_bayes.cli.arguments import (
    Campaign,
    Effort,
    Force,
    Jobs,
    Kind,
    Out,
    Quiet,
    Scheduler,
    Seed,
)
from mfd_bayes.cli.exits import mistakes, resumption, this_command
from mfd_bayes.jobs.signals import end_on_signals

if TYPE_CHECKING:
    from mfd_bayes.pipeline import commands as pipeline

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",  # keeps the lines of examples apart
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Bayesian calibration, with honest uncertainty, of variable-friction dampers with a gap.",
    epilog="New here? mfd-bayes demo out --quick takes about a minute; each command has --help.",
)


_LOOK, _FIT, _USE, _TRY = (
    "Look at your data",
    "Calibrate",
    "Predict and compare",
    "See it work on synthetic data",
)
"""Commands in the order of work."""


@app.command(
    rich_help_panel=_LOOK,
    epilog="Next: mend what is marked in campaign.toml, then mfd-bayes inspect campaign.toml",
)
def init(
    folder: Annotated[Path, typer.Argument(help="The folder of your test files.")],
    force: Annotated[
        bool, typer.Option("--force", help="Replace a campaign.toml that is there.")
    ] = False,
) -> None:
    """Write a first campaign.toml for a folder of test files.

    Guesses columns, units, actuations and ids from the names and numbers of the
    files; what is not certain is marked "unsure" in the file, with the
    alternatives, and what is missing "FIXME". Writes FOLDER/campaign.toml.

    Example:
      mfd-bayes init tests
      mfd-bayes init tests --force
    """
    from mfd_bayes.pipeline import commands as pipeline

    with mistakes():
        path, draft = pipeline.init(folder, force=force)
    for name, reason in draft.left_out:
        console.say(f"left out: {name}: {reason}")
    for doubt in pipeline.doubts(draft):
        console.say(f"unsure: {doubt}")
    missing = pipeline.gaps(draft)
    for gap in missing:
        console.say(f"FIXME: {gap}")
    left_out = f"{len(draft.left_out)} left out" if draft.left_out else "none left out"
    console.say(f"{path} written: tests {len(draft.tests)}, {left_out}")
    if missing:
        console.say("warning: complete what is marked FIXME before you calibrate")
    else:
        console.say(f"look next: {shlex.join(['mfd-bayes', 'inspect', str(path)])}")


@app.command(
    rich_help_panel=_LOOK,
    epilog="Next: mfd-bayes prior-check campaign.toml, or mfd-bayes calibrate --help",
)
def inspect(
    file: Annotated[Path, typer.Argument(help="A test file or a campaign.toml.")],
    folder: Annotated[Path, typer.Option("-o", "--out", help="Folder of the PNG.")] = Path(),
) -> None:
    """Show what was read, warn of what would spoil a fit, and draw it.

    Columns, units, rate, peaks, cycles, energy and drifts; then warnings: swapped
    signs, lags, clipping, spikes, lost samples and the like. Warnings are no errors.

    Writes a PNG of every test: NAME_inspect.png, here or in the folder of -o.

    Example:
      mfd-bayes inspect test.csv
      mfd-bayes inspect campaign.toml -o looks
    """
    from mfd_bayes.pipeline import commands as pipeline

    with mistakes():
        found = pipeline.inspect(file, folder)
    for inspection, picture in found:
        console.say(inspection.name)
        for key, fact in inspection.facts.items():
            console.say(f"  {key:21s}{fact}")
        for fault in inspection.faults:
            console.say(f"  {'warning':21s}{fault.name}: {fault.sentence}")
        console.say(f"  {'picture':21s}{picture}")


@app.command(rich_help_panel=_LOOK, epilog="Next: mfd-bayes calibrate campaign.toml -o out")
def prior_check(
    campaign: Campaign,
    folder: Annotated[Path, typer.Option("-o", "--out", help="Folder of the PNGs.")] = Path(),
) -> None:
    """Draw what the priors allow beside the data of every test.

    Where most of a test's force lies outside the band, mend the priors before
    calibrating. Writes a PNG of every test: CAMPAIGN_ID_prior.png, here or in
    the folder of -o.

    Example:
      mfd-bayes prior-check campaign.toml
      mfd-bayes prior-check campaign.toml -o looks
    """
    from mfd_bayes.pipeline import commands as pipeline

    with mistakes():
        found = pipeline.prior_check(campaign, folder)
    for name, share, picture in found:
        console.say(f"{name}: {share:.0%} of the force inside the 95 % prior band; {picture}")


@app.command(rich_help_panel=_FIT, epilog="Next: open out/report.html, then mfd-bayes check out")
def calibrate(
    campaign: Campaign,
    out: Annotated[Path, typer.Option("-o", "--out", help="The run folder to make.")],
    resume: Annotated[bool, typer.Option("--resume", help="Finish a run that is there.")] = False,
    force: Force = False,
    jobs: Jobs = 0,
    scheduler: Scheduler = "",
    seed: Seed = 1,
    effort: Effort = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Read and check only.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Exit 1 if a check fails.")] = False,
    quiet: Quiet = False,
) -> None:
    """Calibrate every test of a campaign, infer the laws, and write the report.

    Writes the run folder OUT: report.html, tables of parameters and laws (CSV,
    JSON, LaTeX), checks.csv, pictures, and a posterior.nc of every test, which
    ArviZ opens. Ctrl-C loses nothing that is finished: --resume goes on.

    Example:
      mfd-bayes calibrate campaign.toml -o out --dry-run
      mfd-bayes calibrate campaign.toml -o out
      mfd-bayes calibrate campaign.toml -o out --resume
    """
    with mistakes("" if dry_run else resumption()):
        from mfd_bayes.pipeline import commands as pipeline

        options = _options(out, effort, seed, jobs, scheduler, resume=resume, force=force)
        if dry_run:
            plan = pipeline.plan_campaign(campaign, options)
            samples = ", ".join(f"{task.id} ({task.trace.samples} samples)" for task in plan.tasks)
            console.say(f"{campaign} is fine: would calibrate {samples}")
            console.say(f"and predict {', '.join(plan.held_out) or 'nothing'}; nothing was written")
            for name, sentence in pipeline.find_warnings(plan):
                console.say(f"warning: {name}: {sentence}")
            return
        with progress.watch(quiet=quiet) as observe:
            view = pipeline.calibrate_campaign(campaign, out, options, observe)
        console.print_end(view, out, quiet=quiet)
    if strict and pipeline.fails(view):
        raise typer.Exit(1)


@app.command(
    rich_help_panel=_FIT,
    epilog="Next: mfd-bayes predict --help, or mfd-bayes calibrate --help if a check failed",
)
def check(
    out: Out,
    every: Annotated[bool, typer.Option("--all", help="Show those that passed too.")] = False,
    quiet: Quiet = False,
) -> None:
    """Show convergence and predictive checks as a table; exit 1 where one fails.

    One line sums up each kind of check of each test, and what did not pass stands
    in full; --all shows every one. Writes nothing; OUT/checks.csv holds them all.

    Example:
      mfd-bayes check out
      mfd-bayes check out --all
      mfd-bayes check out --quiet && echo fit to use
    """
    from mfd_bayes.pipeline import commands as pipeline

    with mistakes():
        view = pipeline.check(out)
    if not quiet:
        console.print_checks(view, every=every)
    console.say(view.sentence)
    if pipeline.fails(view):
        raise typer.Exit(1)


@app.command(rich_help_panel=_FIT, epilog="Next: open out/report.html, then mfd-bayes check out")
def report(
    out: Out,
    quiet: Quiet = False,
    pdf: Annotated[bool, typer.Option("--pdf", help="Print it too; needs a Chromium.")] = False,
) -> None:
    """Remake the report, tables and figures of a run from what is stored, without sampling.

    Writes OUT/report.html, the tables beside it, OUT/figures and the pictures
    of every test; with --pdf OUT/report.pdf too.

    Example:
      mfd-bayes report out
      mfd-bayes report out --pdf
    """
    with mistakes(this_command()):
        from mfd_bayes.pipeline import commands as pipeline

        with progress.watch(quiet=quiet) as observe:
            view = pipeline.report(out, observe, pdf=pdf)
        console.print_end(view, out, quiet=quiet)


@app.command(
    rich_help_panel=_USE, epilog="Next: look at bands.png, then mfd-bayes crossvalidate --help"
)
def predict(
    out: Out,
    motion: Annotated[Path, typer.Option(help="A file with time_s and displacement_in, …")],
    actuation: Annotated[str, typer.Option(help='Such as "1000 psi".')],
    bands: Annotated[Path, typer.Option("-o", "--out", help="CSV to write; a PNG beside it.")],
    kind: Annotated[Kind, typer.Option(help="What the band holds.")] = Kind.new_test,
    probability: Annotated[float, typer.Option(help="Of the equal-tailed band.")] = 0.95,
    compare: Annotated[
        bool, typer.Option("--compare", help="Show the force that the motion's file holds beside.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Predict the force of a motion at an actuation, tested or not.

    Writes the band as CSV where -o says, a PNG beside it, and what derives from
    the force, such as energy and peaks, as ..._derived.csv. Where the actuation
    was never tested, or the run did not pass its checks, it warns.

    Example:
      mfd-bayes predict out --motion quake.csv --actuation "1000 psi" -o bands.csv
    """
    from mfd_bayes.pipeline import commands as pipeline

    question = pipeline.Question(motion, actuation, kind.value, probability, bands, compare)
    with mistakes():
        band, derived = pipeline.predict(out, question)
    for remark in band.remarks:
        console.say(f"warning: {remark}", err=True)
    console.say(
        f"{band.interval} {100 * band.probability:g} % band of kind {band.kind}, from "
        f"{band.source}: {bands} and {bands.with_suffix('.png')}"
    )
    if quiet:
        return
    console.print_derived(derived, band.probability)
    console.say(f"look next at {question.derived}")


@app.command(
    rich_help_panel=_USE, epilog="Next: open out/report.html, then mfd-bayes compare --help"
)
def crossvalidate(
    campaign: Campaign,
    out: Annotated[Path, typer.Option("-o", "--out", help="The run folder to make.")],
    by: Annotated[str, typer.Option(metavar="test|level|session", help="What a part is.")] = "test",
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a run.")] = False,
    force: Force = False,
    jobs: Jobs = 0,
    scheduler: Scheduler = "",
    seed: Seed = 1,
    effort: Effort = None,
    quiet: Quiet = False,
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
        from mfd_bayes.pipeline import commands as pipeline

        options = _options(out, effort, seed, jobs, scheduler, resume=resume, force=force)
        with progress.watch(quiet=quiet) as observe:
            view = pipeline.crossvalidate(campaign, out, by, options, observe)
        console.print_left_out(view, quiet=quiet)
        console.print_end(view, out, quiet=quiet)


@app.command(
    rich_help_panel=_USE, epilog="Next: open out/MODEL/report.html of the model that is favoured"
)
def compare(
    campaign: Campaign,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder of one run for each model.")],
    models: Annotated[
        str, typer.Option(help="Two or more, with commas between them.")
    ] = "three_stage,lugre,bouc_wen",
    by: Annotated[
        str, typer.Option(help="Leave out each test, level or session of each model's run too.")
    ] = "",
    resume: Annotated[bool, typer.Option("--resume", help="Finish runs that are there.")] = False,
    force: Force = False,
    jobs: Jobs = 0,
    scheduler: Scheduler = "",
    seed: Seed = 1,
    effort: Effort = None,
    quiet: Quiet = False,
) -> None:
    """Calibrate a campaign under several models and say which one its records favour.

    Writes a run folder OUT/MODEL of each, and OUT/comparison.csv: how well each
    model predicts every cycle of a record from all others (PSIS-LOO). The
    campaign's own model does not count.

    Example:
      mfd-bayes compare campaign.toml -o out
      mfd-bayes compare campaign.toml -o out --models three_stage,lugre
    """
    with mistakes(resumption()):
        from mfd_bayes.pipeline import commands as pipeline

        names = [name.strip() for name in models.split(",") if name.strip()]
        options = _options(out, effort, seed, jobs, scheduler, resume=resume, force=force)
        with progress.watch(quiet=quiet) as observe:
            found, left_out = pipeline.compare(campaign, out, names, options, observe, by)
        console.print_comparison(found, quiet=quiet)
        for model, view in left_out.items():
            console.say(f"{model}: {view.sentence} Mean CRPS {view.mean.crps:.3f} kip.")
        if not quiet:
            console.say(f"look next at {out / 'comparison.csv'}")


@app.command(
    rich_help_panel=_TRY,
    epilog="Next: open out/report.html, then mfd-bayes inspect test.csv with a file of yours",
)
def demo(
    out: Out,
    quick: Annotated[bool, typer.Option("--quick", help="A look in about a minute.")] = False,
    jobs: Jobs = 0,
    scheduler: Scheduler = "",
    seed: Seed = 1,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Calibrate a synthetic campaign after the MFD paper's test matrix.

    Writes its CSV files and campaign.toml under OUT/campaign, which are a
    pattern for your own, calibrates them, writes OUT/report.html and compares
    the posterior with the stated truth.

    Example:
      mfd-bayes demo out --quick
    """
    effort = "quick" if quick else "standard"
    resume = ["mfd-bayes", "calibrate", str(out / "campaign" / "campaign.toml"), "-o", str(out)]
    resume += ["--effort", effort, "--seed", str(seed), "--resume"]
    resume += ["--scheduler", scheduler] if scheduler else []
    with mistakes(shlex.join(resume)):
        from mfd_bayes.pipeline import commands as pipeline

        options = pipeline.Options(
            effort=effort,
            seed=seed,
            jobs=jobs,
            force=force,
            command=this_command(),
            scheduler=scheduler,
        )
        with progress.watch(quiet=quiet) as observe:
            view = pipeline.demo(out, options, observe)
        console.print_truth(view, quiet=quiet)
        console.print_end(view, out, quiet=quiet)


def _options(
    out: Path,
    effort: str | None,
    seed: int,
    jobs: int,
    scheduler: str,
    *,
    resume: bool,
    force: bool,
) -> pipeline.Options:
    """Options of a command that calibrates into a folder; a run that is resumed has its effort."""
    from mfd_bayes.pipeline import commands as pipeline

    chosen = pipeline.effort_of(out, effort, resume=resume)
    return pipeline.Options(
        effort=chosen,
        seed=seed,
        jobs=jobs,
        resume=resume,
        force=force,
        command=this_command(),
        scheduler=scheduler,
    )


def _version(wanted: bool) -> None:
    if wanted:
        from mfd_bayes import __version__

        typer.echo(f"mfd-bayes {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show it.")
    ] = False,
) -> None:
    """Bayesian calibration, with honest uncertainty, of variable-friction dampers with a gap."""


def main() -> None:
    """Run the command line."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # numpy is not there yet; the matrices here are small
    with end_on_signals():
        app()
