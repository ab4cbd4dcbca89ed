"""Names and places of a run's files, its lock, and what may be written or removed."""

from __future__ import annotations

import fcntl
import os
import re
import shlex
import socket
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from io import FileIO
from itertools import chain
from pathlib import Path
from typing import Any, Literal, get_args

from mfd_bayes.errors import StoreError, hash_file
from mfd_bayes.jobs.signals import before_end
from mfd_bayes.store.files import PART, cannot_remove, check_place, is_part, remove_file

MANIFEST = "manifest.json"
CAMPAIGN = "campaign.toml"
PRIORS = "priors.toml"
MODEL = "model.py"
"""A copy of the file of a model of the user's own."""

POPULATION = "population.nc"
CROSSVALIDATION = "crossvalidation"
REHEARSAL = "rehearsal"
DISCARDED = f".{MANIFEST}.discarded"
"""The manifest of a run while it is removed: if that is interrupted, it can be repeated."""

OWNER = ".owner"
"""The lock of the folder, which names the process that works in it."""

PartKind = Literal["test", "level", "session", "motion"]
"""What is left out of a campaign at a time."""

FOLDERS = ("tests", "figures", CROSSVALIDATION, REHEARSAL)
"""Folders in a run folder."""

WRITTEN = re.compile(
    r"tests/[^/]+/((posterior|pooled|record)\.nc|record\.csv|page\.html"
    r"|(loops|history|residuals|marginals|corner|ranks)\.png)"
    r"|figures/(overview|laws|truth|next)\.(png|csv)"
    rf"|{CROSSVALIDATION}/({'|'.join(get_args(PartKind))})_\d+\.json"
    rf"|{REHEARSAL}/run_\d+\.json"
)
"""Names of the files that a run and its report write in these folders; others are not theirs."""

ASSESSMENT = "assessment.json"
"""Checks and verdict of a run, for `mfd-bayes check`."""

REWEIGHED = ("reweighed.csv", "reweighed.html")
"""What `mfd-bayes reweigh` writes: a run under two priors, side by side."""

DRAWS = ("draws.csv", "draws.parquet")
ADVICE = ("next.csv", "next.json", "next.png")
"""What `mfd-bayes next` writes into a run folder where it is told no other place."""

REHEARSED = tuple(f"{REHEARSAL}.{form}" for form in ("csv", "html", "png"))
"""What `mfd-bayes rehearse` writes into a run folder, beside its folder of results."""

_ON_REQUEST = ("tables.docx", "tables.xlsx", "report.pdf", "datasheet.pdf")
_TABLES = "parameters derived loop_estimates laws law_scores checks scores crossvalidation"
OUTPUTS = (
    *(f"{name}.csv" for name in (*_TABLES.split(), "tested_range", "sensitivity")),
    *(f"{name}.{form}" for name in ("parameters", "laws") for form in ("json", "tex")),
    *("datasheet.csv", "datasheet.tex", "cycles.csv", "conformity.csv", "factors.csv"),
    *(*_ON_REQUEST, *REWEIGHED, *DRAWS, "report.html", "datasheet.html"),
    *(ASSESSMENT, POPULATION, CAMPAIGN, PRIORS, MODEL),
)
"""Files that a run and its report write, but for the manifest and what lies in folders."""


def folder_of(test_id: str) -> str:
    """Folder of all that is stored of a test."""
    return f"tests/{test_id}"


def posterior_of(test_id: str) -> str:
    """File of a test's posterior."""
    return f"{folder_of(test_id)}/posterior.nc"


def pooled_of(test_id: str) -> str:
    """File of a test's posterior after pooling."""
    return f"{folder_of(test_id)}/pooled.nc"


def record_of(test_id: str) -> str:
    """File of the record of a held-out test (predicted, never fitted)."""
    return f"{folder_of(test_id)}/record.nc"


def is_written_by_run(name: Path) -> bool:
    """Whether a run writes a file of this name in its folder."""
    top = name.parts[0] if name.parts else ""
    return top in FOLDERS or name.as_posix() in (*OUTPUTS, MANIFEST, DISCARDED)


def is_file_of_a_run(path: Path) -> bool:
    """Whether a path, links followed, lies in a run folder and is one that the run writes."""
    target = path.resolve()
    for folder in target.parents:
        if (folder / MANIFEST).is_file() or (folder / DISCARDED).is_file():
            return is_written_by_run(target.relative_to(folder))
    return False


# --- the lock


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Make the folder and keep other processes from working in it until the end.

    The lock is the operating system's, on a file in the folder, and ends with its owner. The file
    names the owner to a process that is refused.
    """
    path = folder / OWNER
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = path.open("ab+", buffering=0)
    except OSError as error:
        raise StoreError(f"cannot write in the run folder {folder}: {error.strerror}") from error

    def leave() -> None:
        with suppress(OSError):  # a name that is left behind is no lock
            path.unlink(missing_ok=True)

    with file:
        if not _has_lock(file, path):
            file.seek(0)
            owner = file.read(1000).decode(errors="replace").strip()
            name = f": {owner}" if owner else ""
            raise StoreError(f"another process is working in {folder}{name}: let it end")
        command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
        process = f"process {os.getpid()} on {socket.gethostname()}"
        owner = f"{command!r}, {process} since {datetime.now(UTC):%Y-%m-%d %H:%M:%S UTC}"
        with before_end(leave):
            try:
                with suppress(OSError):  # a full disk: the first result reports it
                    file.truncate(0)
                    file.write(owner.encode(errors="backslashreplace"))
                yield
            finally:
                leave()


def _has_lock(file: FileIO, path: Path) -> bool:
    """Whether this process has the lock of a file now, which no other has removed meanwhile."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat())


# --- what lies in a folder


def is_free(folder: Path, campaign_folder: Path) -> bool:
    """Whether a folder holds nothing but the campaign, a lock's owner or an unfinished manifest."""
    return not folder.is_dir() or all(
        entry.resolve() == campaign_folder or entry.name == OWNER or is_part(entry, MANIFEST)
        for entry in folder.iterdir()
    )


def check_links(folder: Path, names: Iterable[str] = FOLDERS) -> None:
    """Refuse named folders that are, or hold, links to outside of a run folder."""
    try:
        root = folder.resolve()
        for name in names:
            for path in chain([folder / name], (folder / name).rglob("*")):
                if path.is_symlink() and not path.resolve().is_relative_to(root):
                    raise StoreError(f"{path} is a link to outside of the run folder")
    except (OSError, RuntimeError) as error:  # links in a circle
        raise StoreError(f"cannot read {folder}: {error}") from error


def check_places(folder: Path) -> None:
    """Refuse a folder in which a file of the run would replace a device, a pipe or a link."""
    for name in (MANIFEST, *OUTPUTS):
        check_place(folder / name)


def check_stored(folder: Path, name: str, digests: Mapping[str, Any]) -> Path:
    """Path of a stored file, checked: it is in the run folder and its hash, if known, is unchanged.

    Raises StoreError where it is missing, a link to elsewhere, or not what was written.
    """
    path = folder / name
    try:
        if not path.resolve().is_relative_to(folder.resolve()):
            raise StoreError(f"{path} is a link to outside of the run folder")
        if name in digests and hash_file(path) != digests[name]:
            raise StoreError(
                f"{path} is not what this run wrote: its SHA-256 is not that in {MANIFEST}; or "
                "another process has changed the run meanwhile"
            )
    except (OSError, RuntimeError) as error:
        raise StoreError(f"cannot read {path}: {error}") from error
    return path


def hash_stored(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """SHA-256 of the named files that exist in a run folder."""
    return {name: hash_file(folder / name) for name in names if (folder / name).is_file()}


def check_apart(folder: Path, inputs: Iterable[Path], *, force: bool, resume: bool) -> None:
    """Refuse a run that would remove or replace one of its inputs: campaign, priors, records.

    With `force`, what an earlier run wrote will be removed; with `resume`, what it wrote of a test.
    """
    root = folder.resolve()
    for path in inputs:
        target = path.resolve()
        if not target.is_relative_to(root):
            continue
        name = target.relative_to(root)
        copied = name.as_posix() in (CAMPAIGN, PRIORS, MODEL)  # written as they were read
        in_folder = name.parts[0] in FOLDERS and not (resume and name.parts[0] == "tests")
        if is_written_by_run(name) and (force or not (copied or in_folder)):
            raise StoreError(
                f"{path} is an input of this run and lies where {folder} is written: it would be "
                "lost; give another folder"
            )


def discard(folder: Path) -> None:
    """Remove what a run wrote, and nothing else; if it is interrupted, it can be repeated.

    Raises StoreError where the folder is not a run folder, or something cannot be removed.
    """
    check_links(folder)
    marker = folder / DISCARDED
    try:
        if (folder / MANIFEST).is_file():
            (folder / MANIFEST).replace(marker)
        elif not marker.exists():
            raise StoreError(f"{folder} exists and is not a run folder: it has no {MANIFEST}")
        remove_partial_files(folder)
        for name in FOLDERS:
            remove_folder(folder, name)
        for name in (*OUTPUTS, *ADVICE, *REHEARSED):
            (folder / name).unlink(missing_ok=True)
        marker.unlink()
    except OSError as error:
        raise cannot_remove(folder, error) from error


def remove_folder(folder: Path, name: str) -> None:
    """Remove what a run wrote in one of its folders, and the folder where nothing else is in it.

    Of a link, the link alone. StoreError where something cannot be removed.
    """
    path = folder / name
    try:
        if path.is_symlink():
            path.unlink()
        elif path.is_dir():
            for entry in path.iterdir():
                if WRITTEN.fullmatch(f"{name}/{entry.name}"):
                    entry.unlink()
                elif name == "tests" and entry.is_dir():
                    remove_folder(folder, f"{name}/{entry.name}")
            if not any(path.iterdir()):
                path.rmdir()
    except OSError as error:
        raise cannot_remove(path, error) from error


def remove_stale(folder: Path, *, draws: bool) -> None:
    """Remove what no report writes again unasked, before the population is inferred anew.

    With `draws`, tests are sampled too, and the table of their draws is removed.
    """
    on_request = (
        *_ON_REQUEST,
        *ADVICE,
        *REHEARSED,
        *REWEIGHED,
        "figures/next.png",
        "figures/next.csv",
    )
    remove_folder(folder, REHEARSAL)
    for name in (*on_request, *(DRAWS if draws else ())):
        remove_file(folder / name)


def remove_partial_files(folder: Path) -> None:
    """Remove the partly written files that a killed process left in a run folder, if possible."""
    for glob in (folder.glob, *((folder / name).rglob for name in FOLDERS)):
        for path in glob(f".*{PART}"):
            if re.fullmatch(rf"\..+\.[0-9a-f]{{8}}\{PART}", path.name):
                with suppress(OSError):  # if the folder is read-only, the next write reports it
                    path.unlink(missing_ok=True)


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
