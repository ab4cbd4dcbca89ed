"""The commands `draws`, `export` and `serve`: what they print."""

from __future__ import annotations

from mfd_bayes.applications.export.options import DrawsOptions, ExportOptions, ServeOptions
from mfd_bayes.console import say, warn


def run_draws(options: DrawsOptions) -> None:
    """Write the posterior draws of every test as one table."""
    from mfd_bayes.applications.export.draws import write_draws

    written, rows = write_draws(options)
    say(f"{written} written: {rows} draws")


def run_export(options: ExportOptions) -> None:
    """Write joint samples of a new device's parameters."""
    from mfd_bayes.applications.export.samples import export

    sentences, remarks = export(options)
    warn(remarks)
    for sentence in sentences:
        say(sentence)


def run_serve(options: ServeOptions) -> None:
    """Serve a model or a run until the process is ended."""
    from mfd_bayes.applications.export.server import serve

    serve(options)
