"""Processes that are forked from a server, and the server itself."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from mfd_bayes.jobs.processes import context, started_alike

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has the server here")

SLOW = "import time\nfrom mfd_bayes.jobs.processes import importing\n"
WAITING = """
import time
from mfd_bayes.jobs.processes import get_ready
get_ready("slow_module")
print("ready", flush=True)
time.sleep(60)
"""
LOOKING = """
import sys
from concurrent.futures import ProcessPoolExecutor
from mfd_bayes.jobs.processes import context, get_ready, started_alike
if __name__ == "__main__":
    get_ready("colorsys")
    with started_alike(), ProcessPoolExecutor(1, context()) as pool:
        print(pool.submit(eval, "'colorsys' in __import__('sys').modules").result())
    print("colorsys" in sys.modules)
"""

ENDED = """
import sys, time
from concurrent.futures import ProcessPoolExecutor
from mfd_bayes.jobs import processes
from mfd_bayes.jobs.signals import end_on_signals
if __name__ == "__main__":
    if sys.argv[1:] == ["untold"]:
        processes._TIDIED = ""
    processes.get_ready("colorsys")
    with end_on_signals(), ProcessPoolExecutor(1, processes.context()) as pool:
        with processes.started_alike():
            print(pool.submit(int).result(), flush=True)
        time.sleep(60)
"""


LONG = """
import sys
from concurrent.futures import ProcessPoolExecutor
from mfd_bayes.jobs.processes import context, get_ready, started_alike
if __name__ == "__main__":
    get_ready("colorsys")
    with started_alike(), ProcessPoolExecutor(1, context()) as pool:
        print(pool.submit(int).result(), context().get_start_method())
"""


def run(script: str, folder: Path, *words: str) -> "subprocess.Popen[str]":
    """Start Python with a script in a session of its own."""
    file = folder / "script.py"
    file.write_text(script)
    return subprocess.Popen(
        [sys.executable, str(file), *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(folder)},
        start_new_session=True,
    )


def of_session(leader: int) -> list[int]:
    """Live processes of a session."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if entry.name.isdigit() and int(fields[3]) == leader and fields[0] != "Z":
            found.append(int(entry.name))
    return found


def seconds_until_alone(process: "subprocess.Popen[str]", most: float) -> float:
    """Seconds from the death of a process until none of its session lives; `most` if some do."""
    process.send_signal(signal.SIGKILL)
    process.wait()
    began = time.monotonic()
    while of_session(process.pid) and time.monotonic() < began + most:
        time.sleep(0.05)
    return min(time.monotonic() - began, most)


def test_a_process_begins_with_what_the_server_has_imported(tmp_path):
    process = run(LOOKING, tmp_path)
    assert process.communicate(timeout=60)[0].split() == ["True", "False"]


@pytest.mark.parametrize("watched", [True, False])
def test_the_server_ends_with_its_parent_while_it_imports(tmp_path, watched):
    within = "with importing():\n    " if watched else ""
    (tmp_path / "slow_module.py").write_text(f"{SLOW}{within}time.sleep(20)\n")
    process = run(WAITING, tmp_path)
    assert process.stdout.readline() == "ready\n"
    time.sleep(1.0)  # the server has begun to import
    alone = seconds_until_alone(process, 3.0)
    for left in of_session(process.pid):
        os.kill(left, signal.SIGKILL)
    process.stdout.close()
    process.stderr.close()
    assert (alone < 3.0) == watched


@pytest.mark.parametrize(("size", "how"), [(75, "forkserver"), (76, "spawn"), (120, "spawn")])
def test_processes_start_also_where_the_folder_of_temporary_files_has_a_long_name(
    tmp_path, monkeypatch, size, how
):
    with tempfile.TemporaryDirectory(dir="/tmp") as short:
        folder = Path(short) / ("x" * (size - len(short) - 1))
        folder.mkdir()
        monkeypatch.setenv("TMPDIR", str(folder))
        printed, complaint = run(LONG, tmp_path).communicate(timeout=60)
    assert (printed.split(), complaint) == (["0", how], "")


@pytest.mark.parametrize("words", [(), ("untold",)])
def test_a_signal_ends_a_pool_with_one_sentence(tmp_path, words):
    process = run(ENDED, tmp_path, *words)
    assert process.stdout.readline() == "0\n"
    process.send_signal(signal.SIGTERM)
    complaint = process.communicate(timeout=60)[1]
    assert process.returncode == 143
    assert ("leaked semaphore" in complaint) == bool(words)
    if not words:
        assert complaint == "mfd-bayes: interrupted by SIGTERM\n"


def test_processes_have_one_thread_whatever_this_one_has(monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    with started_alike(), ProcessPoolExecutor(1, context()) as pool:
        assert pool.submit(os.getenv, "OPENBLAS_NUM_THREADS").result() == "1"
    assert os.environ["OPENBLAS_NUM_THREADS"] == "7"
