"""Files that a building file names, which must lie in its folder."""

from __future__ import annotations

from pathlib import Path

from mfd_bayes.errors import BuildingError


def file_beside(folder: Path, name: str, key: str) -> Path:
    """Path of a file in a building file's folder; `key` is the place at which it is named.

    Raises
    ------
    BuildingError
        When it lies outside the folder once links are followed, or its name is none of a file.
    """
    try:
        found = (folder / name).resolve()
        inside = not Path(name).is_absolute() and found.is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError) as error:
        raise BuildingError(f"{key}: the file {name!r} cannot be found: {error}") from error
    if not inside:
        raise BuildingError(
            f"{key}: the file {name!r} lies outside the folder of the building file"
        )
    return folder / name
