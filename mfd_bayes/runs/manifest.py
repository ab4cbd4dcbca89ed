"""The manifest of a run: versions, settings, hashes, timings, scores and verdicts."""

from __future__ import annotations

import json
import os
import platform
import re
import reprlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from mfd_bayes.calibration.effort import Effort
from mfd_bayes.campaign.schema import CampaignFile, Id, Role
from mfd_bayes.campaign.standard import Standard
from mfd_bayes.errors import CampaignError, StoreError, UnitError, hash_file
from mfd_bayes.jobs.job import JobState
from mfd_bayes.population.law_scores import DependenceScore, LawScore
from mfd_bayes.records.cycles import MeasuredCycles
from mfd_bayes.runs.findings import Finding
from mfd_bayes.runs.folder import (
    MANIFEST,
    POPULATION,
    PartKind,
    check_stored,
    pooled_of,
    posterior_of,
)
from mfd_bayes.runs.unit_system import UnitSystem, system_of
from mfd_bayes.store.files import (
    AtLeastOne,
    Figure,
    Index,
    Part,
    Positive,
    Three,
    check,
    json_text,
    read_json,
    write_json,
    write_text,
)
from mfd_bayes.store.netcdf import load_test
from mfd_bayes.units import DAMPER, Axes

# --- models of the user's own


def calibrated_models() -> Path | None:
    """The user's list of files of models that calibrations have run: a SHA-256 a line.

    None where no folder for it is known. It stands in no run folder, and has no paths, so that
    nothing in a folder that is received, or where it lies, makes a model trusted.
    """
    state = os.environ.get("XDG_STATE_HOME", "")
    try:
        path = Path(state) if Path(state).is_absolute() else Path.home() / ".local" / "state"
    except RuntimeError:  # a user without a home
        return None
    return path / "mfd_bayes" / "calibrated_models.txt" if path.is_absolute() else None


def is_calibrated_model(path: Path) -> bool:
    """Whether a calibration by this user on this machine has run a file of this content."""
    models = calibrated_models()
    try:
        return models is not None and hash_file(path) in models.read_text("ascii").split()
    except (OSError, ValueError):
        return False


def add_calibrated_model(path: Path) -> None:
    """Add the file of a campaign's own model to the user's list, if that can be written."""
    models = calibrated_models()
    if models is None or is_calibrated_model(path):
        return
    with suppress(OSError):  # a read-only home: the run is then opened as anybody's
        models.parent.mkdir(parents=True, exist_ok=True)
        with models.open("a", encoding="ascii") as file:
            file.write(f"{hash_file(path)}\n")


OLD_PAGE = (
    '<p role="alert"><strong>This page is of an earlier calibration.</strong> The run in this '
    "folder is being calibrated again, since {since}, and the page is written again at the end.</p>"
)


def mark_pages(folder: Path) -> None:
    """Let the pages of an earlier report say so, while a run is calibrated again."""
    date, begin = f"{datetime.now(UTC):%Y-%m-%d %H:%M UTC}", OLD_PAGE.partition("{")[0]
    for path in (
        *folder.glob("report.html"),
        *folder.glob("datasheet.html"),
        *folder.glob("tests/*/page.html"),
    ):
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, ValueError):  # not what a report wrote
            continue
        if begin not in text:
            write_text(path, text.replace("<header>", f"<header>{OLD_PAGE.format(since=date)}", 1))


# --- a test

FORMAT: Literal[4] = 4
"""Format of a run folder, raised when another version cannot read what this one writes."""


class Status(StrEnum):
    """Whether a run has calibrated its tests and inferred the population."""

    RUNNING = "running"
    FINISHED = "finished"


class Entry(Part):
    """A test: its record, and how its calibration went."""

    role: Role
    status: JobState
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
    """Displacements, in, at the ends and turns of the record before and after its window."""
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


# --- what evaluation makes of a run, as the manifest holds it


@dataclass(frozen=True)
class Score:
    """How well the draws of a predicted force met the force of one record."""

    coverage: Three
    """Share of samples inside the equal-tailed bands of `COVERAGES`."""
    width: Figure
    """Mean width of the 95 % band, kip."""
    interval_score: Figure
    """Mean interval score of the 95 % band, kip (Gneiting and Raftery, 2007): its width, and 40
    times how far the force lies outside."""
    crps: Figure
    """Mean continuous ranked probability score, kip."""
    rrse: Figure
    """Root relative squared error of the median."""


@dataclass(frozen=True)
class Prediction:
    """How a test was predicted from a campaign without its part."""

    part: str
    test: str
    score: Score
    """Of bands of kind "observation"."""
    fitted: Score
    """Of the test's own posterior."""
    simultaneous: bool | None = None
    """Whether the whole force is inside the 95 % band of whole histories."""
    log_score: Figure | None = None
    """Mean log density of the force, per kip, under the draws of `score`."""


@dataclass(frozen=True)
class CampaignCrossValidation:
    """Predictions of every test of a campaign, each from the parts that the test is not in."""

    by: PartKind
    predictions: AtLeastOne[Prediction]


@dataclass(frozen=True)
class ComparisonRow:
    """How well a model predicts the cycles of a test, or of all tests, that it has not seen."""

    subject: str
    model: str
    cycles: Index
    elpd: Figure
    """Expected log predictive density of all cycles."""
    elpd_se: Figure
    """Its standard error: over tests where there are several, over cycles of one."""
    p_loo: Figure
    """Effective number of parameters."""
    worst_k: Figure
    """Largest Pareto k of PSIS."""
    bad: Figure
    """Share of cycles in which k is too large for PSIS."""
    unsettled: Figure
    """Share of cycles in which k is too large also after they were computed anew."""
    difference: Figure
    """Elpd less that of the best model, paired over cycles."""
    difference_se: Figure
    rrse: Figure
    """Root relative squared error of the posterior median, of the record that it has seen."""
    log_evidence: Figure
    """Log of likelihood times prior, integrated; the sum over tests."""
    log_evidence_se: Figure
    evidence_k: Figure
    """Pareto k of its importance weights."""
    evidence_trusted: bool
    """Whether k and the standard error are small enough."""


@dataclass(frozen=True)
class ComparedEstimate:
    """A quantity of a test under one of the models compared, in `unit`: 95 % interval, median."""

    test: str
    name: str
    unit: str
    model: str
    lower: Figure
    median: Figure
    upper: Figure


@dataclass(frozen=True)
class ComparedValue:
    """A value of the data sheet under the models compared, and last under their mixture."""

    condition: str
    quantity: str
    direction: str
    unit: str
    values: Mapping[str, Three]
    """Nominal value, lower and upper bound by model, in `unit`."""
    difference: Figure
    """Of the models' nominal values, over half of the width between the mixture's bounds."""

    @property
    def depends_on_model(self) -> bool:
        """Whether the models differ by more than half of the width of their mixture."""
        return self.difference > 1.0


@dataclass(frozen=True)
class ComparedSheet:
    """The data sheet over models, the weight of each, and a sentence on weights and marks."""

    rows: tuple[ComparedValue, ...]
    weights: Mapping[str, Figure]
    sentence: str


@dataclass(frozen=True)
class Comparison:
    """Models of one campaign, compared: rows of every test, then of all; best model first.

    The sentence says which model the records favour, and whether its check figures speak
    against it. The estimates are those of slip forces, stiffness of the build-up, and gap.
    """

    rows: tuple[ComparisonRow, ...]
    sentence: str
    estimates: tuple[ComparedEstimate, ...] = ()
    sheet: ComparedSheet | None = None


# --- the manifest


class Truth(Part):
    """The true quantities from which a synthetic campaign was made."""

    population: Mapping[str, float | None]
    tests: Mapping[Id, Mapping[str, float | None]]


class Manifest(Part):
    """Content of a run's manifest.json."""

    status: Status = Status.RUNNING
    format: Literal[4] = FORMAT
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
    standard: Standard | None = None
    """The standard that `settings.design` names, whole."""
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
    reweighed: Mapping[str, str] = Field(default_factory=dict)
    """Of a run under other priors than its draws were sampled under: the run whose draws they are,
    and how those of each test and of the population were made of them."""
    warnings: tuple[Finding, ...] = ()
    """What the records, and then the results, gave cause to warn of."""
    verdicts: Mapping[str, str] = Field(default_factory=dict)
    peak_excess: Mapping[str, Mapping[str, Figure]] = Field(default_factory=dict)
    """Of measured peaks over the population's, by direction: `population.peaks.PeakExcess`."""

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
        if self.status == Status.FINISHED and not self.finished:
            raise ValueError("finished is missing")
        return self

    @property
    def content(self) -> dict[str, Any]:
        """All keys and their plain values."""
        return self.model_dump()

    @property
    def system(self) -> UnitSystem:
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

    def changed(self, **updates: Any) -> Self:
        """The manifest with changed keys."""
        return self.model_copy(update=updates)

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


def check_readable(manifest: Manifest) -> None:
    """Refuse a manifest that could not be read once it is stored."""
    try:
        for name in manifest.inputs:
            name.encode()
        check(Manifest, json.loads(json_text(manifest.content)), "the manifest")
    except UnicodeEncodeError as error:
        raise CampaignError(f"the name of the file {name!r} is not UTF-8: rename it") from error
    except StoreError as error:
        raise CampaignError(
            f"this campaign could not be opened once it is stored: {error}"
        ) from error


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


def this_machine() -> dict[str, str]:
    """Name of the processor, the instructions that NumPy uses of it, and each BLAS, in words.

    The last digits of draws depend on them.
    """
    import scipy.linalg  # noqa: F401  (loads its BLAS)
    from threadpoolctl import threadpool_info

    names: list[str] = []
    with suppress(OSError):
        text = Path("/proc/cpuinfo").read_text(errors="replace")
        names = re.findall(r"^model name\s*: *(.*\S)", text, re.MULTILINE)
    config: dict[str, Any] = np.show_config(mode="dicts") or {}  # type: ignore[assignment]
    sets = config.get("SIMD Extensions", {})
    libraries = (info for info in threadpool_info() if info["user_api"] == "blas")
    keys = ("internal_api", "version", "architecture")
    return {
        "processor": names[0] if names else platform.processor() or platform.machine(),
        "instructions": " ".join([*sets.get("baseline", []), *sets.get("found", [])]),
        "BLAS": ", ".join(sorted({" ".join(str(info.get(k)) for k in keys) for info in libraries})),
    }


def _damage(folder: Path, name: str, previous: Manifest) -> str:
    """Why the stored posterior of a test cannot be kept; "" where it can, or there is none.

    The hash of one that was stored just before the run was killed is not known: it is read.
    """
    file = posterior_of(name)
    if not (folder / file).is_file():
        return ""
    try:
        path = check_stored(folder, file, previous.files)
        if file not in previous.files and load_test(path).facts.get("test") != name:
            return f"{path} is of another test"
    except StoreError as error:
        return str(error)
    return ""


def _damage_of_population(folder: Path, previous: Manifest) -> str:
    """Why the stored population of a finished run cannot be kept; "" where it can."""
    if previous.status == Status.FINISHED:
        try:
            for name in (POPULATION, *map(pooled_of, previous.tests)):
                if name in previous.files:
                    check_stored(folder, name, previous.files)
        except StoreError as error:
            return str(error)
    return ""
