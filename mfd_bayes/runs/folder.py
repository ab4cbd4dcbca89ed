"""The layout of a run folder, and checks of what lies in it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from mfd_bayes.errors import StoreError
from mfd_bayes.records.regular import hash_file
from mfd_bayes.store.files import PART, cannot_remove, check_place, remove_file

MANIFEST = "manifest.json"
CAMPAIGN = "campaign.toml"
PRIORS = "priors.toml"
POPULATION = "population.nc"
CROSSVALIDATED = "crossvalidation"
FOLDERS = ("tests", "figures", CROSSVALIDATED)
"""Folders in a run folder."""


def folder_of(test_id: str) -> str:
    """Path of the folder of all that is stored of a test."""
    return f"tests/{test_id}"


def posterior_of(test_id: str) -> str:
    """Path of a test's posterior in a run folder."""
    return f"{folder_of(test_id)}/posterior.nc"


def pooled_of(test_id: str) -> str:
    """Path of a test's posterior after pooling in a run folder."""
    return f"tests/{test_id}/pooled.nc"


def record_of(test_id: str) -> str:
    """Path of the record of a held-out test (predicted, never fitted) in a run folder."""
    return f"tests/{test_id}/record.nc"


def check_links(out: Path, names: Iterable[str] = FOLDERS) -> None:
    """Refuse links that lead out of a run folder, where it is read or written.

    Parameters
    ----------
    out : Path
        Run folder.
    names : iterable of str
        Folders in it that are checked.

    Raises
    ------
    StoreError
        When one of them, or something in them, is a link to outside of the run folder.
    """
    try:
        home = out.resolve()
        for name in names:
            _check_inside(out / name, home)
            for folder, folders, files in os.walk(out / name):
                for entry in (*folders, *files):
                    _check_inside(Path(folder) / entry, home)
    except (OSError, RuntimeError) as error:  # links in a circle
        raise StoreError(f"cannot read {out}: {error}") from error


def _check_inside(path: Path, home: Path) -> None:
    if path.is_symlink() and not path.resolve().is_relative_to(home):
        raise StoreError(f"{path} is a link to outside of the run folder")


def check_places(out: Path) -> None:
    """Refuse to write a run into a folder in which a file of it would replace a device or a link.

    Raises
    ------
    StoreError
        When the place of one of its files is a device, a pipe, or a link out of the folder.
    """
    for name in (MANIFEST, *_OUTPUTS):
        check_place(out / name)


def check_stored(out: Path, name: str, digests: Mapping[str, Any]) -> Path:
    """Path of a stored file, checked: it is in the run folder and its hash, if known, is unchanged.

    Parameters
    ----------
    out : Path
        Run folder.
    name : str
        Path of the file in it, with slashes.
    digests : mapping of str to str
        SHA-256 of files, by name.

    Raises
    ------
    StoreError
        When the file is a link to elsewhere, is missing, or is not the one that was written.
    """
    path = out / name
    try:
        if not path.resolve().is_relative_to(out.resolve()):
            raise StoreError(f"{path} is a link to outside of the run folder")
        if name in digests and hash_file(path) != digests[name]:
            raise StoreError(
                f"{path} is not what this run wrote: its SHA-256 is not that in {MANIFEST}"
            )
    except (OSError, RuntimeError) as error:
        raise StoreError(f"cannot read {path}: {error}") from error
    return path


def hash_stored(out: Path, names: Iterable[str]) -> dict[str, str]:
    """SHA-256 of the named files that exist in a run folder."""
    return {name: hash_file(out / name) for name in names if (out / name).is_file()}


_TABLES = (
    *("parameters.csv", "derived.csv", "readings.csv", "noises.csv"),
    *("laws.csv", "law_scores.csv", "checks.csv", "scores.csv"),
    *("parameters.json", "laws.json", "parameters.tex", "laws.tex"),
    *("crossvalidation.csv", "tested_range.csv", "tables.docx", "tables.xlsx"),
    *("datasheet.csv", "datasheet.tex", "datasheet.html", "datasheet.pdf"),
)


def draws_as(form: str) -> str:
    """Name of the table of all draws in a run folder, as "csv" or "parquet"."""
    return f"draws.{form}"


_DRAWS = tuple(map(draws_as, ("csv", "parquet")))
_OUTPUTS = (POPULATION, *_TABLES, *_DRAWS, "report.html", "report.pdf", CAMPAIGN, PRIORS)


ADVICE = ("next.csv", "next.json", "next.png")
"""What `mfd-bayes next` writes into a run folder where it is told no other place."""

_ASKED_FOR = (
    *("tables.docx", "tables.xlsx", "report.pdf", "datasheet.pdf"),
    *(*ADVICE, "figures/next.png", "figures/next.csv"),
)
"""What a report writes only where it is asked for, and advice: all rests on the population."""

DISCARDED = f".{MANIFEST}.discarded"


def name_in_run(path: Path) -> Path | None:
    """Name of a file in the run folder that it lies in, as `manifest.json`; None outside of any.

    Links are followed.
    """
    found = path.resolve()
    for folder in found.parents:
        if (folder / MANIFEST).is_file() or (folder / DISCARDED).is_file():
            return found.relative_to(folder)
    return None


def is_of_run(name: Path) -> bool:
    """Whether a name in a run folder is that of a file which the run writes, or of its folders."""
    first = name.parts[0] if name.parts else ""
    return first in FOLDERS or name.as_posix() in (*_OUTPUTS, MANIFEST, DISCARDED)


def check_apart(out: Path, inputs: Iterable[Path], *, force: bool, resume: bool = False) -> None:
    """Refuse a run that would remove or replace one of its own inputs.

    Parameters
    ----------
    out : Path
        Run folder.
    inputs : iterable of Path
        Campaign file, priors and records.
    force : bool
        Whether what an earlier run wrote will be removed.
    resume : bool
        Whether what it wrote of a test may be removed.

    Raises
    ------
    StoreError
        When an input lies where the run writes.
    """
    home = out.resolve()
    for path in inputs:
        found = path.resolve()
        if not found.is_relative_to(home):
            continue
        name = found.relative_to(home)
        copied = name.as_posix() in (CAMPAIGN, PRIORS) and not force  # written as it was read
        stays = name.parts[0] in FOLDERS and not (resume and name.parts[0] == "tests")
        if is_of_run(name) and not copied and (force or not stays):
            raise StoreError(
                f"{path} is an input of this run and lies where {out} is written: it would be "
                "lost; give another folder"
            )


def discard(out: Path) -> None:
    """Remove what a run wrote, and nothing else; if it is interrupted, it can be repeated.

    Raises
    ------
    StoreError
        When the folder is not a run folder, or something in it cannot be removed.
    """
    check_links(out)
    begun = out / DISCARDED
    try:
        if (out / MANIFEST).is_file():
            (out / MANIFEST).replace(begun)
        elif not begun.exists():
            raise StoreError(f"{out} exists and is not a run folder: it has no {MANIFEST}")
        remove_partial_files(out)
        for name in FOLDERS:
            remove_folder(out / name)
        for name in (*_OUTPUTS, *ADVICE):
            (out / name).unlink(missing_ok=True)
        begun.unlink()
    except OSError as error:
        raise cannot_remove(out, error) from error


def remove_folder(path: Path) -> None:
    """Remove a folder if it is there; of a link, the link alone.

    Raises
    ------
    StoreError
        When it cannot be removed.
    """
    try:
        if path.is_symlink():
            path.unlink()
        elif path.exists():
            shutil.rmtree(path)
    except OSError as error:
        raise cannot_remove(path, error) from error


def remove_stale(out: Path, *, draws: bool) -> None:
    """Remove what no report writes again unasked, before the population is inferred anew.

    Parameters
    ----------
    out : Path
        Run folder.
    draws : bool
        Whether tests are sampled too, so that the table of their draws is removed.

    Raises
    ------
    StoreError
        When something cannot be removed.
    """
    for name in (*_ASKED_FOR, *(_DRAWS if draws else ())):
        remove_file(out / name)


def remove_partial_files(out: Path) -> None:
    """Remove the partly written files that a killed process left in a run folder, if possible."""
    folders = [out / name for name in FOLDERS]
    for parts in (out.glob, *(folder.rglob for folder in folders)):
        for part in parts(f".*{PART}"):
            with suppress(OSError):  # if the folder is read-only, the next write reports it
                part.unlink(missing_ok=True)
