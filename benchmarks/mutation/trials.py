"""Which tests execute which lines, and a run of those tests on one fault."""

from __future__ import annotations

import ast
import importlib.util
import json
import os
import resource
import signal
import sys
import traceback
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

from benchmarks.mutation.operators import Mutant, mutants

MEMORY = 4 * 2**30
"""Bytes of addresses that a process may use."""

SAME = 100
"""Calls without a new line after which a function is no longer watched within a test."""

COLLECTION = 60.0
"""Seconds of processor time that the collection of tests may take."""

QUIET = (
    *("-q", "-x", "--tb=no", "--no-header", "-p", "no:cacheprovider"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # of what was loaded before
)


@dataclass(frozen=True, eq=False)
class Cover:
    """What every test executes.

    Attributes
    ----------
    seconds : dict of str to float
        Of each test, by its identity.
    lines : dict of str to dict of int to set of str
        Tests that execute a line, by file.
    references : dict of str to set of (str, int)
        Lines of the package and of its tests in which a name is read.
    failed : list of str
    """

    seconds: dict[str, float]
    lines: dict[str, dict[int, set[str]]]
    references: dict[str, set[tuple[str, int]]]
    failed: list[str]

    def of(self, module: str, mutant: Mutant, longest: float) -> list[str]:
        """Tests to try a fault on, those of quick files first.

        Only tests of the folder that mirrors its own, none of `longest` seconds or more. What
        is executed on import concerns those that execute a line with what it binds, and those
        of files that name it.
        """
        own = f"tests/{Path(module).parts[1]}/"
        if mutant.names:
            places = {p for name in mutant.names for p in self.references.get(name, ())}
            named = {file for file, _ in places}
            if mutant.function:  # of a class, and of what it holds
                places |= {(module, line) for line in self.lines[module]}
        else:
            places = {(module, line) for line in range(mutant.line, mutant.last + 1)}
            named = set()
        found = {t for file, line in places for t in self.lines.get(file, {}).get(line, ())}
        found |= {test for test in self.seconds if _file(test) in named}
        tests = {t for t in found if t.startswith(own) and self.seconds[t] < longest}
        total: dict[str, float] = defaultdict(float)
        for test in tests:
            total[_file(test)] += self.seconds[test]
        return sorted(tests, key=lambda t: (total[_file(t)], _file(t), self.seconds[t], t))


def _file(test: str) -> str:
    return test.partition("::")[0]


def cover(tree: Path, folders: Sequence[str], jobs: int) -> Cover:
    """Run all tests under a tracer, in some processes."""
    files = sorted(
        (p for folder in folders for p in (tree / folder).rglob("test_*.py")),
        key=lambda p: p.stat().st_size,
    )
    children = [_fork(lambda part=files[i::jobs]: _watched(tree, part)) for i in range(jobs)]
    found = [child.read() for child in children]
    for child in children:
        os.waitpid(child.pid, 0)
    seconds: dict[str, float] = {}
    failed: list[str] = []
    lines: dict[str, dict[int, set[str]]] = defaultdict(lambda: defaultdict(set))
    for part in found:
        seconds |= part["seconds"]
        failed += part["failed"]
        for test, places in part["places"].items():
            for file, line in places:
                lines[file][line].add(test)
    return Cover(seconds, lines, _references(tree), failed)


def _references(tree: Path) -> dict[str, set[tuple[str, int]]]:
    found = defaultdict(set)
    for path in (*(tree / "mfd_bayes").rglob("*.py"), *(tree / "tests").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            name = getattr(node, "id", getattr(node, "attr", None))
            if isinstance(name, str) and isinstance(node.ctx, ast.Load):
                found[name].add((str(path.relative_to(tree)), node.lineno))
    return found


def _watched(tree: Path, files: Sequence[Path]) -> dict[str, Any]:
    watch = _Watch(str(tree))
    args = [a for a in QUIET if a != "-x"]
    code = pytest.main([*args, *map(str, files)], plugins=[watch])
    failed = watch.failed or ([] if code == 0 else [f"pytest ended with {code}"])
    places = {test: sorted(watch.of(test)) for test in watch.seconds}
    return {"seconds": watch.seconds, "failed": failed, "places": places}


class _Watch:
    """Plugin that notes the lines of the package that each test and its fixtures execute."""

    def __init__(self, root: str) -> None:
        self.root, self.package = root, f"{root}/mfd_bayes/"
        self.seconds: dict[str, float] = defaultdict(float)
        self.failed: list[str] = []
        self.fixtures: dict[str, list[str]] = {}
        self.places: dict[str, set[tuple[str, int]]] = defaultdict(set)
        self.ours: dict[CodeType, str] = {}
        self.now: set[tuple[str, int]] = set()
        self.stale: dict[CodeType, int] = defaultdict(int)

    def of(self, test: str) -> set[tuple[str, int]]:
        return self.places[test].union(*(self.places[f] for f in self.fixtures[test]))

    def _enter(self, frame: FrameType, event: str, _: Any) -> Any:
        code = frame.f_code
        name = self.ours.get(code)
        if name and self.stale[code] > SAME:
            return None
        if name is None:
            ours = code.co_filename.startswith(self.package)
            name = self.ours[code] = code.co_filename[len(self.root) + 1 :] if ours else ""
        if not name:
            return None
        self.stale[code] += 1
        self.now.add((name, frame.f_lineno))
        return self._line

    def _line(self, frame: FrameType, event: str, _: Any) -> Any:
        if event == "line":
            place = self.ours[frame.f_code], frame.f_lineno
            if place not in self.now:
                self.now.add(place)
                self.stale[frame.f_code] = 0
        return self._line

    def _noted(self, key: str) -> Iterator[None]:
        before, stale, tracer = self.now, self.stale, sys.gettrace()
        self.now, self.stale = self.places[key], defaultdict(int)
        sys.settrace(self._enter)
        try:
            yield
        finally:
            sys.settrace(tracer)
            self.now, self.stale = before, stale

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Iterator[None]:
        return (yield from self._wrapped(_key(fixturedef)))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        _forget()
        known = item._fixtureinfo.name2fixturedefs.values()
        self.fixtures[item.nodeid] = [_key(f) for those in known for f in those]
        return (yield from self._wrapped(item.nodeid))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        return (yield from self._wrapped(item.nodeid))

    def _wrapped(self, key: str) -> Iterator[None]:
        noting = self._noted(key)
        next(noting)
        try:
            return (yield)
        finally:
            noting.close()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.seconds[report.nodeid] += report.duration
        if report.failed:
            self.failed.append(report.nodeid)


def _key(fixture: Any) -> str:
    return f"fixture {fixture.baseid} {fixture.argname}"


def _forget() -> None:
    """Empty the caches of the package, so that every test executes all that it needs."""
    for name, module in list(sys.modules.items()):
        if name.startswith("mfd_bayes."):
            for value in list(vars(module).values()):
                for held in (value, *(vars(value).values() if isinstance(value, type) else ())):
                    clear = getattr(getattr(held, "__func__", held), "cache_clear", None)
                    if clear:
                        clear()


@dataclass(frozen=True)
class Child:
    """A process, and the end of its pipe from which its words are read."""

    pid: int
    pipe: int

    def read(self) -> dict[str, Any]:
        """What it found; nothing where it was ended."""
        with os.fdopen(self.pipe, encoding="utf-8") as stream:
            words = stream.read()
        found: dict[str, Any] = json.loads(words or "{}")
        if "error" in found:
            raise RuntimeError(found["error"])
        return found

    def ended(self, status: int) -> tuple[str, str]:
        """State of the fault that it tried, and the test that failed."""
        found = self.read()
        if os.WIFSIGNALED(status):
            late = os.WTERMSIG(status) == signal.SIGPROF
            return ("timed out" if late else "killed"), ""
        if not found:
            return "killed", "ends the process"
        if found["code"] in (0, 5):
            return "survived", "" if found["code"] == 0 else "no test runs it"
        return "killed", found["failed"] or f"pytest ended with {found['code']}"


def _fork(work: Any) -> Child:
    reader, writer = os.pipe()
    pid = os.fork()
    if pid:
        os.close(writer)
        return Child(pid, reader)
    try:
        os.close(reader)
        quiet = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(quiet, stream)
        try:
            words = json.dumps(work()).encode()
        except BaseException:
            words = json.dumps({"error": traceback.format_exc()}).encode()
        with os.fdopen(writer, "wb") as stream:
            stream.write(words)
    finally:
        os._exit(0)


def try_on(tree: Path, module: str, mutant: Mutant, tests: Sequence[str], covered: Cover) -> Child:
    """Start a process that runs the tests with the fault in place."""

    def work() -> dict[str, Any]:
        if not tests:
            return {"code": 5, "failed": ""}
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        changed = ast.parse((tree / module).read_text(encoding="utf-8"))
        mutants(changed)[mutant.number].make()
        sys.meta_path.insert(0, _Faulty(tree / module, ast.fix_missing_locations(changed)))
        chosen = _Chosen(tests, covered.seconds)
        files = dict.fromkeys(_file(test) for test in tests)
        signal.setitimer(signal.ITIMER_PROF, COLLECTION)
        code = pytest.main([*QUIET, *files], plugins=[chosen])
        return {"code": int(code), "failed": chosen.failed}

    return _fork(work)


class _Faulty(MetaPathFinder):
    """Import finder that loads one module from a changed syntax tree."""

    def __init__(self, path: Path, tree: ast.Module) -> None:
        self.path, self.tree = path, tree
        parts = path.with_suffix("").parts
        self.name = ".".join(parts[parts.index("mfd_bayes") :])

    def find_spec(self, name: str, path: Any, target: Any = None) -> ModuleSpec | None:
        if name != self.name:
            return None
        return importlib.util.spec_from_file_location(
            name, self.path, loader=_Loader(name, str(self.path), self.tree)
        )


class _Loader(SourceFileLoader):
    def __init__(self, name: str, path: str, tree: ast.Module) -> None:
        super().__init__(name, path)
        self.tree = tree

    def get_code(self, fullname: str) -> CodeType:
        return compile(self.tree, self.path, "exec")


class _Chosen:
    """Plugin that runs only some tests, in their order, each with a limit of its time."""

    def __init__(self, tests: Sequence[str], seconds: Mapping[str, float]) -> None:
        self.place = {test: i for i, test in enumerate(tests)}
        self.seconds = seconds
        self.failed = ""

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted(
            (item for item in items if item.nodeid in self.place),
            key=lambda item: self.place[item.nodeid],
        )

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        signal.setitimer(signal.ITIMER_PROF, 10.0 + 3.0 * self.seconds[nodeid])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self.failed:
            self.failed = report.nodeid
