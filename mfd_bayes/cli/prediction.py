"""The commands that predict and compare: predict, crossvalidate, compare."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mfd_bayes.cli import arguments, console, progress
from mfd_bayes.cli.exits import mistakes, resumption


def predict(
    out: arguments.Run,
    motion: Annotated[
        Path,
        typer.Option(parser=arguments.path, help="A file with time_s and displacement_in, …"),
    ],
    actuation: Annotated[str, typer.Option(help='Such as "1000 psi".')],
    bands: Annotated[
        Path,
        typer.Option("-o", "--out", parser=arguments.path, help="CSV to write; a PNG beside it."),
    ],
    kind: arguments.Kind = "new_test",
    probability: Annotated[
        float, typer.Option(help="Probability of the equal-tailed band.")
    ] = 0.95,
    compare: Annotated[
        bool, typer.Option("--compare", help="Show the force in the motion's file beside it.")
    ] = False,
    test: Annotated[
        str, typer.Option(metavar="ID", help="The calibrated test, for --kind this_test.")
    ] = "",
    whole: Annotated[
        bool, typer.Option("--whole", help="Add a band that holds the whole history.")
    ] = False,
    recalibrate: Annotated[
        bool, typer.Option("--recalibrate", help="Widen it by tests that were left out.")
    ] = False,
    explain: Annotated[
        bool, typer.Option("--explain", help="Say what makes the band wide.")
    ] = False,
    force: arguments.Replace = False,
    quiet: arguments.Quiet = False,
) -> None:
    """Predict the force of a motion at an actuation, tested or not.

    Writes the band as CSV where -o says, a PNG beside it, and what derives from
    the force, such as energy and peaks, as ..._derived.csv. Where the actuation
    was never tested, or the run is not usable, it warns. --recalibrate
    is for --kind observation and needs a run of crossvalidate; --explain takes
    some seconds.

    Example:
      mfd-bayes predict out --motion quake.csv --actuation "1000 psi" -o bands.csv
      mfd-bayes predict out --motion quake.csv --actuation "1 ksi" -o b.csv --explain
    """
    from mfd_bayes.pipeline import commands as pipeline

    asked = (motion, actuation, kind, probability, bands)
    question = pipeline.Question(*asked, compare, test, whole, recalibrate, explain, force)
    with mistakes():
        band, derived = pipeline.predict(out, question)
    for remark in band.remarks:
        console.say(f"warning: {remark}", err=True)
    console.say(
        f"{band.interval} {console.in_percent(band.probability)} % band of kind {band.kind}, from "
        f"{band.source}: {bands} and {bands.with_suffix('.png')}"
    )
    if band.shares:
        console.print_shares(band.shares, quiet=quiet)
    if not quiet:
        console.print_derived(derived, band.probability)
        console.say(f"look next at {question.derived}")


def crossvalidate(
    campaign: arguments.Campaign,
    out: arguments.NewRun,
    by: Annotated[
        str, typer.Option(metavar="test|level|session", help="What to leave out in turn.")
    ] = "test",
    resume: arguments.Resume = False,
    force: arguments.Force = False,
    jobs: arguments.Jobs = 0,
    scheduler: arguments.Scheduler = "",
    seed: arguments.Seed = 1,
    effort: arguments.Effort = None,
    quiet: arguments.Quiet = False,
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

        options = arguments.completed(
            pipeline.Options(
                seed=seed, jobs=jobs, scheduler=scheduler, resume=resume, force=force, by=by
            ),
            out,
            effort,
        )
        with progress.watch(quiet=quiet) as observe:
            view = pipeline.crossvalidate(campaign, out, options, observe)
        console.print_left_out(view.left_out, quiet=quiet)
        console.print_end(view, out, quiet=quiet)
    if not pipeline.is_whole(view):
        raise typer.Exit(1)


def compare(
    campaign: arguments.Campaign,
    out: Annotated[
        Path,
        typer.Option(
            "-o", "--out", parser=arguments.path, help="Folder of one run for each model."
        ),
    ],
    models: Annotated[
        str, typer.Option(help="Two or more, with commas between them.")
    ] = "three_stage,lugre,bouc_wen",
    by: Annotated[
        str, typer.Option(help="Leave out each test, level or session of each model's run too.")
    ] = "",
    resume: arguments.Resume = False,
    force: arguments.Force = False,
    jobs: arguments.Jobs = 0,
    scheduler: arguments.Scheduler = "",
    seed: arguments.Seed = 1,
    effort: arguments.Effort = None,
    quiet: arguments.Quiet = False,
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
        options = arguments.completed(
            pipeline.Options(
                seed=seed, jobs=jobs, scheduler=scheduler, resume=resume, force=force, by=by
            ),
            out,
            effort,
        )
        with progress.watch(quiet=quiet) as observe:
            found, left_out = pipeline.compare(campaign, out, names, options, observe)
        console.print_comparison(found, quiet=quiet)
        for model, view in left_out.items():
            console.say(f"{model}: {view.sentence} Mean CRPS {view.mean.crps:.3f} kip.")
        if not quiet:
            console.say(f"look next at {out / 'comparison.csv'}")
