"""How many random faults in the package do the tests notice? cosmic-ray makes the faults.

In a clone of the project, with everything installed, and cosmic-ray and pytest-cov:

    python -m benchmarks.faults.run cover             # with -m "" the slow tests too
    nice python -m benchmarks.faults.run try 0 300 > faults.txt

`cover` runs the tests once to learn which run which line (twice the time of the tests). Faults are
drawn uniformly from all of cosmic-ray's, but for those that do not compile, change annotations
alone, or put | & ^ << >> into arithmetic. Each is tried, with -x, on the tests that run its
statement: those of its room first, then the quick ones, up to SECONDS. A fault takes half a minute;
it may do anything, so that only the clone should be writable.
"""

import ast
import itertools
import json
import random
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import coverage
import pytest
from cosmic_ray.commands.init import _all_work_items
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator

SEED, SECONDS = 52, 300.0
BITS = re.compile(r"Operator_(Add|Sub|Mul|Div|FloorDiv|Mod|Pow)_(Bit|[LR]Shift)")
CONTEXT = re.compile(r"(.+?)(?:\|| \()(setup|run|call|teardown)\)?", re.DOTALL)
OURS = ["-o", "addopts=", "--import-mode=importlib", "-p", "no:cacheprovider"]
COVERAGE = f"""[run]
data_file = {Path.cwd()}/.coverage
source_pkgs = mfd_bayes
parallel = true
patch = subprocess
sigterm = true
concurrency = multiprocessing,thread
context = ${{PYTEST_CURRENT_TEST-}}
disable_warnings = no-data-collected, module-not-measured, module-not-imported, already-imported
"""
seconds: Counter[str] = Counter()


def pytest_runtest_logreport(report):
    seconds[report.nodeid] += report.duration if report.passed else 1e9


def cover(words):
    """Run the tests once; keep the seconds of those that pass, and which lines they run."""
    Path("coverage.ini").write_text(COVERAGE)
    words = [*OURS, "--cov", "--cov-config=coverage.ini", "--cov-context=test", *words]
    pytest.main([*words, "--cov-report="], plugins=[sys.modules[__name__]])
    Path("tests.json").write_text(json.dumps({n: s for n, s in seconds.items() if s < 1e9}))


def behaviour(text):
    """The tree of some code without its annotations; "" where it does not compile."""
    try:
        compile(text, "", "exec")
    except (SyntaxError, ValueError):
        return ""
    for node in ast.walk(tree := ast.parse(text)):
        for name in {"annotation", "returns"} & {*node._fields}:
            setattr(node, name, None)
    return ast.dump(tree)


def faults():
    """Faults in random order: module, line, operator, and the code without and with it."""
    sites = [w.mutations[0] for w in _all_work_items(sorted(Path("mfd_bayes").rglob("*.py")), {})]
    random.Random(SEED).shuffle(sites)
    for m in sites:
        text = m.module_path.read_text("utf-8")
        mutant = mutate_code(text, get_operator(m.operator_name)(), m.occurrence)
        if not BITS.search(m.operator_name) and behaviour(mutant) not in ("", behaviour(text)):
            yield m.module_path, m.start_pos[0], m.operator_name.split("/")[1], text, mutant


def tests_of(path, line, data):
    """Tests that run a statement, or any function of its module where it runs on import."""
    nodes = [n for n in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(n, ast.stmt)]
    functions = [n for n in nodes if isinstance(n, ast.FunctionDef)]
    enclosing = [n for n in nodes if n.lineno <= line <= n.end_lineno]
    inner = max(enclosing, key=lambda n: (n.lineno, -n.end_lineno), default=None)
    nested = any(f in enclosing and f is not inner for f in functions)
    run = [inner] if inner and nested else functions
    lines = {m for n in run for m in range(n.lineno + (n in functions), n.end_lineno + 1)}
    contexts = data.contexts_by_lineno(str(path.resolve()))
    matches = {CONTEXT.fullmatch(c) for n in lines for c in contexts.get(n, ())} - {None}
    files = {m[1].split("::")[0] for m in matches if m[2] == "setup"}  # of a fixture's other tests
    names = {m[1] for m in matches} | {n for n in seconds if n.split("::")[0] in files}
    room = f"tests/{path.parts[1].removesuffix('.py')}"
    return sorted(names & {*seconds}, key=lambda n: (not n.startswith(room), seconds[n]))


def notices(names):
    """The first of some tests that fails, or "timeout"; "" where none does."""
    selected = [n for i, n in enumerate(names) if sum(seconds[m] for m in names[: i + 1]) < SECONDS]
    Path("names").write_text("\n".join(selected))
    command = ["prlimit", "--as=6000000000", sys.executable, "-m", "pytest", "-x", "-q", *OURS]
    try:
        process = subprocess.run([*command, "@names"], capture_output=True, text=True, timeout=1800)
    except subprocess.TimeoutExpired:
        return "timeout"
    failed = re.search(r"^(?:FAILED|ERROR):? (.+?)(?: - .*)?$", process.stdout, re.MULTILINE)
    return "" if process.returncode == 0 else failed[1] if failed else "on import"


def attempt(start, stop):
    """Try the faults of some numbers; print each, and the share noticed of each room."""
    (data := coverage.CoverageData(".coverage")).read()
    seconds.update(json.loads(Path("tests.json").read_text()))
    rooms = {}
    for path, line, operator, text, mutant in itertools.islice(faults(), start, stop):
        names = tests_of(path, line, data)
        path.write_text(mutant, "utf-8")
        try:
            detector = notices(names) if names else ""
        finally:
            path.write_text(text, "utf-8")
        print(f"{path}:{line} {operator}: {detector or 'NOT NOTICED'}", flush=True)
        for room in (path.parts[1], "all"):
            rooms.setdefault(room, []).append(bool(detector))
    for room, noticed in sorted(rooms.items()):
        print(f"{room:20s} {sum(noticed)} of {len(noticed)}, {sum(noticed) / len(noticed):.0%}")


if __name__ == "__main__":
    step, *words = sys.argv[1:]
    cover(words) if step == "cover" else attempt(*map(int, words))
