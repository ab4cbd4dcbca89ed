"""Run folders that no sampler has seen."""

import json
import shutil
from pathlib import Path

import pytest

from tests.run_folders import plan_of


@pytest.fixture
def out(made_run, tmp_path) -> Path:
    """A copy of the run of a and b."""
    return Path(shutil.copytree(made_run, tmp_path / "out"))


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
