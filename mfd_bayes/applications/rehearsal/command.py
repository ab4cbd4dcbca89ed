"""The command `rehearse`: what it writes and prints."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import typer

from mfd_bayes.applications.rehearsal.options import RehearseOptions
from mfd_bayes.applications.rehearsal.rehearsal import Rehearsal, StoredRehearsal
from mfd_bayes.applications.rehearsal.summary import (
    SHEET,
    RehearsalSummary,
    draw_rehearsals,
    rehearsal_page,
)
from mfd_bayes.console import say
from mfd_bayes.jobs.job import JobState, Observe, Step
from mfd_bayes.jobs.local import check_workers, get_ready, run_jobs
from mfd_bayes.jobs.progress import show_progress
from mfd_bayes.reporting.figures import to_png
from mfd_bayes.reporting.tables import to_csv
from mfd_bayes.runs.folder import (
    POPULATION,
    REHEARSAL,
    REHEARSED,
    alone_in,
    remove_folder,
    remove_partial_files,
)
from mfd_bayes.runs.run import Run, open_run
from mfd_bayes.store.files import write_bytes, write_text


def run_rehearse(options: RehearseOptions) -> None:
    """Rehearse a run, and print it; exit code 1 where a bound of the data sheet is not right."""
    get_ready()
    run = replace(open_run(options.out, trust=options.trust_model), units=options.units)
    check_workers(options)
    with alone_in(options.out):
        if options.force:
            remove_folder(options.out, REHEARSAL)
        with show_progress(quiet=options.quiet) as observe:
            results = rehearse(run, options, observe)
        summary = RehearsalSummary(results)
        write_rehearsals(run, summary, options.effort)
    for sentence in () if options.quiet else summary.sentences:
        say(sentence)
    for error in summary.errors:
        say(f"warning: a rehearsal could not be calibrated: {error}", err=True)
    say(summary.verdict)
    if not options.quiet:
        say(f"look next at {options.out / REHEARSED[1]}")
    if summary.deviating["of"].isin(SHEET).any():
        raise typer.Exit(1)


def rehearse(run: Run, options: RehearseOptions, observe: Observe) -> list[StoredRehearsal]:
    """Results of all rehearsals, which are stored; those that are there are not made again."""
    manifest, folder = run.manifest, run.folder
    effort = options.effort or manifest.effort.name
    jobs = [
        Rehearsal(number, effort, manifest.seed, manifest.keys[POPULATION])
        for number in range(1, options.runs + 1)
    ]
    todo = [job for job in jobs if job.stored(folder) is None]
    for job in jobs:
        if job not in todo:
            observe(Step(job.id, JobState.KEPT))
    try:
        with closing(run_jobs(todo, folder, options, observe)) as outcomes:
            for _ in outcomes:
                pass
    finally:
        remove_partial_files(folder)
    return [result for job in jobs if (result := job.stored(folder)) is not None]


def write_rehearsals(run: Run, summary: RehearsalSummary, effort: str) -> None:
    """Write table, picture and page into the run folder."""
    manifest, folder = run.manifest, run.folder
    facts = {
        "rehearsals": str(summary.runs),
        "effort": effort or manifest.effort.name,
        "run": f"{folder.resolve().name} (seed {manifest.seed}, {manifest.finished})",
        "priors": manifest.priors,
    }
    table, page, figure = (folder / name for name in REHEARSED)
    png = to_png(draw_rehearsals(summary))
    heading = [summary.verdict, summary.expected, "p_family: p_value times the rows of its group"]
    write_text(table, to_csv(summary.table, heading))
    write_bytes(figure, png)
    write_text(page, rehearsal_page(summary, manifest.title, facts, png))
