"""Make small faults in the code, one at a time, and count those that the tests notice.

    python -m benchmarks.mutation.run --sample 680 --keep outcomes.json > mutation.txt
    python -m benchmarks.mutation.run --modules mfd_bayes/friction/gap.py --lines 120 130

The code is copied to a temporary folder, and a fault exists only in the memory of the process that
tries it. For each fault, the tests that execute its line run, from the folder of tests that has
the name of its room, quickest files first, until one fails. The order of faults is random, so that
what is done at any time is a random sample. The same command with the same `--keep` goes on;
`--minutes 0` only prints the table. `judged.toml` explains known faults that survived; those that
it does not know are listed last. Exits with 1 where the tests fail without any fault.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import os
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from benchmarks.common.data import PROJECT, data_folder
from benchmarks.common.machine import platform_line
from benchmarks.mutation.operators import Mutant, mutants
from benchmarks.mutation.table import Outcome, judgements, table
from benchmarks.mutation.trials import Child, cover, try_on

Kept = dict[tuple[str, str, int, str], Outcome]

FOLDERS = ("tests/friction", "tests/population", "tests/calibration")
TARGETS = (
    *("mfd_bayes/friction/*.py", "mfd_bayes/population/*.py"),
    "mfd_bayes/calibration/noise.py",
)
COPIED = ("mfd_bayes", "tests", "priors", "pyproject.toml", "README.md", "LICENSE")

# What is loaded once, before the processes part: libraries, and modules that import no target.
LOADED = (
    *(
        "xdist.plugin",
        "xdist.looponfail",
        "_pytest.junitxml",
        "_pytest.pastebin",
        "_pytest.skipping",
    ),
    *("pytest", "hypothesis", "emcee", "arviz", "xarray", "pandas", "h5py", "pint", "pydantic"),
    *("scipy.stats.qmc", "scipy.optimize", "scipy.integrate", "scipy.interpolate", "scipy.signal"),
    *(
        "mfd_bayes.store.files",
        "mfd_bayes.records.trace",
        "mfd_bayes.units",
    ),
)


def main() -> int:
    """Try the faults and print the table; 1 where the tests fail without any fault."""
    asked = _arguments()
    began = time.perf_counter()
    os.nice(10)
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    os.environ.setdefault("MFD_BAYES_DATA", str(data_folder()))
    kept = _kept(asked.keep)
    with tempfile.TemporaryDirectory() as folder:
        tree = _copied(Path(folder).resolve())
        faults = {m: mutants(ast.parse((tree / m).read_text())) for m in _modules(tree)}
        if asked.minutes > 0:
            os.chdir(tree)
            sys.path.insert(0, str(tree))
            for name in LOADED:
                importlib.import_module(name)
            if not _try_all(tree, _chosen(faults, asked), kept, asked):
                return 1
    done = sorted(kept.values(), key=lambda o: (o.module, o.line, o.column, o.change))
    print(f"python -m benchmarks.mutation.run {' '.join(sys.argv[1:])}, {platform_line()};")
    print(f"{time.perf_counter() - began:.0f} s\n")
    counts = {module: len(found) for module, found in faults.items() if found}
    print(table(counts, done, judgements(Path(__file__).with_name("judged.toml"))))
    return 0


def _copied(tree: Path) -> Path:
    for name in COPIED:
        if (PROJECT / name).is_dir():
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(PROJECT / name, tree / name, ignore=ignored)
        else:
            shutil.copy(PROJECT / name, tree / name)
    return tree


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sample", type=int, default=0, help="faults in all; 0: every one")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=600.0, help="start none after these")
    parser.add_argument("--longest", type=float, default=16.0, help="leave out tests over it, in s")
    parser.add_argument("--modules", nargs="*", default=[], help="only these files")
    parser.add_argument("--lines", nargs=2, type=int, metavar=("FIRST", "LAST"))
    parser.add_argument("--keep", type=Path, help="JSON file of what is done, and not again")
    parser.add_argument("--again", action="store_true", help="try again what survived in that file")
    asked = parser.parse_args()
    asked.keep = asked.keep and asked.keep.resolve()
    return asked


def _modules(tree: Path) -> list[str]:
    found = {path for target in TARGETS for path in tree.glob(target)}
    return sorted(str(path.relative_to(tree)) for path in found)


def _chosen(
    faults: Mapping[str, Sequence[Mutant]], asked: argparse.Namespace
) -> list[tuple[str, Mutant]]:
    """The faults to try, of each module its share of the sample, at random."""
    total = sum(map(len, faults.values()))
    share = min(asked.sample / total, 1.0) if asked.sample else 1.0
    chosen = []
    for module, found in faults.items():
        rng = random.Random(f"{asked.seed} {module}")
        picked = rng.sample(list(found), round(share * len(found)))
        for mutant in sorted(picked, key=lambda m: m.number):
            inside = not asked.lines or asked.lines[0] <= mutant.line <= asked.lines[1]
            if inside and (not asked.modules or module in asked.modules):
                chosen.append((module, mutant))
    random.Random(asked.seed).shuffle(chosen)
    return chosen


def _try_all(
    tree: Path, chosen: Sequence[tuple[str, Mutant]], kept: Kept, asked: argparse.Namespace
) -> bool:
    """Try what is not kept, and keep it; whether the tests pass without a fault."""
    began = time.perf_counter()
    covered = cover(tree, FOLDERS, asked.jobs)
    if covered.failed:
        _say("fail without any fault: " + " ".join(covered.failed))
        return False
    _say(f"{len(covered.seconds)} tests, {sum(covered.seconds.values()):.0f} s, watched")
    waiting = []
    for module, mutant in reversed(chosen):
        old = kept.get(_place(tree, module, mutant).key)
        if old is None or (asked.again and old.state == "survived"):
            waiting.append((module, mutant))
    running: dict[int, tuple[Child, str, Mutant, float]] = {}
    while waiting or running:
        late = time.perf_counter() - began > 60.0 * asked.minutes
        while waiting and not late and len(running) < asked.jobs:
            module, mutant = waiting.pop()
            child = try_on(tree, module, mutant, covered.of(module, mutant, asked.longest), covered)
            running[child.pid] = (child, module, mutant, time.perf_counter())
        if not running:
            break
        pid, status = os.wait()
        child, module, mutant, started = running.pop(pid)
        state, test = child.ended(status)
        seconds = round(time.perf_counter() - started, 1)
        outcome = replace(_place(tree, module, mutant), state=state, test=test, seconds=seconds)
        kept[outcome.key] = outcome
        _say(f"{len(waiting)} left; {module}:{mutant.line} {mutant.change} {state} {test}")
        if asked.keep:
            asked.keep.write_text(json.dumps([asdict(o) for o in kept.values()], indent=0))
    return True


def _place(tree: Path, module: str, mutant: Mutant) -> Outcome:
    """What became of a fault before anything did."""
    line = (tree / module).read_text(encoding="utf-8").splitlines()[mutant.line - 1]
    text = " ".join(line.split())
    return Outcome(module, mutant.line, mutant.column, mutant.function, text, mutant.change)


def _kept(path: Path | None) -> Kept:
    if path is None or not path.exists():
        return {}
    outcomes = [Outcome(**told) for told in json.loads(path.read_text())]
    return {outcome.key: outcome for outcome in outcomes}


def _say(words: str) -> None:
    print(words, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
