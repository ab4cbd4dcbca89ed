"""The rooms import one way, no two files import each other, and nothing that is read is run."""

import ast
import re
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "mfd_bayes"

# From the edge of files to the edge of people: a room may import from those before it in this
# list, and from itself.
ROOMS = (
    "records",
    "friction",
    "store",
    "jobs",
    "calibration",
    "population",
    "planning",
    "response",
    "campaign",
    "runs",
    "evaluation",
    "reporting",
    "pipeline",
    "cli",
)

RUN_CODE = ("pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve", "yaml")
"""Libraries whose files may hold code: what we read is data."""

MODULES = sorted(PACKAGE.rglob("*.py"))


def module_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def imports_of(path: Path, *, annotations: bool = True) -> tuple[str, ...]:
    """Names that a file imports; without `annotations`, those alone that it needs to run."""
    names: list[str] = []
    tree = ast.parse(path.read_text(encoding="utf-8"))
    if not annotations:
        tree.body = [node for node in tree.body if not is_for_annotations(node)]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return tuple(names)


def is_for_annotations(node: ast.stmt) -> bool:
    """Whether a statement is `if TYPE_CHECKING:`."""
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def files_of(names: tuple[str, ...]) -> set[str]:
    """The files of the package that names stand in: `mfd_bayes.a.b.C` in `mfd_bayes.a.b`."""
    known = set(map(module_of, MODULES)) - {"mfd_bayes"}
    whole = {name if name in known else name.rpartition(".")[0] for name in names}
    return whole & known


def place_of(module: str) -> int:
    """Number of a module's room, -1 of a file at the root that has none."""
    first = module.split(".")[1]
    return ROOMS.index(first) if first in ROOMS else -1


def test_every_file_has_a_room() -> None:
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders == set(ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_says_what_it_is_for(room: str) -> None:
    tree = ast.parse((PACKAGE / room / "__init__.py").read_text(encoding="utf-8"))
    assert ast.get_docstring(tree, clean=True).splitlines()[0].endswith(".")  # type: ignore[union-attr]


@pytest.mark.parametrize("path", MODULES, ids=module_of)
def test_imports_run_one_way(path: Path) -> None:
    module = module_of(path)
    if module in ("mfd_bayes", "mfd_bayes.__main__"):  # the names of Python, the command
        return
    for file in files_of(imports_of(path)):
        same = file.split(".")[1] == module.split(".")[1]
        assert same or place_of(file) < place_of(module) or place_of(file) == -1, (
            f"{module} may not import {file}"
        )


def circle_in(imports: dict[str, set[str]]) -> list[str]:
    """Files that import each other, in a circle; empty where none do."""
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_no_two_files_import_each_other() -> None:
    needed = {path: imports_of(path, annotations=False) for path in MODULES}
    imports = {module_of(path): files_of(names) for path, names in needed.items()}
    for room in list(imports):  # a room's __init__ imports what it offers
        imports[room] -= {room}
    assert circle_in(imports) == []


def test_a_circle_would_be_seen() -> None:
    assert circle_in({"a": {"b"}, "b": {"c"}, "c": {"a"}})


def calls_of(text: str) -> set[str]:
    """Names of functions that are called by their name alone, and of keyword arguments."""
    calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    names = {call.func.id for call in calls if isinstance(call.func, ast.Name)}
    return names | {str(keyword.arg) for call in calls for keyword in call.keywords}


@pytest.mark.parametrize("path", MODULES, ids=module_of)
def test_nothing_that_is_read_is_run(path: Path) -> None:
    libraries = {name.split(".")[0] for name in imports_of(path)}
    assert not libraries & set(RUN_CODE)
    found = calls_of(path.read_text(encoding="utf-8"))
    assert not found & {"eval", "exec", "compile", "__import__", "allow_pickle"}


def test_what_is_run_would_be_seen() -> None:
    assert {"eval", "allow_pickle"} <= calls_of("np.load(eval(x), allow_pickle=True)")


@pytest.mark.parametrize("path", MODULES, ids=module_of)
def test_regular_expressions_are_read_alike_by_every_python(path: Path) -> None:
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    texts = [n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    assert not [text for text in texts if never_back(text)]


def never_back(text: str) -> bool:
    """Whether a text has a possessive quantifier or an atomic group: Python 3.11.2 errs there."""
    return re.search(r"[+*?}]\+|\(\?>", text) is not None


def test_what_is_read_otherwise_would_be_seen() -> None:
    assert all(map(never_back, (r"\d++(?:[.p]\d++)?+", r"(?>\d)", "a{2}+")))


def test_the_command_line_computes_nothing() -> None:
    names = [name for path in PACKAGE.glob("cli/*.py") for name in imports_of(path)]
    rooms = {file.split(".")[1] for file in files_of(tuple(names))} & set(ROOMS)
    shown = {"runs", "evaluation", "reporting", "campaign"}  # whose results are printed
    assert rooms <= {"pipeline", "cli", "jobs"} | shown


def test_no_module_is_a_drawer() -> None:
    names = {path.stem for path in MODULES}
    assert not names & {"utils", "helpers", "common", "misc"}


def test_import_is_quick_and_starts_nothing() -> None:
    code = (
        "import sys, time; began = time.perf_counter(); import mfd_bayes;"
        "heavy = {'numpy', 'scipy', 'emcee', 'arviz', 'matplotlib', 'pandas'} & set(sys.modules);"
        "print(sorted(heavy))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
