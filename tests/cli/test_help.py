"""The help of the command line, its completion, and its suggestions after a typing error."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import typer.main
from typer.testing import CliRunner

import mfd_bayes
from mfd_bayes.cli.commands import app

COMMAND = Path(sys.executable).parent / "mfd-bayes"
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
        for part in (COMMANDS[command], *COMMANDS[command].params):
            assert not re.search(r"\[[a-z\[/]", getattr(part, "help", None) or "")  # as markup


def test_commands_are_listed_in_the_order_of_work():
    names = [line.strip("│ ").split()[0] for line in help_of() if line.startswith("│")]
    names = [name for name in names if name in COMMANDS]
    assert sorted(names) == sorted(COMMANDS)
    assert names[:3] == ["init", "inspect", "prior-check"]
    assert names[-1] == "demo"
    assert here("-h").stdout == here("--help").stdout


def test_help_imports_no_slow_library():
    code = (
        "import sys; from typer.testing import CliRunner; from mfd_bayes.cli.commands import app;"
        "assert CliRunner().invoke(app, ['--help']).exit_code == 0;"
        "heavy = {'numpy', 'scipy', 'pydantic', 'pint', 'xarray', 'importlib.metadata'};"
        "print(sorted(heavy & set(sys.modules)))"
    )
    assert ran([sys.executable, "-c", code]).stdout == "[]\n"


def test_it_runs_as_a_module_too():
    outcome = ran([sys.executable, "-m", "mfd_bayes", "--version"])
    assert (outcome.returncode, outcome.stderr) == (0, "")
    assert outcome.stdout == f"mfd-bayes {mfd_bayes.__version__}\n"


# --- typing errors


def test_a_typing_error_is_named_in_the_last_line_with_a_suggestion():
    for words, error in [
        ("predict out --kind nope", "'--kind': 'nope' is not one of 'device', 'new_test'"),
        ("respond out --draws -5", r"'--draws'.* 10\b"),
        ("predict", "Missing argument '(out|OUT)'"),
        ("calibrate campaign.toml", "-o: missing: give the run folder"),
        ("calibrat", "No such command 'calibrat'. Did you mean 'calibrate'"),
        ("xyzzy", "No such command 'xyzzy'.$"),
        ("calibrate c.toml -o out --efort quick", "No such option.*--efort.*--effort"),
        ("--verson", "No such option.*--verson.*--version"),
    ]:
        outcome = here(*words.split())
        assert (outcome.exit_code, outcome.stdout) == (2, "")
        *usage, last = [line for line in outcome.stderr.splitlines() if line]
        assert not usage or usage[-1].startswith("Try 'mfd-bayes ")
        assert last.startswith("Error: ")
        assert re.search(error, last)  # typer's words differ from version to version


# --- completion


def test_words_are_completed():
    for words, offered in [
        ("c", {"calibrate", "check", "crossvalidate", "compare"}),
        ("calibrate --eff", {"--effort"}),
        ("calibrate c.toml --effort st", {"standard"}),
        ("nothing-like-this", set()),
    ]:
        line, count = f"mfd-bayes {words}", str(len(words.split()))
        bash = here(_MFD_BAYES_COMPLETE="complete_bash", COMP_WORDS=line, COMP_CWORD=count)
        assert set(bash.stdout.split()) == offered
        zsh = here(_MFD_BAYES_COMPLETE="complete_zsh", _TYPER_COMPLETE_ARGS=line)
        assert all(name in zsh.stdout for name in offered)


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_completion_is_installed_and_bash_completes_a_command(tmp_path):
    home = {"HOME": str(tmp_path), "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    assert ran([COMMAND, "--install-completion", "bash"], **home).returncode == 0
    scripts = [path.read_text() for path in tmp_path.rglob("*") if path.is_file()]
    (script,) = [text for text in scripts if "_MFD_BAYES_COMPLETE" in text]
    function = re.search(r"^(\w+)\(\)", script, re.MULTILINE).group(1)
    code = f"{script}\nCOMP_WORDS=(mfd-bayes cali); COMP_CWORD=1; {function} mfd-bayes cali\n"
    path = f"{COMMAND.parent}{os.pathsep}{os.environ['PATH']}"
    done = ran(["bash", "-c", code + 'echo "${COMPREPLY[@]}"'], PATH=path)
    assert done.stdout == "calibrate\n"
