"""The commands that take a run to a building: respond, export."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from mfd_bayes.cli import arguments, console, progress
from mfd_bayes.cli.exits import mistakes


def respond(
    out: arguments.Run,
    building: Annotated[
        Path, typer.Option(parser=arguments.path, help="The building file; see init --building.")
    ],
    ground: Annotated[
        list[str], typer.Option(help="Ground motion, .AT2 or CSV; several by several --ground.")
    ],
    folder: Annotated[
        Path, typer.Option("-o", "--out", parser=arguments.path, help="Folder to write.")
    ],
    sweep: Annotated[
        str, typer.Option(metavar="RANGE", help='actuation="500 psi to 1500 psi in 8 steps".')
    ] = "",
    minimise: Annotated[
        Literal["drift", "acceleration"], typer.Option(help="What the sweep makes small.")
    ] = "drift",
    by: Annotated[
        Literal["mean", "q90", "passing"],
        typer.Option(
            help="By its mean, its 90 % quantile, or the probability to exceed its limit."
        ),
    ] = "mean",
    kind: Annotated[
        Literal["new_test", "device"],
        typer.Option(help="With each damper's scatter from test to test, or without."),
    ] = "new_test",
    draws: Annotated[int, typer.Option(min=10, max=5000)] = 300,
    scale: Annotated[
        float | None, typer.Option(help="Factor of every ground motion.", show_default="1")
    ] = None,
    unit: Annotated[
        str, typer.Option(metavar='"cm/s^2"', help="Unit of files that do not say it.")
    ] = "",
    peak: Annotated[
        str, typer.Option(metavar='"0.3 g"', help="Scale every ground motion to this peak.")
    ] = "",
    tolerance: Annotated[
        float, typer.Option(help="Largest error of a draw's peak drift, as a share.")
    ] = 0.01,
    jobs: arguments.Jobs = 0,
    seed: arguments.Seed = 1,
    units: arguments.Units = None,
    force: arguments.Replace = False,
    quiet: arguments.Quiet = False,
) -> None:
    """Compute a building's response to earthquakes, with this device as its dampers.

    Every draw of the dampers goes through a nonlinear time-history analysis. Writes
    FOLDER/report.html with the drift profile and its bands, histories, loops and
    limits, and the tables peaks.csv, limits.csv, draws.csv, peaks.tex and
    response.json. A step file without its step is given as FILE:0.01s. Files that
    are numbers alone are taken to be in g; FILE:0.01s:cm/s^2 says otherwise. A peak
    above 5 g or below 0.0001 g is refused unless its unit, --scale or --peak is given.

    Example:
      mfd-bayes respond out --building b.toml --ground quake.AT2 -o response

    With --sweep actuation="500 psi to 1500 psi" it compares actuations.
    """
    from mfd_bayes.pipeline import response as pipeline

    query = pipeline.Query(
        building,
        tuple(ground),
        folder,
        kind=kind,
        draws=draws,
        seed=seed,
        unit=unit,
        scale=scale,
        peak=peak,
        sweep=sweep,
        quantity=minimise,
        goal=by,
        tolerance=tolerance,
        jobs=jobs,
        units=units or "",
        force=force,
    )
    with mistakes():
        asked = pipeline.prepare(out, query)
        for moved in () if quiet else asked.grounds:
            console.say(moved.words)
        with progress.watch(quiet=quiet) as observe:
            found = pipeline.respond(asked, observe)
    for remark in found.view.remarks:
        console.say(f"warning: {remark}", err=True)
    for sentence in found.view.verdict:
        console.say(sentence)
    if found.view.sweep:
        console.say(found.view.sweep)
    if not quiet:
        console.say(f"look next at {found.page}")


def export(
    out: arguments.Run,
    to: Annotated[Literal["quofem", "opensees", "csv"], typer.Option(help="Who is to read it.")],
    folder: Annotated[
        Path, typer.Option("-o", "--out", parser=arguments.path, help="Folder to write.")
    ] = Path("export"),
    actuation: Annotated[
        str, typer.Option(help='Such as "1000 psi"; the middle of the tests\' by default.')
    ] = "",
    draws: Annotated[int, typer.Option(min=10, max=20000)] = 1000,
    seed: arguments.Seed = 1,
    force: arguments.Replace = False,
    extrapolate: Annotated[
        bool, typer.Option("--extrapolate", help="Export also far outside of the tested range.")
    ] = False,
) -> None:
    """Write joint samples of a new device's parameters for other programs.

    quofem: a column per variable without a header, grouped so that correlations are
    kept, and dakotaTab.out. opensees: a material fitted to predicted loops, with its
    misfit. csv: one table with names and units. All are in kip, in and ksi. Outside of
    the tested actuations it warns, far outside it refuses.

    Example:
      mfd-bayes export out --to quofem --actuation "1000 psi" -o samples
    """
    from mfd_bayes.pipeline import export as pipeline

    with mistakes():
        question = pipeline.Export(to, folder, actuation, draws, seed, force, extrapolate)
        found = pipeline.export(out, question)
    for remark in found.remarks:
        console.say(f"warning: {remark}", err=True)
    for sentence in found.said:
        console.say(sentence)
