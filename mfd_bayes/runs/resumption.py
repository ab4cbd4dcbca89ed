"""Checks whether a run may be started, resumed or replaced in a folder, and what is kept."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

from mfd_bayes.errors import StoreError
from mfd_bayes.jobs.job import State
from mfd_bayes.runs.folder import (
    DISCARDED,
    MANIFEST,
    POPULATION,
    check_links,
    check_places,
    check_stored,
    discard,
    posterior_of,
)
from mfd_bayes.runs.lock import OWNER
from mfd_bayes.runs.manifest import Manifest, read_begun
from mfd_bayes.store.files import is_part, json_text

_SAME = ("settings", "inputs", "seed", "effort", "versions")
"""Keys of the manifest that must not change from one session of a run to the next."""

_TOLD = 10
"""Largest number of changed entries that a message lists."""


def prepare_folder(
    manifest: Manifest, home: Path, out: Path, *, resume: bool, force: bool
) -> tuple[Manifest, Manifest | None]:
    """Check that a run may be started, resumed or replaced in a folder; remove a replaced one.

    Parameters
    ----------
    manifest : Manifest
        Of the run to be calibrated.
    home : Path
        Folder of the campaign file, links resolved; it may lie in the run folder.
    out : Path
        Run folder.
    resume, force : bool
        Whether to resume or replace a run that exists.

    Returns
    -------
    Manifest
        The given one, with the results that are kept from an earlier session.
    Manifest or None
        The earlier session's manifest, if it is resumed.

    Raises
    ------
    StoreError
        When the folder may not be used, or holds something other than this run.
    """
    check_links(out)
    check_places(out)
    if _is_free(home, out):
        return manifest, None
    if not (resume or force):
        raise StoreError(f"{out} exists: give --resume to finish it or --force to replace it")
    if force or (out / DISCARDED).exists():
        discard(out)
        return manifest, None
    try:
        before = read_begun(out)
    except StoreError as error:
        raise StoreError(
            f"{out} cannot be resumed: {error}; give --force to start again"
        ) from error
    new = json.loads(json_text(manifest.content))
    for key in _SAME:
        changed = _changes(before.content.get(key), new[key])
        if changed is not None:
            raise StoreError(
                f"{out} cannot be resumed: {key}{changed} changed since it was started; "
                "give --force to start again"
            )
    files = _kept_files(manifest.tests, out, before.files or {})
    return _with_results(manifest, before).changed(files=files), before


def _with_results(manifest: Manifest, before: Manifest) -> Manifest:
    """The manifest with the results of an earlier session."""
    if before.truth is not None:
        manifest = manifest.changed(truth=before.truth)
    for name, entry in before.tests.items():
        if name in manifest.tests and entry.status == State.DONE:
            manifest = manifest.with_test(name, status=State.DONE, seconds=entry.seconds)
    return manifest.changed(started=before.started, seconds=before.seconds)


def _kept_files(tests: Iterable[str], out: Path, digests: Mapping[str, str]) -> dict[str, str]:
    """Hashes of the posteriors that are kept, after a check that the files are unchanged.

    Hashes of other or missing files are dropped: such a file is written again before its hash
    is, and a kill in between would leave a new file with an old hash.
    """
    names = [name for name in map(posterior_of, tests) if (out / name).is_file()]
    for name in (*names, *([POPULATION] if (out / POPULATION).is_file() else [])):
        check_stored(out, name, digests)
    return {name: digests[name] for name in names if name in digests}


def _is_free(home: Path, out: Path) -> bool:
    """Whether a folder holds nothing but the campaign, a lock's owner or an unfinished manifest."""
    return all(
        entry.resolve() == home
        or entry.name == OWNER
        or is_part(entry, MANIFEST)
        or is_part(entry, OWNER)
        for entry in out.iterdir()
    )


def _changes(old: object, new: object) -> str | None:
    """Names of entries that differ, in brackets; "" for a plain value, None if all are equal."""
    if old == new:
        return None
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return ""
    names = [key for key in {**old, **new} if old.get(key) != new.get(key)]
    told = ", ".join(name[:60] for name in names[:_TOLD])
    return f" ({told}{', and more' if len(names) > _TOLD else ''})"
