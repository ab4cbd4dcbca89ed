"""Guards what a command writes where its user says: nothing is replaced without --force."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mfd_bayes.errors import StoreError
from mfd_bayes.runs.folder import MANIFEST, is_file_of_a_run
from mfd_bayes.store.files import check_place


def check_outputs(outputs: Iterable[Path], inputs: Iterable[Path], *, force: bool) -> None:
    """Refuse outputs that exist, but for `force`, and what must never be replaced."""
    inputs = list(inputs)
    for path in outputs:
        if path.name in ("", ".."):
            raise StoreError(f"cannot write {path}: give the name of a file")
        check_place(path)
        try:
            if path.is_dir():
                raise StoreError(f"cannot write {path}: it is a folder; give the name of a file")
            for source in inputs:
                linked = path.exists() and source.exists() and path.samefile(source)
                if linked or path.resolve() == source.resolve():
                    raise StoreError(
                        f"cannot write {path}: it is an input of this command, {source}"
                    )
            if is_file_of_a_run(path):
                raise StoreError(f"cannot write {path}: it is a file of the run in that folder")
            if path.exists() and not force:
                raise StoreError(f"{path} exists: give another name, or --force to replace it")
        except (OSError, RuntimeError, ValueError) as error:
            raise StoreError(f"cannot write {path}: {error}") from error


def check_folder(folder: Path, *, force: bool) -> None:
    """Refuse a folder of outputs that holds something, but for `force`, and run folders."""
    if folder.exists() and not folder.is_dir():
        raise StoreError(f"cannot write {folder}: it is a file, and a folder is expected")
    if (folder / MANIFEST).exists():
        raise StoreError(f"{folder} is a run folder: give a folder of its own")
    if folder.is_dir() and any(folder.iterdir()) and not force:
        raise StoreError(f"{folder} is not empty: give another name, or --force to write into it")
