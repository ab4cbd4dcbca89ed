"""Which of 300 random faults in the package the fast tests notice; cosmic-ray makes the faults.

    git clone . HOME/house; pip install -e 'HOME/house[test]' distributed cosmic-ray pytest-cov
    python -m benchmarks.faults.run draw HOME     # draws the faults: HOME/faults.jsonl
    python -m benchmarks.faults.run cover HOME    # runs all tests once: which run which line
    nice -n 19 python -m benchmarks.faults.run try HOME    # after a break it goes on
    python -m benchmarks.faults.run table HOME > benchmarks/faults/faults.txt

Faults are drawn uniformly from all of cosmic-ray's in mfd_bayes/, but for those that change only
annotations, do not compile, or put | & ^ << >> for arithmetic, which no float survives. A fault is
tried on the tests that run its line, up to the first that fails: its room's first, the quick ones
first, in PARTS. All faults have had one part before one has the next. A part that takes far more
processor time than without the fault is a timeout. At the end all tests that failed run without a
fault; what fails then counts no more. A fault may delete any file: make all but HOME read-only.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter, defaultdict
from itertools import accumulate
from pathlib import Path

import coverage
from cosmic_ray.mutating import use_mutation
from cosmic_ray.plugins import get_operator
from cosmic_ray.testing import TestOutcome, run_tests

from benchmarks.faults.cover import cover, tests_of
from benchmarks.faults.draw import SEED, draw

HOME = Path(sys.argv[2]).resolve()
PARTS = (20.0, 80.0, 380.0, 4000.0)  # s without a fault, from the first test to a part's last


def keep(faults):
    text = "".join(json.dumps(fault, ensure_ascii=False) + "\n" for fault in faults)
    (HOME / "new").write_text(text, "utf-8")
    (HOME / "new").replace(HOME / "faults.jsonl")


def kept():
    return [json.loads(line) for line in (HOME / "faults.jsonl").open(encoding="utf-8")]


def fails(names, seconds, remake=False):
    """The first of some tests that fails, or what else ended them; "" where all pass."""
    (HOME / "names").write_text("\n".join(names))
    for folder in (HOME / "temporary", HOME / "remade"):
        shutil.rmtree(folder, ignore_errors=True)
    os.environ["MFD_BAYES_FINISHED_RUN"] = str(HOME / ("remade" if remake else "finished"))
    words = f"-m pytest -x -q -p no:cacheprovider --basetemp={HOME / 'temporary'} @{HOME / 'names'}"
    limits = f"prlimit --cpu={60 + 3 * round(seconds)} --as={6 * 10**9}"
    command = f"{limits} sh -c '{sys.executable} {words} 2>&1'"
    outcome, output = run_tests(command, 1800 + 60 * seconds)
    if outcome == TestOutcome.SURVIVED:
        return ""
    failed = re.search(r"^(?:FAILED|ERROR):? (.+?)(?: - .*)?$", output, re.MULTILINE)
    return failed[1] if failed else "on import" if "Error" in output else "timeout"


def attempt(fault, k, tests, data):
    """Try a fault on part k of its tests."""
    names, remake = tests_of(fault, tests, data)
    until = accumulate(tests[n]["seconds"] for n in names)
    which = [sum(end > most for most in PARTS) for end in until]
    part = [n for n, i in zip(names, which, strict=True) if i == k]
    fault["tests"] = [sum(i <= k for i in which), len(names)]
    if part:
        operator = get_operator(fault["operator"])()
        with use_mutation(Path(fault["file"]), operator, fault["occurrence"]):
            fault["by"] = fails(part, sum(tests[n]["seconds"] for n in part), remake)
        if fault["by"]:
            fault["state"] = "timeout" if fault["by"] == "timeout" else "noticed"
    print(fault["number"], fault["state"], fault["tests"], fault["by"], flush=True)


def try_all():
    subprocess.run(["git", "checkout", "-q", "--", "mfd_bayes"], check=True)
    data = coverage.CoverageData(str(HOME / "cover" / ".coverage"))
    data.read()
    tests = json.loads((HOME / "tests.json").read_text())
    users = (n for n, t in tests.items() if t["passed"] and "tests::finished_run" in t["shared"])
    assert not fails([next(users)], 600.0)  # which makes the finished run
    faults = kept()
    while left := [(k, f) for k in range(len(PARTS)) for f in faults if f["parts"] <= k]:
        for k, fault in left:
            if fault["state"] == "survived":
                attempt(fault, k, tests, data)
            fault["parts"] = k + 1
            keep(faults)
        names = sorted({f["by"] for f in faults} & {*tests})
        while (bad := fails(names, sum(tests[n]["seconds"] for n in names))) in names:
            names.remove(bad)
            tests[bad]["passed"] = False
            for fault in (f for f in faults if f["by"] == bad):
                fault |= {"state": "survived", "parts": 0, "by": ""}
        (HOME / "tests.json").write_text(json.dumps(tests, indent=0))
        keep(faults)


def table():
    faults = kept()
    commit = subprocess.check_output(["git", "describe", "--always"], text=True)
    print(f"python -m benchmarks.faults.run, seed {SEED}, code and tests of commit {commit}")
    print(
        f"{'':28}{'faults':>8}{'noticed':>9}{'timeout':>9}{'survived':>10}{'open':>9}{'share':>8}"
    )
    groups = defaultdict(Counter)
    for f in faults:
        kind = f["operator"].split("/")[1].split("_")[0]
        for group in ("/".join(f["file"].split("/")[:2]), f" {kind}", "  all"):
            left = f["state"] == "survived" and (not f["tests"] or f["tests"][0] < f["tests"][1])
            groups[group]["open" if left else f["state"]] += 1
    for group, states in sorted(groups.items()):
        counts = [states[state] for state in ("noticed", "timeout", "survived", "open")]
        share = sum(counts[:2]) / max(1, sum(counts[:3]))
        cells = "{:9}{:9}{:10}{:9}".format(*counts)
        print(f"{group.strip():28}{sum(counts):8}{cells}{share:8.0%}")
    print(
        "\nOpen: not tried yet on all tests that run the line. Share: of those that are not open."
    )
    print("Not noticed so far, with the number of tests that were tried:")
    for f in (f for f in faults if f["parts"] and f["state"] == "survived"):
        done = " of ".join(str(n) for n in f["tests"])
        print(f"{f['number']:4} {f['file']}:{f['line']} {f['function']}, {done} tests")
        print(f"       {f['before']}\n       {f['after']}")


if __name__ == "__main__":
    os.chdir(HOME / "house")
    sys.path[0] = str(HOME / "house")
    steps = {
        "draw": lambda: keep(draw()),
        "cover": lambda: cover(HOME),
        "try": try_all,
        "table": table,
    }
    steps[sys.argv[1]]()
