"""The command line: its commands in the order of work.

Typer makes an option of each parameter of a command, so commands have more than five; whatever
they call takes the options together, as frozen settings.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer

from mfd_bayes.cli.calibration import calibrate, check, demo, draws, report
from mfd_bayes.cli.environment import settle_environment
from mfd_bayes.cli.planning import next_test
from mfd_bayes.cli.prediction import compare, crossvalidate, predict
from mfd_bayes.cli.preparation import init, inspect, prior_check
from mfd_bayes.cli.response import export, respond
from mfd_bayes.cli.streams import checked_streams
from mfd_bayes.cli.usage import NothingEmpty, OneSentence
from mfd_bayes.jobs.signals import end_on_signals

app = typer.Typer(
    cls=OneSentence,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",  # keeps the lines of examples apart
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Bayesian calibration, with honest uncertainty, of variable-friction dampers with a gap.",
    epilog="New here? mfd-bayes demo out --quick takes a few minutes; each command has --help.",
)

_LOOK, _FIT, _USE, _TRY = (
    "Look at your data",
    "Calibrate",
    "Predict and compare",
    "See it work on synthetic data",
)

_COMMANDS: tuple[tuple[str, Callable[..., None], str], ...] = (
    (
        _LOOK,
        init,
        "complete campaign.toml where it is marked, then mfd-bayes inspect campaign.toml",
    ),
    (_LOOK, inspect, "mfd-bayes prior-check campaign.toml, or mfd-bayes calibrate --help"),
    (_LOOK, prior_check, "mfd-bayes calibrate campaign.toml -o out"),
    (_FIT, calibrate, "open out/report.html, then mfd-bayes check out"),
    (_FIT, check, "mfd-bayes predict --help, or mfd-bayes calibrate --help if a check failed"),
    (_FIT, report, "open out/report.html, then mfd-bayes check out"),
    (_USE, predict, "look at bands.png, then mfd-bayes crossvalidate --help"),
    (_USE, crossvalidate, "open out/report.html, then mfd-bayes compare --help"),
    (_USE, compare, "open out/MODEL/report.html of the model that is favoured"),
    (_USE, draws, "read the table with pandas, R or another program; or mfd-bayes predict --help"),
    (_USE, next_test, "make the test, add it to campaign.toml, and calibrate again"),
    (_USE, respond, "open FOLDER/report.html, then mfd-bayes export --help"),
    (_USE, export, "read about.json in the folder, beside the samples"),
    (_TRY, demo, "open out/report.html, then mfd-bayes inspect test.csv with a file of yours"),
)
"""Panel of the help, command, and what to do next."""

for _panel, _command, _next in _COMMANDS:
    _name = "next" if _command is next_test else None  # next is a word of Python
    app.command(_name, cls=NothingEmpty, rich_help_panel=_panel, epilog=f"Next: {_next}")(_command)


def _version(wanted: bool) -> None:
    if wanted:
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
    with end_on_signals(), checked_streams():
        app()
