"""One process at a time in a run folder: a second one is refused with the name of the owner."""

import errno
import fcntl
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import pytest

from mfd_bayes.errors import StoreError
from mfd_bayes.runs import lock
from mfd_bayes.runs.lock import OWNER, Owner, alone_in

HOLD = """\
import sys, time
from pathlib import Path
from mfd_bayes.jobs.signals import end_on_signals
from mfd_bayes.runs.lock import alone_in

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
    out.mkdir()
    facts = {"host": socket.gethostname(), "boot": "", "pid": 2**22 + 1, "command": "mfd-bayes x"}
    (out / OWNER).write_text(json.dumps(facts | {"since": "2026-01-02 03:04:05 UTC"} | changes))


def test_a_second_process_is_refused_with_the_owners_name(out):
    with held(out) as process:
        with (
            pytest.raises(StoreError, match="another process is calibrating into") as caught,
            alone_in(out),
        ):
            pytest.fail("two are at work")
        sentence = str(caught.value)
        for word in (str(out), f"process {process.pid} on {socket.gethostname()} since ", "UTC"):
            assert word in sentence
        assert f"'-c {out}'" in sentence  # its command
        assert (out / OWNER).is_file()  # the refused process does not remove the owner's name
    with alone_in(out):
        pass


def test_a_released_lock_leaves_no_file(out):
    with alone_in(out):
        assert json.loads((out / OWNER).read_text())["pid"] == os.getpid()
    with pytest.raises(KeyError), alone_in(out):
        raise KeyError
    assert not list(out.iterdir())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_process_ended_by_a_signal_leaves_no_file(out, number):
    with held(out) as process:
        process.send_signal(number)
        assert process.wait(20) == 128 + number
    assert not list(out.iterdir())


READ_ONLY = """\
import errno

def refuse(*_, **__):
    raise OSError(errno.EROFS, "Read-only file system")

Path.unlink = refuse
"""


def test_a_process_that_cannot_remove_the_owners_name_ends_the_same_way(out):
    script = HOLD.replace("with end_on", f"{READ_ONLY}\nwith end_on")
    with held(out, script) as process:
        process.send_signal(signal.SIGINT)
        _, complaint = process.communicate(timeout=20)
    assert process.returncode == 130
    assert complaint == "mfd-bayes: interrupted\n"
    with alone_in(out):  # a name left behind is not a lock
        pass


def test_the_name_of_a_killed_owner_is_no_lock(out):
    with held(out) as process:
        process.kill()
        process.wait()
    assert (out / OWNER).is_file()
    with alone_in(out):
        assert json.loads((out / OWNER).read_text())["pid"] == os.getpid()


def test_an_owner_on_another_machine_is_refused_with_what_to_do(out):
    leave(out, host="node7", boot="another")
    with pytest.raises(StoreError) as caught, alone_in(out):
        pytest.fail("it may be at work")
    sentence = str(caught.value)
    for word in ("'mfd-bayes x', process 4194305 on node7 since 2026-01-02", "cannot see whether"):
        assert word in sentence
    assert f"if it has ended, remove {out / OWNER}" in sentence
    (out / OWNER).unlink()
    with alone_in(out):
        pass


@pytest.mark.skipif(not lock._BOOT.is_file(), reason="this system does not name its start")
def test_a_dead_owner_in_another_container_of_this_machine_is_no_lock(out):
    leave(out, host="container", boot=lock._BOOT.read_text().strip())
    with alone_in(out):
        pass


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"host": "node7"}'])
def test_an_owners_file_that_cannot_be_read_is_no_lock(out, content):
    out.mkdir()
    (out / OWNER).write_text(content)
    with alone_in(out):
        pass


@pytest.fixture
def without_locks(monkeypatch):
    """A file system without locks."""

    def fail(handle, operation):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", fail)


@pytest.mark.parametrize("alive", [True, False])
def test_without_locks_only_a_living_owner_is_refused(out, without_locks, alive):
    leave(out, pid=os.getppid() if alive else 2**22 + 1)
    if alive:
        with pytest.raises(StoreError, match=f"process {os.getppid()} on"), alone_in(out):
            pytest.fail("it is at work")
    else:
        with alone_in(out):
            pass


def test_a_dead_owner_is_not_named_when_another_process_has_the_lock(out):
    leave(out)
    folder = os.open(out, os.O_RDONLY)
    fcntl.flock(folder, fcntl.LOCK_EX)
    try:
        with pytest.raises(StoreError) as caught, alone_in(out):
            pytest.fail("it is locked")
    finally:
        os.close(folder)
    assert "4194305" not in str(caught.value)


def test_the_lock_works_outside_the_main_thread(out):
    found = []

    def work():
        with alone_in(out):
            found.append(Owner(**json.loads((out / OWNER).read_text())))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found[0].on_this_machine
    assert found[0].alive


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with (
        pytest.raises(StoreError, match="cannot make the run folder"),
        alone_in(Path(tmp_path / "file" / "out")),
    ):
        pytest.fail("there is no such folder")


@pytest.mark.parametrize(
    ("key", "value"), [("pid", "1"), ("pid", -1), ("pid", 10**30), ("host", None), ("since", [])]
)
def test_an_owners_file_with_wrong_values_is_no_lock(out, key, value):
    leave(out)
    named = json.loads((out / OWNER).read_text()) | {key: value}
    (out / OWNER).write_text(json.dumps(named))
    with alone_in(out):
        pass
