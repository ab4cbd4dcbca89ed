"""Run folders that no sampler has seen."""

import json
import shutil
from pathlib import Path

import pytest

from tests.run_folders import plan_of, write_run


@pytest.fixture(scope="session")
def made(tmp_path_factory) -> Path:
    """A finished run of the tests a and b, with c held out; tests read it."""
    folder = tmp_path_factory.mktemp("made") / "out"
    write_run(folder)
    return folder


@pytest.fixture
def out(made, tmp_path) -> Path:
    """A copy of the run."""
    return Path(shutil.copytree(made, tmp_path / "out"))


@pytest.fixture
def plan():
    """The plan of the run."""
    return plan_of(small=False)


@pytest.fixture
def change():
    """Function that changes the manifest in a folder."""

    def change(folder, how):
        manifest = json.loads((folder / "manifest.json").read_text())
        how(manifest)
        (folder / "manifest.json").write_text(json.dumps(manifest))

    return change
