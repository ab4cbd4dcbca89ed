"""The manifest of a run: its inputs, settings, progress and results, and the keys of a resume."""

from __future__ import annotations

import hashlib
import json
import platform
import reprlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from mfd_bayes.axes import DAMPER, Axes
from mfd_bayes.calibration.diagnostics import Effort
from mfd_bayes.calibration.priors import PriorFile
from mfd_bayes.campaign.schema import CampaignFile, Id, Role
from mfd_bayes.errors import CampaignError, StoreError, UnitError
from mfd_bayes.friction.models import file_of
from mfd_bayes.jobs.job import State
from mfd_bayes.population.law_scores import DependenceScore, LawScore
from mfd_bayes.population.laws import LAW_NAMES
from mfd_bayes.records.loops import MeasuredCycles
from mfd_bayes.runs.lock import other_owner
from mfd_bayes.runs.paths import CROSSVALIDATION, MANIFEST, POPULATION, folder_of
from mfd_bayes.runs.scores import CampaignCrossValidation, Comparison
from mfd_bayes.runs.unit_system import System, system_of
from mfd_bayes.runs.verdict import Finding
from mfd_bayes.store.files import json_text, read_json, write_json
from mfd_bayes.store.schema import Figure, Index, Part, Positive, Three, check

FORMAT: Literal[2] = 2
"""Format of a run folder, raised when another version cannot read what this one writes."""

COMPARISON = "comparison"
"""Name of the key of the comparison of models."""


class Status(StrEnum):
    """Whether a run has calibrated its tests and inferred the population."""

    RUNNING = "running"
    FINISHED = "finished"


class Entry(Part):
    """A test: its record, and how its calibration went."""

    role: Role
    status: State
    samples: Index
    rate: Positive
    """Sampling rate of the fit, Hz."""
    record_rate: Positive
    """Sampling rate of the record, Hz."""
    unit: str
    """The record's unit of displacement."""
    response_unit: str = ""
    """The record's unit of force; empty in a run before there were other responses."""
    conditions: Mapping[str, Figure]
    """Stroke, speed, frequency and actuation, as `tested_range.conditions_of` has them."""
    peak_force: Figure
    """Largest force of the fit in size, kip."""
    derived: Mapping[str, str] = Field(default_factory=dict)
    """Role to what the signal was made of, in words, where it is more than a column."""
    before: tuple[Figure, ...] = ()
    after: tuple[Figure, ...] = ()
    """Displacements, in, at the ends and turns of the record before and after its fit window."""
    measured: Mapping[str, tuple[Figure, ...]]
    """Values of each cycle as recorded: `MeasuredCycles.to_content`."""
    seconds: Figure = 0.0
    error: str = ""

    @field_validator("measured")
    @classmethod
    def _check_measured(cls, measured: Mapping[str, Any]) -> Mapping[str, Any]:
        MeasuredCycles.from_content(measured)
        return measured

    @property
    def filtered(self) -> bool:
        """Whether the record was low-passed for the fit."""
        return self.rate < 0.999 * self.record_rate


class Truth(Part):
    """The true quantities from which a synthetic campaign was made."""

    population: Mapping[str, float | None]
    tests: Mapping[Id, Mapping[str, float | None]]


class Manifest(Part):
    """Content of a run's manifest.json."""

    status: Status = Status.RUNNING
    format: Literal[2] = FORMAT
    title: str
    command: str
    started: str
    finished: str = ""
    seed: Index
    effort: Effort
    priors: str
    """Title and file of the priors."""
    settings: CampaignFile
    """What the campaign file says, with its defaults and what the command line replaced."""
    inputs: Mapping[str, str]
    """SHA-256 of each file that was read."""
    keys: Mapping[str, str] = Field(default_factory=dict)
    """SHA-256 of all that a stored result rests on, by its place: see `with_keys`."""
    files: Mapping[str, str] = Field(default_factory=dict)
    """SHA-256 of each file that the run has stored, by its name in the folder."""
    versions: Mapping[str, str]
    platform: str
    machines: tuple[Mapping[str, str], ...] = ()
    """The machines that have computed a part of it, as `this_machine` has them."""
    axes: Axes = DAMPER
    """What the model's motion and response are."""
    tests: Annotated[Mapping[Id, Entry], Field(min_length=1)]
    truth: Truth | None = None
    seconds: Figure = 0.0
    law_scores: tuple[LawScore, ...] = ()
    free_exponents: Mapping[str, Three] = Field(default_factory=dict)
    dependence_scores: tuple[DependenceScore, ...] = ()
    population_sampler: Any = None
    """Acceptance rates and number of sweeps; written, never read."""
    crossvalidation: CampaignCrossValidation | None = None
    comparison: Comparison | None = None
    warnings: tuple[Finding, ...] = ()
    """What the records, and then the results, gave cause to warn of."""
    verdicts: Mapping[str, str] = Field(default_factory=dict)
    peak_factors: Mapping[str, tuple[Figure, ...]] = Field(default_factory=dict)
    """Of the measured peak of a cycle over the model's: `evaluation.properties.PeakFactor`."""

    @model_validator(mode="after")
    def _check_together(self) -> Self:
        if list(self.tests) != [test.id for test in self.settings.test]:
            raise ValueError("tests are not those of its settings")
        lost = {*self.settings.order.values(), *(self.truth.tests if self.truth else ())}
        if lost := lost - set(self.tests):
            raise ValueError(f"its tests do not include {min(lost)!r}, which it names")
        try:
            _ = self.settings.actuation_unit
        except UnitError as error:
            raise ValueError(str(error)) from error
        levels = {(score.quantity, len(score.levels)) for score in self.law_scores}
        known = all(s.law in LAW_NAMES and len(s.levels) > 1 for s in self.law_scores)
        if not known or len(levels) > len(dict(levels)):
            raise ValueError("law_scores must be of known laws, and of the same two levels or more")
        try:
            _ = [str(finding.message) for finding in self.warnings]
        except (AttributeError, LookupError, ValueError) as error:
            raise ValueError(f"warnings have a message that cannot be written: {error}") from error
        if self.status == Status.FINISHED and not self.finished:
            raise ValueError("finished is missing")
        return self

    @property
    def content(self) -> dict[str, Any]:
        """All keys and their plain values."""
        return self.model_dump()

    @property
    def system(self) -> System:
        """System of units of the records, fit for the size of their forces."""
        return system_of(
            (entry.unit for entry in self.tests.values()),
            (entry.peak_force for entry in self.tests.values()),
            (test.actuation_unit for test in self.settings.test),
            self.axes,
            (entry.response_unit for entry in self.tests.values()),
        )

    @property
    def fitted(self) -> list[str]:
        """Ids of the tests that are to be calibrated."""
        return [name for name, entry in self.tests.items() if entry.role == "calibrate"]

    def changed(self, **parts: Any) -> Self:
        """The manifest with changed keys."""
        return self.model_copy(update=parts)

    def with_test(self, name: str, **values: Any) -> Self:
        """The manifest with changed values of a test."""
        entry = self.tests[name].model_copy(update=values)
        return self.changed(tests={**self.tests, name: entry})

    def with_files(self, hashes: Mapping[str, str]) -> Self:
        """The manifest with hashes of more files."""
        return self.changed(files={**self.files, **hashes})

    def longer(self, seconds: float) -> Self:
        """The manifest with this computing time, s, added."""
        return self.changed(seconds=self.seconds + seconds)

    def write(self, folder: Path) -> None:
        """Write it into a run folder; raises StoreError when it cannot be written."""
        write_json(folder / MANIFEST, self.content)


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
        "start": general.start,
        "rate": general.rate,
        "checks_noise": settings.checks_noise(manifest.effort.name),
        "effort": asdict(manifest.effort),
        "seed": manifest.seed,
        "priors": {name: (p.family, dict(p.figures)) for name, p in priors.parameters.items()},
    }
    keys = {}
    for name, test in settings.tests.items():
        columns = {role: c.model_dump() for role, c in settings.columns_of(test).items()}
        record = manifest.inputs[test.file], Path(test.file).suffix.lower()
        own = name, test.role, record, columns, test.fit, str(test.actuation)
        keys[folder_of(name)] = _digest(own, of_all)
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
    followed = {name: (after, keys[folder_of(after)]) for name, after in settings.order.items()}
    keys[CROSSVALIDATION] = _digest(keys[POPULATION], followed)
    return manifest.changed(keys=keys)


def _digest(*parts: object) -> str:
    """SHA-256 of plain values, 64 hexadecimal digits."""
    text = json.dumps(json.loads(json_text(parts)), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def check_readable(manifest: Manifest) -> None:
    """Refuse a manifest that could not be read, or would be another one, once it is stored."""
    for name in manifest.inputs:
        if any("\ud800" <= c <= "\udfff" for c in name):  # Python's sign of other bytes
            raise CampaignError(f"the name of the file {name!r} is not UTF-8: rename it")
    written = json.loads(json_text(manifest.content))
    try:
        again = check(Manifest, written, "the manifest")
    except StoreError as error:
        raise CampaignError(
            f"this campaign could not be opened once it is stored: {error}"
        ) from error
    if json.loads(json_text(again.content)) != written:
        raise CampaignError("this campaign would not be the same once it is stored and read")


def read_manifest(folder: Path) -> Manifest:
    """Manifest of a finished run, checked; StoreError where it is none or of another version."""
    path = folder / MANIFEST
    if not path.exists():
        raise StoreError(f"{folder} is not a run folder: it has no {MANIFEST}")
    content = read_json(path)
    if content.get("status") != Status.FINISHED:
        raise StoreError(
            f"the run in {folder} is not finished; finish it with: "
            f"mfd-bayes calibrate CAMPAIGN.toml -o {folder} --resume"
        )
    return _checked(path, content)


def read_begun(folder: Path) -> Manifest:
    """Manifest of a run that is to be resumed, finished or not, checked as by `read_manifest`."""
    path = folder / MANIFEST
    return _checked(path, read_json(path))


def _checked(path: Path, content: dict[str, Any]) -> Manifest:
    if content.get("format") != FORMAT:
        versions = content.get("versions")
        writer = versions.get("mfd_bayes") if isinstance(versions, Mapping) else None
        raise StoreError(
            f"{path} is of format {reprlib.repr(content.get('format'))}, and this version of "
            f"mfd_bayes reads format {FORMAT} only: open it with the version that wrote it "
            f"({reprlib.repr(writer)}), or calibrate again"
        )
    return check(Manifest, content, path)


@contextmanager
def unchanged(folder: Path, manifest: Manifest) -> Iterator[None]:
    """Raise StoreError where a run changes while it is read: it may be of two runs then."""

    def check_same(cause: StoreError | None = None) -> None:
        try:
            now = read_json(folder / MANIFEST)
        except StoreError:
            now = {}
        same = manifest.model_dump(include={"status", "started", "finished", "seed", "files"})
        if any(now.get(key) != value for key, value in same.items()):
            raise StoreError(
                f"the run in {folder} was changed by another process while it was read"
                f"{other_owner(folder)}; wait until that has ended, and try again"
            ) from cause

    try:
        yield
    except StoreError as error:
        check_same(error)
        raise
    check_same()


def this_machine() -> dict[str, str]:
    """Name of the processor, the instructions that NumPy uses of it, and each BLAS, in words.

    The last digits of draws depend on them.
    """
    import scipy.linalg  # noqa: F401  (loads its BLAS)
    from threadpoolctl import threadpool_info

    processor = platform.processor() or platform.machine()
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                processor = line.partition(":")[2].strip()
                break
    config: dict[str, Any] = np.show_config(mode="dicts") or {}  # type: ignore[assignment]
    sets = config.get("SIMD Extensions", {})
    instructions = " ".join([*sets.get("baseline", []), *sets.get("found", [])])
    machine = {"processor": processor, "instructions": instructions}
    for library in sorted(threadpool_info(), key=lambda info: str(info["filepath"])):
        if library["user_api"] == "blas":
            owner = [name for name in ("numpy", "scipy") if f"{name}.libs" in library["filepath"]]
            words = (library["internal_api"], library.get("version"), library.get("architecture"))
            text = " ".join(str(word) for word in words if word)
            machine.setdefault(f"BLAS of {owner[0]}" if owner else "BLAS", text)
    return machine
