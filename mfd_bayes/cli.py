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
from typing import Annotated, Any, NoReturn

import typer

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


def _console() -> Any:
    from rich.console import Console

    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=110)


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
        with _watch() as observe:
            view = pipeline.demo(out, options, observe)
        _print_truth(view)
        _print_end(view, out)


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
        with _watch() as observe:
            view = pipeline.calibrate_campaign(campaign, out, options, observe)
        _print_end(view, out)
    if strict and pipeline.fails(view):
        raise typer.Exit(1)


@app.command()
def report(out: Out) -> None:
    """Remake the report, tables and figures of a run from what is stored, without sampling.

    Example: mfd-bayes report out
    """
    with _mistakes(_command()):
        from mfd_bayes import pipeline

        with _watch() as observe:
            view = pipeline.report(out, observe)
        _print_end(view, out)


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
        band = pipeline.predict(out, question)
    typer.echo(
        f"{band.interval} {100 * band.probability:g} % band of kind {band.kind}, from "
        f"{band.source}: {bands} and {bands.with_suffix('.png')}"
    )


@app.command()
def check(out: Out) -> None:
    """Show convergence and predictive checks as a table; exit 1 where one fails.

    Example: mfd-bayes check out
    """
    from mfd_bayes import pipeline

    with _mistakes():
        view = pipeline.check(out)
    _print_checks(view)
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


@contextmanager
def _watch() -> Iterator[Any]:
    """Show steps as bars on a terminal, as lines elsewhere."""
    console = _console()
    if not console.is_terminal:
        yield lambda step: typer.echo(_line(step))
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[news]}"))
    with Progress(*columns, TimeElapsedColumn(), console=console) as bars:
        shown: dict[str, Any] = {}

        def observe(step: Any) -> None:
            if step.id not in shown:
                shown[step.id] = bars.add_task(step.id, total=1.0, news="")
            done = step.stage == "done"
            share = 0.0 if step.progress is None else step.progress.steps / step.progress.limit
            bars.update(shown[step.id], completed=1.0 if done else share, news=_news(step))

        yield observe


def _news(step: Any) -> str:
    """What a step says, in a line."""
    progress = step.progress
    if progress is None:
        return f"{step.stage} {step.message}".strip()
    rate = progress.steps / max(progress.seconds, 1e-9)
    left = (progress.limit - progress.steps) / rate
    text = f"{step.stage}, {progress.steps} steps, R-hat {progress.r_hat:.3f}, "
    text += f"ESS {progress.ess:.0f}, {rate:.0f} steps/s"
    return text if step.stage == "done" else f"{text}, at most {left:.0f} s left"


def _line(step: Any) -> str:
    return f"{step.id}: {_news(step)}"


def _print_truth(view: Any) -> None:
    from rich.table import Table

    table = Table(title="Truth against posterior (95 % equal-tailed interval)")
    for name in ("test", "quantity", "unit", "truth", "2.5 %", "50 %", "97.5 %", "inside", "data"):
        table.add_column(name)
    for row in view.truth:
        figures = (f"{x:.4g}" for x in (row.truth, row.lower, row.median, row.upper))
        informed = "informed" if row.informed else "prior only"
        inside = "yes" if row.inside else "NO"
        table.add_row(row.subject, row.name, row.unit, *figures, inside, informed)
    _console().print(table)
    known = [row for row in view.truth if row.informed]
    hits = sum(row.inside for row in known)
    typer.echo(
        f"truth inside the 95 % interval for {hits} of {len(known)} quantities that the "
        f"data inform ({hits / max(len(known), 1):.1%})"
    )


def _print_checks(view: Any) -> None:
    from rich.table import Table

    table = Table(title="Checks")
    for name in ("subject", "check", "target", "value", "limit", "verdict"):
        table.add_column(name, overflow="fold")
    for c in view.checks:
        table.add_row(c.subject, c.name, c.target, f"{c.value:.4g}", c.limit, c.verdict)
    _console().print(table)


def _print_end(view: Any, out: Path) -> None:
    typer.echo(f"{view.verdict.upper()}: {view.sentence}")
    typer.echo(f"look next at {out / 'report.html'}")


def main() -> None:
    """Run the command line."""
    with end_on_signals():
        app()
