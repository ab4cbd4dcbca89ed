"""Standard streams that are full or closed, and short memory, end a command with one sentence."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from mfd_bayes.cli.options import mistakes
from tests.run_folders import write_run

WHOLE = (sys.executable, "-m", "mfd_bayes")
FULL = Path("/dev/full")
full = pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")


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


@full
def test_an_output_that_takes_nothing_is_said_in_one_sentence(run):
    for words in (["--help"], ["check", "none", "--help"]):
        code, said = run([*WHOLE, *words], 1, "full")
        (sentence,) = said.splitlines()
        assert sentence.startswith("mfd-bayes: cannot write the output: ")
        assert code == 2


def test_an_output_whose_reader_has_seen_enough_is_no_error(run):
    assert run([*WHOLE, "--help"], 1, "broken") == (0, "")


def test_a_file_does_not_get_what_is_printed_where_the_output_is_closed(stored, run, tmp_path):
    motion = tmp_path / "m.csv"
    rows = "".join(f"{i / 10},{(-1) ** (i // 10) * (i % 10)}\n" for i in range(100))
    motion.write_text("time_s,displacement_in\n" + rows)
    words = ("predict", stored, "--motion", motion, "--actuation", "500 psi", "--extrapolate")
    code, said = run([*WHOLE, *words, "--no-figures", "-o", tmp_path / "b.csv"], 1, "closed")
    assert (code, "warning: the run is not usable" in said) == (0, True)
    assert (tmp_path / "b.csv").read_text().startswith("# equal-tailed")


def test_short_memory_is_said_in_a_sentence(capsys):
    for error, resume, said in [
        (MemoryError("Unable to allocate 3 GiB"), "", "short: Unable to allocate 3 GiB"),
        (MemoryError(), "a --resume", "short; what is finished is kept, go on with: a --resume"),
    ]:
        with pytest.raises(typer.Exit) as ended, mistakes(resume):
            raise error
        assert ended.value.exit_code == 2
        (sentence,) = capsys.readouterr().err.splitlines()
        assert sentence.startswith("mfd-bayes: ")
        assert sentence.endswith(said)
