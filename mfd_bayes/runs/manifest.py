"""The manifest of a run: its inputs, settings, progress and results."""

from __future__ import annotations

import json
import reprlib
from collections.abc import Iterable, Mapping
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from mfd_bayes.calibration.effort import Effort
from mfd_bayes.errors import CampaignError, StoreError
from mfd_bayes.jobs.job import State
from mfd_bayes.population.law_scores import DependenceScore, LawScore
from mfd_bayes.records.trace import Trace
from mfd_bayes.runs.findings import Finding
from mfd_bayes.runs.folder import MANIFEST
from mfd_bayes.runs.results import CampaignCrossValidation, Comparison
from mfd_bayes.runs.settings import LAWS, Id, Settings
from mfd_bayes.runs.systems import System, system_of
from mfd_bayes.store.files import json_text, read_json, write_json
from mfd_bayes.store.schema import Figure, Index, Part, Positive, Three, check

FORMAT = 1
"""Format number of a run folder, raised when older folders must be read in another way. Folders
of the first version have no number, and their manifest no hashes."""


class Status(StrEnum):
    """Whether a run has calibrated its tests and inferred the population."""

    RUNNING = "running"
    FINISHED = "finished"


class Entry(Part):
    """A test: its record, and how its calibration went."""

    role: Literal["calibrate", "validate"]
    status: State
    samples: Index | None = None
    rate: Positive | None = None
    """Sampling rate of the fit, Hz."""
    record_rate: Positive | None = None
    """Sampling rate of the record, Hz."""
    unit: str = "in"
    """The record's unit of displacement."""
    derived: Mapping[str, str] = Field(default_factory=dict)
    """Role to what the signal was made of, in words, where it is more than a column."""
    before: tuple[Figure, ...] = ()
    after: tuple[Figure, ...] = ()
    """Displacements, in, at the ends and turns of the record before and after its fit window."""
    measured: Mapping[str, tuple[Figure, ...]] = Field(default_factory=dict)
    """Values of each cycle as recorded, `MeasuredCycles.to_content`; of earlier versions, none."""
    seconds: Figure = 0.0
    error: str = ""
    key: str = ""
    """SHA-256 of all that its posterior rests on; empty where an earlier version left it out."""

    @property
    def filtered(self) -> bool:
        """Whether the record was low-passed for the fit."""
        return bool(self.rate and self.record_rate and self.rate < 0.999 * self.record_rate)


class Truth(Part):
    """The true quantities from which a synthetic campaign was made."""

    population: Mapping[str, float | None]
    tests: Mapping[Id, Mapping[str, float | None]]


class Manifest(Part):
    """Content of a run's manifest.json, with the keys in the order in which they are written.

    Keys that an earlier version did not write have a default, and keys that this version does
    not know are kept.
    """

    status: Status = Status.RUNNING
    format: Index = 0
    title: str
    command: str
    started: str
    seed: Index
    effort: Effort
    settings: Settings
    inputs: Mapping[str, str]
    """SHA-256 of each file that was read."""
    versions: Mapping[str, str]
    platform: str
    machines: tuple[Mapping[str, str], ...] = ()
    """The machines that have computed a part of it, as `runs.machine` has them."""
    population_key: str = ""
    """SHA-256 of all that the population rests on; empty where an earlier version left it out."""
    tests: Annotated[Mapping[Id, Entry], Field(min_length=1)]
    files: Mapping[str, str] | None = None
    """SHA-256 of each file that the run has stored, by its name in the folder."""
    truth: Truth | None = None
    seconds: Figure = 0.0
    law_scores: tuple[LawScore, ...] = ()
    free_exponents: Mapping[str, Three] = Field(default_factory=dict)
    dependence_scores: tuple[DependenceScore, ...] = ()
    population_sampler: Any = None
    """Acceptance rates and number of sweeps; written, never read."""
    finished: str = ""
    crossvalidation: CampaignCrossValidation | None = None
    comparison: Comparison | None = None
    warnings: tuple[Finding, ...] = ()
    """What the records, and then the results, gave cause to warn of."""
    verdicts: Mapping[str, str] = Field(default_factory=dict)

    _content: dict[str, Any] = PrivateAttr()

    @model_validator(mode="after")
    def _check_together(self) -> Self:
        unknown = set(self.tests) - set(self.settings.tests)
        if unknown:
            raise ValueError(f"its settings do not include test {min(unknown)!r}")
        followed = set(self.settings.order.values()) - set(self.tests)
        if followed:
            raise ValueError(f"its tests do not include {min(followed)!r}, which another follows")
        for name in self.truth.tests if self.truth else ():
            entry = self.tests.get(name)
            if entry is None or entry.rate is None or entry.record_rate is None:
                raise ValueError(f"truth of test {name!r}, whose sampling rates are not given")
        for score in self.law_scores:
            if score.law not in LAWS or len(score.levels) < 2:
                raise ValueError("law_scores must be of a known law, with two levels or more")
        levels = {(score.quantity, len(score.levels)) for score in self.law_scores}
        if len(levels) > len({quantity for quantity, _ in levels}):
            raise ValueError("law_scores of one quantity must be of the same levels")
        if self.status == Status.FINISHED and "finished" not in self.model_fields_set:
            raise ValueError("finished is missing")
        return self

    def model_post_init(self, _context: Any, /) -> None:
        """Store the keys that are written."""
        self._content = self.model_dump(exclude_unset=True)

    @property
    def content(self) -> Mapping[str, Any]:
        """All keys of its file, also those that this version does not know."""
        return self._content

    def system_of(self, traces: Iterable[Trace]) -> System:
        """System of units of the records, fit for the size of the forces of their traces."""
        return system_of(
            (entry.unit for entry in self.tests.values()),
            (trace.force for trace in traces),
            (self.settings.tests[name].given_actuation for name in self.tests),
        )

    def changed(self, **parts: Any) -> Self:
        """The manifest with changed keys."""
        found = self.model_copy(update=parts)
        found._content = self._content | found.model_dump(include=set(parts), exclude_unset=True)
        return found

    def with_test(self, name: str, **values: Any) -> Self:
        """The manifest with changed values of a test."""
        entry = self.tests[name].model_copy(update=values)
        return self.changed(tests={**self.tests, name: entry})

    def with_files(self, hashes: Mapping[str, str]) -> Self:
        """The manifest with hashes of more files."""
        return self.changed(files={**(self.files or {}), **hashes})

    def longer(self, seconds: float) -> Self:
        """The manifest with this computing time, s, added."""
        return self.changed(seconds=self.seconds + seconds)

    def write(self, folder: Path) -> None:
        """Write it into a run folder.

        Raises
        ------
        StoreError
            When it cannot be written.
        """
        write_json(folder / MANIFEST, self._content)


def check_readable(manifest: Manifest) -> None:
    """Refuse a manifest that could not be read once it is written.

    Raises
    ------
    CampaignError
        When a key has a value that the run folder may not hold, or another one once it is read.
    """
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
    """Manifest of a finished run, checked.

    Raises
    ------
    StoreError
        When there is none, the run is not finished, or a key is missing or of the wrong kind.
    """
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
    """Manifest of a run that is to be resumed, finished or not, checked.

    Raises
    ------
    StoreError
        When there is none, or a key is missing or of the wrong kind.
    """
    path = folder / MANIFEST
    return _checked(path, read_json(path))


def _checked(path: Path, content: dict[str, Any]) -> Manifest:
    _check_version(path, content)
    manifest = check(Manifest, content, path)
    manifest._content = content
    return manifest


def _check_version(path: Path, manifest: Mapping[str, Any]) -> None:
    """Refuse a run folder of a later version, in which keys may have another meaning."""
    number = manifest.get("format", 0)
    if not isinstance(number, int) or number <= FORMAT:
        return
    versions = manifest.get("versions")
    writer = versions.get("mfd_bayes") if isinstance(versions, Mapping) else None
    later = f"mfd_bayes {writer[:20]}" if isinstance(writer, str) else "a later mfd_bayes"
    raise StoreError(
        f"{path} is of format {reprlib.repr(number)}, and mfd_bayes {version('mfd_bayes')} reads "
        f"formats up to {FORMAT}: open it with {later}"
    )
