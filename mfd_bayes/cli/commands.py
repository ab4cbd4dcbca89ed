"""The command line: its commands in the order of work."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from typing import TYPE_CHECKING, Annotated

import typer

from mfd_bayes.cli.calibration import (
    calibrate,
    check,
    demo,
    draws,
    init,
    inspect,
    prior_check,
    report,
)
from mfd_bayes.cli.options import Command, Commands, checked_output
from mfd_bayes.cli.use import (
    accept,
    compare,
    crossvalidate,
    export,
    next_test,
    predict,
    respond,
    serve,
    watch,
)
from mfd_bayes.jobs.signals import end_on_signals

if TYPE_CHECKING:
    from collections.abc import Callable

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",  # keeps the lines of examples apart
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Bayesian calibration, with honest uncertainty, of variable-friction dampers with a gap.",
    epilog="New here? mfd-bayes demo out --quick takes a few minutes; each command has --help.",
)

_PANELS: dict[str, tuple[tuple[Callable[..., None], str], ...]] = {
    "Look at your data": (
        (init, "complete campaign.toml where it is marked, then mfd-bayes inspect campaign.toml"),
        (inspect, "mfd-bayes prior-check campaign.toml, or mfd-bayes calibrate --help"),
        (prior_check, "mfd-bayes calibrate campaign.toml -o out"),
    ),
    "Calibrate": (
        (calibrate, "open out/report.html, then mfd-bayes check out"),
        (check, "mfd-bayes predict --help, or mfd-bayes calibrate --help if a check failed"),
        (report, "open out/report.html, then mfd-bayes check out"),
    ),
    "Predict and compare": (
        (predict, "look at bands.png, then mfd-bayes crossvalidate --help"),
        (accept, "print and file FOLDER/DEVICE.html; test a rejected device again"),
        (crossvalidate, "open out/report.html, then mfd-bayes compare --help"),
        (compare, "open out/MODEL/report.html of the model that is favoured"),
        (draws, "read the table with pandas, R or another program; or mfd-bayes predict --help"),
        (watch, "stop the test, add it to campaign.toml, and calibrate again"),
        (next_test, "make the test, add it to campaign.toml, and calibrate again"),
        (respond, "open FOLDER/report.html, then mfd-bayes export --help"),
        (export, "read about.json in the folder, beside the samples"),
        (serve, "in Python: umbridge.HTTPModel(URL, 'posterior')([q])"),
    ),
    "See it work on synthetic data": (
        (demo, "open out/report.html, then mfd-bayes inspect test.csv with a file of yours"),
    ),
}
"""Panels of the help: their commands, and what to do after each."""

for _panel, _commands in _PANELS.items():
    for _command, _next in _commands:
        _name = "next" if _command is next_test else None  # next is a word of Python
        app.command(_name, cls=Command, rich_help_panel=_panel, epilog=f"Next: {_next}")(_command)


def _version(show: bool) -> None:
    if show:
        from mfd_bayes import __version__

        typer.echo(f"mfd-bayes {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Bayesian calibration, with honest uncertainty, of variable-friction dampers with a gap."""


def main() -> None:
    """Run the command line."""
    settle_environment()
    with end_on_signals(), checked_output():
        app(prog_name="mfd-bayes")


def settle_environment() -> None:
    """Make what libraries read from the environment the same for everybody.

    One thread for each matrix, for those here are small; figures without a screen, for a notebook
    may have set a backend of its own; and a folder for caches where the home cannot be written to.
    Processes that are started inherit it.
    """
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # before numpy is imported
    os.environ["MPLBACKEND"] = "agg"
    if not os.access(os.environ.get("HOME", ""), os.W_OK):
        own = tempfile.mkdtemp(prefix="mfd-bayes-")
        atexit.register(shutil.rmtree, own, ignore_errors=True)
        for name in ("MPLCONFIGDIR", "XDG_CACHE_HOME"):
            os.environ.setdefault(name, own)
