"""A dask scheduler and two workers as processes of this machine, and faults of them."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from distributed import Client

from benchmarks.interruption.harness import of_session

PATIENCE = 300.0
"""Seconds in which the processes of a cluster must start."""

PAUSE = 3.0
"""Seconds until another worker comes, or until Ctrl-C where none does."""


@dataclass
class Cluster:
    """The processes, each the leader of a session, and the folder of their files and words."""

    home: Path
    scheduler: subprocess.Popen[bytes]
    address: str = ""
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def add_worker(self) -> None:
        """Start one more worker as it is documented: a nanny, and the process that it minds."""
        words = (self.address, "--nthreads", "1", "--no-dashboard", "--local-directory", self.home)
        name = f"worker{len(self.workers)}.log"
        self.workers.append(_start(self.home / name, "dask_worker", *words))

    def busy(self) -> bool:
        """Whether any worker has something to do."""
        with Client(self.address, set_as_default=False) as client:
            return any(client.processing().values())


@contextmanager
def cluster(home: Path) -> Iterator[Cluster]:
    """A scheduler with two workers, until the end of the block."""
    home.mkdir()
    file = home / "scheduler.json"
    words = ("--port", "0", "--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", file)
    found = Cluster(home, _start(home / "scheduler.log", "dask_scheduler", *words))
    try:
        found.address = _address(file)
        for _ in range(2):
            found.add_worker()
        with Client(found.address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=PATIENCE)
        yield found
    finally:
        for process in (*found.workers, found.scheduler):
            lose(process)


def disturb_cluster(
    kind: str, process: subprocess.Popen[str], own: Cluster, printed: Path, moment: float
) -> bool:
    """Kill parts of a cluster while a command runs; whether the command was still running."""
    time.sleep(moment)
    if process.poll() is not None:
        return False
    if kind == "scheduler":
        lose(own.scheduler)
    elif kind == "client":
        process.kill()
    else:
        for worker in own.workers[: 1 if kind == "lost worker" else 2]:
            lose(worker)
    if kind == "all workers":
        time.sleep(PAUSE)
        own.add_worker()
    elif kind == "no workers":  # it says so and waits, until it is told to end
        until = time.monotonic() + PATIENCE
        while process.poll() is None and "waits for a worker" not in printed.read_text():
            time.sleep(0.1)
            if time.monotonic() > until:
                break
        time.sleep(PAUSE)
        process.send_signal(signal.SIGINT)
    return True


def lose(process: subprocess.Popen[bytes]) -> None:
    """Kill a process with all its children, as when its machine dies."""
    while alive := of_session(process.pid):  # a nanny may just have started another
        for pid, _ in alive:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
    process.wait()


def _start(log: Path, module: str, *words: object) -> subprocess.Popen[bytes]:
    with log.open("w") as file:
        return subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{module}", *map(str, words)],
            stdout=file,
            stderr=file,
            env=os.environ | {"TMPDIR": str(log.parent)},  # what a lost worker leaves goes too
            start_new_session=True,
        )


def _address(file: Path) -> str:
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        try:
            return str(json.loads(file.read_text())["address"])
        except (OSError, ValueError):
            time.sleep(0.1)
    raise TimeoutError("no scheduler")
