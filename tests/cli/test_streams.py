"""Standard streams that are full or closed end a command with one sentence and exit 2.

Every command here is a process of its own. Most have the real command line and streams, but in
place of the module that works one that takes no seconds to import.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

WHOLE = (sys.executable, "-m", "mfd_bayes")
FULL = Path("/dev/full")
STATES = pytest.mark.parametrize("state", ["full", "closed", "broken"])

DRIVER = """\
import sys
from types import ModuleType, SimpleNamespace

import mfd_bayes.pipeline
from mfd_bayes.cli.commands import main
from mfd_bayes.errors import StoreError
from mfd_bayes.runs.verdict import Verdict


def check(out, units):
    if not out.exists():
        raise StoreError(f"{out} is not a run folder")
    found = SimpleNamespace(
        subject="a", name="R-hat", target="k3", value=1.2, limit="1", tolerance=0.1,
        verdict=Verdict.FAIL,
    )
    return SimpleNamespace(
        checks=(found,) * 300, warnings=(), judgements=(), sentence="It failed."
    )


commands = ModuleType("mfd_bayes.pipeline.commands")
commands.check = check
commands.fails = lambda view: True
sys.modules[commands.__name__] = mfd_bayes.pipeline.commands = commands
main()
"""


@pytest.fixture(scope="module")
def light(tmp_path_factory):
    """Words that start the command without its work: every run folder has failed."""
    driver = tmp_path_factory.mktemp("driver") / "driver.py"
    driver.write_text(DRIVER)
    return sys.executable, str(driver)


@pytest.fixture(scope="module")
def stored(tmp_path_factory, benchmark_module):
    folder = tmp_path_factory.mktemp("streams") / "out"
    benchmark_module("fuzz.runs").write_run(folder, small=True)
    return folder


def ran(command, number, state, other, buffered=True):
    """A command whose stream of that number is in some state: exit code, and the other stream."""
    plain = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}

    def prepare():
        if state == "closed":
            os.close(number)
        elif state == "full":
            os.dup2(os.open(FULL, os.O_WRONLY), number)
        else:
            reader, writer = os.pipe()
            os.close(reader)
            os.dup2(writer, number)

    with other.open("wb") as file:
        streams = {"stdout": file, "stderr": subprocess.DEVNULL} if number == 2 else {}
        streams = streams or {"stdout": subprocess.DEVNULL, "stderr": file}
        done = subprocess.run(
            [str(word) for word in command],
            preexec_fn=prepare,
            env=plain if buffered else plain | {"PYTHONUNBUFFERED": "1"},
            check=False,
            timeout=120,
            **streams,
        )
    return done.returncode, other.read_text()


@pytest.fixture
def other(tmp_path):
    """File that takes what the other stream says."""
    return tmp_path / "other.txt"


def cannot_be_printed(code, told):
    (sentence,) = told.splitlines()
    assert sentence.startswith("mfd-bayes: cannot write the output: ")
    assert code == 2


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
@pytest.mark.parametrize("state", ["full", "closed"])
@pytest.mark.parametrize(
    "words", [("check", "{out}"), ("--version",), ("check", "--help")], ids=" ".join
)
def test_an_output_that_takes_nothing_is_told_in_one_sentence(light, other, words, state):
    words = [word.format(out=other.parent) for word in words]
    cannot_be_printed(*ran([*light, *words], 1, state, other))


@pytest.mark.parametrize(
    ("words", "code"), [(("check", "{out}"), 1), (("--version",), 0), (("check", "--help"), 0)]
)
def test_an_output_whose_reader_has_seen_enough_is_no_error(light, other, words, code):
    words = [word.format(out=other.parent) for word in words]
    assert ran([*light, *words], 1, "broken", other) == (code, "")


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
def test_a_whole_check_whose_output_is_full_is_told_in_one_sentence(stored, other):
    cannot_be_printed(*ran([*WHOLE, "check", stored], 1, "full", other))


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
@STATES
@pytest.mark.parametrize("buffered", [True, False])
def test_a_refusal_that_nobody_can_hear_goes_to_the_output(light, other, state, buffered):
    code, told = ran([*light, "check", other.parent / "none"], 2, state, other, buffered)
    (sentence,) = told.splitlines()
    assert "is not a run folder" in sentence
    assert code == 2


def changes_nothing(code, told):
    assert code == 1  # its verdict
    assert told.count("\n") == 1


@STATES
def test_messages_that_nobody_asked_for_change_nothing(light, other, state):
    changes_nothing(*ran([*light, "check", other.parent, "--quiet"], 2, state, other))


@pytest.mark.slow
def test_a_whole_check_needs_no_place_for_messages(stored, other):
    changes_nothing(*ran([*WHOLE, "check", stored, "--quiet"], 2, "closed", other))


def test_a_file_does_not_get_what_is_printed_where_the_output_is_closed(stored, other, tmp_path):
    motion = tmp_path / "m.csv"
    rows = "".join(f"{i / 10},{(-1) ** (i // 10) * (i % 10)}\n" for i in range(100))
    motion.write_text("time_s,displacement_in\n" + rows)
    words = ("predict", stored, "--motion", motion, "--actuation", "500 psi", "--extrapolate")
    code, told = ran([*WHOLE, *words, "-o", tmp_path / "b.csv"], 1, "closed", other)
    assert code == 2
    assert "cannot write the output: it is closed" in told
    assert (tmp_path / "b.csv").read_text().startswith("# equal-tailed")
    assert (tmp_path / "b.png").read_bytes().startswith(b"\x89PNG")
