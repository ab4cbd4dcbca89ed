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
    *("records", "friction", "store", "jobs", "calibration", "population", "campaign"),
    *("runs", "evaluation", "reporting", "applications", "pipeline", "cli"),
)
THIN = {"mfd_bayes.runs.run imports mfd_bayes.reporting.notebook"}
"""What a run takes from a room above: how it shows itself in a notebook."""
RUN_CODE = {"pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve", "yaml"}
"""Libraries whose files may hold code: what we read is data."""


def module_of(path: Path) -> str:
    names = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(names[:-1] if names[-1] == "__init__" else names)


TREES = {module_of(path): ast.parse(path.read_text("utf-8")) for path in PACKAGE.rglob("*.py")}


@cache
def imports_of(module: str, *, annotations: bool = True, inner: bool = True) -> tuple[str, ...]:
    """Names that a module imports; without `annotations` those alone that it needs to run.

    Without `inner`, those that it needs to be loaded.
    """
    names: list[str] = []
    for statement in TREES[module].body:
        if not (annotations and inner) and ast.unparse(statement).startswith("if TYPE_CHECKING:"):
            continue
        for node in ast.walk(statement) if inner else (statement,):
            if isinstance(node, ast.Import):
                names += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                names += [f"{node.module}.{alias.name}" for alias in node.names]
    return tuple(names)


def modules_of(names: tuple[str, ...]) -> set[str]:
    """The package's modules that names stand in: `mfd_bayes.a.b.C` in `mfd_bayes.a.b`."""
    modules = set(TREES) - {"mfd_bayes"}
    return {name if name in modules else name.rpartition(".")[0] for name in names} & modules


def place_of(module: str) -> int:
    """Number of a module's room, -1 of a file at the root that has none."""
    room = module.split(".")[1]
    return ROOMS.index(room) if room in ROOMS else -1


def calls_of(tree: ast.AST) -> set[str]:
    """Functions that are called by their name alone, and keyword arguments."""
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    names = {expr.func.id for expr in calls if isinstance(expr.func, ast.Name)}
    return names | {str(keyword.arg) for expr in calls for keyword in expr.keywords}


def test_every_file_has_a_room_which_says_what_it_is_for() -> None:
    assert {path.parent.name for path in PACKAGE.glob("*/__init__.py")} == set(ROOMS)
    for room in ROOMS:
        assert (ast.get_docstring(TREES[f"mfd_bayes.{room}"]) or "").partition("\n")[0][-1] == "."


def test_imports_run_one_way() -> None:
    outer = {"mfd_bayes", "mfd_bayes.__main__"}  # the names of Python, and the command
    against = {
        f"{module} imports {imported}"
        for module in set(TREES) - outer
        for imported in modules_of(imports_of(module))
        if place_of(imported) > place_of(module)
    }
    assert against == THIN
    assert not [
        x for x in THIN if x.split()[2] in modules_of(imports_of(x.split()[0], inner=False))
    ]


def test_an_application_imports_only_the_door_of_another() -> None:
    def application_of(module: str) -> str:
        return ".".join(module.split(".")[:3]) if ".applications." in module else ""

    against = [
        f"{module} imports {imported}"
        for module in TREES
        for imported in modules_of(imports_of(module))
        if application_of(module)
        and application_of(imported) not in ("", application_of(module), imported)
    ]
    assert against == []


def test_no_two_files_import_each_other() -> None:
    imports = {
        name: {
            imported
            for imported in modules_of(imports_of(name, annotations=False)) - {name}
            if f"{name} imports {imported}" not in THIN
        }
        for name in TREES
    }
    TopologicalSorter(imports).prepare()
    with pytest.raises(CycleError):  # one would be seen
        TopologicalSorter({"a": {"b"}, "b": {"c"}, "c": {"a"}}).prepare()


def test_nothing_that_is_read_is_run() -> None:
    for module, tree in TREES.items():
        assert not {name.split(".")[0] for name in imports_of(module)} & RUN_CODE, module
        run = {"eval", "exec", "compile", "__import__", "allow_pickle"} & calls_of(tree)
        assert not run, module
    assert {"eval", "allow_pickle"} <= calls_of(ast.parse("np.load(eval(x), allow_pickle=True)"))


def test_regular_expressions_are_read_alike_by_every_python() -> None:
    # Python 3.11.2 errs in possessive quantifiers and atomic groups
    never = re.compile(r"[+*?}]\+|\(\?>")
    for module, tree in TREES.items():
        texts = [n.value for n in ast.walk(tree) if isinstance(n, ast.Constant)]
        assert not [t for t in texts if isinstance(t, str) and never.search(t)], module
    assert all(map(never.search, (r"\d++(?:[.p]\d++)?+", r"(?>\d)", "a{2}+")))


def test_the_command_line_computes_nothing() -> None:
    names = [name for module in TREES if ".cli" in module for name in imports_of(module)]
    rooms = {module.split(".")[1] for module in modules_of(tuple(names))} & set(ROOMS)
    assert rooms <= {
        *("applications", "pipeline", "cli", "jobs", "runs", "evaluation", "reporting", "campaign")
    }


def test_what_is_slow_to_load_is_loaded_where_it_is_needed(small_run, tmp_path) -> None:
    command = "from mfd_bayes.cli.commands import main; main()"
    display = "import mfd_bayes as mb; mb.open_run(sys.argv[1])._repr_html_()"
    sine = ("predict", small_run, "--sine", "1 in, 1 Hz, 2 cycles", "--actuation", "500 psi")
    sine += ("--no-figures", "-o", tmp_path / "bands.csv")
    for code, words, slow in (
        ("import mfd_bayes", (), {"numpy", "scipy", "emcee", "arviz", "matplotlib", "pandas"}),
        (command, ("--help",), {"numpy", "scipy", "pydantic", "pint", "importlib.metadata"}),
        (display, (small_run,), {"matplotlib", "arviz"}),
        (command, sine, {"pint", "pandas", "scipy.optimize", "xarray"}),
    ):
        loaded = f"atexit.register(lambda: print('loaded', {slow!r} & {{*sys.modules}}))"
        code = f"import atexit, sys; {loaded}; {code}"
        python = [sys.executable, "-W", "ignore", "-c", code, *map(str, words)]
        process = subprocess.run(python, capture_output=True, text=True, check=True)
        assert process.stdout.splitlines()[-1] == "loaded set()", process.stderr
