"""Run folders that no sampler has seen, made by the fuzz benchmark."""

import json
import shutil
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def runs(benchmark_module) -> ModuleType:
    """The benchmark's maker of run folders."""
    return benchmark_module("fuzz.runs")


@pytest.fixture(scope="session")
def made(runs, tmp_path_factory) -> Path:
    """A finished run of the tests a and b, with c held out; tests read it."""
    folder = tmp_path_factory.mktemp("made") / "out"
    runs.write_run(folder)
    return folder


@pytest.fixture
def out(made, tmp_path) -> Path:
    """A copy of the run."""
    return Path(shutil.copytree(made, tmp_path / "out"))


@pytest.fixture
def plan(runs):
    """The plan of the run."""
    return runs.plan_of(small=False)


@pytest.fixture
def change():
    """Function that changes the manifest in a folder."""

    def change(folder, how):
        manifest = json.loads((folder / "manifest.json").read_text())
        how(manifest)
        (folder / "manifest.json").write_text(json.dumps(manifest))

    return change
