"""What the tests share: the folder of real records, and one finished run for all of them."""

import fcntl
import importlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from hypothesis.configuration import set_hypothesis_home_dir

# The arrays here are small: with threads of its own, BLAS takes several times the processor time,
# most of it waiting. Set before the first import of NumPy, and for the processes that tests start.
for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# Processes that tests start read what tests define. Last, so that the installed package is tested.
sys.path.append(str(Path(__file__).parents[1]))

# What a calibration remembers of a user's own models is not to be that of who runs the tests.
if "PYTEST_XDIST_WORKER" not in os.environ:
    os.environ["XDG_STATE_HOME"] = tempfile.mkdtemp(prefix="mfd_bayes-state-")

# The tests run in a folder of their own, and a path is meant from where they were started.
for variable in {"MFD_BAYES_DATA", "MFD_BAYES_FINISHED_RUN"} & set(os.environ):
    os.environ[variable] = str(Path(os.environ[variable]).absolute())

# On its first import of a day ArviZ writes a file, and two processes that do so at once fail: the
# one that starts the others is first.
importlib.import_module("mfd_bayes.store.netcdf").import_arviz()

# A shell starts what runs in its background with Ctrl-C ignored, and processes inherit it. The
# tests that interrupt a process need it heard.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_configure(config) -> None:
    """Hypothesis writes before the first test: to a folder that is removed at the end."""
    folder = tempfile.TemporaryDirectory()
    config.add_cleanup(folder.cleanup)
    if "PYTEST_XDIST_WORKER" not in os.environ:
        config.add_cleanup(lambda: shutil.rmtree(os.environ["XDG_STATE_HOME"]))
    set_hypothesis_home_dir(folder.name)


@pytest.fixture(scope="session")
def nowhere(tmp_path_factory):
    """An empty folder, in which the tests run: what lies where they were started is not theirs."""
    folder = tmp_path_factory.mktemp("nowhere")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


@pytest.fixture(autouse=True)
def write_under_tmp_path_alone(nowhere):
    """A test that leaves a file in the working directory fails."""
    yield
    assert [path.name for path in nowhere.iterdir()] == []


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Folder of the real records, or a skip that says how to provide them."""
    root = Path(os.environ.get("MFD_BAYES_DATA", Path(__file__).parents[2] / "shared" / "data"))
    folder = root / "brfd"
    if not folder.is_dir():
        pytest.skip(
            f"real records not found at {folder}; set MFD_BAYES_DATA to their parent folder"
        )
    return folder


# The command as installed, but for the figures of its reports, which take half of a report's time.
# What draws in processes of its own would draw: they do not run this file as the main one.
DRIVER = """\
import sys

from mfd_bayes.cli.commands import main

if __name__ == "__main__":
    if {"calibrate", "crossvalidate", "report"} & set(sys.argv):
        from contextlib import nullcontext

        from mfd_bayes.jobs.local import in_turn
        from mfd_bayes.reporting import figures, page

        figures.draw_shared = figures.draw_test = lambda *_: iter(())
        # tests are drawn in this process
        page.several_processes = lambda functions, _: nullcontext(in_turn(functions))
    main()
"""


@pytest.fixture(scope="session")
def without_figures(tmp_path_factory) -> list[str]:
    """Words that start the command for a test that does not look at a report's figures."""
    driver = tmp_path_factory.mktemp("driver") / "driver.py"
    driver.write_text(DRIVER)
    return [sys.executable, str(driver)]


@pytest.fixture
def no_figures(monkeypatch) -> None:
    """Reports of up to three tests that are made in this process have no figures."""
    for name in ("draw_shared", "draw_test"):
        monkeypatch.setattr(f"mfd_bayes.reporting.figures.{name}", lambda *_: iter(()))


@pytest.fixture
def small_pictures(monkeypatch) -> None:
    """The pictures of a prediction and an inspection are empty ones, which are drawn at once."""
    from mfd_bayes.reporting import figures
    from mfd_bayes.reporting.figures import new_figure

    dot = figures.to_png(new_figure(1, 1))
    for name in ("draw_loops", "draw_history", "draw_inspection"):
        monkeypatch.setattr(figures, name, lambda *_, **__: None)
    monkeypatch.setattr(figures, "to_png", lambda _: dot)


@dataclass(frozen=True)
class FinishedRun:
    """A small synthetic campaign that the command has calibrated."""

    campaign: Path  # of three tests and one held out
    truth: dict[str, Any]  # the parameters that the records are made with
    out: Path  # tests read it, or change a copy of it
    stdout: str
    stderr: str


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory) -> FinishedRun:
    """The finished run, calibrated once for all processes of a test session.

    Sessions of the same code share one in the folder that MFD_BAYES_FINISHED_RUN names.
    """
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # which the processes share
    folder = Path(os.environ.get("MFD_BAYES_FINISHED_RUN", folder / "finished_run"))
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # the others wait for the first
        ended = folder / "ended.json"
        if not ended.is_file():
            ended.write_text(json.dumps(calibrate_once(folder)))
    ended = json.loads(ended.read_text())
    assert ended.pop("code") == 0, ended["stderr"]
    return FinishedRun(folder / "campaign" / "campaign.toml", out=folder / "out", **ended)


def calibrate_once(folder: Path) -> dict[str, Any]:
    """Calibrate the small campaign in two processes; the truth, and how the command ended."""
    from mfd_bayes.campaign.synthetic import Matrix, write_campaign

    pressures = (500.0, 1000.0, 1500.0)
    matrix = Matrix(pressures=pressures, frequencies=(0.5,), cycles=(2,), held_out=(1200.0, 0.5))
    (folder / "campaign").mkdir()
    truth = write_campaign(folder / "campaign", 1, matrix)
    path = folder / "campaign" / "campaign.toml"
    path.write_text(path.read_text().replace('"ou"', '"ou"\nrate = "50 Hz"\narea = 1.5'))
    command = [sys.executable, "-m", "mfd_bayes", "calibrate", path, "-o", folder / "out"]
    # a user has set no thread counts
    environment = {name: v for name, v in os.environ.items() if not name.endswith("_NUM_THREADS")}
    environment["PYTHONPATH"] = os.pathsep.join(sys.path)
    command = [*map(str, command), "--effort", "quick", "--jobs", "2"]
    ended = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    printed = {"stdout": ended.stdout, "stderr": ended.stderr}
    return {"truth": truth, "code": ended.returncode, **printed}


@pytest.fixture(scope="session")
def made_run(tmp_path_factory) -> Path:
    """A finished run of a and b, with c held out, that no sampler has seen. Tests read it."""
    from tests.run_folders import write_run

    return write_run(tmp_path_factory.mktemp("made") / "out", small=False)


@pytest.fixture(scope="session")
def small_run(tmp_path_factory) -> Path:
    """As `made_run`, of a alone, with a model of fewer parameters."""
    from tests.run_folders import write_run

    return write_run(tmp_path_factory.mktemp("made") / "out", small=True)
