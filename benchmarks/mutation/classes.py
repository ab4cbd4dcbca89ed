"""What a fault is tried on: test files that are near its module, or those of a class of guards."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path

LEFT_OUT = ("test_architecture.py", "test_docs.py", "test_python_page.py", "test_browser.py")
"""Test files that look at the text of the code, or need what is not everywhere."""


@dataclass(frozen=True)
class Guards:
    """A class of what could be destroyed or taken wrongly, and what guards against it.

    Attributes
    ----------
    modules : tuple of str
        Patterns of files of the package.
    tests : tuple of str
        Test files that are there for it, quickest first.
    """

    modules: tuple[str, ...]
    tests: tuple[str, ...]


GUARDS = {
    "outputs": Guards(
        ("pipeline/outputs.py", "runs/folder.py", "store/files.py"),
        (
            *("tests/store/test_files.py", "tests/runs/test_manifest.py"),
            *("tests/pipeline/test_outputs.py", "tests/pipeline/test_edges.py"),
        ),
    ),
    "lock": Guards(
        ("runs/lock.py", "runs/manifest.py"),
        ("tests/runs/test_lock.py", "tests/pipeline/test_edges.py"),
    ),
    "streams": Guards(
        ("cli/errors.py", "cli/commands.py", "reporting/figures/agg.py"),
        (
            *("tests/test_small_print.py", "tests/reporting/test_backend.py"),
            *("tests/cli/test_streams.py", "tests/cli/test_commands.py"),
        ),
    ),
    "readers": Guards(
        (
            *("records/numbers.py", "records/regular.py", "records/columns.py", "units.py"),
            *("records/file_name_check.py", "records/data_quality.py", "runs/unit_system.py"),
        ),
        (
            *("tests/test_units.py", "tests/test_small_print.py", "tests/records/test_roles.py"),
            *("tests/records/test_declared.py", "tests/records/test_faults.py"),
            *("tests/records/test_regular.py", "tests/records/test_record.py"),
            "tests/pipeline/test_extremes.py",
        ),
    ),
}
"""What a command writes, who works in a run folder, where it prints, and what it reads."""


def guards_of(tree: Path, module: str) -> list[str]:
    """Test files of the classes of guards that a module belongs to."""
    path = tree / module
    found = [
        name
        for guards in GUARDS.values()
        if any(path in (tree / "mfd_bayes").glob(pattern) for pattern in guards.modules)
        for name in guards.tests
    ]
    return [name for name in dict.fromkeys(found) if (tree / name).is_file()]


def near(tree: Path, module: str) -> list[str]:
    """Test files of the folder of the same name and those that import a module, nearest first.

    The nearest has the module's name, then come those that import it, then small files.
    """
    parts = Path(module).with_suffix("").parts
    room = tree / "tests" / parts[1] if len(parts) > 2 else tree / "none"
    known = ".".join(parts).removesuffix(".__init__")
    ranked = []
    for path in (tree / "tests").rglob("test_*.py"):
        names = _imported(path)
        imports = known in names
        if path.name not in LEFT_OUT and (imports or room in path.parents):
            named = path.stem == f"test_{parts[-1]}"
            rank = (not named, not imports, room not in path.parents, path.stat().st_size)
            ranked.append((rank, str(path.relative_to(tree))))
    return [name for _, name in sorted(ranked)]


def _imported(path: Path) -> set[str]:
    """Modules that a file imports, by either way of writing it."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found
