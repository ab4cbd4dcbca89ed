"""Give damaged files to every reader, and report each that gives neither a result nor an error.

    python -m benchmarks.fuzz.run --inputs 101000 --seed 1 > benchmarks/fuzz/fuzz.txt
    python -m benchmarks.fuzz.run --commands --inputs 20000 --jobs 1 > benchmarks/fuzz/commands.txt
    python -m benchmarks.fuzz.run --seed 1 --target csv --only 1234 --keep folder

Every input is made only from the seed, the target's name and its number, and is read in a process
with limits of memory and time. It must end in a result or in an `MfdError`. Findings are: any
other exception, a signal, too much time or memory, a file written outside the input's folder, a
program started, a network connection, an object unpickled, and of commands a file replaced that
is not theirs. Exits with 1 where there are any.
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.machine import platform_line
from benchmarks.fuzz.targets import Target, commands, controls, few, targets
from mfd_bayes.errors import MfdError

__all__ = ["commands", "controls", "few", "make_input", "run", "shares", "targets"]

MEMORY = 1024 * 2**20  # beyond what the libraries take when they are imported
"""Bytes of addresses that a process may use."""

SECONDS = 10.0
"""Processor time that an input may take."""

SENTENCE = 6000
"""Most characters of what an error says."""

BATCH = 50
_FORBIDDEN = (
    *("pickle.find_class", "subprocess.Popen", "os.system", "os.exec", "os.posix_spawn"),
    *("socket.connect", "os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.link", "os.symlink"),
)
_FILES = {
    **dict.fromkeys(("open", "os.remove", "os.mkdir", "os.rmdir"), slice(0, 1)),
    **dict.fromkeys(("os.rename", "os.link"), slice(0, 2)),
    "os.symlink": slice(1, 2),
}
"""Which of what an event tells are paths that are written."""
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


@dataclass(frozen=True)
class Ended:
    """How an input ended: "result", "refused" or "finding", and the message."""

    number: int
    kind: str
    words: str = ""


@dataclass
class Tally:
    """What became of a target's inputs."""

    kinds: Counter[str] = field(default_factory=Counter)
    findings: list[Ended] = field(default_factory=list)
    seconds: float = 0.0

    def add(self, ended: Ended) -> None:
        """Count how an input ended."""
        self.kinds[ended.kind] += 1
        if ended.kind == "finding":
            self.findings.append(ended)


def make_input(target: Target, seed: int, number: int) -> tuple[dict[str, bytes], bytes]:
    """Files of an input, and the one among them that was changed."""
    name = int.from_bytes(hashlib.sha256(target.name.encode()).digest()[:4], "big")
    rng = np.random.default_rng([seed, name, number])
    files = dict(target.files[rng.integers(len(target.files))])
    files[target.changed] = target.mutate(files[target.changed], rng)
    return target.finish(files), files[target.changed]


def lay_out(folder: Path, files: dict[str, bytes]) -> None:
    """Write an input's files."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


class _Watch:
    """What Python was asked to do that no reading of a file needs."""

    def __init__(self) -> None:
        self.on = False
        self.home: str | None = None  # of a target that writes
        self.seen: list[str] = []
        sys.addaudithook(self._hear)

    def _hear(self, event: str, args: tuple[Any, ...]) -> None:
        if not self.on or (self.home is not None and event in _FILES and self._inside(event, args)):
            return
        if event.startswith(_FORBIDDEN):
            self.seen.append(f"{event} {args[:2]}"[:200])
        elif event == "open" and isinstance(args[2], int) and args[2] & _WRITES:
            self.seen.append(f"open for writing {args[0]}"[:200])

    def _inside(self, event: str, args: tuple[Any, ...]) -> bool:
        """Whether all paths of an event lie in the folder of a target that writes."""
        named = args[_FILES[event]]
        paths = [os.fsdecode(a) for a in named if isinstance(a, str | bytes | os.PathLike)]
        if event == "os.mkdir" and Path(paths[0]).is_dir():  # it is there: nothing is made
            return True
        if event in ("os.remove", "os.rmdir") and isinstance(args[1], int) and args[1] >= 0:
            paths = [str(Path(f"/proc/self/fd/{args[1]}").readlink() / paths[0])]
        return all(str(Path(p).absolute()).startswith(f"{self.home}/") for p in paths)


def try_input(target: Target, path: Path, watch: _Watch) -> tuple[str, str]:
    """Read a changed file: how that ended, and the message."""
    watch.seen.clear()
    watch.home = str(path.parent) if target.writes else None
    watch.on = True
    try:
        target.read(path)
        kind, words = "result", ""
    except MfdError as error:
        kind, words = _judged(error)
    except BaseException as error:  # the very thing that is looked for
        at = traceback.extract_tb(error.__traceback__)[-1]
        kind = "finding"
        words = f"{type(error).__name__}: {str(error)[:200]} ({Path(at.filename).name}:{at.lineno})"
    finally:
        watch.on = False
    return ("finding", watch.seen[0]) if watch.seen else (kind, words)


def _judged(error: MfdError) -> tuple[str, str]:
    """Whether an error is a sentence, and not one that memory made necessary."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError):
            return "finding", f"memory: {str(error)[:200]}"
        cause = cause.__cause__ or cause.__context__
    if not str(error) or len(str(error)) > SENTENCE:
        return "finding", f"no sentence: {len(str(error))} characters"
    return "refused", str(error)


def work(pipe: Connection, home: Path, seed: int, made_by: Callable[[], Sequence[Target]]) -> None:
    """Read inputs as they are asked for: (target's number, first, last) → an answer for each."""
    sys.dont_write_bytecode = True
    warnings.simplefilter("error")
    warnings.filterwarnings("ignore", message=".*ArviZ is undergoing")
    found, watch = made_by(), _Watch()
    for target in found:  # what is imported late is imported now
        lay_out(home, dict(target.files[0]))
        if target.share:
            target.read(home / target.changed)
        shutil.rmtree(home)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    pipe.send("ready")
    while (asked := pipe.recv()) is not None:
        at, first, last = asked
        target = found[at]
        for number in range(first, last):
            home.mkdir()
            lay_out(home, make_input(target, seed, number)[0])
            pipe.send((number, *try_input(target, home / target.changed, watch)))
            shutil.rmtree(home)


@dataclass
class _Worker:
    """A process that reads inputs, and what it is at."""

    process: Any
    pipe: Connection
    home: Path
    batch: tuple[int, int, int] | None = None
    since: float = 0.0
    worked: float = 0.0

    def begin(self) -> None:
        """Note the start time of an input."""
        self.since, self.worked = time.monotonic(), _processor_time(self.process.pid)

    def is_late(self, seconds: float) -> bool:
        """Whether an input takes too long; others that keep the machine busy do not count."""
        waited = time.monotonic() - self.since
        if waited < seconds:
            return False
        worked = _processor_time(self.process.pid) - self.worked
        return worked > seconds or waited > 6 * seconds

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()
        shutil.rmtree(self.home, ignore_errors=True)


def run(
    made_by: Callable[[], Sequence[Target]],
    counts: Sequence[int],
    seed: int,
    jobs: int,
    tell: Callable[[str], None] = lambda _: None,
    seconds: float = SECONDS,
) -> list[Tally]:
    """Tallies of all targets, whose inputs are read by `jobs` processes."""
    found = made_by()
    tallies = [Tally() for _ in found]
    batches = iter(_batches(counts))
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        workers = [_start(home / str(i), seed, made_by) for i in range(jobs)]
        left = sum(_give(worker, next(batches, None)) for worker in workers)
        while left:
            busy = {w.pipe: (i, w) for i, w in enumerate(workers) if w.batch is not None}
            for pipe in wait(list(busy), timeout=0.5):
                i, worker = busy[pipe]  # type: ignore[index]
                at, number, last = worker.batch  # type: ignore[misc]
                try:
                    answer = Ended(*worker.pipe.recv())
                except EOFError:
                    worker.process.join()
                    ended = Ended(number, "finding", f"exit code {worker.process.exitcode}")
                    left += _replace(workers, i, seed, made_by, tallies, ended, batches)
                    continue
                tallies[at].add(answer)
                tallies[at].seconds += time.monotonic() - worker.since
                if answer.kind == "finding":
                    tell(f"{found[at].name} {answer.number}: {answer.words}")
                worker.begin()
                worker.batch = (at, number + 1, last)
                if number + 1 == last:
                    left += _give(worker, next(batches, None)) - 1
            for i, worker in enumerate(workers):
                if worker.batch is not None and worker.is_late(seconds):
                    ended = Ended(worker.batch[1], "finding", f"more than {seconds:g} s")
                    tell(f"{found[worker.batch[0]].name} {ended.number}: {ended.words}")
                    left += _replace(workers, i, seed, made_by, tallies, ended, batches)
        for worker in workers:
            worker.end()
    return tallies


def _processor_time(pid: int) -> float:
    """Seconds of processor time that a process has had; those of the clock where none says."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return time.monotonic()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def _batches(counts: Sequence[int]) -> Iterator[tuple[int, int, int]]:
    for at, count in enumerate(counts):
        for first in range(0, count, BATCH):
            yield at, first, min(first + BATCH, count)


def _start(home: Path, seed: int, made_by: Callable[[], Sequence[Target]]) -> _Worker:
    ours, theirs = multiprocessing.Pipe()
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=work, args=(theirs, home, seed, made_by), daemon=True)
    process.start()
    theirs.close()
    ours.recv()
    return _Worker(process, ours, home)


def _give(worker: _Worker, batch: tuple[int, int, int] | None) -> int:
    """Give a worker its next inputs; 1 where there are any."""
    worker.batch = batch
    worker.begin()
    if batch is not None:
        worker.pipe.send(batch)
    return int(batch is not None)


def _replace(
    workers: list[_Worker],
    i: int,
    seed: int,
    made_by: Callable[[], Sequence[Target]],
    tallies: list[Tally],
    ended: Ended,
    batches: Iterator[tuple[int, int, int]],
) -> int:
    """Count the input that a worker was lost to, and start another for the rest of its batch."""
    at, number, last = workers[i].batch or (0, 0, 0)
    tallies[at].add(ended)
    workers[i].end()
    workers[i] = _start(workers[i].home, seed, made_by)
    rest = (at, number + 1, last) if number + 1 < last else next(batches, None)
    return _give(workers[i], rest) - 1


def shares(found: Sequence[Target], inputs: int) -> list[int]:
    """Numbers of inputs, by the targets' shares."""
    whole = sum(target.share for target in found)
    return [max(round(inputs * target.share / whole), 1) for target in found]


def main() -> int:
    words = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    words.add_argument("--inputs", type=int, default=100_000)
    words.add_argument("--seed", type=int, default=1)
    words.add_argument("--jobs", type=int, default=2)
    words.add_argument("--commands", action="store_true", help="only options and outputs")
    words.add_argument("--target", help="only this one")
    words.add_argument("--only", type=int, help="lay out this input of the target, and read it")
    words.add_argument("--keep", type=Path, help="where to lay it out")
    given = words.parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    made_by = commands if given.commands else targets
    found = made_by()
    if given.only is not None:
        target = next(t for t in found if t.name == given.target)
        lay_out(given.keep, make_input(target, given.seed, given.only)[0])
        print(target.read(given.keep / target.changed))
        return 0
    counts = shares(found, given.inputs)
    if given.target:
        counts = [given.inputs * (target.name == given.target) for target in found]
    began = time.monotonic()
    tallies = run(made_by, counts, given.seed, given.jobs, lambda t: print(t, file=sys.stderr))
    return _print(found, tallies, given, time.monotonic() - began)


def _print(
    found: Sequence[Target], tallies: Sequence[Tally], given: argparse.Namespace, seconds: float
) -> int:
    few = " --commands" if given.commands else ""
    print(f"python -m benchmarks.fuzz.run{few} --inputs {given.inputs} --seed {given.seed}")
    print(f"{platform_line()}; {MEMORY >> 20} MB and {SECONDS:g} s an input\n")
    widths = (24, 9, 9, 14, 9, 9)
    head = ("target", "inputs", "results", "clean errors", "findings", "ms each")
    print("".join(f"{cell:>{w}}" for cell, w in zip(head, widths, strict=True)))
    rows = [(t.name, tally) for t, tally in zip(found, tallies, strict=True)]
    whole = Tally(sum((t.kinds for _, t in rows), Counter()), [], sum(t.seconds for _, t in rows))
    for name, tally in (*rows, ("all", whole)):
        k, total = tally.kinds, max(tally.kinds.total(), 1)
        cells = (name, k.total(), k["result"], k["refused"], k["finding"])
        each = f"{1e3 * tally.seconds / total:.1f}"
        print("".join(f"{cell:>{w}}" for cell, w in zip((*cells, each), widths, strict=True)))
    print(f"\n{seconds:.0f} s with {given.jobs} processes")
    for target, tally in zip(found, tallies, strict=True):
        for ended in tally.findings:
            _, content = make_input(target, given.seed, ended.number)
            digest = hashlib.sha256(content).hexdigest()[:16]
            print(f"FINDING {target.name} --only {ended.number} sha256 {digest}: {ended.words}")
    return int(whole.kinds["finding"] > 0)


if __name__ == "__main__":
    sys.exit(main())
