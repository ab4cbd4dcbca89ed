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
ORDER = (
    *("init", "inspect", "prior-check", "calibrate", "check", "report"),
    *("predict", "crossvalidate", "compare", "draws", "next", "respond", "export", "demo"),
)


def ran(words, **variables):
    return subprocess.run(
        [str(word) for word in words],
        capture_output=True,
        text=True,
        env=os.environ | {"COLUMNS": "80"} | variables,
        timeout=60,
        check=False,
    )


def here(words, **variables):
    """As `ran`, of the command line in this process."""
    return CliRunner().invoke(app, words, prog_name="mfd-bayes", env={"COLUMNS": "80"} | variables)


def help_of(*words):
    outcome = CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": "80"})
    assert outcome.exit_code == 0
    return [line.strip() for line in outcome.stdout.splitlines() if line.strip()]


def examples_of(command):
    """Lines of a command's help that show the command."""
    lines = help_of(command)
    start = lines.index("Example:") + 1
    found = []
    for line in lines[start:]:
        if not line.startswith("mfd-bayes "):
            break
        found.append(line)
    return found


# --- help


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_shows_an_example_on_a_line_of_its_own(command):
    examples = examples_of(command)
    assert examples
    assert all(example.startswith(f"mfd-bayes {command} ") for example in examples)
    assert not any("mfd-bayes" in example[1:] for example in examples)  # two are not joined


@pytest.mark.parametrize("command", COMMANDS)
def test_every_example_is_a_valid_call(command):
    for example in examples_of(command):
        _, name, *words = shlex.split(example.partition(" && ")[0])
        COMMANDS[name].make_context(name, words)


def test_an_example_with_an_option_that_is_not_there_would_be_found():
    with pytest.raises(Exception, match="No such option"):
        COMMANDS["check"].make_context("check", ["out", "--loud"])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("predict", "out", "--kind", "nope"), "--kind: 'nope' is not one of 'device', 'new_test'"),
        (("respond", "out", "--draws", "-5"), r"--draws.* 10\b"),
        (("calibrate", "c.toml", "--jobz", "1"), "No such option.*--jobz"),
        (("predict",), "Missing argument '(out|OUT)'"),
        (("predict", "out", "--motion"), "'--motion' requires an argument"),
        (("nosuch",), "No such command 'nosuch'"),
    ],
)
def test_a_typing_error_is_one_sentence_that_names_the_help(words, said):
    outcome = here(list(words))
    assert outcome.exit_code == 2
    assert outcome.stdout == ""
    (sentence,) = outcome.stderr.splitlines()
    assert sentence.startswith("mfd-bayes: ")
    assert re.search(said, sentence)  # typer's words differ from version to version
    command = "" if words[0] == "nosuch" else f" {words[0]}"
    assert sentence.endswith(f"; see mfd-bayes{command} -h")
    assert "Value error" not in sentence


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_a_command_says_what_it_writes_and_what_to_do_next(command):
    lines = help_of(command)
    assert any(re.search(r"\b[Ww]rites?\b", line) for line in lines)
    frame = max(i for i, line in enumerate(lines) if line.startswith("╰"))
    assert lines[frame + 1].startswith("Next: ")


def test_commands_are_listed_in_the_order_of_work():
    lines = help_of()
    named = [line.strip("│ ").split()[0] for line in lines if line.startswith("│")]
    listed = [name for name in named if name in COMMANDS]
    assert listed == [name for name in ORDER if name in COMMANDS]
    assert set(listed) == set(COMMANDS)


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
    assert "calibrate" in ran([sys.executable, "-m", "mfd_bayes", "--help"]).stdout


# --- suggestions


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("calibrat",), "calibrate"),
        (("cross-validate",), "crossvalidate"),
        (("calibrate", "c.toml", "-o", "out", "--efort", "quick"), "--effort"),
        (("check", "out", "--quite"), "--quiet"),
        (("--verson",), "--version"),
    ],
)
def test_a_mistyped_word_is_answered_with_a_suggestion(words, meant):
    outcome = here(words)
    assert outcome.exit_code == 2
    assert meant in re.split("Did you mean|Possible options", outcome.stderr)[1]
    assert "Traceback" not in outcome.stderr


def test_a_word_like_no_command_gets_no_suggestion():
    outcome = ran([COMMAND, "xyzzy"])
    assert (outcome.returncode, outcome.stdout) == (2, "")
    assert "No such command" in outcome.stderr
    assert "Did you mean" not in outcome.stderr


# --- completion


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_the_script_for_a_shell_is_printed(shell):
    script = ran([COMMAND], _MFD_BAYES_COMPLETE=f"source_{shell}")
    assert script.returncode == 0
    assert f"_MFD_BAYES_COMPLETE=complete_{shell}" in script.stdout
    shown = ran(
        [COMMAND, "--show-completion", shell], _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="1"
    )
    assert shown.returncode == 0
    assert shown.stdout.strip() == script.stdout.strip()


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("cal", {"calibrate"}),
        ("c", {"calibrate", "check", "crossvalidate", "compare"}),
        ("calibrate --eff", {"--effort"}),
        ("calibrate c.toml --effort st", {"standard"}),
        ("nothing-like-this", set()),
    ],
)
def test_words_are_completed(words, found):
    line = f"mfd-bayes {words}"
    count = str(len(words.split()))
    bash = here([], _MFD_BAYES_COMPLETE="complete_bash", COMP_WORDS=line, COMP_CWORD=count)
    assert set(bash.stdout.split()) == found
    zsh = here([], _MFD_BAYES_COMPLETE="complete_zsh", _TYPER_COMPLETE_ARGS=line)
    offered = re.findall(r'^\s*"?\(?"?([\w-]+)"?:', zsh.stdout, re.MULTILINE)
    assert all(name in zsh.stdout for name in found)
    assert set(offered) <= found


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_bash_completes_a_command():
    script = ran([COMMAND], _MFD_BAYES_COMPLETE="source_bash").stdout
    function = re.search(r"^(\w+)\(\)", script, re.MULTILINE).group(1)
    code = f"{script}\nCOMP_WORDS=(mfd-bayes cali); COMP_CWORD=1; {function} mfd-bayes cali\n"
    path = f"{COMMAND.parent}{os.pathsep}{os.environ['PATH']}"
    done = ran(["bash", "-c", code + 'echo "${COMPREPLY[@]}"'], PATH=path)
    assert done.stdout == "calibrate\n"


def test_completion_is_installed_for_a_shell(tmp_path):
    home = {"HOME": str(tmp_path), "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    assert ran([COMMAND, "--install-completion", "bash"], **home).returncode == 0
    scripts = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert any("_MFD_BAYES_COMPLETE" in path.read_text() for path in scripts)


@pytest.mark.parametrize("command", COMMANDS)
def test_no_word_of_a_help_is_taken_for_markup_and_lost(command):
    told = [COMMANDS[command].help, *(getattr(p, "help", "") for p in COMMANDS[command].params)]
    assert [text for text in told if re.search(r"\[[a-z\[/]", text or "")] == []
