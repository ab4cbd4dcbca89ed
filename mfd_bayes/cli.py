"""The command line: arguments, progress and exit codes."""

from __future__ import annotations

import errno
import os
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from enum import StrEnum
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from mfd_bayes import console
from mfd_bayes.interruption import end_on_signals, hinting

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Bayesian calibration, with honest uncertainty, of variable-friction dampers with a gap.",
)


class EffortName(StrEnum):
    """How far a sampling goes."""

    quick = "quick"
    standard = "standard"
    thorough = "thorough"


class Kind(StrEnum):
    """What a band holds."""

    device = "device"
    new_test = "new_test"
    observation = "observation"


Out = Annotated[Path, typer.Argument(help="The run folder.")]
Campaign = Annotated[Path, typer.Argument(help="The campaign file, campaign.toml.")]
Jobs = Annotated[int, typer.Option(min=0, help="Processes; 0 for one a processor.")]
Seed = Annotated[int, typer.Option(min=0, help="The same seed gives the same draws.")]
Force = Annotated[bool, typer.Option("--force", help="Replace a run that is there.")]


@contextmanager
def _mistakes(resume: str = "") -> Iterator[None]:
    """Turn errors that a user can cause into one sentence and exit code 2.

    Parameters
    ----------
    resume : str
        The command that goes on where this one is interrupted.
    """
    from mfd_bayes.errors import MfdError

    try:
        with hinting(f"; what is finished is kept, go on with: {resume}" if resume else ""):
            yield
    except MfdError as error:
        _fail(str(error))
    except OSError as error:
        if error.errno == errno.EPIPE:  # whoever read the output has enough
            raise
        _fail(f"cannot write {error.filename or 'the output'}: {error.strerror or error}")


def _fail(sentence: str) -> NoReturn:
    with suppress(OSError):
        typer.echo(f"mfd-bayes: {sentence}", err=True)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:  # a full disk, and Python would complain of it once more at its end
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    raise typer.Exit(2)


@app.command()
def demo(
    out: Out,
    quick: Annotated[bool, typer.Option("--quick", help="A look in about a minute.")] = False,
    jobs: Jobs = 0,
    seed: Seed = 1,
    force: Force = False,
) -> None:
    """Calibrate a synthetic campaign after the MFD paper's test matrix.

    Writes its CSV files under OUT/campaign, calibrates them, writes OUT/report.html and
    compares the posterior with the stated truth.

    Example: mfd-bayes demo out --quick
    """
    effort = "quick" if quick else "standard"
    resume = ["mfd-bayes", "calibrate", str(out / "campaign" / "campaign.toml"), "-o", str(out)]
    resume += ["--effort", effort, "--seed", str(seed), "--resume"]
    with _mistakes(shlex.join(resume)):
        from mfd_bayes import pipeline

        options = pipeline.Options(effort, seed, jobs, force=force, command=_command())
        with console.watch() as observe:
            view = pipeline.demo(out, options, observe)
        console.print_truth(view)
        console.print_end(view, out)


@app.command()
def calibrate(
    campaign: Campaign,
    out: Annotated[Path, typer.Option("-o", "--out", help="The run folder to make.")],
    resume: Annotated[bool, typer.Option("--resume", help="Finish a run that is there.")] = False,
    force: Force = False,
    jobs: Jobs = 0,
    seed: Seed = 1,
    effort: Annotated[EffortName, typer.Option(help="How far to sample.")] = EffortName.standard,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Read and check only.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Exit 1 if a check fails.")] = False,
) -> None:
    """Calibrate every test of a campaign, infer the laws, and write the report.

    Example: mfd-bayes calibrate campaign.toml -o out
    """
    with _mistakes("" if dry_run else _resumption()):
        from mfd_bayes import pipeline

        options = pipeline.Options(effort.value, seed, jobs, resume, force, _command())
        if dry_run:
            plan = pipeline.plan_campaign(campaign, options)
            samples = ", ".join(f"{task.id} ({task.trace.samples} samples)" for task in plan.tasks)
            typer.echo(f"{campaign} is fine: would calibrate {samples}")
            typer.echo(f"and predict {', '.join(plan.held_out) or 'nothing'}; nothing was written")
            return
        with console.watch() as observe:
            view = pipeline.calibrate_campaign(campaign, out, options, observe)
        console.print_end(view, out)
    if strict and pipeline.fails(view):
        raise typer.Exit(1)


@app.command()
def crossvalidate(
    campaign: Campaign,
    out: Annotated[Path, typer.Option("-o", "--out", help="The run folder to make.")],
    by: Annotated[str, typer.Option(metavar="test|level|session", help="What a part is.")] = "test",
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a run.")] = False,
    force: Force = False,
    jobs: Jobs = 0,
    seed: Seed = 1,
    effort: Annotated[EffortName, typer.Option(help="How far to sample.")] = EffortName.standard,
) -> None:
    """Predict every part of a campaign from all the others, and score the predictions.

    Calibrates the campaign first; with --resume it takes the posteriors that OUT has. Then it
    leaves out one test, level of actuation or session after another, infers the population of
    the others, and writes OUT/crossvalidation.csv and the report.

    Example: mfd-bayes crossvalidate campaign.toml -o out --by level --resume
    """
    with _mistakes(_resumption()):
        from mfd_bayes import pipeline

        options = pipeline.Options(effort.value, seed, jobs, resume, force, _command())
        with console.watch() as observe:
            view = pipeline.crossvalidate(campaign, out, by, options, observe)
        console.print_left_out(view)
        console.print_end(view, out)


@app.command()
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
    seed: Seed = 1,
    effort: Annotated[EffortName, typer.Option(help="How far to sample.")] = EffortName.standard,
) -> None:
    """Calibrate a campaign under several models and say which one its records favour.

    Makes a run folder OUT/MODEL of each, and OUT/comparison.csv: how well each model predicts
    every cycle of a record from all others (PSIS-LOO). The campaign's own model does not count.

    Example: mfd-bayes compare campaign.toml -o out --models three_stage,lugre
    """
    with _mistakes(_resumption()):
        from mfd_bayes import pipeline

        names = [name.strip() for name in models.split(",") if name.strip()]
        options = pipeline.Options(effort.value, seed, jobs, resume, force, _command())
        with console.watch() as observe:
            found, left_out = pipeline.compare(campaign, out, names, options, observe, by)
        console.print_comparison(found)
        for model, view in left_out.items():
            typer.echo(f"{model}: {view.sentence} Mean CRPS {view.mean.crps:.3f} kip.")
        typer.echo(f"look next at {out / 'comparison.csv'}")


@app.command()
def report(out: Out) -> None:
    """Remake the report, tables and figures of a run from what is stored, without sampling.

    Example: mfd-bayes report out
    """
    with _mistakes(_command()):
        from mfd_bayes import pipeline

        with console.watch() as observe:
            view = pipeline.report(out, observe)
        console.print_end(view, out)


@app.command()
def predict(
    out: Out,
    motion: Annotated[Path, typer.Option(help="A file with time_s and displacement_in, …")],
    actuation: Annotated[str, typer.Option(help='Such as "1000 psi".')],
    bands: Annotated[Path, typer.Option("-o", "--out", help="CSV to write; a PNG beside it.")],
    kind: Annotated[Kind, typer.Option(help="What the band holds.")] = Kind.new_test,
    probability: Annotated[float, typer.Option(help="Of the equal-tailed band.")] = 0.95,
) -> None:
    """Predict the force of a motion at an actuation, tested or not.

    Example: mfd-bayes predict out --motion quake.csv --actuation "1000 psi" -o bands.csv
    """
    from mfd_bayes import pipeline

    question = pipeline.Question(motion, actuation, kind.value, probability, bands)
    with _mistakes():
        band, derived = pipeline.predict(out, question)
    typer.echo(
        f"{band.interval} {100 * band.probability:g} % band of kind {band.kind}, from "
        f"{band.source}: {bands} and {bands.with_suffix('.png')}"
    )
    console.print_derived(derived, band.probability)
    typer.echo(f"look next at {question.derived}")


@app.command()
def check(out: Out) -> None:
    """Show convergence and predictive checks as a table; exit 1 where one fails.

    Example: mfd-bayes check out
    """
    from mfd_bayes import pipeline

    with _mistakes():
        view = pipeline.check(out)
    console.print_checks(view)
    typer.echo(view.sentence)
    if pipeline.fails(view):
        raise typer.Exit(1)


@app.command()
def inspect(
    file: Annotated[Path, typer.Argument(help="A test file or a campaign.toml.")],
    folder: Annotated[Path, typer.Option("-o", "--out", help="Folder of the PNG.")] = Path(),
) -> None:
    """Show what was read: columns, units, rate, turning points, loops; and draw it.

    Example: mfd-bayes inspect test.csv
    """
    from mfd_bayes import pipeline

    with _mistakes():
        found = pipeline.inspect(file, folder)
    for inspection, picture in found:
        typer.echo(inspection.name)
        for key, fact in inspection.facts.items():
            typer.echo(f"  {key:21s}{fact}")
        typer.echo(f"  {'picture':21s}{picture}")


@app.command()
def prior_check(
    campaign: Campaign,
    folder: Annotated[Path, typer.Option("-o", "--out", help="Folder of the PNGs.")] = Path(),
) -> None:
    """Draw what the priors allow beside the data of every test.

    Example: mfd-bayes prior-check campaign.toml
    """
    from mfd_bayes import pipeline

    with _mistakes():
        found = pipeline.prior_check(campaign, folder)
    for name, share, picture in found:
        typer.echo(f"{name}: {share:.0%} of the force inside the 95 % prior band; {picture}")


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


def _command() -> str:
    return shlex.join(["mfd-bayes", *sys.argv[1:]])


def _resumption() -> str:
    """The command that goes on where this one is interrupted."""
    given = [word for word in sys.argv[1:] if word not in ("--force", "--resume")]
    return shlex.join(["mfd-bayes", *given, "--resume"])


def main() -> None:
    """Run the command line."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # numpy is not there yet; the matrices here are small
    with end_on_signals():
        app()
