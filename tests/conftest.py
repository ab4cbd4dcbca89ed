"""What the tests share."""

import os
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
