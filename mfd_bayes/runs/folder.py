"""The layout of a run folder, and checks of what lies in it."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mfd_bayes.errors import StoreError
from mfd_bayes.plan import Options, Plan
from mfd_bayes.records.record import hash_file
from mfd_bayes.runs.lock import OWNER
from mfd_bayes.runs.manifest import read_begun
from mfd_bayes.store.files import is_part

if TYPE_CHECKING:
    pass
from mfd_bayes.store.files import _PART

if TYPE_CHECKING:
    pass


PRIORS = "priors.toml"


POPULATION = "population.nc"


def posterior_of(test_id: str) -> str:
    """Where a run folder holds the posterior of a test."""
    return f"tests/{test_id}/posterior.nc"


def pooled_of(test_id: str) -> str:
    """Where a run folder holds the posterior of a test after pooling."""
    return f"tests/{test_id}/pooled.nc"


def record_of(test_id: str) -> str:
    """Where a run folder holds the record of a test that is predicted, never fitted."""
    return f"tests/{test_id}/record.nc"


FOLDERS = ("tests", "figures", "crossvalidation")
"""Folders of a run folder."""


def check_links(out: Path, names: Iterable[str] = FOLDERS) -> None:
    """Refuse a run folder that leads out of itself, where it is read or written.

    Parameters
    ----------
    out : Path
    names : iterable of str
        Folders in it that are looked at.

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


def check_stored(out: Path, name: str, digests: Mapping[str, Any]) -> Path:
    """Path of a stored file that is in its run folder and, where its hash is known, unchanged.

    Parameters
    ----------
    out : Path
        Run folder.
    name : str
        Path of the file in it, with slashes.
    digests : mapping of str to str
        SHA-256 of files by such names.

    Raises
    ------
    StoreError
        When the file lies elsewhere, is missing, or is another than was written.
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
    """SHA-256 of those files of a run folder that there are."""
    return {name: hash_file(out / name) for name in names if (out / name).is_file()}


_TABLES = (
    *("parameters.csv", "derived.csv", "laws.csv", "law_scores.csv", "checks.csv", "scores.csv"),
    *("parameters.json", "laws.json", "parameters.tex", "laws.tex"),
    "crossvalidation.csv",
)


_OUTPUTS = ("population.nc", *_TABLES, "report.html", "report.pdf", "campaign.toml", "priors.toml")


_STORED = (posterior_of, pooled_of, record_of)


_TOLD = 10
"""Most entries that are told to differ."""


_DISCARDED = f".{MANIFEST}.discarded"


def prepare_folder(plan: Plan, out: Path, options: Options) -> dict[str, Any]:
    """Check that a folder may be begun, finished or replaced; leave in it what is kept.

    What the plan's manifest keeps of an earlier session is added to it.

    Returns
    -------
    dict
        Manifest of the run that is gone on with, or empty.

    Raises
    ------
    StoreError
        When the folder may not be begun, or holds something else than this plan's run.
    """
    check_links(out)
    if _is_free(plan, out):
        return {}
    if not (options.resume or options.force):
        raise StoreError(f"{out} exists: give --resume to finish it or --force to replace it")
    if options.force or (out / _DISCARDED).exists():
        discard(out)
        return {}
    try:
        before = read_begun(out)
    except StoreError as error:
        raise StoreError(
            f"{out} cannot be resumed: {error}; give --force to start again"
        ) from error
    for key in ("settings", "inputs", "seed", "effort", "versions"):
        changed = _changes(before.get(key), json.loads(json.dumps(plan.manifest[key])))
        if changed is not None:
            raise StoreError(
                f"{out} cannot be resumed: {key}{changed} changed since it was started; "
                "give --force to start again"
            )
    _keep(plan.manifest, before)
    plan.manifest["files"] = _kept_files(plan.manifest["tests"], out, before.get("files") or {})
    return before


def _keep(manifest: dict[str, Any], before: dict[str, Any]) -> None:
    """Take over from an earlier session what this one will not find out again."""
    manifest |= {key: before[key] for key in ("truth", "started") if key in before}
    manifest["seconds"] = before.get("seconds") or 0.0
    for name, entry in before["tests"].items():
        if name in manifest["tests"] and entry["status"] == "done":
            manifest["tests"][name] |= {k: entry[k] for k in ("status", "seconds") if k in entry}


def _kept_files(tests: Iterable[str], out: Path, digests: Mapping[str, str]) -> dict[str, str]:
    """Hashes of the posteriors that are gone on with, after a look whether they still hold.

    Of other files none is kept, nor of one that is gone: they are written anew, and before
    their hashes, so that a kill in between would leave a file that is not that of its hash.
    """
    names = [name for name in map(posterior_of, tests) if (out / name).is_file()]
    for name in (*names, *([POPULATION] if (out / POPULATION).is_file() else [])):
        check_stored(out, name, digests)
    return {name: digests[name] for name in names if name in digests}


def _is_free(plan: Plan, out: Path) -> bool:
    """Whether a folder holds nothing but the campaign itself, or what was to be its manifest."""
    return all(
        entry.resolve() == plan.campaign.folder
        or entry.name == OWNER
        or is_part(entry, MANIFEST)
        or is_part(entry, OWNER)
        for entry in out.iterdir()
    )


def _changes(old: object, new: object) -> str | None:
    """Which entries differ, in brackets; "" for a plain value, None where all are the same."""
    if old == new:
        return None
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return ""
    names = [key for key in {**old, **new} if old.get(key) != new.get(key)]
    told = ", ".join(name[:60] for name in names[:_TOLD])
    return f" ({told}{', and more' if len(names) > _TOLD else ''})"


def discard(out: Path) -> None:
    """Remove what a run wrote, and nothing else; what is begun is known for such until its end.

    Raises
    ------
    StoreError
        When the folder is not a run folder, or something in it cannot be removed.
    """
    check_links(out)
    begun = out / _DISCARDED
    try:
        if (out / MANIFEST).is_file():
            (out / MANIFEST).replace(begun)
        elif not begun.exists():
            raise StoreError(f"{out} exists and is not a run folder: it has no {MANIFEST}")
        sweep(out)
        for name in FOLDERS:
            if (out / name).exists():
                shutil.rmtree(out / name)
        for name in _OUTPUTS:
            (out / name).unlink(missing_ok=True)
        begun.unlink()
    except OSError as error:
        raise StoreError(f"cannot remove {error.filename}: {error.strerror}") from error


MANIFEST = "manifest.json"


def sweep(out: Path) -> None:
    """Remove from a run folder what a killed process was writing, where it can be removed."""
    folders = [out / name for name in ("tests", "figures", "crossvalidation")]
    for parts in (out.glob, *(folder.rglob for folder in folders)):
        for part in parts(f".*{_PART}"):
            with suppress(OSError):  # why not will be said of what is to be written
                part.unlink(missing_ok=True)
