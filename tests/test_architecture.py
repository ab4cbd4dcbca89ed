"""The rooms import one way, and each heavy library has one home."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "mfd_bayes"

# A room may import from those before it in this list, and from itself.
LAYERS = (
    ("mfd_bayes.errors", "mfd_bayes.jobs.signals"),
    (
        "mfd_bayes.units",
        "mfd_bayes.records.readers.hdf5",
        "mfd_bayes.store.toml",
        "mfd_bayes.store.schema",
    ),
    ("mfd_bayes.records",),
    ("mfd_bayes.campaign.file", "mfd_bayes.friction", "mfd_bayes.store.files"),
    ("mfd_bayes.calibration",),
    ("mfd_bayes.population", "mfd_bayes.calibration.quantities"),
    ("mfd_bayes.reporting",),
    ("mfd_bayes.runs.manifest",),
    ("mfd_bayes.runs.run", "mfd_bayes.calibration.task", "mfd_bayes.campaign.synthetic"),
    ("mfd_bayes.pipeline.plan", "mfd_bayes.assessment", "mfd_bayes.jobs.workers"),
    ("mfd_bayes.jobs.likelihoods",),
    ("mfd_bayes.population.inference",),
    ("mfd_bayes.jobs.cluster", "mfd_bayes.runs.lock", "mfd_bayes.reporting.publication"),
    ("mfd_bayes.jobs.dispatch",),
    ("mfd_bayes.pipeline.calibration", "mfd_bayes.validation.folds"),
    ("mfd_bayes.records.inspection", "mfd_bayes.validation.models", "mfd_bayes.campaign.draft"),
    ("mfd_bayes.pipeline.commands", "mfd_bayes.cli.console", "mfd_bayes.cli.arguments"),
    ("mfd_bayes.cli.progress", "mfd_bayes.cli.exits"),
    ("mfd_bayes.cli.commands",),
    ("mfd_bayes.__main__",),
)

HOMES = {
    "emcee": ("mfd_bayes.calibration.sampling", "mfd_bayes.calibration.moves"),
    "arviz": ("mfd_bayes.calibration.diagnostics", "mfd_bayes.store.files"),
    "arviz_stats": ("mfd_bayes.calibration.diagnostics", "mfd_bayes.store.files"),
    "xarray": ("mfd_bayes.store.files", "mfd_bayes.runs.run"),
    "matplotlib": ("mfd_bayes.reporting.figures",),
    "corner": ("mfd_bayes.reporting.figures",),
    "PIL": ("mfd_bayes.reporting.figures",),
    "bokeh": ("mfd_bayes.reporting.explorer",),
    "jinja2": ("mfd_bayes.reporting.html",),
    "markupsafe": ("mfd_bayes.reporting.html", "mfd_bayes.reporting.symbols"),
    "pint": ("mfd_bayes.units",),
    "pydantic": (
        *("mfd_bayes.campaign.file", "mfd_bayes.runs.manifest", "mfd_bayes.store.schema"),
        *("mfd_bayes.calibration.stored", "mfd_bayes.population.stored"),
    ),
    "h5py": (
        "mfd_bayes.records.readers.matlab_v73",
        "mfd_bayes.records.readers.hdf5",
        "mfd_bayes.store.files",
    ),
    "openpyxl": ("mfd_bayes.records.readers.excel",),
    "nptdms": ("mfd_bayes.records.readers.tdms",),
    "dask": ("mfd_bayes.jobs.cluster",),
    "distributed": ("mfd_bayes.jobs.cluster",),
    "threadpoolctl": ("mfd_bayes.jobs.cluster",),
    "typer": (
        "mfd_bayes.cli.commands",
        "mfd_bayes.cli.console",
        "mfd_bayes.cli.arguments",
        "mfd_bayes.cli.exits",
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


def imports_of(path: Path) -> list[str]:
    names = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


MODULES = sorted(PACKAGE.rglob("*.py"))


def layer_of(name: str) -> int | None:
    for number, rooms in enumerate(LAYERS):
        if any(name == room or name.startswith(room + ".") for room in rooms):
            return number
    return None


def inside(name: str, homes: tuple[str, ...]) -> bool:
    return any(name == home or name.startswith(home + ".") for home in homes)


@pytest.mark.parametrize("path", MODULES, ids=module_of)
def test_imports_run_one_way(path: Path) -> None:
    module = module_of(path)
    if module == "mfd_bayes":
        return
    own = layer_of(module)
    assert own is not None, f"{module} belongs to no room: say where in LAYERS"
    room = ".".join(module.split(".")[:2])
    for name in imports_of(path):
        if not name.startswith("mfd_bayes.") or inside(name, (room, "mfd_bayes.__version__")):
            continue
        theirs = layer_of(name)
        assert theirs is not None, f"{module} imports {name}, which belongs to no room"
        assert theirs < own, f"{module} may not import {name}"


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


def test_the_command_line_calls_the_pipeline_alone() -> None:
    ours = {
        name.split(".")[1]
        for name in imports_of(PACKAGE / "cli.py")
        if name.startswith("mfd_")
        if "." in name
    }
    shows = {"arguments", "console", "ending", "interruption", "progress"}
    assert ours <= {"pipeline", "__version__"} | shows


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
