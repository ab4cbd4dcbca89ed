"""Checks whether a run may be started, resumed or replaced in a folder, and what is kept."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

from mfd_bayes.calibration.prior_files import PriorFile, load_priors
from mfd_bayes.errors import PriorError, StoreError
from mfd_bayes.jobs.job import State
from mfd_bayes.runs.folder import (
    CROSSVALIDATED,
    DISCARDED,
    MANIFEST,
    POPULATION,
    PRIORS,
    check_links,
    check_places,
    check_stored,
    discard,
    posterior_of,
    remove_folder,
)
from mfd_bayes.runs.lock import OWNER
from mfd_bayes.runs.manifest import Manifest, read_begun
from mfd_bayes.store.files import is_part, json_text

_SAME = ("settings", "inputs", "seed", "effort", "versions")
"""Keys of the manifest that must not change from one session of a run to the next."""

_MAY_CHANGE = ("settings", "inputs")
"""Those of them that may change as far as they do not concern the tests' posteriors."""

ALL, POPULATION_TOO, TESTS = "all", "tests and population", "tests"

_POPULATION_ONLY = ("laws", "dependence")
"""Settings that concern the population alone."""

_TOLD = 10
"""Largest number of changed entries that a message lists."""


class Existing(Enum):
    """What happens to a run that exists in the folder."""

    REFUSED = "refused"
    RESUMED = "resumed"
    REPLACED = "replaced"

    @classmethod
    def asked(cls, *, resume: bool, force: bool) -> Existing:
        """By the options of a command, of which one at most is given."""
        return cls.RESUMED if resume else cls.REPLACED if force else cls.REFUSED


def prepare_folder(
    manifest: Manifest,
    home: Path,
    out: Path,
    existing: Existing,
    priors: PriorFile | None = None,
) -> tuple[Manifest, Manifest | None]:
    """Check that a run may be started, resumed or replaced in a folder; remove a replaced one.

    Where only what concerns the population has changed (laws, dependence, sessions, priors of
    scatter), the tests' posteriors are kept, and nothing that rests on the population. Where only
    the order of the tests has changed, all is kept but the tests that were left out.

    Parameters
    ----------
    manifest : Manifest
        Of the run to be calibrated.
    home : Path
        Folder of the campaign file, links resolved; it may lie in the run folder.
    out : Path
        Run folder.
    existing : Existing
        What happens to a run that exists.
    priors : PriorFile, optional
        Of the run to be calibrated; without them no change is allowed.

    Returns
    -------
    Manifest
        The given one, with the results that are kept from an earlier session.
    Manifest or None
        The earlier session's manifest, if its population is kept too.

    Raises
    ------
    StoreError
        When the folder may not be used, or holds something other than this run, or something in
        it that must go cannot be removed.
    """
    check_links(out)
    check_places(out)
    if _is_free(home, out):
        return manifest, None
    check_free(home, out, existing)
    if existing is Existing.REPLACED or (out / DISCARDED).exists():
        discard(out)
        return manifest, None
    try:
        before = read_begun(out)
    except StoreError as error:
        again = "--force to start again" if (out / MANIFEST).exists() else "another folder by -o"
        raise StoreError(f"{out} cannot be resumed: {error}; give {again}") from error
    same = _same_parts(manifest, before, out, priors)
    _refuse_changes(manifest, before, out, () if same is None else _MAY_CHANGE)
    files = _kept_files(manifest.tests, out, before.files or {})
    kept = _with_results(manifest, before, out).changed(files=files)
    if same in (TESTS, POPULATION_TOO):
        remove_folder(out / CROSSVALIDATED)
    if same == POPULATION_TOO and before.crossvalidation is not None:
        before = before.changed(crossvalidation=None)
    return kept, None if same == TESTS else before


def check_free(home: Path, out: Path, existing: Existing) -> None:
    """Refuse a folder that exists and is neither to be resumed nor to be replaced."""
    if existing is Existing.REFUSED and not _is_free(home, out):
        raise StoreError(f"{out} exists: give --resume to finish it or --force to replace it")


def _refuse_changes(
    manifest: Manifest, before: Manifest, out: Path, allowed: Collection[str]
) -> None:
    """Refuse to resume where something other than the allowed keys has changed."""
    new = json.loads(json_text(manifest.content))
    for key in _SAME:
        changed = None if key in allowed else _changes(before.content.get(key), new[key])
        if changed is not None:
            raise StoreError(
                f"{out} cannot be resumed: {key}{changed} changed since it was started; "
                "give --force to start again"
            )


def _same_parts(
    manifest: Manifest, before: Manifest, out: Path, priors: PriorFile | None
) -> str | None:
    """What rests on the same inputs as before; None where nothing is known to.

    `ALL`; or `POPULATION_TOO`, which is all but predictions of what was left out; or `TESTS` alone.
    The campaign and the prior file may differ in what none depends on, such as a comment.
    """
    earlier = _stored_priors(out, before)
    if priors is None or earlier is None:
        return None
    old, new = before.content, json.loads(json_text(manifest.content))
    if _of_tests(old, earlier) != _of_tests(new, priors):
        return None
    if _of_population(old, earlier) != _of_population(new, priors):
        return TESTS
    return ALL if _order(old) == _order(new) else POPULATION_TOO


def _stored_priors(out: Path, before: Manifest) -> PriorFile | None:
    """Priors of an earlier session; None where it has not stored any that can be read."""
    try:
        return load_priors(check_stored(out, PRIORS, before.files or {}).name, out)
    except (PriorError, StoreError):
        return None


def _of_tests(content: Mapping[str, Any], priors: PriorFile) -> tuple[object, ...]:
    """All that the tests' posteriors rest on, of a manifest's content."""
    settings = content["settings"]
    rest = {k: v for k, v in settings.items() if k not in ("tests", "priors", *_POPULATION_ONLY)}
    tests = {
        name: {k: v for k, v in test.items() if k not in ("session", "after")}
        for name, test in settings["tests"].items()
    }
    files = {str(test.get("file")) for test in tests.values()}
    inputs = {name: digest for name, digest in content["inputs"].items() if name in files}
    roles = {name: entry["role"] for name, entry in content["tests"].items()}
    return rest, tests, inputs, roles, _figures(priors)


def _of_population(content: Mapping[str, Any], priors: PriorFile) -> tuple[object, ...]:
    """All that the population rests on besides the tests' posteriors."""
    settings = content["settings"]
    sessions = {name: test.get("session", "") for name, test in settings["tests"].items()}
    scatter = {name: (s.parameters, s.sd, s.sparse) for name, s in priors.scatter.items()}
    return tuple(settings.get(key) for key in _POPULATION_ONLY), sessions, scatter


def _order(content: Mapping[str, Any]) -> dict[str, str]:
    """Which test follows which, of a manifest's content: predictions rest on it."""
    tests = content["settings"]["tests"]
    return {name: test["after"] for name, test in tests.items() if test.get("after")}


def population_digest(content: Mapping[str, Any], priors: PriorFile) -> str:
    """Digest, 64 hexadecimal digits, of what a population and predictions from it rest on.

    These are the tests' posteriors, sessions and order, the laws and dependence, and the priors.

    Parameters
    ----------
    content : mapping
        Of a manifest, with the hashes of the posteriors.
    priors : PriorFile
    """
    plain = json.loads(json_text(content))
    parts = {
        "posteriors": {
            name: (plain.get("files") or {}).get(posterior_of(name)) for name in plain["tests"]
        },
        "population": _of_population(plain, priors),
        "order": _order(plain),
        "priors": _figures(priors),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _figures(priors: PriorFile) -> dict[str, tuple[str, dict[str, float]]]:
    """Family and figures of each parameter's prior, by name."""
    return {name: (p.family, dict(p.figures)) for name, p in priors.parameters.items()}


def _with_results(manifest: Manifest, before: Manifest, out: Path) -> Manifest:
    """The manifest with the results of an earlier session.

    A comparison rests on the tests' posteriors alone, and is kept where all of them are.
    """
    fitted = (name for name, entry in manifest.tests.items() if entry.role == "calibrate")
    if before.comparison and all((out / posterior_of(name)).is_file() for name in fitted):
        manifest = manifest.changed(comparison=before.comparison)
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
    return not out.is_dir() or all(
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
