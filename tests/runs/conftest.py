"""Run folders that no sampler has seen."""

import json
import shutil
from pathlib import Path

import pytest

from tests.run_folders import plan_of


@pytest.fixture
def out(made_run, tmp_path) -> Path:
    return Path(shutil.copytree(made_run, tmp_path / "out"))


@pytest.fixture
def plan():
    return plan_of(small=False)


@pytest.fixture
def change():
    def change(folder, how):
        manifest = json.loads((folder / "manifest.json").read_text())
        how(manifest)
        (folder / "manifest.json").write_text(json.dumps(manifest))

    return change
