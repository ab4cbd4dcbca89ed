"""What the tests share."""

import importlib
import os
import sys
from pathlib import Path

import pytest


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


@pytest.fixture(scope="session")
def benchmark_module():
    """Function that imports a module of benchmarks/, such as "sbc.study"."""
    root = Path(__file__).parents[1]
    if not (root / "benchmarks").is_dir():
        pytest.skip("benchmarks/ is not part of this distribution")
    sys.path.append(str(root))  # last, so that an installed mfd_bayes is the one that is tested
    yield lambda name: importlib.import_module(f"benchmarks.{name}")
    sys.path.remove(str(root))
