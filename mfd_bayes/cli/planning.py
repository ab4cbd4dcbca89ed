"""The command that says which test to make next."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mfd_bayes.cli import arguments, console
from mfd_bayes.cli.exits import mistakes


def next_test(
    out: arguments.Run,
    goal: Annotated[
        str, typer.Option(help='What to know better: "energy at 1000 psi, 0.5 Hz, 1 in".')
    ] = "",
    candidates: Annotated[
        str, typer.Option(help='Tests to choose from: "500|1350 psi, 0.5 Hz, 1 in", or a file.')
    ] = "",
    limits: Annotated[str, typer.Option(help='Of the actuator: "10 in/s, 6 in, 20 kip".')] = "",
    table: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            parser=arguments.path,
            help="CSV to write; JSON and PNG beside it.",
            show_default="OUT/next.csv",
        ),
    ] = None,
    write: Annotated[
        Path | None,
        typer.Option(
            parser=arguments.path,
            metavar="FILE.toml",
            help="Draft the next entries of campaign.toml.",
        ),
    ] = None,
    tests: Annotated[int, typer.Option(min=1, max=3, help="How many tests --write drafts.")] = 1,
    draws: Annotated[
        int, typer.Option(min=200, help="Draws of the posterior that are simulated.")
    ] = 2000,
    seed: arguments.Seed = 0,
    force: arguments.Replace = False,
    units: arguments.Units = None,
    quiet: arguments.Quiet = False,
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
        from mfd_bayes.pipeline import commands as pipeline

        wish = pipeline.Wish(
            goal,
            candidates,
            limits,
            table,
            write,
            tests,
            draws,
            seed,
            units or "",
            force,
        )
        told = pipeline.next_test(out, wish)
    for remark in told.advice.remarks:
        console.say(f"warning: {remark}", err=True)
    if not quiet:
        heads = ["narrows by", "hours", "per hour", "information, nat", "repeats"]
        console.print_rows(
            "How much the best candidates are expected to narrow the goal", heads, told.rows
        )
    console.say(told.sentence)
    if not quiet:
        for sentence in told.together:
            console.say(sentence)
        console.say(f"look next at {' and '.join(map(str, told.files[:1] + told.files[2:]))}")
