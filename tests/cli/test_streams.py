"""Standard streams that are full or closed, and short memory, end a command with one sentence."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from mfd_bayes.cli.streams import mistakes


def run(script, *words):
    """Exit code and messages of the command, which is "$@" in a script of bash."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    environment["PYTHONPATH"] = os.pathsep.join(sys.path)
    command = ["bash", "-c", script, "bash", sys.executable, "-m", "mfd_bayes", *map(str, words)]
    how = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True, "timeout": 120}
    process = subprocess.run(command, env=environment, check=False, **how)
    return process.returncode, process.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_an_output_that_takes_nothing_is_said_in_one_sentence():
    code, stderr = run('"$@" > /dev/full', "--help")
    (sentence,) = stderr.splitlines()
    assert sentence.startswith("mfd-bayes: cannot write the output: ")
    assert code == 2


def test_an_output_whose_reader_has_seen_enough_is_no_error():
    assert run('"$@" | true; exit ${PIPESTATUS[0]}', "--help") == (0, "")


def test_a_file_does_not_get_what_is_printed_where_the_output_is_closed(small_run, tmp_path):
    bands = tmp_path / "b.csv"
    words = ("predict", small_run, "--sine", "1 in, 1 Hz, 2 cycles", "--actuation", "500 psi")
    code, stderr = run('"$@" >&-', *words, "--extrapolate", "--no-figures", "-o", bands)
    assert (code, "warning: the run is not usable" in stderr) == (0, True)
    assert bands.read_text().startswith("# equal-tailed")


def test_short_memory_is_said_in_a_sentence(capsys):
    with pytest.raises(typer.Exit) as ended, mistakes(lambda: "a --resume"):
        raise MemoryError("Unable to allocate 3 GiB")
    assert ended.value.exit_code == 2
    (sentence,) = capsys.readouterr().err.splitlines()
    assert "Unable to allocate 3 GiB" in sentence
    assert sentence.endswith("what is finished is kept, go on with: a --resume")
