"""What interrupts a calibration, at random moments of its course, and what a resumed run is then.

    python benchmarks/interruption.py [FAULTS] [SEED] > benchmarks/interruption.txt

runs `mfd-bayes calibrate` on a small synthetic campaign once undisturbed; then FAULTS (25) times
from nothing, each time with a fault: Ctrl-C, SIGTERM, SIGKILL, SIGKILL of a worker process, a disk
(tmpfs, for which it must be root) of random size that fills up. Each is looked at for tracebacks,
processes that go on, and files whose content is not the undisturbed run's; then resumed with
another number of processes, and compared: arrays bit for bit, tables and pictures byte for byte.
Some 10 minutes on two cores. A worker is killed so long after the first one started, at 0.3 of the
moment that is shown.
"""

import os
import platform
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from mfd_bayes.demo import Truth, write_campaign

COMMAND = [str(Path(sys.executable).parent / "mfd-bayes")]
KINDS = ("SIGINT", "SIGTERM", "SIGKILL", "worker", "disk")
EXITS = {"SIGINT": 130, "SIGTERM": 143, "SIGKILL": -9, "worker": 0, "disk": 2}
TIMED = ("manifest.json", "report.html")  # they tell when, and how long


@dataclass
class Ended:
    """How a command ended: its exit code, what it said, how long it took and left behind."""

    code: int
    printed: str
    complaint: str
    seconds: float
    orphans: int


def lay_out(folder: Path) -> Path:
    """Write a campaign of two short tests and one held out; its path."""
    truth = Truth(pressures=(500.0, 1000.0), frequencies=(0.5,), cycles=(1,), held_out=(800.0, 0.5))
    write_campaign(folder, 1, truth)
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


def calibrate(campaign: Path, out: Path, jobs: int, *options: str) -> subprocess.Popen[str]:
    """Start the command in a session of its own, its words going to files apart from the folder."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's "&" has it ignored
    words = ["calibrate", str(campaign), "-o", str(out), "--effort", "quick", "--jobs", str(jobs)]
    printed, complaint = (out.parents[1] / name for name in ("printed.txt", "complaint.txt"))
    with printed.open("w") as stdout, complaint.open("w") as stderr:
        return subprocess.Popen(
            [*COMMAND, *words, *options],
            stdout=stdout,
            stderr=stderr,
            text=True,
            env=os.environ | {"PYTHONUNBUFFERED": "1", "OPENBLAS_NUM_THREADS": "1"},
            start_new_session=True,
        )


def end(process: subprocess.Popen[str], out: Path, began: float, grace: float = 5.0) -> Ended:
    """Wait for a command's end, and a while for the processes that it has started."""
    code = process.wait(timeout=600)
    seconds = time.monotonic() - began
    until = time.monotonic() + grace
    while (orphans := of_session(process.pid)) and time.monotonic() < until:
        time.sleep(0.05)
    for pid, _ in orphans:
        os.kill(pid, signal.SIGKILL)
    words = [(out.parents[1] / name).read_text() for name in ("printed.txt", "complaint.txt")]
    return Ended(code, *words, seconds, len(orphans))


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
    """What of a file is to be the same in every run."""
    if path.suffix == ".nc":
        return arrays(path)
    if path.name in TIMED:
        return path.read_text().rstrip()[-1:]
    return path.read_bytes()


def differing(out: Path, reference: Path) -> list[str]:
    """Files of a run folder that hold something else than the reference's; hidden ones aside."""
    found = []
    for path in sorted(out.rglob("*")):
        if path.is_file() and not path.name.startswith("."):
            name = path.relative_to(out)
            try:
                same = content(path) == content(reference / name)
            except (OSError, ValueError):
                same = False
            if not same:
                found.append(str(name))
    return found


def files(out: Path) -> set[str]:
    return {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}


def mount(folder: Path, size: int, *, again: bool = False) -> None:
    options = f"{'remount,' if again else ''}size={size // 1024}k"
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], check=True)


def wait_for_worker(process: subprocess.Popen[str], delay: float) -> int | None:
    """Some worker that is at work so long after the first began; None where there is none."""
    while process.poll() is None:
        workers = [pid for pid, line in of_session(process.pid) if "spawn_main" in line]
        if workers:
            time.sleep(delay)
            break
        time.sleep(0.02)
    workers = [pid for pid, line in of_session(process.pid) if "spawn_main" in line]
    return max(workers, default=None)


def disturb(kind: str, process: subprocess.Popen[str], moment: float) -> bool:
    """Bring a fault upon a command; whether it was in time."""
    if kind == "disk":
        return True
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


def stage(ended: Ended) -> str:
    """The last that a command said before its end."""
    lines = ended.printed.splitlines()
    return lines[-1].split(",")[0] if lines else "start"


def show(*cells: object) -> None:
    widths = (3, 8, 22, 5, 6, 8, 6, 26, 8, 10)
    print("".join(f"{cell!s:>{width}}" for cell, width in zip(cells, widths, strict=True)))
    sys.stdout.flush()


def main() -> None:
    faults = int(sys.argv[1]) if len(sys.argv) > 1 else 25
    rng = np.random.default_rng(int(sys.argv[2]) if len(sys.argv) > 2 else 1)
    kinds = KINDS if os.geteuid() == 0 else KINDS[:-1]
    with tempfile.TemporaryDirectory() as folder:
        run(Path(folder), faults, rng, kinds)


def run(home: Path, faults: int, rng: np.random.Generator, kinds: tuple[str, ...]) -> None:
    campaign = lay_out(home / "campaign")
    reference = home / "reference" / "disk" / "out"
    reference.parent.mkdir(parents=True)
    began = time.monotonic()
    whole = end(calibrate(campaign, reference, 2), reference, began)
    if whole.code:
        sys.exit(whole.complaint)
    size = sum(path.stat().st_size for path in reference.rglob("*") if path.is_file())
    print(f"mfd-bayes calibrate, {platform.platform()}, Python {platform.python_version()}")
    print(f"undisturbed: {whole.seconds:.0f} s, {size / 1e6:.1f} MB, {len(files(reference))} files")
    head = ("", "fault", "moment", "jobs", "exit", "orphans", "words", "last said")
    show(*head, "resumed", "identical")
    totals: Counter[str] = Counter()
    number, course = 0, whole.seconds
    while number < faults:
        kind, jobs = kinds[number % len(kinds)], 1 + number // len(kinds) % 2
        share = (number // len(kinds) + rng.random()) / -(-faults // len(kinds))
        out = home / str(number) / "disk" / "out"
        out.parent.mkdir(parents=True)
        room = int(4096 + share * 0.98 * size)
        if kind == "disk":
            mount(out.parent, room)
        try:
            done = disturb_one(kind, campaign, out, jobs, share * course, reference)
            if isinstance(done, Ended):  # before the fault came: the machine has grown faster
                course = min(course, done.seconds)
                continue
            ended, again, halves, identical = done
        finally:
            if kind == "disk":
                subprocess.run(["umount", "-l", str(out.parent)], check=True)
            shutil.rmtree(out.parents[1])
        number += 1
        moment = f"{room / 1e3:.0f} kB" if kind == "disk" else f"{share:.0%} of {course:.0f} s"
        limit = 0 if kind in ("SIGKILL", "worker") else 1
        clean = "Traceback" not in ended.complaint and len(ended.complaint.splitlines()) <= limit
        show(
            number,
            kind,
            moment,
            f"{jobs}>{3 - jobs}",
            ended.code,
            ended.orphans,
            "clean" if clean else "BAD",
            stage(ended)[:25],
            again.code,
            "yes" if identical else "NO",
        )
        if not clean:
            print(ended.complaint, file=sys.stderr)
        totals["exit code as documented"] += ended.code == EXITS[kind]
        totals["at most one sentence, no traceback"] += clean
        totals["no process left"] += not ended.orphans
        totals["every file there is whole, and the undisturbed run's"] += not halves
        totals["resumed with exit code 0"] += again.code == 0 and not again.complaint
        totals["identical to the undisturbed run"] += identical
    for fact, count in totals.items():
        print(f"{count:3d} of {faults}  {fact}")


def disturb_one(
    kind: str, campaign: Path, out: Path, jobs: int, moment: float, reference: Path
) -> tuple[Ended, Ended, list[str], bool] | Ended:
    """A fault and what follows: its end, the resumed end, half files, whether all is the same.

    The end alone where the fault came too late.
    """
    began = time.monotonic()
    process = calibrate(campaign, out, jobs)
    if not disturb(kind, process, 0.3 * moment if kind == "worker" else moment):
        return end(process, out, began)
    ended = end(process, out, began)
    halves = [name for name in differing(out, reference) if Path(name).name not in TIMED]
    if kind == "disk":
        mount(out.parent, 2**28, again=True)
    again = end(calibrate(campaign, out, 3 - jobs, "--resume"), out, time.monotonic())
    same = not differing(out, reference) and files(out) == files(reference)
    return ended, again, halves, same


if __name__ == "__main__":
    main()
