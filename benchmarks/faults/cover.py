"""Which tests run which line of the package, and how long each test takes."""

import ast
import json
import os
import re
from collections import defaultdict
from pathlib import Path

import pytest

INI = Path(__file__).with_name("cover.ini").resolve()
IDLE = ("data_folder", "benchmark_module", "without_figures")  # fixtures that run no package code
CONTEXT = re.compile(r"(.+?)(?:\|| \()(setup|run|call|teardown)\)?", re.DOTALL)


class Watch:
    """Notes of each test its seconds, whether it passed, and the shared fixtures it uses."""

    def __init__(self):
        self.tests = defaultdict(lambda: {"seconds": 0.0, "passed": False, "shared": []})

    def pytest_collection_modifyitems(self, items):  # noqa: D102
        os.environ["COVERAGE_PROCESS_START"] = str(INI)  # for the commands that tests start
        for item in items:
            for *_, made in item._fixtureinfo.name2fixturedefs.values():
                if made.scope != "function" and made.baseid and made.argname not in IDLE:
                    self.tests[item.nodeid]["shared"].append(f"{made.baseid}::{made.argname}")

    def pytest_runtest_logreport(self, report):  # noqa: D102
        self.tests[report.nodeid]["seconds"] += report.duration
        self.tests[report.nodeid]["passed"] |= report.when == "call" and report.passed


def cover(home):
    """Run all fast tests once, and keep what was watched in a folder."""
    os.environ["FAULTS"] = str(home)
    words = ["-o", "addopts=", "-m", "not slow", "--import-mode=importlib"]  # --dist hides contexts
    words += ["--cov", f"--cov-config={INI}", "--cov-context=test", "--cov-report="]
    words += [f"--basetemp={home / 'temporary'}"]
    pytest.main(words, plugins=[watch := Watch()])
    (home / "tests.json").write_text(json.dumps(watch.tests, indent=0))


def tests_of(fault, tests, data):
    """Tests that run a fault's line or share a fixture that does; whether a run is made with it."""
    path = Path(fault["file"])
    nodes = [n for n in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(n, ast.stmt)]
    around = [n for n in nodes if n.lineno <= fault["line"] <= n.end_lineno]
    inner = max(around, key=lambda n: n.lineno, default=None)
    functions = [n for n in nodes if isinstance(n, ast.FunctionDef)]
    lines = {m for f in functions for m in range(f.body[0].lineno, f.end_lineno + 1)}
    if any(f in around and f is not inner for f in functions):  # it is not run on import
        end = inner.body[0].lineno - 1 if hasattr(inner, "body") else inner.end_lineno
        lines = set(range(inner.lineno, max(end, inner.lineno) + 1))
    by_line = data.contexts_by_lineno(str(path.resolve()))
    found = {CONTEXT.fullmatch(c) for n in lines for c in by_line.get(n, ())} - {None}
    made = {f for m in found if m[2] == "setup" for f in tests[m[1]]["shared"]}
    names = {m[1] for m in found} | {n for n in tests if made & {*tests[n]["shared"]}}
    room = f"tests/{path.parts[1].removesuffix('.py')}"
    names = names or {n for n in tests if n.startswith(f"{room}/")}  # no test is known to run it
    order = sorted((not n.startswith(room), tests[n]["seconds"], n) for n in names)
    return [n for *_, n in order if tests[n]["passed"]], any("finished" in f for f in made)
