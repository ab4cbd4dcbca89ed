"""The command `reweigh`: what it writes and prints."""

from __future__ import annotations

from dataclasses import replace

from mfd_bayes.applications.reweighing.options import ReweighOptions
from mfd_bayes.applications.reweighing.page import side_by_side
from mfd_bayes.applications.reweighing.reweighing import reweigh
from mfd_bayes.console import print_rows, say
from mfd_bayes.jobs.job import Workplace
from mfd_bayes.jobs.progress import show_progress
from mfd_bayes.runs.folder import REWEIGHED, alone_in, check_places
from mfd_bayes.runs.run import open_run, rewrite_manifest
from mfd_bayes.store.files import write_text


def run_reweigh(options: ReweighOptions) -> None:
    """Show a run under another prior file beside itself."""
    run = replace(open_run(options.out, trust=options.trust_model), units=options.units)
    with show_progress(quiet=options.quiet) as observe:
        reweighing = reweigh(
            run,
            options.priors,
            options.folder,
            jobs=options.jobs,
            seed=options.seed,
            observe=observe,
        )
    comparison = side_by_side(reweighing, Workplace(options.jobs).processes)
    folder = options.out if options.folder is None else options.folder
    with alone_in(folder):
        check_places(folder)
        table, page = (folder / name for name in REWEIGHED)
        write_text(table, comparison.csv())
        write_text(page, comparison.page())
        if options.folder is not None:
            rewrite_manifest(reweighing.reweighed, verdicts=comparison.verdicts[1])
    if not options.quiet:
        rows = [
            (name, w.words, *comparison.uses.get(name, ("", "")))
            for name, w in reweighing.weights.items()
        ]
        print_rows(
            "Draws under the other priors", ["of", "made", "before", "after"], rows, folded=2
        )
        say(comparison.sentence)
    for label, verdict in zip(("before", "after"), comparison.verdicts, strict=True):
        say(f"{label}: {verdict['campaign'].upper()}: {verdict['sentence']}")
    if not options.quiet:
        say(f"look next at {page} and {table}")
