"""Standard streams that are full or closed, and short memory, end a command with one sentence.

Most commands here are processes with the real command line and streams, but in place of the
modules that work some that take no seconds to import.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from mfd_bayes.cli.errors import mistakes
from tests.run_folders import write_run

WHOLE = (sys.executable, "-m", "mfd_bayes")
FULL = Path("/dev/full")
full = pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")

DRIVER = """\
import sys
from types import ModuleType, SimpleNamespace

import mfd_bayes.evaluation
import mfd_bayes.pipeline
from mfd_bayes.cli.commands import main
from mfd_bayes.errors import StoreError
from mfd_bayes.messages import Message
from mfd_bayes.runs.verdict import Verdict


def check(out, units):
    if not out.exists():
        raise StoreError(f"{out} is not a run folder")
    failed = SimpleNamespace(
        test="a", check="R-hat", feature="k3", observed=1.2, unit="1", limit="1", tolerance=0.1,
        status=Verdict.FAIL, message=Message("It is bad."),
    )
    return SimpleNamespace(
        checks=(failed,) * 300, warnings=(), judgements=(), sentences=(Message("Bad."),),
        systems=(SimpleNamespace(words=None),), metric=False,
    )


report = ModuleType("mfd_bayes.pipeline.report")
summary = ModuleType("mfd_bayes.evaluation.summary")
report.check, summary.fails = check, lambda view: True
sys.modules[report.__name__] = mfd_bayes.pipeline.report = report
sys.modules[summary.__name__] = mfd_bayes.evaluation.summary = summary
main()
"""


@pytest.fixture(scope="module")
def light(tmp_path_factory):
    """Words that start the command without its work: every run folder has failed."""
    driver = tmp_path_factory.mktemp("driver") / "driver.py"
    driver.write_text(DRIVER)
    return sys.executable, str(driver)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("streams") / "out"
    write_run(folder, small=True)
    return folder


@pytest.fixture
def run(tmp_path):
    """Function that runs a command whose stream of a number is in some state.

    It returns the exit code, and what the other stream says.
    """

    def run(command, number, state, buffered=True):
        plain = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
        plain["PYTHONPATH"] = os.pathsep.join(sys.path)

        def prepare():
            if state == "closed":
                os.close(number)
            elif state == "full":
                os.dup2(os.open(FULL, os.O_WRONLY), number)
            else:
                reader, writer = os.pipe()
                os.close(reader)
                os.dup2(writer, number)

        other = tmp_path / "other.txt"
        with other.open("wb") as file:
            streams = [subprocess.DEVNULL, file] if number == 1 else [file, subprocess.DEVNULL]
            done = subprocess.run(
                [str(word) for word in command],
                stdout=streams[0],
                stderr=streams[1],
                preexec_fn=prepare,
                env=plain if buffered else plain | {"PYTHONUNBUFFERED": "1"},
                check=False,
                timeout=120,
            )
        return done.returncode, other.read_text()

    return run


WORDS = pytest.mark.parametrize(
    ("words", "code"), [(("check", "."), 1), (("--version",), 0), (("check", "--help"), 0)]
)


@full
@pytest.mark.parametrize("state", ["full", "closed"])
@WORDS
def test_an_output_that_takes_nothing_is_said_in_one_sentence(light, run, words, code, state):
    code, said = run([*light, *words], 1, state)
    (sentence,) = said.splitlines()
    assert sentence.startswith("mfd-bayes: cannot write the output: ")
    assert code == 2


@WORDS
def test_an_output_whose_reader_has_seen_enough_is_no_error(light, run, words, code):
    assert run([*light, *words], 1, "broken") == (code, "")


@full
@pytest.mark.parametrize("state", ["full", "closed", "broken"])
@pytest.mark.parametrize("buffered", [True, False])
def test_a_refusal_that_nobody_can_hear_goes_to_the_output(light, run, state, buffered):
    code, said = run([*light, "check", "none"], 2, state, buffered)
    (sentence,) = said.splitlines()
    assert "is not a run folder" in sentence
    assert code == 2


@pytest.mark.parametrize("state", ["full", "closed", "broken"])
def test_messages_that_nobody_asked_for_change_nothing(light, run, state):
    code, said = run([*light, "check", ".", "--quiet"], 2, state)
    assert (code, said.count("\n")) == (1, 1)  # its verdict


def test_a_file_does_not_get_what_is_printed_where_the_output_is_closed(stored, run, tmp_path):
    motion = tmp_path / "m.csv"
    rows = "".join(f"{i / 10},{(-1) ** (i // 10) * (i % 10)}\n" for i in range(100))
    motion.write_text("time_s,displacement_in\n" + rows)
    words = ("predict", stored, "--motion", motion, "--actuation", "500 psi", "--extrapolate")
    code, said = run([*WHOLE, *words, "-o", tmp_path / "b.csv"], 1, "closed")
    assert code == 2
    assert "cannot write the output: it is closed" in said
    assert (tmp_path / "b.csv").read_text().startswith("# equal-tailed")
    assert (tmp_path / "b.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("error", "resume", "said"),
    [
        (MemoryError(), "", "memory is too short"),
        (MemoryError("Unable to allocate 3 GiB"), "", "short: Unable to allocate 3 GiB"),
        (MemoryError(), "a --resume", "short; what is finished is kept, go on with: a --resume"),
    ],
)
def test_short_memory_is_said_in_a_sentence(capsys, error, resume, said):
    with pytest.raises(typer.Exit) as ended, mistakes(resume):
        raise error
    assert ended.value.exit_code == 2
    (sentence,) = capsys.readouterr().err.splitlines()
    assert sentence.startswith("mfd-bayes: ")
    assert sentence.endswith(said)
