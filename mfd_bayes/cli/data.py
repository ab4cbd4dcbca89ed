"""The commands that look at data before a calibration: init, inspect, prior-check."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from mfd_bayes.cli.console import say
from mfd_bayes.cli.errors import mistakes
from mfd_bayes.cli.options import Campaign, Pictures, Replace, Units, path


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
        from mfd_bayes.pipeline import prior_check as pipeline

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
