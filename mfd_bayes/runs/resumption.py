"""Checks whether a run may be started, resumed or replaced in a folder, and what is kept."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from mfd_bayes.calibration.prior_files import PriorFile
from mfd_bayes.errors import StoreError
from mfd_bayes.jobs.job import State
from mfd_bayes.runs.folder import (
    CROSSVALIDATED,
    DISCARDED,
    MANIFEST,
    POPULATION,
    check_links,
    check_places,
    check_stored,
    discard,
    folder_of,
    posterior_of,
    remove_folder,
)
from mfd_bayes.runs.lock import OWNER
from mfd_bayes.runs.manifest import Manifest, Status, read_begun
from mfd_bayes.store.files import is_part, json_text

_SAME = ("seed", "effort", "versions")
"""Keys of the manifest that must not change from one session of a run to the next."""

_OF_POPULATION = ("laws", "dependence", "actuation_unit")
"""Settings that concern the population and no test's posterior."""

_TOLD = 10
"""Largest number of names that a message lists."""


class Existing(Enum):
    """What happens to a run that exists in the folder."""

    REFUSED = "refused"
    RESUMED = "resumed"
    REPLACED = "replaced"

    @classmethod
    def asked(cls, *, resume: bool, force: bool) -> Existing:
        """By the options of a command, of which one at most is given."""
        return cls.RESUMED if resume else cls.REPLACED if force else cls.REFUSED


@dataclass(frozen=True)
class Resumed:
    """What a run begins with.

    Attributes
    ----------
    manifest : Manifest
        Of the run, with the results that are kept from an earlier session.
    before : Manifest or None
        The earlier session's manifest, if its population is kept too.
    same_tests : bool
        Whether the run has the calibrated tests that it had, none of them changed.
    told : tuple of str
        What the user must know: what is not kept, and that this is another machine.
    """

    manifest: Manifest
    before: Manifest | None = None
    same_tests: bool = False
    told: tuple[str, ...] = ()


def with_keys(manifest: Manifest, priors: PriorFile) -> Manifest:
    """The manifest with the keys of its tests and of its population.

    A key is the SHA-256 of all that a stored result rests on: where it is the same as before, the
    result is kept. A test's own has nothing of the other tests.
    """
    plain = json.loads(json_text(manifest.content))
    settings, figures = plain["settings"], _figures(priors)
    of_all = {name: settings[name] for name in ("model", "noise", "start", "rate")}
    of_all |= {"checks_noise": manifest.settings.checks_noise(manifest.effort.name)}
    of_all |= {"effort": plain["effort"], "seed": plain["seed"], "priors": figures}
    for name, test in settings["tests"].items():
        own = {part: test[part] for part in ("columns", "fit", "actuation")}
        own |= {"id": name, "record": plain["inputs"][test["file"]]}
        own["form"] = Path(test["file"]).suffix.lower()
        manifest = manifest.with_test(name, key=_digest(own, of_all))
    sessions = [settings["tests"][name].get("session", "") for name, _ in _fitted(manifest)]
    laws = [settings.get(name) for name in _OF_POPULATION]
    return manifest.changed(
        population_key=_digest(_fitted(manifest), sessions, laws, _scatter(priors))
    )


def prepare_folder(manifest: Manifest, home: Path, out: Path, existing: Existing) -> Resumed:
    """Check that a run may be started, resumed or replaced in a folder; remove a replaced one.

    Of a run that is resumed, every test is kept whose key is the same as before. What is stored of
    the others is removed. The population is kept where its key is the same, and what was left out
    where in addition the order of the tests is.

    Parameters
    ----------
    manifest : Manifest
        Of the run to be calibrated, with its keys.
    home : Path
        Folder of the campaign file, links resolved; it may lie in the run folder.
    out : Path
        Run folder.
    existing : Existing
        What happens to a run that exists.

    Raises
    ------
    StoreError
        When the folder may not be used, or holds something other than this run, or something in
        it that must go cannot be removed.
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
    _check_same(manifest, before, out)
    kept = [name for name in manifest.tests if _is_same(name, manifest, before)]
    files = _kept_files(kept, out, before.files or {})
    same_population = manifest.population_key == before.population_key
    told = (*_changes_told(kept, manifest, before, out), *_machine_told(manifest, before))
    found = _with_results(manifest.changed(files=files), before, kept, out)
    if not same_population or _order(manifest) != _order(before):
        remove_folder(out / CROSSVALIDATED)
        if before.crossvalidation is not None:
            before = before.changed(crossvalidation=None)
    if not same_population:
        before.changed(status=Status.RUNNING).write(out)  # what is left is no finished run
    for name in {*before.tests, *manifest.tests}.difference(kept):
        remove_folder(out / folder_of(name))
    same_tests = _fitted(manifest) == _fitted(before)
    return Resumed(found, before if same_population else None, same_tests, told)


def check_free(home: Path, out: Path, existing: Existing) -> None:
    """Refuse a folder that exists and is neither to be resumed nor to be replaced."""
    if existing is Existing.REFUSED and not _is_free(home, out):
        raise StoreError(f"{out} exists: give --resume to finish it or --force to replace it")


def _check_same(manifest: Manifest, before: Manifest, out: Path) -> None:
    """Refuse to resume a run of other tests, or with another seed, effort or version."""
    new = json.loads(json_text(manifest.content))
    for key in _SAME:
        changed = _changes(before.content.get(key), new[key])
        if changed is not None:
            raise StoreError(
                f"{out} cannot be resumed: {key}{changed} changed since it was started; "
                "give --force to start again"
            )
    if not before.population_key:
        raise StoreError(
            f"{out} cannot be resumed: an earlier version began it, which did not store what each "
            "of its tests rests on; give --force to start again"
        )
    if not set(before.tests) & set(manifest.tests):
        raise StoreError(
            f"{out} cannot be resumed: it is a run of other tests ({_named(before.tests)}); "
            "give another folder, or --force to replace it"
        )


def _is_same(name: str, manifest: Manifest, before: Manifest) -> bool:
    """Whether what is stored of a test may be kept."""
    new, old = manifest.tests[name], before.tests.get(name)
    return old is not None and (old.key, old.role) == (new.key, new.role)


def _fitted(manifest: Manifest) -> list[tuple[str, str]]:
    """Ids and keys of the calibrated tests, in their order."""
    return [(name, e.key) for name, e in manifest.tests.items() if e.role == "calibrate"]


def _order(manifest: Manifest) -> dict[str, tuple[str, str]]:
    """Which test follows which, with the key of that one: predictions rest on it."""
    return {
        name: (after, manifest.tests[after].key) for name, after in manifest.settings.order.items()
    }


def _changes_told(
    kept: Collection[str], manifest: Manifest, before: Manifest, out: Path
) -> tuple[str, ...]:
    """Sentences on the finished tests that are not kept."""
    lost = [n for n in before.tests if n not in kept and (out / posterior_of(n)).is_file()]
    again = [n for n in lost if n in manifest.tests and manifest.tests[n].role == "calibrate"]
    gone = [name for name in lost if name not in again]
    told = []
    if again:
        told.append(f"what they rest on has changed, so they are sampled again: {_named(again)}")
    if gone:
        told.append(f"no longer calibrated by this campaign, so removed: {_named(gone)}")
    return tuple(told)


def _machine_told(manifest: Manifest, before: Manifest) -> tuple[str, ...]:
    """A sentence where the run was computed by another machine, as far as its draws tell."""
    (here,) = manifest.machines
    for there in before.machines:
        names = [name for name in {**there, **here} if there.get(name) != here.get(name)]
        if names:
            differ = "; ".join(
                f"{name} was {there.get(name, 'none')[:120]}, is {here.get(name, 'none')[:120]}"
                for name in names
            )
            return (
                "another machine has computed a part of this run, and draws that are kept can "
                f"differ in their last digits from those of this one: {differ}",
            )
    return ()


def _digest(*parts: object) -> str:
    """SHA-256 of plain values, 64 hexadecimal digits."""
    plain = json.loads(json_text(parts))
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


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
    settings = plain["settings"]
    parts = {
        "posteriors": {
            name: (plain.get("files") or {}).get(posterior_of(name)) for name in plain["tests"]
        },
        "population": [settings.get(name) for name in _OF_POPULATION],
        "sessions": {name: test.get("session", "") for name, test in settings["tests"].items()},
        "scatter": _scatter(priors),
        "order": {n: t["after"] for n, t in settings["tests"].items() if t.get("after")},
        "priors": _figures(priors),
    }
    return _digest(parts)


def _scatter(priors: PriorFile) -> dict[str, Any]:
    """Priors of the scatter, by group."""
    return {name: (s.parameters, s.sd, s.sparse) for name, s in priors.scatter.items()}


def _figures(priors: PriorFile) -> dict[str, tuple[str, dict[str, float]]]:
    """Family and figures of each parameter's prior, by name."""
    return {name: (p.family, dict(p.figures)) for name, p in priors.parameters.items()}


def _with_results(
    manifest: Manifest, before: Manifest, kept: Collection[str], out: Path
) -> Manifest:
    """The manifest with the results of an earlier session.

    A comparison rests on the tests' posteriors alone, and is kept where all of them are.
    """
    same, fitted = _fitted(manifest) == _fitted(before), [name for name, _ in _fitted(manifest)]
    if before.comparison and same and all((out / posterior_of(n)).is_file() for n in fitted):
        manifest = manifest.changed(comparison=before.comparison)
    if before.truth is not None:
        tests = {name: known for name, known in before.truth.tests.items() if name in kept}
        manifest = manifest.changed(truth=before.truth.model_copy(update={"tests": tests}))
    for name in kept:
        if before.tests[name].status == State.DONE:
            seconds = before.tests[name].seconds
            manifest = manifest.with_test(name, status=State.DONE, seconds=seconds)
    machines = dict.fromkeys(tuple(one.items()) for one in (*before.machines, *manifest.machines))
    return manifest.changed(
        started=before.started, seconds=before.seconds, machines=tuple(map(dict, machines))
    )


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
    return f" ({_named(key for key in {**old, **new} if old.get(key) != new.get(key))})"


def _named(names: Iterable[str]) -> str:
    """Names with commas; the first of many."""
    found = list(names)
    told = ", ".join(name[:60] for name in found[:_TOLD])
    return told if len(found) <= _TOLD else f"{told}, and {len(found) - _TOLD} more"
