"""Standard streams that are full or closed, and short memory, end a command with one sentence."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from mfd_bayes.cli.options import mistakes

FULL = Path("/dev/full")
full = pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")


@pytest.fixture
def run(tmp_path):
    """Function that runs a command whose standard output is in some state: code and messages."""

    def run(words, state):
        plain = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
        plain["PYTHONPATH"] = os.pathsep.join(sys.path)

        def prepare():
            if state == "closed":
                os.close(1)
            elif state == "full":
                os.dup2(os.open(FULL, os.O_WRONLY), 1)
            else:
                reader, writer = os.pipe()
                os.close(reader)
                os.dup2(writer, 1)

        other = tmp_path / "other.txt"
        with other.open("wb") as file:
            done = subprocess.run(
                [sys.executable, "-m", "mfd_bayes", *map(str, words)],
                stdout=subprocess.DEVNULL,
                stderr=file,
                preexec_fn=prepare,
                env=plain,
                check=False,
                timeout=120,
            )
        return done.returncode, other.read_text()

    return run


@full
def test_an_output_that_takes_nothing_is_said_in_one_sentence(run):
    code, said = run(["--help"], "full")
    (sentence,) = said.splitlines()
    assert sentence.startswith("mfd-bayes: cannot write the output: ")
    assert code == 2


def test_an_output_whose_reader_has_seen_enough_is_no_error(run):
    assert run(["--help"], "broken") == (0, "")


def test_a_file_does_not_get_what_is_printed_where_the_output_is_closed(small_run, run, tmp_path):
    bands = tmp_path / "b.csv"
    words = ("predict", small_run, "--sine", "1 in, 1 Hz, 2 cycles", "--actuation", "500 psi")
    code, said = run([*words, "--extrapolate", "--no-figures", "-o", bands], "closed")
    assert (code, "warning: the run is not usable" in said) == (0, True)
    assert bands.read_text().startswith("# equal-tailed")


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
