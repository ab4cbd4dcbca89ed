"""What a user finds in a run folder after a fault, and what a resumed run leaves in it."""

import fcntl
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.interruption.cluster import Cluster
from benchmarks.interruption.harness import COMMAND, LIMIT, TIMED, differing, files
from mfd_bayes.calibration.result import load_result
from mfd_bayes.errors import MfdError
from mfd_bayes.runs.run import open_run

UNFINISHED = (" is not finished; finish it with: ", " is not a run folder: it has no manifest.json")


@dataclass
class Undisturbed:
    """A campaign, the folder of its undisturbed run, and how long that run took."""

    campaign: Path
    out: Path
    seconds: float
    on_cluster: float
    workers: float
    checks: str
    size: int

    def lasting(self, kind: str) -> float:
        """Seconds over which the moments of a kind of fault on this machine are drawn."""
        return self.workers if kind == "worker" else self.seconds


@dataclass
class Fault:
    """A fault that will be caused: its kind, moment and run folder."""

    number: int
    kind: str
    share: float
    out: Path
    jobs: int
    cluster: Cluster | None = None
    said: str = field(default="", init=False)

    @property
    def where(self) -> tuple[int, tuple[str, ...]]:
        """Number of processes, and the option of a cluster."""
        return (0, ("--scheduler", self.cluster.address)) if self.cluster else (self.jobs, ())


def check(out: Path) -> subprocess.CompletedProcess[str]:
    return command("check", str(out), "--all")


def command(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *words], capture_output=True, text=True, timeout=LIMIT, check=False
    )


def look_at(fault: Fault, run: Undisturbed) -> str:
    """What a user gets who looks at the folder before it is resumed."""
    if fault.jobs == 1:
        shown = check(fault.out)
        same = shown.stdout == run.checks.replace(str(run.out), str(fault.out))
    else:
        copy = fault.out.parents[1] / "copy" / "out"
        copy.mkdir(parents=True)
        if fault.out.is_dir():
            shutil.copytree(fault.out, copy, dirs_exist_ok=True)
        shown = command("report", str(copy))
        there = {name for name in files(copy) if not Path(name).name.startswith(".")}
        same = there == files(run.out) and not differing(copy, run.out)
        shutil.rmtree(copy.parent)
    if shown.returncode in (0, 1) and same and not shown.stderr:
        return "all there"
    sentences = shown.stderr.splitlines()
    if shown.returncode == 2 and len(sentences) == 1 and any(w in sentences[0] for w in UNFINISHED):
        return "unfinished"
    print(fault.number, shown, same, file=sys.stderr)
    return "BAD"


def is_whole(fault: Fault, run: Undisturbed) -> bool:
    """Whether every file that is there is the undisturbed run's, and every posterior opens."""
    bad = [name for name in differing(fault.out, run.out) if Path(name).name not in TIMED]
    try:
        for path in fault.out.rglob("posterior.nc"):
            load_result(path.parent.name, path, open_run(run.out).priors)
    except MfdError as error:
        bad.append(str(error))
    if bad:
        print(fault.number, bad, file=sys.stderr)
    return not bad


def is_complete(out: Path, run: Undisturbed) -> bool:
    """Whether a folder holds the undisturbed run's files and no other, each to its hash."""
    try:
        return (
            not differing(out, run.out)
            and files(out) == files(run.out)
            and open_run(out).population is not None
        )
    except MfdError as error:
        print(error, file=sys.stderr)
        return False


def left_behind(fault: Fault) -> list[str]:
    """What no resumed run should leave: hidden files, a lock, tests that a cluster is at."""
    found = sorted(name for name in files(fault.out) if Path(name).name.startswith("."))
    handle = os.open(fault.out, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        found.append("lock")
    finally:
        os.close(handle)
    if fault.kind == "client" and fault.cluster and fault.cluster.busy():
        found.append("tests")
    return found
