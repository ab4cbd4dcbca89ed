"""The command line: its commands, in the order of work, each made of a dataclass."""

from __future__ import annotations

import atexit
import inspect
import os
import shutil
import sys
import tempfile
from dataclasses import MISSING, fields
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from mfd_bayes.cli.streams import checked_output, mistakes, refuse
from mfd_bayes.jobs.signals import end_on_signals

if TYPE_CHECKING:
    from collections.abc import Callable

_PANELS = {
    "Look at your data": (
        (
            *("init", "pipeline"),
            "complete campaign.toml where it is marked, then mfd-bayes inspect campaign.toml",
        ),
        (
            *("inspect", "pipeline"),
            "mfd-bayes prior-check campaign.toml, or mfd-bayes calibrate --help",
        ),
        ("prior-check", "pipeline", "mfd-bayes calibrate campaign.toml -o out"),
    ),
    "Calibrate": (
        ("calibrate", "pipeline", "open out/report.html, then mfd-bayes check out"),
        (
            "check",
            "pipeline",
            "mfd-bayes predict --help, or mfd-bayes calibrate --help if a check failed",
        ),
        ("report", "pipeline", "open out/report.html, then mfd-bayes check out"),
    ),
    "Predict and compare": (
        ("predict", "prediction", "look at bands.png, then mfd-bayes crossvalidate --help"),
        ("accept", "acceptance", "print and file FOLDER/DEVICE.html; test a rejected device again"),
        ("crossvalidate", "pipeline", "open out/report.html, then mfd-bayes compare --help"),
        ("rehearse", "rehearsal", "open out/rehearsal.html, then mfd-bayes crossvalidate --help"),
        ("reweigh", "reweighing", "open reweighed.html; with -o then mfd-bayes report OUT2"),
        ("compare", "pipeline", "open out/MODEL/report.html of the model that is favoured"),
        (
            "draws",
            "export",
            "read the table with pandas, R or another program; or mfd-bayes predict --help",
        ),
        ("watch", "watch", "stop the test, add it to campaign.toml, and calibrate again"),
        ("next", "next_test", "make the test, add it to campaign.toml, and calibrate again"),
        ("respond", "buildings", "open FOLDER/report.html, then mfd-bayes export --help"),
        ("export", "export", "read about.json in the folder, beside the samples"),
        ("serve", "export", "in Python: umbridge.HTTPModel(URL, 'posterior')([q])"),
    ),
    "See it work on synthetic data": (
        (
            "demo",
            "pipeline",
            "open out/report.html, then mfd-bayes inspect test.csv with a file of yours",
        ),
    ),
}
"""Panels of the help: each command, the folder of its options and its function, what is next."""

RENAMED = {
    ("predict", "--given"): "--condition-on",
    ("predict", "--whole"): "--simultaneous",
    ("respond", "--by"): "--statistic",
}
"""Names of today for options of commands that had others."""


class Command(TyperCommand):
    """A command that refuses old options, and an empty text, as of a variable that is not set."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Refuse an option by the name that it had once."""
        for word in args:
            option = word.partition("=")[0]
            if new := RENAMED.get((str(self.name), option)):
                refuse(f"{option} is now called {new}")
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command, when no option was given an empty text."""
        for param in self.params:
            value = ctx.params.get(param.name)
            source = ctx.get_parameter_source(param.name)
            if isinstance(value, str) and not value.strip() and source.name == "COMMANDLINE":
                name = next(reversed(param.opts), param.name)
                raise typer.BadParameter(
                    "got an empty text: give a value, or leave it out", param_hint=name
                )
        return super().invoke(ctx)


class Commands(TyperGroup):
    """The commands; a word typed wrongly is answered in click's own lines, without a box."""

    def main(self, args: Any = None, *, standalone_mode: bool = True, **extra: Any) -> Any:  # type: ignore[override]
        """Run a command; where it stands alone, exit as it asks for."""
        try:
            code = super().main(args, standalone_mode=False, **extra)
        except Exception as error:
            usage: Any = error
            if not standalone_mode or not hasattr(error, "show"):
                raise
            usage.message = str(usage.message).removeprefix("Value error, ")
            if usage.format_message():  # else the help was shown
                usage.show()
            sys.exit(2)
        if not standalone_mode:
            return code
        sys.exit(code if isinstance(code, int) else 0)


def command_of(name: str, folder: str) -> Callable[..., None]:
    """A command as typer takes it, made of the dataclass of its options.

    Of "predict" in the folder "prediction" that is `PredictOptions` in its options.py, and
    `run_predict` in its command.py, which is imported when the command is run. Fields that are not
    `Annotated` are no options; the class's own come before those that it inherits.
    """
    home = f"mfd_bayes.{folder if folder == 'pipeline' else f'applications.{folder}'}"
    title = {"next": "NextTest"}.get(name, name.title().replace("-", ""))
    kind: Any = getattr(import_module(f"{home}.options"), f"{title}Options")

    def command(**typed: Any) -> None:
        values = {n: tuple(v) if isinstance(v, list) else v for n, v in typed.items()}
        options = kind(**{n: v for n, v in values.items() if v is not None})
        with mistakes(getattr(options, "resumption", str)):
            function = f"run_{name.replace('-', '_')}"
            getattr(import_module(f"{home}.command"), function)(options)

    hints = get_type_hints(kind, include_extras=True)
    defaults = {f.name: f.default for f in fields(kind)}
    ordered = dict.fromkeys(n for each in kind.__mro__ for n in inspect.get_annotations(each))
    parameters = [
        inspect.Parameter(
            n,
            inspect.Parameter.KEYWORD_ONLY,
            default=_default_of(defaults[n]),
            annotation=_annotation_of(hints[n]),
        )
        for n in ordered
        if get_origin(hints[n]) is Annotated
    ]
    command.__doc__ = inspect.getdoc(kind)
    command.__annotations__ = {p.name: p.annotation for p in parameters}
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return command


def _default_of(value: object) -> object:
    """Default of an option as typer takes it: an empty text or tuple stands for none."""
    return inspect.Parameter.empty if value is MISSING else None if value in ("", ()) else value


def _annotation_of(hint: Any) -> Any:
    """Annotation of an option as typer takes it: a list where there may be several."""
    kind, *marks = get_args(hint)
    if get_origin(kind) is tuple:
        kind = list[get_args(kind)[0]]  # type: ignore[misc]
    elif get_origin(kind) is Literal:
        kind = Literal[tuple(filter(None, get_args(kind)))]
    return Annotated[(kind, *marks)]


app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",  # keeps the lines of examples apart
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Bayesian calibration, with honest uncertainty, of variable-friction dampers with a gap.",
    epilog="New here? mfd-bayes demo out --quick takes a few minutes; each command has --help.",
)

for _panel, _commands in _PANELS.items():
    for _name, _folder, _next in _commands:
        app.command(_name, cls=Command, rich_help_panel=_panel, epilog=f"Next: {_next}")(
            command_of(_name, _folder)
        )


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
