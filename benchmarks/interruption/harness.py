"""A calibration as a process, the faults of this machine, and the content of its run folder."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from mfd_bayes.campaign.synthetic import Matrix, write_campaign

COMMAND = [str(Path(sys.executable).parent / "mfd-bayes")]
EXITS = {
    "SIGINT": 130,
    "SIGTERM": 143,
    "SIGKILL": -9,
    "worker": 0,
    "disk": 2,
    "read-only": 2,
    "lost worker": 0,
    "all workers": 0,
    "no workers": 130,
    "scheduler": 2,
    "client": -9,
}
TIMED = ("manifest.json", "report.html")  # they tell when, and how long
LIMIT = 1200.0
"""Seconds after which a command is taken to hang: far more than ten times the undisturbed."""


@dataclass
class Ended:
    """How a command ended: exit code, output, time, and processes left behind."""

    code: int
    printed: str
    complaint: str
    seconds: float
    orphans: int


def lay_out(folder: Path) -> Path:
    """Write a campaign of two short tests and one held out; its path."""
    matrix = Matrix(
        pressures=(500.0, 1000.0), frequencies=(0.5,), cycles=(1,), held_out=(800.0, 0.5)
    )
    write_campaign(folder, 1, matrix)
    campaign = folder / "campaign.toml"
    campaign.write_text(campaign.read_text().replace('"ou"', '"ou"\nrate = "25 Hz"'))
    return campaign


def of_session(leader: int) -> list[tuple[int, str]]:
    """Live processes of a session, with their command lines."""
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            state, _, _, session = (entry / "stat").read_text().rpartition(")")[2].split()[:4]
            line = (entry / "cmdline").read_text().replace("\0", " ")
        except OSError:
            continue
        if int(session) == leader and state != "Z":
            found.append((int(entry.name), line))
    return found


def workers_of(leader: int) -> list[int]:
    """Processes of a session that do jobs: started by themselves, or forked from a server."""
    servers = [pid for pid, line in of_session(leader) if "multiprocessing.forkserver" in line]
    forked = [pid for pid in servers if parent_of(pid) in servers]
    return forked + [pid for pid, line in of_session(leader) if "spawn_main" in line]


def parent_of(pid: int) -> int:
    """Parent of a process; 0 where it has ended."""
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0


def heed_interrupts() -> None:
    """Let the processes that are started be interrupted: a shell's "&" has SIGINT ignored."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def calibrate(campaign: Path, out: Path, jobs: int, *options: str) -> subprocess.Popen[str]:
    """Start the command in a session of its own, its words going to files apart from the folder."""
    words = ["calibrate", str(campaign), "-o", str(out), "--effort", "quick", "--jobs", str(jobs)]
    with printed(out).open("w") as stdout, complaint(out).open("w") as stderr:
        return subprocess.Popen(
            [*COMMAND, *words, *options],
            stdout=stdout,
            stderr=stderr,
            text=True,
            env=os.environ | {"PYTHONUNBUFFERED": "1", "OPENBLAS_NUM_THREADS": "1"},
            start_new_session=True,
        )


def end(process: subprocess.Popen[str], out: Path, began: float, grace: float = 15.0) -> Ended:
    """Wait for a command's end, and a while for the processes that it has started."""
    try:
        code = process.wait(timeout=LIMIT)
    except subprocess.TimeoutExpired:
        process.kill()
        code = process.wait() - 1000  # no command ends so
    seconds = time.monotonic() - began
    until = time.monotonic() + grace
    while (orphans := of_session(process.pid)) and time.monotonic() < until:
        time.sleep(0.05)
    for pid, _ in orphans:
        os.kill(pid, signal.SIGKILL)
    return Ended(code, printed(out).read_text(), complaint(out).read_text(), seconds, len(orphans))


def printed(out: Path) -> Path:
    """The file of what the command of a run folder prints."""
    return out.parents[1] / "printed.txt"


def complaint(out: Path) -> Path:
    """The file of what it complains of."""
    return out.parents[1] / "complaint.txt"


def stage(out: Path) -> str:
    """The last that the command has said."""
    lines = printed(out).read_text().splitlines()
    return lines[-1].split(",")[0] if lines else "start"


# --- what befalls it


def mount(folder: Path, size: int, *, again: bool = False) -> None:
    """Put a disk of so many bytes under a folder, or make it larger."""
    options = f"{'remount,' if again else ''}size={size // 1024}k"
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], check=True)


def unmount(folder: Path) -> None:
    """Take away whatever is mounted under a folder."""
    while folder.is_mount():
        subprocess.run(["umount", "-l", str(folder)], check=True)


def forbid_writing(folder: Path, *, over: bool, patience: float = 2.0) -> None:
    """Make the disk under a folder read-only; or put the same disk, read-only, over it.

    A disk becomes read-only in a moment in which none of its files is open for writing; where
    none comes, it is put over, where a file that is open can still be written, but not renamed.
    """
    until = time.monotonic() + patience
    while not over and time.monotonic() < until:
        words = ["mount", "-o", "remount,ro", str(folder)]
        if subprocess.run(words, stderr=subprocess.DEVNULL, check=False).returncode == 0:
            return
    subprocess.run(["mount", "--bind", str(folder), str(folder)], check=True)
    subprocess.run(["mount", "-o", "remount,bind,ro", str(folder)], check=True)


def allow_writing(folder: Path) -> None:
    """Undo `forbid_writing`."""
    subprocess.run(["umount", str(folder)], stderr=subprocess.DEVNULL, check=False)
    if folder.is_mount():
        subprocess.run(["mount", "-o", "remount,rw", str(folder)], check=True)


def wait_for_worker(process: subprocess.Popen[str], delay: float) -> int | None:
    """Some worker that is at work so long after the first began; None where there is none."""
    while process.poll() is None:
        if workers_of(process.pid):
            time.sleep(delay)
            break
        time.sleep(0.02)
    return max(workers_of(process.pid), default=None)


def disturb(kind: str, process: subprocess.Popen[str], moment: float) -> bool:
    """Send a signal to a command, or SIGKILL to a process of its own; whether it was in time."""
    if kind == "worker":
        victim = wait_for_worker(process, moment)
        if victim is None:
            return False
        os.kill(victim, signal.SIGKILL)
        return True
    time.sleep(moment)
    if process.poll() is not None:
        return False
    process.send_signal(getattr(signal, kind))
    return True


# --- what its folder holds


def arrays(path: Path) -> dict[str, bytes]:
    """Every array of a NetCDF file, as bytes."""
    found = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            found[name] = np.asarray(item[()]).tobytes()

    with h5py.File(path) as file:
        file.visititems(visit)
    return found


def content(path: Path) -> object:
    """What of a file is to be the same in every run: all but times, and the command's words."""
    if path.suffix == ".nc":
        return arrays(path)
    if path.name == "manifest.json":
        manifest = json.loads(path.read_text())
        for key in ("command", "started", "finished", "seconds"):
            manifest.pop(key, None)
        for entry in manifest["tests"].values():
            entry.pop("seconds", None)
        return manifest | {"files": sorted(manifest["files"])}  # posteriors hold their wall times
    if path.name == "report.html":
        told = r"<dt>(command|started|finished)</dt><dd>[^\n]*</dd>"
        return re.sub(told, "", path.read_text())
    return path.read_bytes()


def differing(out: Path, reference: Path) -> list[str]:
    """Files of a run folder whose content differs from the reference's; without hidden files."""
    found = []
    for path in sorted(out.rglob("*")):
        if path.is_file() and not path.name.startswith("."):
            name = path.relative_to(out)
            try:
                same = content(path) == content(reference / name)
            except (OSError, ValueError, KeyError):
                same = False
            if not same:
                found.append(str(name))
    return found


def files(out: Path) -> set[str]:
    """Every file of a folder, hidden ones too."""
    return {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}
