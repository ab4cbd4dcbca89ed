"""Whether a run folder may be begun, gone on with or replaced, and what of it is kept."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from mfd_bayes.errors import StoreError
from mfd_bayes.runs.folder import (
    DISCARDED,
    MANIFEST,
    POPULATION,
    check_links,
    check_stored,
    discard,
    posterior_of,
)
from mfd_bayes.runs.lock import OWNER
from mfd_bayes.runs.manifest import read_begun
from mfd_bayes.store.files import is_part

_TOLD = 10
"""Most entries that are told to differ."""


def prepare_folder(
    manifest: dict[str, Any], home: Path, out: Path, *, resume: bool, force: bool
) -> dict[str, Any]:
    """Check that a folder may be begun, finished or replaced; leave in it what is kept.

    Parameters
    ----------
    manifest : dict
        Of the run that is begun; what is kept of an earlier session is added to it.
    home : Path
        Folder of the campaign file, links resolved: it may be in the run folder.
    out : Path
        Run folder.
    resume, force : bool
        What to do with a run that is there: finish it, or replace it.

    Returns
    -------
    dict
        Manifest of the run that is gone on with, or empty.

    Raises
    ------
    StoreError
        When the folder may not be begun, or holds something else than this run.
    """
    check_links(out)
    if _is_free(home, out):
        return {}
    if not (resume or force):
        raise StoreError(f"{out} exists: give --resume to finish it or --force to replace it")
    if force or (out / DISCARDED).exists():
        discard(out)
        return {}
    try:
        before = read_begun(out)
    except StoreError as error:
        raise StoreError(
            f"{out} cannot be resumed: {error}; give --force to start again"
        ) from error
    for key in ("settings", "inputs", "seed", "effort", "versions"):
        changed = _changes(before.get(key), json.loads(json.dumps(manifest[key])))
        if changed is not None:
            raise StoreError(
                f"{out} cannot be resumed: {key}{changed} changed since it was started; "
                "give --force to start again"
            )
    _keep(manifest, before)
    manifest["files"] = _kept_files(manifest["tests"], out, before.get("files") or {})
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


def _is_free(home: Path, out: Path) -> bool:
    """Whether a folder holds nothing but the campaign itself, or what was to be its manifest."""
    return all(
        entry.resolve() == home
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
