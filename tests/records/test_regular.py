"""What is read as a file is a file: a pipe does not hang a command, and a device is named."""

import os
import shutil
import signal
import socket

from tests.command_line import refusal

READERS = {
    "odd.toml": ("calibrate", "odd.toml", "-o", "out", "--dry-run"),
    "odd.csv": ("inspect", "odd.csv"),
    "run/manifest.json": ("check", "run"),
    "run/tests/a/posterior.nc": ("check", "run"),
}


def make(kind, path, monkeypatch):
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        os.mknod(path, 0o20666, os.makedev(1, 5))  # as /dev/zero, which never ends
    else:
        monkeypatch.chdir(path.parent)  # the path of a socket is short
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(path.name)


def too_late(*_):
    raise TimeoutError("the command hangs")


def test_what_is_no_file_is_refused_at_once(tmp_path, monkeypatch, small_run):
    handler = signal.signal(signal.SIGALRM, too_late)
    for kind in ("pipe", "socket", *(["device"] if os.geteuid() == 0 else [])):
        for name, words in READERS.items():
            folder = tmp_path / kind / name.replace("/", "_")
            shutil.copytree(small_run, folder / "run")
            make(kind, folder / name, monkeypatch)
            monkeypatch.chdir(folder)
            signal.alarm(60)
            sentence = refusal(*words)
            signal.alarm(0)
            assert "not a file" in sentence or "is missing" in sentence, (kind, name)
            assert name.rpartition("/")[2] in sentence, (kind, name)
    signal.signal(signal.SIGALRM, handler)
