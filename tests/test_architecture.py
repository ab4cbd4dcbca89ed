"""The rooms import one way, and each heavy library has one home."""

import ast
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
    "validation",
    "assessment",
    "reporting",
    "pipeline",
    "cli",
)

ROOT = {"__init__", "__main__", "errors", "units"}
"""The files that have no room."""

HOMES = {
    "emcee": ("mfd_bayes.calibration.ensembles", "mfd_bayes.calibration.moves"),
    "arviz": ("mfd_bayes.store.arviz",),
    "arviz_stats": ("mfd_bayes.calibration.diagnostics", "mfd_bayes.store.netcdf"),
    "xarray": (
        *("mfd_bayes.store.netcdf", "mfd_bayes.calibration.result"),
        "mfd_bayes.reporting.notebook",
    ),
    "matplotlib": ("mfd_bayes.reporting.figures",),
    "corner": ("mfd_bayes.reporting.figures",),
    "PIL": ("mfd_bayes.reporting.figures",),
    "bokeh": ("mfd_bayes.reporting.explorer",),
    "jinja2": ("mfd_bayes.reporting.html",),
    "markupsafe": (
        *("mfd_bayes.reporting.glossary", "mfd_bayes.reporting.html"),
        *("mfd_bayes.reporting.symbols", "mfd_bayes.reporting.response_page"),
    ),
    "pint": ("mfd_bayes.units",),
    "pydantic": (
        *("mfd_bayes.campaign.schema", "mfd_bayes.campaign.content"),
        *("mfd_bayes.runs.manifest", "mfd_bayes.runs.settings", "mfd_bayes.store.schema"),
        *("mfd_bayes.calibration.stored", "mfd_bayes.population.stored"),
        *("mfd_bayes.response.schema", "mfd_bayes.response.content"),
    ),
    "h5py": (
        "mfd_bayes.records.readers.matlab_v73",
        "mfd_bayes.records.readers.hdf5",
        "mfd_bayes.store.netcdf",
    ),
    "openpyxl": ("mfd_bayes.records.readers.excel", "mfd_bayes.reporting.workbook"),
    "pyarrow": ("mfd_bayes.reporting.draws",),
    "docx": ("mfd_bayes.reporting.word",),
    "nptdms": ("mfd_bayes.records.readers.tdms",),
    "dask": ("mfd_bayes.jobs.cluster",),
    "distributed": ("mfd_bayes.jobs.cluster",),
    "threadpoolctl": ("mfd_bayes.jobs.cluster", "mfd_bayes.population.inference"),
    "typer": (
        *("mfd_bayes.cli.commands", "mfd_bayes.cli.arguments", "mfd_bayes.cli.preparation"),
        *("mfd_bayes.cli.calibration", "mfd_bayes.cli.prediction", "mfd_bayes.cli.planning"),
        *("mfd_bayes.cli.console", "mfd_bayes.cli.exits", "mfd_bayes.cli.response"),
        "mfd_bayes.cli.usage",
    ),
    "rich": ("mfd_bayes.cli.console", "mfd_bayes.cli.progress"),
}

FORBIDDEN = (
    *("numba", "jax"),
    *("pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve", "yaml"),  # files are data
)


def module_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def imports_of(path: Path) -> tuple[str, ...]:
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return tuple(names)


LINES, LINES_OF_FUNCTION, PARAMETERS = 300, 40, 5
"""Of a file, of a function without its docstring, and of a function; options of commands apart."""

KERNELS = {
    "mfd_bayes.friction.backlash",
    "mfd_bayes.friction.bouc_wen",
    "mfd_bayes.calibration.staged_noise.log_density",
}
"""Numerical code that reads top to bottom."""

CONTRACTS = {
    *(
        f"mfd_bayes.friction.{name}.step"
        for name in ("backlash", "bouc_wen", "stepping", "weakened")
    ),
    "mfd_bayes.records.trace.from_arrays",
    "mfd_bayes.runs.response.respond_of_run",
    "mfd_bayes.runs.average.predict",
    "mfd_bayes.runs.run.predict",
    "mfd_bayes.runs.run.follow",
    "mfd_bayes.runs.run.respond",
}
"""Names of Python that other programs call as they are."""

MODULES = sorted(PACKAGE.rglob("*.py"))


def inside(name: str, homes: tuple[str, ...]) -> bool:
    return any(name == home or name.startswith(home + ".") for home in homes)


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
    assert {path.stem for path in PACKAGE.glob("*.py")} == ROOT
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders == set(ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_says_what_it_is_for(room: str) -> None:
    tree = ast.parse((PACKAGE / room / "__init__.py").read_text(encoding="utf-8"))
    assert (ast.get_docstring(tree) or "").count("\n") <= 8
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


def too_large(name: str, text: str) -> list[str]:
    """What of a file's text is over the project's sizes: lines, lines of functions, parameters."""
    found, lines = [], text.count("\n")
    if lines > LINES and name not in KERNELS:
        found.append(f"{name}: {lines} lines")
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.FunctionDef):
            continue
        told = f"{name}.{node.name}"
        said = ast.get_docstring(node) is not None
        first = node.body[0].end_lineno + 1 if said else node.body[0].lineno  # type: ignore[operator]
        if node.end_lineno - first >= LINES_OF_FUNCTION and told not in KERNELS:  # type: ignore[operator]
            found.append(f"{told}: {node.end_lineno - first + 1} lines")  # type: ignore[operator]
        given = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
        count = len([one for one in given if one not in ("self", "cls")])
        if count > PARAMETERS and told not in CONTRACTS and not name.startswith("mfd_bayes.cli."):
            found.append(f"{told}: {count} parameters")
    return found


@pytest.mark.parametrize("path", MODULES, ids=module_of)
def test_files_and_functions_are_small(path: Path) -> None:
    assert too_large(module_of(path), path.read_text(encoding="utf-8")) == []


def test_what_is_too_large_would_be_seen() -> None:
    function = "def f(a, b, c, d, e, g):\n" + "    pass\n" * 41 + "\n" * 300
    assert len(too_large("mfd_bayes.some", function)) == 3
    assert too_large("mfd_bayes.cli.some", "def f(a, b, c, d, e, g):\n    pass\n") == []


def circle_in(imports: dict[str, set[str]]) -> list[str]:
    """Files that import each other, in a circle; empty where none do."""
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_no_two_files_import_each_other() -> None:
    imports = {module_of(path): files_of(imports_of(path)) for path in MODULES}
    for room in list(imports):  # a room's __init__ imports what it offers
        imports[room] -= {room}
    assert circle_in(imports) == []


def test_a_circle_would_be_seen() -> None:
    assert circle_in({"a": {"b"}, "b": {"c"}, "c": {"a"}})


@pytest.mark.parametrize("path", MODULES, ids=module_of)
def test_heavy_libraries_stay_at_home(path: Path) -> None:
    module = module_of(path)
    for name in imports_of(path):
        for library, homes in HOMES.items():
            if inside(name, (library,)):
                assert inside(module, homes), f"{module} may not import {library}"
        assert not inside(name, FORBIDDEN), f"{module} may not import {name}"


def calls_of(text: str) -> set[str]:
    """Names of functions that are called by their name alone, and of keyword arguments."""
    calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    names = {call.func.id for call in calls if isinstance(call.func, ast.Name)}
    return names | {str(keyword.arg) for call in calls for keyword in call.keywords}


@pytest.mark.parametrize("path", MODULES, ids=module_of)
def test_nothing_that_is_read_is_run(path: Path) -> None:
    found = calls_of(path.read_text(encoding="utf-8"))
    assert not found & {"eval", "exec", "compile", "__import__", "allow_pickle"}


def test_what_is_run_would_be_seen() -> None:
    assert {"eval", "allow_pickle"} <= calls_of("np.load(eval(x), allow_pickle=True)")


@pytest.mark.parametrize(
    "name",
    ["commands", "arguments", "preparation", "calibration", "prediction", "planning", "response"],
)
def test_commands_call_the_pipeline_alone(name: str) -> None:
    ours = files_of(imports_of(PACKAGE / "cli" / f"{name}.py"))
    rooms = {file.split(".")[1] for file in ours}
    assert rooms <= {"pipeline", "cli", "jobs"}
    assert {file for file in ours if ".jobs." in file} <= {"mfd_bayes.jobs.signals"}


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
