"""The commands that predict and compare: predict, crossvalidate, compare."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mfd_bayes.cli import arguments, console, progress
from mfd_bayes.cli.exits import mistakes, resumption

if TYPE_CHECKING:
    from mfd_bayes.pipeline.prediction import Answer
    from mfd_bayes.pipeline.question import Question

_COMPARED = "three_stage,lugre,bouc_wen,backlash"


def predict(
    out: arguments.Run,
    actuation: Annotated[str, typer.Option(help='Such as "1000 psi".')],
    bands: Annotated[
        Path,
        typer.Option("-o", "--out", parser=arguments.path, help="CSV to write; PNGs beside it."),
    ],
    motion: Annotated[
        Path | None,
        typer.Option(parser=arguments.path, help="A file with time_s and displacement_in, …"),
    ] = None,
    sine: Annotated[
        str, typer.Option(help='A harmonic motion instead: "1 in, 0.5 Hz, 3 cycles".')
    ] = "",
    kind: arguments.Kind = "new_test",
    probability: Annotated[
        float, typer.Option(help="Probability of the equal-tailed band.")
    ] = 0.95,
    compare: Annotated[
        bool, typer.Option("--compare", help="Compare with the force in the motion's file.")
    ] = False,
    test: Annotated[
        str, typer.Option(metavar="ID", help="The calibrated test, for --kind this_test.")
    ] = "",
    whole: Annotated[
        bool, typer.Option("--whole", help="Add a band that holds the whole history.")
    ] = False,
    explain: Annotated[
        bool, typer.Option("--explain", help="Say what makes the band wide.")
    ] = False,
    design: Annotated[
        bool, typer.Option("--design", help="Print mean and bounding properties with λ factors.")
    ] = False,
    extrapolate: Annotated[
        bool, typer.Option("--extrapolate", help="Predict also far outside of the tested range.")
    ] = False,
    rate: Annotated[
        str, typer.Option(metavar='"64 Hz"', help="Thin the motion; else every sample is kept.")
    ] = "",
    given: Annotated[
        str,
        typer.Option(
            metavar='"0 s to 3 s"',
            help="The time in which the file's force is used.",
        ),
    ] = "",
    after: Annotated[
        str,
        typer.Option(metavar="ID", help="The test before, where the device was not reset."),
    ] = "",
    others: Annotated[
        list[Path] | None,
        typer.Option(
            "--with",
            metavar="OUT",
            parser=arguments.path,
            help="Predict together with this run of another model; may be repeated.",
        ),
    ] = None,
    force: arguments.Replace = False,
    units: arguments.Units = None,
    quiet: arguments.Quiet = False,
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
    from mfd_bayes.pipeline import commands as pipeline

    question = pipeline.Question(
        motion,
        actuation,
        kind,
        probability,
        bands,
        compare=compare,
        test=test,
        whole=whole,
        explain=explain,
        extrapolate=extrapolate,
        sine=sine,
        rate=rate,
        units=units or "",
        design=design,
        force=force,
        given=given,
        after=after,
        others=tuple(others or ()),
    )
    with mistakes():
        answer = pipeline.predict(out, question)
    _tell(answer, question, quiet=quiet)


def _tell(answer: Answer, question: Question, *, quiet: bool) -> None:
    """Print what a prediction found, and where its tables are."""
    band = answer.band
    for remark in band.remarks:
        console.say(f"warning: {remark}", err=True)
    console.say(
        f"{band.interval} {console.in_percent(band.probability)} % band of kind {band.kind} "
        f"({answer.name}), from {band.source}: {question.bands} and {question.picture}"
    )
    if answer.compared is not None:
        console.say(answer.compared.sentence(answer.system))
        if answer.disagrees:
            console.say(f"warning: {answer.judged}", err=True)
        elif answer.judged:
            console.say(answer.judged)
    if band.explained:
        console.print_shares(band.explained, quiet=quiet)
    if answer.design:
        console.print_design(answer.design)
    if not quiet:
        console.print_derived(answer.derived, band.probability)
        console.say(f"look next at {question.beside('derived.csv')}")


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
        console.print_left_out(*pipeline.left_out_shown(view), quiet=quiet)
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
        str | None,
        typer.Option(help="Two or more, with commas between them.", show_default=_COMPARED),
    ] = None,
    noises: Annotated[
        str,
        typer.Option(help="Compare noises too, or alone: such as ou,iid,staged."),
    ] = "",
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
    """Calibrate a campaign under several models or noises; say which one its records favour.

    Writes a run folder OUT/MODEL of each, and OUT/comparison.csv: how well each
    model predicts every cycle of a record from all others (PSIS-LOO). The
    campaign's own model does not count. With --noises alone the campaign's model
    is calibrated with each noise, into OUT/NOISE; with both options each model
    with each noise, into OUT/MODEL_NOISE.

    Example:
      mfd-bayes compare campaign.toml -o out
      mfd-bayes compare campaign.toml -o out --models three_stage,lugre
      mfd-bayes compare campaign.toml -o out --noises ou,iid,staged
    """
    with mistakes(resumption()):
        from mfd_bayes.pipeline import commands as pipeline

        if models is None:
            models = "" if noises else _COMPARED
        names, others = (
            [name.strip() for name in text.split(",") if name.strip()] for text in (models, noises)
        )
        options = arguments.completed(
            pipeline.Options(
                seed=seed,
                jobs=jobs,
                scheduler=scheduler,
                resume=resume,
                force=force,
                by=by,
                noises=tuple(others),
            ),
            out,
            effort,
        )
        with progress.watch(quiet=quiet) as observe:
            found, left_out = pipeline.compare(campaign, out, names, options, observe)
        console.print_comparison(found, quiet=quiet)
        for model, (view, unit) in left_out.items():
            console.say(f"{model}: {view.sentence} Mean CRPS {view.mean.crps:.3f} {unit}.")
        if not quiet:
            console.say(f"look next at {out / 'comparison.csv'}")
