"""What is read as a file is a file: a pipe does not hang a command, and a device is named."""

import os
import shutil
import socket
import subprocess
import sys

import pytest

KINDS = ("pipe", "socket", "device")
READERS = {
    "campaign": (("calibrate", "{odd}", "-o", "out", "--dry-run"), "odd.toml"),
    "record": (("inspect", "{odd}"), "odd.csv"),
    "manifest": (("check", "run"), "run/manifest.json"),
    "posterior": (("check", "run"), "run/tests/a/posterior.nc"),
}
CAMPAIGN = """\
[campaign]
priors = "odd.toml"

[[test]]
id = "a"
file = "a.csv"
actuation = "500 psi"
"""


@pytest.fixture(scope="module")
def stored(tmp_path_factory, benchmark_module):
    folder = tmp_path_factory.mktemp("regular") / "run"
    benchmark_module("fuzz.runs").write_run(folder, small=True)
    return folder


def make(kind, path):
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        os.mknod(path, 0o20666, os.makedev(1, 5))  # as /dev/zero, which never ends
    else:
        with socket.socket(socket.AF_UNIX) as found:
            found.bind(path.name)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_file_is_refused_at_once(stored, tmp_path, monkeypatch, reader, kind):
    if kind == "device" and os.geteuid() != 0:
        pytest.skip("only root makes a device")
    words, name = READERS[reader]
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    (tmp_path / "a.csv").write_text("time_s,displacement_in,force_kip\n")
    shutil.copytree(stored, tmp_path / "run")
    monkeypatch.chdir((tmp_path / name).parent)
    make(kind, tmp_path / name)
    done = subprocess.run(
        [sys.executable, "-m", "mfd_bayes", *(word.format(odd=name) for word in words)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2, done
    (sentence,) = done.stderr.splitlines()
    assert "not a file" in sentence
    assert name.rpartition("/")[2] in sentence
