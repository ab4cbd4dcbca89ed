"""Standard streams that are full, closed or broken end a command with one sentence and exit 2."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

COMMAND = (sys.executable, "-m", "mfd_bayes")
FULL = Path("/dev/full")


@pytest.fixture(scope="module")
def stored(tmp_path_factory, benchmark_module):
    folder = tmp_path_factory.mktemp("streams") / "out"
    benchmark_module("fuzz.runs").write_run(folder, small=True)
    return folder


def ran(words, number, state, tmp_path):
    """A command whose stream of that number is in some state: exit code, and the other stream."""
    other = tmp_path / "other.txt"

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
            [*COMMAND, *map(str, words)], preexec_fn=prepare, check=False, timeout=120, **streams
        )
    return done.returncode, other.read_text()


COMMANDS = (
    ("check", "{out}"),
    ("--version",),
    ("check", "--help"),
)


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
@pytest.mark.parametrize("state", ["full", "closed", "broken"])
@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_an_output_that_takes_nothing_is_told_in_one_sentence(stored, tmp_path, words, state):
    code, told = ran([word.format(out=stored) for word in words], 1, state, tmp_path)
    (sentence,) = told.splitlines()
    assert sentence.startswith("mfd-bayes: cannot write the output: ")
    assert code == 2


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
@pytest.mark.parametrize("state", ["full", "closed", "broken"])
def test_a_refusal_that_nobody_can_hear_goes_to_the_output(tmp_path, state):
    code, told = ran(["check", tmp_path / "none"], 2, state, tmp_path)
    (sentence,) = told.splitlines()
    assert "is not a run folder" in sentence
    assert code == 2


@pytest.mark.parametrize("state", ["full", "closed", "broken"])
def test_messages_that_nobody_asked_for_change_nothing(stored, tmp_path, state):
    code, told = ran(["check", stored, "--quiet"], 2, state, tmp_path)
    assert code == 1  # its verdict
    assert told.count("\n") == 1


def test_a_file_does_not_get_what_is_printed_where_the_output_is_closed(stored, tmp_path):
    motion = tmp_path / "m.csv"
    rows = "".join(f"{i / 10},{(-1) ** (i // 10) * (i % 10)}\n" for i in range(100))
    motion.write_text("time_s,displacement_in\n" + rows)
    words = ("predict", stored, "--motion", motion, "--actuation", "500 psi")
    code, told = ran([*words, "-o", tmp_path / "b.csv"], 1, "closed", tmp_path)
    assert code == 2
    assert "cannot write the output: it is closed" in told
    assert (tmp_path / "b.csv").read_text().startswith("# equal-tailed")
    assert (tmp_path / "b.png").read_bytes().startswith(b"\x89PNG")
