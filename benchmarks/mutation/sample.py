"""Try a sample of faults on whole test files, each in a fork: fast tests, then slow ones.

    python -m benchmarks.mutation.sample fast --sample 24 --home FOLDER > fast.txt
    python -m benchmarks.mutation.sample guards --sample 40 --home FOLDER > guards.txt

`fast` takes faults of the whole package and asks whether the fast tests notice what all tests
notice. Each fault is tried on the fast tests of the folder that mirrors its room and of files that
import its module, the nearest three files first. With `--slow` the slow tests of those folders then
run once, with all the faults in place that survived; where one fails, it runs for each of them
alone. `guards` takes faults of the code that guards outputs, locks, streams and readers, and tries
each on the tests of its class alone.

A fault is written into a copy of the project, so that commands which a test starts have it too. All
tests that failed run again without a fault, and must pass. The fast tests get a finished run that
the code without a fault has made. `--home` keeps what is done: the same command goes on, starting
no fault after `--minutes`; `--minutes 0` only prints the table, `--slow` tries the slow tests too.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import random
import shutil
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.common.data import PROJECT
from benchmarks.common.machine import platform_line
from benchmarks.mutation.classes import GUARDS, guards_of, near
from benchmarks.mutation.copies import ENDED, LIMIT, LONGEST, Place
from benchmarks.mutation.operators import Mutant, mutants
from benchmarks.mutation.run import LOADED
from benchmarks.mutation.table import Outcome, judgements, listed

COPIED = ("mfd_bayes", "tests", "benchmarks", "priors", "docs", "pyproject.toml", "README.md")
LIBRARIES = tuple(name for name in LOADED if not name.startswith(("mfd_bayes", "xdist")))
MAKE = "def test_it(finished_run):\n    assert finished_run.code == 0\n"
NEAREST = 3
"""Test files that every fault is tried on first."""
PENDING = "the nearest files only"


def main() -> int:
    """Try faults until the time is over, and print the table."""
    asked = _arguments()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    place = Place(asked.home.resolve())
    for name in LIBRARIES:
        importlib.import_module(name)
    if not place.laid_out.is_file():
        _lay_out(place, asked)
    chosen = _chosen(asked)
    done = place.kept(asked.kind)
    until = time.monotonic() + 60.0 * asked.minutes
    for part in (slice(NEAREST), slice(NEAREST, None)):
        for module, mutant in chosen:
            name = f"{module}:{mutant.number}"
            old = done.get(name)
            if (old is None or old.test == PENDING) and time.monotonic() < until:
                files = _files(place, asked.kind, module)
                done[name] = _tried(place, old or _named(module, mutant), mutant, files, part)
                place.keep(asked.kind, done)
                print(len(done), done[name], file=sys.stderr, flush=True)
    failed = {o.test for o in done.values() if o.state == "killed" and "::" in o.test}
    place.put([])
    if asked.minutes and failed and (again := place.fails(sorted(failed))):
        raise SystemExit(f"without a fault, {LIMIT:.0f} s: {again}")
    slow = _try_slow(place, chosen, done, until) if asked.slow else []
    place.keep(asked.kind, done)
    place.put([])
    words = " ".join(sys.argv[1:])
    print(f"python -m benchmarks.mutation.sample {words}\n{platform_line()}\n")
    judged = judgements(Path(__file__).with_name("judged.toml"))
    print(listed(list(done.values()), judged, with_slow=bool(slow)))
    print("\n".join(["", "Slow tests of these folders:", *slow] if slow else []))
    return 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kind", choices=("fast", "guards"))
    parser.add_argument("--sample", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=600.0, help="start none after these")
    parser.add_argument("--slow", action="store_true", help="then the slow tests, on survivors")
    parser.add_argument("--finished", type=Path, help="a session's MFD_BAYES_FINISHED_RUN")
    parser.add_argument("--home", type=Path, required=True, help="folder that keeps what is done")
    return parser.parse_args()


def _lay_out(place: Place, asked: argparse.Namespace) -> None:
    """Copy the project, and calibrate the finished run of its tests by the code without a fault."""
    shutil.rmtree(place.home, ignore_errors=True)
    for name in COPIED:
        if (PROJECT / name).is_dir():
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(PROJECT / name, place.tree / name, ignore=ignored)
        else:
            shutil.copy(PROJECT / name, place.tree / name)
    if asked.finished:
        shutil.copytree(asked.finished, place.home / "finished")
    else:
        (place.home / "finished").mkdir()
    (place.tree / "tests" / "test_made.py").write_text(MAKE)
    if failed := place.fails(["tests/test_made.py"], longest=0):
        raise SystemExit(f"without a fault: {failed}")
    place.laid_out.touch()


def _chosen(asked: argparse.Namespace) -> list[tuple[str, Mutant]]:
    """The faults to try, at random; of guards, of each class as many."""
    package = PROJECT / "mfd_bayes"
    every = [("**/*.py",)] if asked.kind == "fast" else [g.modules for g in GUARDS.values()]
    rng = random.Random(asked.seed)
    chosen = []
    for patterns in every:
        paths = sorted({path for pattern in patterns for path in package.glob(pattern)})
        faults = [
            (str(path.relative_to(PROJECT)), mutant)
            for path in paths
            for mutant in mutants(ast.parse(path.read_text(encoding="utf-8")))
        ]
        chosen.append(rng.sample(faults, min(-(-asked.sample // len(every)), len(faults))))
    return [fault for faults in zip(*chosen, strict=True) for fault in faults]


def _files(place: Place, kind: str, module: str) -> list[str]:
    """Test files with fast tests that a fault in a module is tried on, nearest first."""
    found = (near if kind == "fast" else guards_of)(place.tree, module)
    slow = "\npytestmark = pytest.mark.slow"
    return [name for name in found if slow not in (place.tree / name).read_text()]


def _named(module: str, mutant: Mutant) -> Outcome:
    """What became of a fault before anything did."""
    text = (PROJECT / module).read_text(encoding="utf-8").splitlines()[mutant.line - 1]
    words = " ".join(text.split())
    return Outcome(
        module, mutant.line, mutant.column, mutant.function, words, mutant.change, test=PENDING
    )


def _tried(
    place: Place, outcome: Outcome, mutant: Mutant, files: Sequence[str], part: slice
) -> Outcome:
    """What became of a fault on the fast tests of some files, of which it is tried on a part."""
    left = "" if part.stop is None or len(files) <= part.stop else PENDING
    if not files[part]:
        return replace(outcome, test=left if files else "no test is near it")
    began = time.monotonic()
    place.put([(outcome.module, mutant)])
    failed = place.fails(["-m", "not slow", *files[part]])
    seconds = round(outcome.seconds + time.monotonic() - began, 1)
    if failed in ("", "..."):
        late = f"not ended after {LIMIT:.0f} s"
        return replace(outcome, test=late if failed else left, seconds=seconds)
    place.put([])
    if failed == ENDED:
        return replace(outcome, state="timed out", test=f"a test of {LONGEST} s", seconds=seconds)
    return replace(outcome, state="killed", test=failed, seconds=seconds)


def _try_slow(
    place: Place, chosen: Sequence[tuple[str, Mutant]], done: dict[str, Outcome], until: float
) -> list[str]:
    """Try slow tests on all survivors at once, and on each alone what fails; what was found."""
    left = [f for f in chosen if f"{f[0]}:{f[1].number}" in done]
    left = [f for f in left if done[f"{f[0]}:{f[1].number}"].state == "survived"]
    files = {name for module, _ in left for name in near(place.tree, module)}
    kept = place.home / "slow.json"
    told = json.loads(kept.read_text()) if kept.is_file() else {}
    for name in sorted(files - {*told}):
        if "mark.slow" in (place.tree / name).read_text() and time.monotonic() < until:
            told[name] = _slow(place, left, done, name)
            kept.write_text(json.dumps(told, indent=0))
            print(name, told[name], file=sys.stderr, flush=True)
    return [f"{name}: {words}" for name, words in told.items()]


def _slow(place: Place, left: list[tuple[str, Mutant]], done: dict[str, Outcome], name: str) -> str:
    """What the slow tests of a file say with all faults in place; those noticed leave `left`."""
    noticed = 0
    while True:
        place.put(left)
        failed = place.fails(["-m", "slow", name], shared=False)
        if failed in ("", "..."):
            ended = "do not end" if failed else "pass"
            return f"{ended} with {len(left)} faults in place, {noticed} were noticed"
        found = []
        for faults in ([], *([fault] for fault in left)):
            place.put(faults)
            if place.fails(["-m", "slow", failed], shared=False):
                found.append(faults)
        if [] in found or not found:
            without = "without a fault" if found else "with faults together only"
            return f"fail {without}: {failed}, {noticed} were noticed"
        for (module, mutant), *_ in found:
            key = f"{module}:{mutant.number}"
            done[key] = replace(done[key], state="slow", test=failed)
            left.remove((module, mutant))
        noticed += len(found)


if __name__ == "__main__":
    sys.exit(main())
