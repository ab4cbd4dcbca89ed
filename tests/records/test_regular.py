"""What is read as a file is a file: a pipe does not hang a command, and a device is named."""

import json
import os
import shutil
import socket
import subprocess
import sys

import pytest

from tests.run_folders import write_run

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

# Runs commands, each in a folder of its own, and prints how each ended. It is a process because
# a command that hangs is not always heard in the process of the tests.
COMMANDS = """\
import json, os, sys
from typer.testing import CliRunner
from mfd_bayes.cli.commands import app

for key, folder, *words in json.loads(sys.argv[1]):
    os.chdir(folder)
    ended = CliRunner().invoke(app, words)
    print(json.dumps([key, ended.exit_code, ended.stderr]), flush=True)
"""


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("regular") / "run"
    write_run(folder, small=True)
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


def prepared(stored, folder, reader, kind):
    """Folder in which one file is something else, and the words of the command that reads it."""
    words, name = READERS[reader]
    folder.mkdir()
    (folder / "campaign.toml").write_text(CAMPAIGN)
    (folder / "a.csv").write_text("time_s,displacement_in,force_kip\n")
    shutil.copytree(stored, folder / "run")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir((folder / name).parent)
        make(kind, folder / name)
    return [str(folder), *(word.format(odd=name) for word in words)]


@pytest.fixture(scope="module")
def ended(stored, tmp_path_factory):
    """Exit code and errors of every command, by its key; a command that hangs has none."""
    home = tmp_path_factory.mktemp("odd")
    kinds = [kind for kind in KINDS if kind != "device" or os.geteuid() == 0]
    keys = [(reader, kind) for reader in READERS for kind in kinds]
    asked = [[key, *prepared(stored, home / "_".join(key), *key)] for key in keys]
    with (home / "ended.txt").open("w") as file:
        process = subprocess.Popen(
            [sys.executable, "-c", COMMANDS, json.dumps(asked)],
            stdout=file,
            stderr=subprocess.DEVNULL,
        )
        try:
            process.wait(120)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    lines = map(json.loads, (home / "ended.txt").read_text().splitlines())
    return {tuple(key): (code, errors) for key, code, errors in lines}


def assert_refused(code, errors, reader):
    assert code == 2
    (sentence,) = errors.splitlines()
    assert "not a file" in sentence
    assert READERS[reader][1].rpartition("/")[2] in sentence


def test_what_is_no_file_is_refused_at_once(ended):
    kinds = [kind for kind in KINDS if kind != "device" or os.geteuid() == 0]
    for reader in READERS:
        for kind in kinds:
            assert (reader, kind) in ended, f"it hung in a command after {list(ended)}"
            assert_refused(*ended[reader, kind], reader)


def test_the_command_itself_refuses_a_pipe_at_once(stored, tmp_path):
    folder, *words = prepared(stored, tmp_path / "odd", "record", "pipe")
    done = subprocess.run(
        [sys.executable, "-m", "mfd_bayes", *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert_refused(done.returncode, done.stderr, "record")
