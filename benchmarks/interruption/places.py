"""What two writers, bad streams and bad places do to a run folder, and what is said of it.

    python -m benchmarks.interruption.places > benchmarks/interruption/places.txt

Ten more faults, of commands as processes, on a finished run folder that no sampler has seen:

writers   a second command that writes into the folder, for every pair of such commands
readers   check and predict, of a folder that a first command holds: what is whole is read, what
           has begun anew is refused
full, closed, broken   the output, then the messages, are a full disk, closed, or a pipe
           without a reader: six faults
device, pipe   what predict, inspect and prior-check would write is a device, a pipe, a socket or
           a link out of its folder: two faults

The second writer must be refused with one sentence and exit code 2, and change nothing; a stream
that takes nothing is one sentence on the other and exit code 2; nothing is replaced. Takes three
minutes on a core.
"""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.common.machine import platform_line
from benchmarks.fuzz.runs import write_run
from benchmarks.fuzz.seeds import texts

COMMAND = (sys.executable, "-m", "mfd_bayes")
OWNER = ".owner.json"
CAMPAIGN = '[[test]]\nid = "{id}"\nfile = "a.csv"\nactuation = "{level} psi"\n'
WRITERS = {
    "report": ("report", "above/lugre"),
    "resume": ("calibrate", "campaign.toml", "-o", "above/lugre", "--resume"),
    "force": ("calibrate", "campaign.toml", "-o", "above/lugre", "--force", "--effort", "quick"),
    "cross": ("crossvalidate", "campaign.toml", "-o", "above/lugre", "--force", "--by", "test"),
    "compare": ("compare", "campaign.toml", "-o", "above", "--models", "lugre,bouc_wen", "--force"),
    "demo": ("demo", "above/lugre", "--force", "--quick"),
}
FIRST = ("report", "force", "cross", "compare", "demo")
"""Those that can begin on this folder; --resume is refused, for the campaign is another one."""

PREDICT = ("predict", "above/lugre", "--motion", "m.csv", "--actuation", "500 psi", "-o", "b.csv")
READERS = {"check": ("check", "above/lugre"), "predict": PREDICT}
LIMIT = 120.0
REFUSALS = (
    *("another process is working in", " is not finished; finish it with: "),
    " is not a run folder: it has no manifest.json",  # --force has just removed it
)


@dataclass
class Case:
    """One case of a fault: its name, and whether all is as it must be, or why not."""

    fault: str
    name: str
    why: str


def lay_out(home: Path, stored: Path) -> None:
    """Lay out a folder with a run, a campaign of two tests, and a motion."""
    shutil.copytree(stored, home / "above" / "lugre")
    text = CAMPAIGN.format(id="a", level=500) + CAMPAIGN.format(id="b", level=900)
    (home / "campaign.toml").write_text(text)
    for name in ("a.csv", "m.csv"):
        (home / name).write_bytes(texts()[0])


def state(folder: Path) -> dict[str, bytes]:
    """Every file, but the owner's name and what is partly written."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith(".")
    }


def ran(home: Path, words: tuple[str, ...]) -> tuple[int, str, str]:
    """Exit code, output and messages of a command."""
    done = subprocess.run(
        [*COMMAND, *words], cwd=home, capture_output=True, text=True, timeout=LIMIT, check=False
    )
    return done.returncode, done.stdout, done.stderr


def two_writers(stored: Path, home: Path) -> Iterator[Case]:
    """Every second command beside every first one that holds the folder."""
    for first in FIRST:
        with tempfile.TemporaryDirectory(dir=home) as name:
            place = Path(name)
            lay_out(place, stored)
            process = subprocess.Popen(
                [*COMMAND, *WRITERS[first]],
                cwd=place,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
            try:
                held = wait_for(place / "above" / "lugre" / OWNER, process)
                os.killpg(process.pid, signal.SIGSTOP)  # it holds its lock, and stands still
                for second, words in WRITERS.items():
                    why = "" if held else "the first did not begin"
                    yield Case("writers", f"{first}, {second}", why or refused(place, words))
                for reader, words in READERS.items():
                    yield Case("readers", f"{first}, {reader}", read_by(place, words, stored))
            finally:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def wait_for(file: Path, process: subprocess.Popen[bytes]) -> bool:
    """Whether a command took its lock before it ended."""
    until = time.monotonic() + LIMIT
    while process.poll() is None and time.monotonic() < until:
        if file.is_file():
            return True
        time.sleep(0.005)
    return False


def refused(home: Path, words: tuple[str, ...]) -> str:
    """Why a second writer was not refused as it must be; "" where it was."""
    before = state(home)
    code, _, told = ran(home, words)
    lines = told.splitlines()
    if code != 2 or len(lines) != 1 or not any(words in lines[0] for words in REFUSALS):
        return f"exit code {code}: {told[-300:]}"
    return "" if state(home) == before else "it changed something"


def read_by(home: Path, words: tuple[str, ...], stored: Path) -> str:
    """Why a reader was not served as it must be; "" where it was.

    A run that is whole is read while another process holds its lock. One that has begun anew is
    refused.
    """
    manifest = home / "above" / "lugre" / "manifest.json"
    whole = manifest.is_file() and manifest.read_bytes() == (stored / manifest.name).read_bytes()
    code, _, told = ran(home, words)
    lines = [line for line in told.splitlines() if not line.startswith("warning: ")]
    good = code in (0, 1) and not lines if whole else code == 2 and len(lines) == 1
    return "" if good else f"whole: {whole}, exit code {code}: {told[-300:]}"


def bad_streams(stored: Path, home: Path) -> Iterator[Case]:
    """Commands whose output or messages take nothing."""
    lay_out(home / "s", stored)
    for name, prepare in (("full", full), ("closed", os.close), ("broken", broken)):
        for number, words in (
            (1, ("check", "above/lugre", "--all")),
            (1, ("--version",)),
            (1, PREDICT),
            (2, ("check", "none")),
            (2, ("calibrate", "none.toml", "-o", "none")),
        ):
            stream = "output" if number == 1 else "messages"
            why = silent(home / "s", words, number, prepare)
            yield Case(f"{name} {stream}", " ".join(words[:2]), why)


def full(number: int) -> None:
    """Put a full disk under a stream."""
    os.dup2(os.open("/dev/full", os.O_WRONLY), number)


def broken(number: int) -> None:
    """Put a pipe that nobody reads under a stream."""
    reader, writer = os.pipe()
    os.close(reader)
    os.dup2(writer, number)


def silent(
    home: Path, words: tuple[str, ...], number: int, prepare: Callable[[int], object]
) -> str:
    """Why a command did not end with one sentence on its other stream; "" where it did."""
    with tempfile.TemporaryFile("w+", dir=home) as other:
        streams = {1: (subprocess.DEVNULL, other), 2: (other, subprocess.DEVNULL)}[number]
        done = subprocess.run(
            [*COMMAND, *words],
            cwd=home,
            stdout=streams[0],
            stderr=streams[1],
            preexec_fn=lambda: prepare(number),
            timeout=LIMIT,
            check=False,
        )
        other.seek(0)
        told = [line for line in other.read().splitlines() if not line.startswith("warning: ")]
    good = done.returncode == 2 and len(told) == 1 and told[0].startswith("mfd-bayes: ")
    return "" if good else f"exit code {done.returncode}: {told}"


def bad_places(stored: Path, home: Path) -> Iterator[Case]:
    """Outputs that are devices, pipes, sockets and links."""
    lay_out(home / "p", stored)
    for kind, make in MAKERS.items():
        for words, name in (
            (PREDICT, "b.csv"),
            (PREDICT, "b.png"),
            (PREDICT, "b_derived.csv"),
            (PREDICT, "b_history.png"),
            (("inspect", "m.csv"), "m_inspect.png"),
            (("prior-check", "campaign.toml"), "campaign_a_prior.png"),
        ):
            place = home / "p" / name
            make(place)
            mode = place.lstat().st_mode
            code, _, told = ran(home / "p", (*words, "--force"))
            kept = place.lstat().st_mode == mode
            good = code == 2 and kept and len(told.splitlines()) == 1
            yield Case(kind, f"{words[0]}, {name}", "" if good else f"{code}, {kept}: {told}")
            place.unlink()


def make_device(path: Path) -> None:
    """Make a device as /dev/null is, or a pipe where only root may."""
    if os.geteuid() == 0:
        os.mknod(path, 0o20666, os.makedev(1, 3))
    else:
        os.mkfifo(path)


def make_socket(path: Path) -> None:
    """Make a socket."""
    with socket.socket(socket.AF_UNIX) as found:
        found.bind(str(path))


MAKERS: dict[str, Callable[[Path], object]] = {
    "device": make_device,
    "pipe": os.mkfifo,
    "socket": make_socket,
    "link": lambda path: path.symlink_to("/nowhere/none"),
}


def main() -> int:
    counts: Counter[tuple[str, bool]] = Counter()
    began = time.monotonic()
    print(f"python -m benchmarks.interruption.places\n{platform_line()}\n", flush=True)
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        write_run(home / "stored", small=True)
        for study in (two_writers, bad_streams, bad_places):
            for case in study(home / "stored", home):
                counts[case.fault, not case.why] += 1
                if case.why:
                    print(f"{case.fault}: {case.name}: {case.why}", flush=True)
    for fault in dict.fromkeys(fault for fault, _ in counts):
        good, bad = counts[fault, True], counts[fault, False]
        print(f"{fault:16} {good:3d} of {good + bad:3d} as they must be")
    print(f"{time.monotonic() - began:.0f} s")
    return int(any(count for (_, good), count in counts.items() if not good))


if __name__ == "__main__":
    sys.exit(main())
