"""The help of the command line, its completion, and its suggestions after a typing error."""

import os
import re
import shlex
import subprocess
import sys

import typer.main
from typer.testing import CliRunner

import mfd_bayes
from mfd_bayes.cli.commands import RENAMED, app

COMMANDS = typer.main.get_command(app).commands


def ran(words, **variables):
    return subprocess.run(
        [str(word) for word in words],
        capture_output=True,
        text=True,
        env=os.environ | {"COLUMNS": "80"} | variables,
        timeout=60,
        check=False,
    )


def here(*words, **variables):
    """As `ran`, of the command line in this process."""
    environment = {"COLUMNS": "80"} | variables
    return CliRunner().invoke(app, words, prog_name="mfd-bayes", env=environment)


def help_of(*words):
    outcome = here(*words, "--help")
    assert outcome.exit_code == 0
    return [line.strip() for line in outcome.stdout.splitlines() if line.strip()]


def test_a_help_says_what_is_written_with_examples_that_are_valid_and_what_is_next():
    for command in COMMANDS:
        lines = help_of(command)
        assert any(re.search(r"\b[Ww]rites?\b", line) for line in lines)
        frame = max(i for i, line in enumerate(lines) if line.startswith("╰"))
        assert lines[frame + 1].startswith("Next: ")
        examples = [line for line in lines if line.startswith("mfd-bayes ")]
        assert lines.index("Example:") + 1 == lines.index(examples[0])
        for example in examples:
            assert example.startswith(f"mfd-bayes {command} ")
            assert "mfd-bayes" not in example[1:]  # two are not joined
            _, name, *words = shlex.split(example.partition(" && ")[0])
            COMMANDS[name].make_context(name, words)
        for item in (COMMANDS[command], *COMMANDS[command].params):
            assert not re.search(r"\[[a-z\[/]", getattr(item, "help", None) or "")  # as markup


def test_it_runs_as_a_module_too():
    outcome = ran([sys.executable, "-m", "mfd_bayes", "--version"])
    assert (outcome.returncode, outcome.stderr) == (0, "")
    assert outcome.stdout == f"mfd-bayes {mfd_bayes.__version__}\n"


def test_an_option_is_refused_by_its_old_name_with_the_new_one():
    for words, new in (
        ("predict out --sine x -o b.csv --given=1", "--given is now called --condition-on"),
        ("predict out --whole", "--whole is now called --simultaneous"),
        ("respond out --by q90", "--by is now called --statistic"),
    ):
        outcome = here(*words.split())
        assert (outcome.exit_code, outcome.stdout) == (2, "")
        assert outcome.stderr == f"mfd-bayes: {new}\n"
    for (command, old), new in RENAMED.items():
        options = {name for param in COMMANDS[command].params for name in param.opts}
        assert new in options
        assert old not in options


# --- typing errors


def test_a_typing_error_is_named_in_the_last_line_with_a_suggestion():
    for words, error in [
        ("predict out --kind nope", "'--kind': 'nope' is not one of 'mean', 'new_test'"),
        ("respond out --draws -5", r"'--draws'.* 10\b"),
        ("calibrate campaign.toml", "-o: missing: give the run folder"),
        ("calibrat", "No such command 'calibrat'. Did you mean 'calibrate'"),
        ("calibrate c.toml -o out --efort quick", "No such option.*--efort.*--effort"),
    ]:
        outcome = here(*words.split())
        assert (outcome.exit_code, outcome.stdout) == (2, "")
        *usage, message = [line for line in outcome.stderr.splitlines() if line]
        assert not usage or usage[-1].startswith("Try 'mfd-bayes ")
        assert message.startswith("Error: ")
        assert re.search(error, message)  # typer's words differ from version to version
