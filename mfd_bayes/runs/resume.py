"""What of an earlier session a run may keep."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from mfd_bayes.calibration.priors import PriorFile
from mfd_bayes.campaign.schema import CALIBRATION_KEYS
from mfd_bayes.errors import StoreError
from mfd_bayes.friction.models import file_of
from mfd_bayes.jobs.job import JobState
from mfd_bayes.runs.folder import (
    CROSSVALIDATION,
    DISCARDED,
    MANIFEST,
    POPULATION,
    check_links,
    check_places,
    discard,
    folder_of,
    is_free,
    posterior_of,
    remove_folder,
)
from mfd_bayes.runs.manifest import Manifest, Status, _damage, _damage_of_population, read_begun
from mfd_bayes.store.files import json_text

COMPARISON = "comparison"
"""Name of the key of the comparison of models."""


def with_keys(manifest: Manifest, priors: PriorFile) -> Manifest:
    """The manifest with the keys of what the run stores.

    A key is the SHA-256 of all that a stored result rests on: where it is the same as before, the
    result is kept. That of a test, named as its folder, has nothing of the other tests. There is
    one for the population, one for what was left out of the campaign, and one for the comparison.
    """
    settings = manifest.settings
    general = settings.campaign
    of_all = {
        "model": general.model,
        **({"model_file": manifest.inputs[file]} if (file := file_of(general.model)) else {}),
        "noise": general.noise,
        "initial": general.initial,
        "rate": general.rate,
        "effort": asdict(manifest.effort),
        "seed": manifest.seed,
        "priors": {name: (p.family, dict(p.figures)) for name, p in priors.parameters.items()},
    }
    keys = {}
    for name, test in settings.tests.items():
        columns = {
            role: column.model_dump(exclude=CALIBRATION_KEYS)
            for role, column in settings.columns_of(test).items()
        }
        record = manifest.inputs[test.file], Path(test.file).suffix.lower()
        content = name, test.role, record, columns, test.window, str(test.actuation)
        keys[folder_of(name)] = _digest(content, of_all)
    fitted = {name: keys[folder_of(name)] for name in manifest.fitted}
    keys[COMPARISON] = _digest([*fitted.items()])
    keys[POPULATION] = _digest(
        [*fitted.items()],
        {name: settings.sessions[name] for name in fitted},
        {name: settings.devices[name] for name in fitted if settings.devices[name]},
        {name: settings.conditions[name] for name in fitted if settings.dependence},
        (settings.laws, settings.dependence, settings.actuation_unit),
        {name: (s.parameters, s.sd, s.sparse) for name, s in priors.scatter.items()},
    )
    followed = {
        name: (predecessor, keys[folder_of(predecessor)])
        for name, predecessor in settings.order.items()
    }
    keys[CROSSVALIDATION] = _digest(keys[POPULATION], followed)
    return manifest.changed(keys=keys)


def _digest(*values: object) -> str:
    """SHA-256 of plain values, 64 hexadecimal digits."""
    text = json.dumps(json.loads(json_text(values)), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class Resumed:
    """What a run begins with: `before` is an earlier session whose population is the same."""

    manifest: Manifest
    before: Manifest | None = None
    same_tests: bool = False
    notes: tuple[str, ...] = ()


def check_free(campaign_folder: Path, folder: Path) -> None:
    """Refuse a folder that exists, where it is neither to be resumed nor to be replaced."""
    if not is_free(folder, campaign_folder):
        raise StoreError(f"{folder} exists: give --resume to finish it or --force to replace it")


def prepare_folder(
    manifest: Manifest,
    campaign_folder: Path,
    folder: Path,
    *,
    resume: bool = False,
    force: bool = False,
) -> Resumed:
    """Check that a run may be started, resumed or replaced in a folder; remove a replaced one.

    Of a run that is resumed, everything is kept whose key is the same as before; what is stored
    under another key is removed.
    """
    check_links(folder)
    check_places(folder)
    if is_free(folder, campaign_folder):
        return Resumed(manifest)
    if not (resume or force):
        check_free(campaign_folder, folder)
    if force or (folder / DISCARDED).exists():
        discard(folder)
        return Resumed(manifest)
    try:
        previous = read_begun(folder)
    except StoreError as error:
        again = "--force to start again" if (folder / MANIFEST).exists() else "another folder by -o"
        raise StoreError(f"{folder} cannot be resumed: {error}; give {again}") from error
    _check_resumable(manifest, previous, folder)
    unchanged = {
        result for result, key in manifest.keys.items() if previous.keys.get(result) == key
    }
    damaged = {
        name: reason for name in manifest.tests if (reason := _damage(folder, name, previous))
    }
    kept_tests = [n for n in manifest.tests if folder_of(n) in unchanged and n not in damaged]
    notes = [f"{reason}; {name} is sampled again" for name, reason in damaged.items()]
    if (
        POPULATION in unchanged
        and not damaged
        and (reason := _damage_of_population(folder, previous))
    ):
        notes.append(f"{reason}; the population is inferred again")
        unchanged.remove(POPULATION)
    resumed = _with_results(manifest, previous, kept_tests, folder)
    if COMPARISON in unchanged and all(
        (folder / posterior_of(n)).is_file() for n in manifest.fitted
    ):
        resumed = resumed.changed(comparison=previous.comparison)
    notes += _notes([*kept_tests, *damaged], manifest, previous, folder)
    if CROSSVALIDATION not in unchanged:
        remove_folder(folder, CROSSVALIDATION)
        previous = previous.changed(crossvalidation=None)
    if POPULATION not in unchanged or damaged:
        previous.changed(status=Status.RUNNING).write(folder)  # what is left is no finished run
    for name in {*previous.tests, *manifest.tests}.difference(kept_tests):
        remove_folder(folder, folder_of(name))
    population = previous if POPULATION in unchanged else None
    return Resumed(resumed, population, COMPARISON in unchanged, tuple(notes))


def _check_resumable(manifest: Manifest, previous: Manifest, root: Path) -> None:
    """Refuse to resume a run of other tests, or with another seed, effort or version."""
    for key in ("seed", "effort", "versions"):
        old_value, new_value = getattr(previous, key), getattr(manifest, key)
        if old_value != new_value:
            names = _differing(old_value, new_value) if isinstance(old_value, Mapping) else []
            raise StoreError(
                f"{root} cannot be resumed: {key}{f' ({_listed(names)})' if names else ''} changed "
                "since it was started; give --force to start again"
            )
    if not set(previous.tests) & set(manifest.tests):
        raise StoreError(
            f"{root} cannot be resumed: it is a run of other tests ({_listed(previous.tests)}); "
            "give another folder, or --force to replace it"
        )


def _with_results(
    manifest: Manifest, previous: Manifest, kept_tests: Collection[str], folder: Path
) -> Manifest:
    """The manifest with what is kept of an earlier session.

    Hashes of other files are dropped: such a file is written again before its hash is, and a kill
    in between would leave a new file with an old hash.
    """
    files = [name for name in map(posterior_of, kept_tests) if (folder / name).is_file()]
    truth = previous.truth
    if truth is not None:
        tests = {name: values for name, values in truth.tests.items() if name in kept_tests}
        truth = truth.model_copy(update={"tests": tests})
    machines = dict.fromkeys(tuple(m.items()) for m in (*previous.machines, *manifest.machines))
    resumed = manifest.changed(
        files={n: previous.files[n] for n in files if n in previous.files},
        truth=truth or manifest.truth,
        started=previous.started,
        seconds=previous.seconds,
        machines=tuple(map(dict, machines)),
    )
    for name in kept_tests:
        if previous.tests[name].status == JobState.DONE:
            seconds = previous.tests[name].seconds
            resumed = resumed.with_test(name, status=JobState.DONE, seconds=seconds)
    return resumed


def _notes(
    kept_tests: Collection[str], manifest: Manifest, previous: Manifest, folder: Path
) -> Iterable[str]:
    """Sentences on finished tests that are not kept, and on another machine that computed some."""
    lost = [
        n for n in previous.tests if n not in kept_tests and (folder / posterior_of(n)).is_file()
    ]
    again = [name for name in lost if name in manifest.fitted]
    removed = [name for name in lost if name not in again]
    if again:
        yield f"what they rest on has changed, so they are sampled again: {_listed(again)}"
    if removed:
        yield f"no longer calibrated by this campaign, so removed: {_listed(removed)}"
    (machine,) = manifest.machines
    for old_machine in previous.machines:
        if names := _differing(old_machine, machine):
            differ = "; ".join(
                f"{name} was {old_machine.get(name, 'none')}, is {machine.get(name, 'none')}"
                for name in names
            )
            yield (
                "another machine has computed a part of this run, and draws that are kept can "
                f"differ in their last digits from those of this one: {differ}"
            )
            return


def _differing(old_values: Mapping[str, str], new_values: Mapping[str, str]) -> list[str]:
    """Keys whose values differ."""
    return [
        name
        for name in {**old_values, **new_values}
        if old_values.get(name) != new_values.get(name)
    ]


def _listed(names: Iterable[str]) -> str:
    """Names with commas; the first ten of many."""
    head, tail = [*names][:10], [*names][10:]
    return ", ".join(head) + (f", and {len(tail)} more" if tail else "")
