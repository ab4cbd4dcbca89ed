"""One process at a time in a run folder: a second one is refused with the name of the owner."""

import os
import shutil
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager

import numpy as np
import pytest

from mfd_bayes.errors import StoreError
from mfd_bayes.runs.folder import OWNER, alone_in
from mfd_bayes.runs.run import open_run
from tests.command_line import contents, refusal, write_csv

HOLD = """\
import sys, time
from pathlib import Path
from mfd_bayes.jobs.signals import end_on_signals
from mfd_bayes.runs.folder import alone_in

with end_on_signals(), alone_in(Path(sys.argv[1])):
    print("in", flush=True)
    for _ in range(2400):  # one long sleep would not hear of a signal that came just before it
        time.sleep(0.05)
"""


@contextmanager
def held(folder):
    """Another process that works in a folder."""
    command = [sys.executable, "-c", HOLD, str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "in\n"
            yield process
        finally:
            process.kill()


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


def test_a_second_process_is_refused_with_the_owners_name(out):
    with held(out) as process:
        with pytest.raises(StoreError) as caught, alone_in(out):
            pytest.fail("two are at work")
        sentence = str(caught.value)
        owner = f"'-c {out}', process {process.pid} on {socket.gethostname()} since "
        assert sentence.startswith(f"another process is working in {out}: {owner}")
        assert (out / OWNER).is_file()  # the refused process does not remove the owner's name
    with alone_in(out):  # of a killed owner the name is no lock
        assert f"process {os.getpid()} on" in (out / OWNER).read_text()


def test_a_process_that_ends_leaves_no_file(out):
    with pytest.raises(KeyError), alone_in(out):
        raise KeyError
    assert not list(out.iterdir())
    with held(out) as process:
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 128 + signal.SIGTERM
    assert not list(out.iterdir())
    (out / OWNER).write_bytes(b"\xff")  # a file that no process holds is no lock
    with alone_in(out):
        pass
    assert not list(out.iterdir())


# --- everything that writes into a run folder takes the lock; what reads notices a change


def test_every_command_that_writes_into_a_run_takes_its_lock(small_run, tmp_path):
    folder, campaign = shutil.copytree(small_run, tmp_path / "lugre"), tmp_path / "campaign.toml"
    campaign.write_text('[[test]]\nid = "a"\nfile = "a.csv"\nactuation = "500 psi"\n')
    time = np.arange(401) / 50
    write_csv(tmp_path / "a.csv", time, np.sin(np.pi * time), np.tanh(4 * np.cos(np.pi * time)))
    with held(folder) as owner:
        snapshot = contents(folder)
        for words in (
            ("report", folder),
            ("calibrate", campaign, "-o", folder, "--resume"),
            ("demo", folder, "--force"),
            ("compare", campaign, "-o", tmp_path, "--models", "lugre,bouc_wen", "--resume"),
        ):
            sentence = refusal(*words)
            assert "another process is working in" in sentence, words
            assert f"process {owner.pid} " in sentence, words
        assert contents(folder) == snapshot


def test_draws_of_another_run_are_not_taken_for_those_that_were_opened(small_run, tmp_path):
    folder = shutil.copytree(small_run, tmp_path / "out")
    test = open_run(folder).tests["a"]
    path = folder / "tests" / "a" / "posterior.nc"
    path.write_bytes(path.read_bytes() + b"\0")
    with pytest.raises(StoreError, match="was changed by another process"):
        _ = test.draws
