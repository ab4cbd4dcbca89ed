"""A run folder: made, resumed or replaced; what lies in it is checked, kept or removed."""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from mfd_bayes.errors import StoreError
from mfd_bayes.jobs.job import State
from mfd_bayes.records.inputs import hash_file
from mfd_bayes.runs.lock import OWNER
from mfd_bayes.runs.manifest import COMPARISON, Manifest, Status, read_begun
from mfd_bayes.runs.paths import (
    ADVICE,
    CAMPAIGN,
    CROSSVALIDATION,
    DISCARDED,
    DRAWS,
    FOLDERS,
    MANIFEST,
    MODEL,
    ON_REQUEST,
    OUTPUTS,
    POPULATION,
    PRIORS,
    folder_of,
    is_written_by_run,
    posterior_of,
)
from mfd_bayes.store.files import PART, cannot_remove, check_place, is_part, remove_file

_MOST_NAMES = 10  # that a message lists


class Existing(Enum):
    """What happens to a run that exists in the folder."""

    REFUSED = "refused"
    RESUMED = "resumed"
    REPLACED = "replaced"

    @classmethod
    def of(cls, *, resume: bool, force: bool) -> Existing:
        """By the options of a command, of which one at most is given."""
        return cls.RESUMED if resume else cls.REPLACED if force else cls.REFUSED


@dataclass(frozen=True)
class Resumed:
    """What a run begins with."""

    manifest: Manifest
    before: Manifest | None = None
    same_tests: bool = False
    notes: tuple[str, ...] = ()


def prepare_folder(manifest: Manifest, home: Path, out: Path, existing: Existing) -> Resumed:
    """Check that a run may be started, resumed or replaced in a folder; remove a replaced one.

    Of a run that is resumed, everything is kept whose key is the same as before; what is stored
    under another key is removed.
    """
    check_links(out)
    check_places(out)
    if _is_free(home, out):
        return Resumed(manifest)
    check_free(home, out, existing)
    if existing is Existing.REPLACED or (out / DISCARDED).exists():
        discard(out)
        return Resumed(manifest)
    try:
        before = read_begun(out)
    except StoreError as error:
        again = "--force to start again" if (out / MANIFEST).exists() else "another folder by -o"
        raise StoreError(f"{out} cannot be resumed: {error}; give {again}") from error
    _check_resumable(manifest, before, out)
    same = {place for place, key in manifest.keys.items() if before.keys.get(place) == key}
    kept = [name for name in manifest.tests if folder_of(name) in same]
    resumed = _with_results(manifest, before, kept, out)
    if COMPARISON in same and all((out / posterior_of(n)).is_file() for n in manifest.fitted):
        resumed = resumed.changed(comparison=before.comparison)
    notes = (*_lost_notes(kept, manifest, before, out), *_machine_notes(manifest, before))
    if CROSSVALIDATION not in same:
        remove_folder(out / CROSSVALIDATION)
        before = before.changed(crossvalidation=None)
    if POPULATION not in same:
        before.changed(status=Status.RUNNING).write(out)  # what is left is no finished run
    for name in {*before.tests, *manifest.tests}.difference(kept):
        remove_folder(out / folder_of(name))
    population = before if POPULATION in same else None
    return Resumed(resumed, population, COMPARISON in same, notes)


def check_free(home: Path, out: Path, existing: Existing) -> None:
    """Refuse a folder that exists and is neither to be resumed nor to be replaced."""
    if existing is Existing.REFUSED and not _is_free(home, out):
        raise StoreError(f"{out} exists: give --resume to finish it or --force to replace it")


def _is_free(home: Path, out: Path) -> bool:
    """Whether a folder holds nothing but the campaign, a lock's owner or an unfinished manifest."""
    return not out.is_dir() or all(
        entry.resolve() == home
        or entry.name == OWNER
        or is_part(entry, MANIFEST)
        or is_part(entry, OWNER)
        for entry in out.iterdir()
    )


def _check_resumable(manifest: Manifest, before: Manifest, out: Path) -> None:
    """Refuse to resume a run of other tests, or with another seed, effort or version."""
    for key in ("seed", "effort", "versions"):
        old, new = getattr(before, key), getattr(manifest, key)
        if old == new:
            continue
        changed = ""
        if isinstance(old, Mapping):
            names = [name for name in {**old, **new} if old.get(name) != new.get(name)]
            changed = f" ({_listed(names)})"
        raise StoreError(
            f"{out} cannot be resumed: {key}{changed} changed since it was started; "
            "give --force to start again"
        )
    if not set(before.tests) & set(manifest.tests):
        raise StoreError(
            f"{out} cannot be resumed: it is a run of other tests ({_listed(before.tests)}); "
            "give another folder, or --force to replace it"
        )


def _with_results(
    manifest: Manifest, before: Manifest, kept: Collection[str], out: Path
) -> Manifest:
    """The manifest with what is kept of an earlier session, after a check of the kept files.

    Hashes of other files are dropped: such a file is written again before its hash is, and a kill
    in between would leave a new file with an old hash.
    """
    files = [name for name in map(posterior_of, kept) if (out / name).is_file()]
    for name in (*files, *([POPULATION] if (out / POPULATION).is_file() else [])):
        check_stored(out, name, before.files)
    resumed = manifest.changed(files={n: before.files[n] for n in files if n in before.files})
    if before.truth is not None:
        tests = {name: values for name, values in before.truth.tests.items() if name in kept}
        resumed = resumed.changed(truth=before.truth.model_copy(update={"tests": tests}))
    for name in kept:
        if before.tests[name].status == State.DONE:
            seconds = before.tests[name].seconds
            resumed = resumed.with_test(name, status=State.DONE, seconds=seconds)
    machines = dict.fromkeys(tuple(m.items()) for m in (*before.machines, *manifest.machines))
    return resumed.changed(
        started=before.started, seconds=before.seconds, machines=tuple(map(dict, machines))
    )


def _lost_notes(
    kept: Collection[str], manifest: Manifest, before: Manifest, out: Path
) -> list[str]:
    """Sentences on the finished tests that are not kept."""
    lost = [n for n in before.tests if n not in kept and (out / posterior_of(n)).is_file()]
    again = [name for name in lost if name in manifest.fitted]
    gone = [name for name in lost if name not in again]
    notes = []
    if again:
        notes.append(f"what they rest on has changed, so they are sampled again: {_listed(again)}")
    if gone:
        notes.append(f"no longer calibrated by this campaign, so removed: {_listed(gone)}")
    return notes


def _machine_notes(manifest: Manifest, before: Manifest) -> list[str]:
    """A sentence where the run was computed by another machine, as far as its draws tell."""
    (here,) = manifest.machines
    for there in before.machines:
        names = [name for name in {**there, **here} if there.get(name) != here.get(name)]
        if names:
            differ = "; ".join(
                f"{name} was {there.get(name, 'none')[:120]}, is {here.get(name, 'none')[:120]}"
                for name in names
            )
            return [
                "another machine has computed a part of this run, and draws that are kept can "
                f"differ in their last digits from those of this one: {differ}"
            ]
    return []


def _listed(names: Iterable[str]) -> str:
    """Names with commas; the first of many."""
    every = [name[:60] for name in names]
    more = f", and {len(every) - _MOST_NAMES} more" if len(every) > _MOST_NAMES else ""
    return ", ".join(every[:_MOST_NAMES]) + more


# --- what lies in a folder


def check_links(out: Path, names: Iterable[str] = FOLDERS) -> None:
    """Refuse named folders that are, or hold, links to outside of a run folder."""
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
    """Refuse a folder in which a file of the run would replace a device, a pipe or a link."""
    for name in (MANIFEST, *OUTPUTS):
        check_place(out / name)


def check_stored(out: Path, name: str, digests: Mapping[str, Any]) -> Path:
    """Path of a stored file, checked: it is in the run folder and its hash, if known, is unchanged.

    Raises StoreError where it is missing, a link to elsewhere, or not what was written.
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


def check_apart(out: Path, inputs: Iterable[Path], *, force: bool, resume: bool = False) -> None:
    """Refuse a run that would remove or replace one of its inputs: campaign, priors, records.

    With `force`, what an earlier run wrote will be removed; with `resume`, what it wrote of a test.
    """
    home = out.resolve()
    for path in inputs:
        place = path.resolve()
        if not place.is_relative_to(home):
            continue
        name = place.relative_to(home)
        copies = (CAMPAIGN, PRIORS, MODEL)  # written as they were read
        copied = name.as_posix() in copies and not force
        stays = name.parts[0] in FOLDERS and not (resume and name.parts[0] == "tests")
        if is_written_by_run(name) and not copied and (force or not stays):
            raise StoreError(
                f"{path} is an input of this run and lies where {out} is written: it would be "
                "lost; give another folder"
            )


def discard(out: Path) -> None:
    """Remove what a run wrote, and nothing else; if it is interrupted, it can be repeated.

    Raises StoreError where the folder is not a run folder, or something cannot be removed.
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
        for name in (*OUTPUTS, *ADVICE):
            (out / name).unlink(missing_ok=True)
        begun.unlink()
    except OSError as error:
        raise cannot_remove(out, error) from error


def remove_folder(path: Path) -> None:
    """Remove a folder if it is there; of a link, the link alone. StoreError when it cannot be."""
    try:
        if path.is_symlink():
            path.unlink()
        elif path.exists():
            shutil.rmtree(path)
    except OSError as error:
        raise cannot_remove(path, error) from error


def remove_stale(out: Path, *, draws: bool) -> None:
    """Remove what no report writes again unasked, before the population is inferred anew.

    With `draws`, tests are sampled too, and the table of their draws is removed.
    """
    for name in (*ON_REQUEST, *(DRAWS if draws else ())):
        remove_file(out / name)


def remove_partial_files(out: Path) -> None:
    """Remove the partly written files that a killed process left in a run folder, if possible."""
    for parts in (out.glob, *((out / name).rglob for name in FOLDERS)):
        for part in parts(f".*{PART}"):
            with suppress(OSError):  # if the folder is read-only, the next write reports it
                part.unlink(missing_ok=True)
