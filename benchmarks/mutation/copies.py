"""A copy of the project with faults in it, and runs of its tests by forks of this process."""

from __future__ import annotations

import ast
import json
import os
import signal
import sys
import time
import traceback
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import pytest

from benchmarks.common.data import PROJECT, data_folder
from benchmarks.mutation.operators import Mutant, mutants
from benchmarks.mutation.table import Outcome

OPTIONS = (
    *("-q", "-x", "--tb=no", "-p", "no:cacheprovider", "-p", "no:xdist"),
    *("-o", "addopts=--import-mode=importlib"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # of what was loaded before
)
LIMIT = 150.0
"""Seconds of one run of pytest, after which a fault counts as a survivor."""
LONGEST = 90
"""Seconds of a fast test, after which a fault is taken to hang it."""
ENDED = f"pytest ended with {-signal.SIGALRM}"
"""What is said of a run in which a test hung."""


@dataclass(frozen=True)
class Place:
    """Folder of a copy of the project, what it holds besides, and the text of what is changed."""

    home: Path

    @property
    def tree(self) -> Path:
        """The copy."""
        return self.home / "project"

    @property
    def laid_out(self) -> Path:
        """A file that is there where the copy is whole."""
        return self.home / "laid_out"

    def kept(self, kind: str) -> dict[str, Outcome]:
        """What is done, by the fault's name."""
        path = self.home / f"{kind}.json"
        found = json.loads(path.read_text()) if path.is_file() else {}
        return {name: Outcome(**told) for name, told in found.items()}

    def keep(self, kind: str, done: dict[str, Outcome]) -> None:
        """Keep what is done."""
        told = {name: asdict(outcome) for name, outcome in done.items()}
        (self.home / f"{kind}.json").write_text(json.dumps(told, indent=0))

    def put(self, faults: Sequence[tuple[str, Mutant]]) -> None:
        """Put faults into the copy; none: as the code is."""
        numbers = defaultdict(list)
        for module, mutant in faults:
            numbers[module].append(mutant.number)
        changed = self.home / "changed.json"
        before = json.loads(changed.read_text()) if changed.is_file() else []
        changed.write_text(json.dumps([*numbers]))
        for module in {*before, *numbers}:
            text = (PROJECT / module).read_text(encoding="utf-8")
            if module in numbers:
                tree = ast.parse(text)
                found = mutants(tree)
                for number in numbers[module]:
                    found[number].make()
                text = ast.unparse(ast.fix_missing_locations(tree))
            path = self.tree / module
            path.write_text(text, encoding="utf-8")
            for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
                compiled.unlink()  # it may be as old and as long

    def fails(self, words: Sequence[str], *, shared: bool = True, longest: int = LONGEST) -> str:
        """First test that fails; "" where none does, "..." where they did not end."""
        reader, writer = os.pipe()
        pid = os.fork()
        if not pid:
            try:
                os.setsid()
                signal.signal(signal.SIGTERM, signal.SIG_DFL)
                finished = self.home / "finished" if shared else None
                found = _ran(self.tree, words, finished, longest)
            except BaseException:  # what is forked must end here
                found = traceback.format_exc()
            os.write(writer, found.encode()[-4000:])
            os._exit(0)
        os.close(writer)
        until = time.monotonic() + LIMIT
        ended = 0
        try:
            while not ended and time.monotonic() < until:
                time.sleep(0.05)
                ended, status = os.waitpid(pid, os.WNOHANG)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(pid, signal.SIGKILL)
        if not ended:
            os.waitpid(pid, 0)
        with os.fdopen(reader) as stream:
            found = stream.read()
        if ended and os.WIFSIGNALED(status):
            return f"pytest ended with {-os.WTERMSIG(status)}"
        if found.startswith("Traceback"):
            raise RuntimeError(found)
        return found if ended else "..."


class _Watch:
    """Pytest plugin that keeps the first failure, and ends the process where a test hangs."""

    def __init__(self, longest: int) -> None:
        self.longest, self.failed = longest, ""

    def pytest_runtest_logstart(self) -> None:
        signal.alarm(self.longest)

    def pytest_runtest_logfinish(self) -> None:
        signal.alarm(0)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self.failed:
            self.failed = report.nodeid


def _ran(tree: Path, words: Sequence[str], finished: Path | None, longest: int) -> str:
    """Run pytest in this process, which is a fork, on the copy; the first failure, or ""."""
    os.environ |= {"PYTHONPATH": str(tree), "MFD_BAYES_DATA": str(data_folder())}
    os.environ |= {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")}
    os.environ.pop("MFD_BAYES_FINISHED_RUN", None)
    if finished:
        os.environ["MFD_BAYES_FINISHED_RUN"] = str(finished)
    sys.path[:] = [str(tree), *(p for p in sys.path if Path(p or ".").resolve() != PROJECT)]
    os.chdir(tree)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        os.dup2(nowhere, number)
    watch = _Watch(longest)
    code = pytest.main([*OPTIONS, *words], plugins=[watch])
    of = Path(sys.modules["mfd_bayes"].__file__ or "") if "mfd_bayes" in sys.modules else tree
    if not of.is_relative_to(tree):
        raise RuntimeError(f"Traceback: {of} was tested")
    return "" if code in (0, 5) else watch.failed or f"pytest ended with {int(code)}"
