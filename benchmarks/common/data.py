"""Where the real records are, which are not part of the project."""

import argparse
import os
from pathlib import Path

PROJECT = Path(__file__).parents[2]


def data_folder() -> Path:
    """Folder that holds brfd/: that of MFD_BAYES_DATA, or ../shared/data beside the project."""
    return Path(os.environ.get("MFD_BAYES_DATA", PROJECT.parent / "shared" / "data"))


def add_data_option(parser: argparse.ArgumentParser) -> None:
    """Give a command line the option --data."""
    words = "folder that holds brfd/ (MFD_BAYES_DATA, ../shared/data)"
    parser.add_argument("--data", type=Path, default=data_folder(), help=words)
