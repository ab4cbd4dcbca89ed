"""One process at a time in a run folder: a second one is refused with the name of the owner."""

import errno
import fcntl
import json
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mfd_bayes.cli.commands import app
from mfd_bayes.errors import StoreError
from mfd_bayes.runs.folder import OWNER, alone_in
from mfd_bayes.runs.run import open_run
from tests.run_folders import write_run

BOOT = Path("/proc/sys/kernel/random/boot_id")

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
def held(out, script=HOLD):
    """Another process that works in a folder."""
    with subprocess.Popen(
        [sys.executable, "-c", script, str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout.readline() == "in\n"
            yield process
        finally:
            process.kill()


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


def leave(out, **changes):
    """Write the name of an owner into a folder."""
    out.mkdir(exist_ok=True)
    facts = {"host": socket.gethostname(), "boot": "", "pid": 2**22 + 1, "command": "mfd-bayes x"}
    (out / OWNER).write_text(json.dumps(facts | {"since": "2026-01-02 03:04:05 UTC"} | changes))


def refused(out):
    """Sentence with which a process is refused."""
    with pytest.raises(StoreError) as caught, alone_in(out):
        pytest.fail("two are at work")
    return str(caught.value)


def test_a_second_process_is_refused_with_the_owners_name(out):
    with held(out) as process:
        sentence = refused(out)
        for word in (str(out), f"process {process.pid} on {socket.gethostname()} since ", "UTC"):
            assert word in sentence
        assert "another process is working in" in sentence
        assert f"'-c {out}'" in sentence  # its command
        assert (out / OWNER).is_file()  # the refused process does not remove the owner's name
    with alone_in(out):  # of a killed owner the name is no lock
        assert json.loads((out / OWNER).read_text())["pid"] == os.getpid()


def test_a_released_lock_leaves_no_file(out):
    with pytest.raises(KeyError), alone_in(out):
        raise KeyError
    assert not list(out.iterdir())


@pytest.mark.parametrize("number", [signal.SIGTERM])
def test_a_process_ended_by_a_signal_leaves_no_file(out, number):
    with held(out) as process:
        process.send_signal(number)
        assert process.wait(60) == 128 + number
    assert not list(out.iterdir())


def test_an_owner_on_another_machine_is_refused_with_what_to_do(out):
    leave(out, host="node7", boot="another")
    sentence = refused(out)
    for word in ("'mfd-bayes x', process 4194305 on node7 since 2026-01-02", "cannot see whether"):
        assert word in sentence
    assert f"if it has ended, remove {out / OWNER}" in sentence


def test_an_owners_file_that_cannot_be_read_or_of_a_dead_one_is_no_lock(out):
    for content in [
        "[]",
        '{"host": "node7"}',
        {"pid": "1"},
        {"pid": 10**30},
    ]:
        leave(out, **(content if isinstance(content, dict) else {}))
        if isinstance(content, str):
            (out / OWNER).write_text(content)
        with alone_in(out):
            pass
        leave(
            out,
            host="container",
            boot=BOOT.read_text().strip() if BOOT.is_file() else "x",
        )
        if BOOT.is_file():  # dead, in another container of this machine
            with alone_in(out):
                pass


def test_without_locks_only_a_living_owner_is_refused(out, monkeypatch):
    for alive in [True, False]:

        def fail(handle, operation):
            raise OSError(errno.ENOLCK, "No locks available")

        monkeypatch.setattr(fcntl, "flock", fail)
        leave(out, pid=os.getppid() if alive else 2**22 + 1)
        if alive:
            assert f"process {os.getppid()} on" in refused(out)
        else:
            with alone_in(out):
                pass


# --- everything that writes into a run folder takes the lock; what reads notices a change

WRITERS = {
    "report": ("report", "{out}"),
    "calibrate": ("calibrate", "{campaign}", "-o", "{out}", "--force"),
    "resume": ("calibrate", "{campaign}", "-o", "{out}", "--resume"),
    "crossvalidate": ("crossvalidate", "{campaign}", "-o", "{out}", "--resume"),
    "demo": ("demo", "{out}", "--force"),
    "compare": ("compare", "{campaign}", "-o", "{above}", "--models", "lugre,bouc_wen", "--resume"),
}

CAMPAIGN = '[[test]]\nid = "a"\nfile = "a.csv"\nactuation = "500 psi"\n'


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A finished run folder that no sampler has seen, named as a model of a comparison."""
    folder = tmp_path_factory.mktemp("stored") / "lugre"
    write_run(folder, small=True)
    return folder


@pytest.fixture
def run_folder(stored, tmp_path):
    shutil.copytree(stored, tmp_path / "lugre")
    text = CAMPAIGN + CAMPAIGN.replace('"a"', '"b"').replace("500", "900")
    (tmp_path / "campaign.toml").write_text(text)
    time = [i / 50 for i in range(401)]
    rows = [f"{t},{math.sin(math.pi * t)},{math.tanh(4 * math.cos(math.pi * t))}" for t in time]
    (tmp_path / "a.csv").write_text("time_s,displacement_in,force_kip\n" + "\n".join(rows))
    return tmp_path / "lugre"


def test_every_command_that_writes_into_a_run_takes_its_lock(run_folder):
    home = run_folder.parent
    places = {"out": run_folder, "above": home, "campaign": home / "campaign.toml"}
    with held(run_folder) as owner:
        before = {p: p.read_bytes() for p in run_folder.rglob("*") if p.is_file()}
        for name, words in WRITERS.items():
            outcome = CliRunner().invoke(app, [word.format(**places) for word in words])
            assert outcome.exit_code == 2, (name, outcome.output)
            (sentence,) = outcome.stderr.splitlines()
            assert "another process is working in" in sentence, name
            assert f"process {owner.pid} " in sentence, name
        assert {p: p.read_bytes() for p in run_folder.rglob("*") if p.is_file()} == before


def change(out):
    """What another process does to a run: the files of another seed, and its manifest."""
    manifest = json.loads((out / "manifest.json").read_text())
    manifest |= {"seed": 2, "status": "running"}
    (out / "manifest.json").write_text(json.dumps(manifest))


def test_draws_of_another_run_are_not_taken_for_those_that_were_opened(run_folder):
    found = open_run(run_folder).tests["a"]
    path = run_folder / "tests" / "a" / "posterior.nc"
    path.write_bytes(path.read_bytes() + b"\0")
    with pytest.raises(StoreError, match="was changed by another process"):
        _ = found.draws
