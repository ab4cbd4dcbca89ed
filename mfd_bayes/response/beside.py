"""Files that a building file names, which must lie in its folder."""

from __future__ import annotations

from pathlib import Path

from mfd_bayes.errors import BuildingError
from mfd_bayes.records.regular import file_inside


def file_beside(folder: Path, name: str, key: str) -> Path:
    """Path of a file in a building file's folder; `key` is the place at which it is named.

    Raises
    ------
    BuildingError
        When it lies outside the folder once links are followed, or its name is none of a file.
    """
    try:
        found = file_inside(folder, name)
    except (OSError, RuntimeError, ValueError) as error:
        raise BuildingError(f"{key}: the file {name!r} cannot be found: {error}") from error
    if found is None:
        raise BuildingError(
            f"{key}: the file {name!r} lies outside the folder of the building file"
        )
    return folder / name
