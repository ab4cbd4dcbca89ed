"""A run folder: the names of its files, its lock, its manifest, and what a resumed run keeps.

And what a command may write where its user says: nothing is replaced without --force.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import platform
import re
import reprlib
import shlex
import socket
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from enum import StrEnum
from io import FileIO
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from mfd_bayes.calibration.diagnostics import Effort
from mfd_bayes.calibration.posterior import PriorFile
from mfd_bayes.campaign.schema import CampaignFile, Id, Role
from mfd_bayes.errors import CampaignError, StoreError, UnitError, hash_file
from mfd_bayes.friction.models import file_of
from mfd_bayes.jobs.job import State
from mfd_bayes.jobs.signals import before_end
from mfd_bayes.messages import Message
from mfd_bayes.population.mixed_model import DependenceScore, LawScore
from mfd_bayes.records.loops import MeasuredCycles
from mfd_bayes.runs.unit_system import System, system_of
from mfd_bayes.store.files import (
    PART,
    AtLeastOne,
    Figure,
    Index,
    Part,
    Positive,
    Three,
    cannot_remove,
    check,
    check_place,
    is_part,
    json_text,
    read_json,
    remove_file,
    write_json,
    write_text,
)
from mfd_bayes.store.netcdf import load_test
from mfd_bayes.units import DAMPER, Axes

MANIFEST = "manifest.json"
CAMPAIGN = "campaign.toml"
PRIORS = "priors.toml"
MODEL = "model.py"
"""A copy of the file of a model of the user's own."""

POPULATION = "population.nc"
CROSSVALIDATION = "crossvalidation"
DISCARDED = f".{MANIFEST}.discarded"
"""The manifest of a run while it is removed: if that is interrupted, it can be repeated."""

OWNER = ".owner"
"""The lock of the folder, which names the process that works in it."""

FOLDERS = ("tests", "figures", CROSSVALIDATION)
"""Folders in a run folder."""

WRITTEN = re.compile(
    r"tests/[^/]+/((posterior|pooled|record)\.nc|record\.csv|page\.html"
    r"|(loops|history|residuals|marginals|corner|ranks)\.png)"
    r"|figures/(overview|laws|truth|next)\.(png|csv)"
    rf"|{CROSSVALIDATION}/(test|level|session)_\d+\.json"
)
"""Names of the files that a run and its report write in these folders; others are not theirs."""

DRAWS = ("draws.csv", "draws.parquet")
ADVICE = ("next.csv", "next.json", "next.png")
"""What `mfd-bayes next` writes into a run folder where it is told no other place."""

_ON_REQUEST = ("tables.docx", "tables.xlsx", "report.pdf", "datasheet.pdf")
_TABLES = "parameters derived loop_estimates noises laws law_scores checks scores crossvalidation"
OUTPUTS = (
    *(f"{name}.csv" for name in (*_TABLES.split(), "tested_range")),
    *(f"{name}.{form}" for name in ("parameters", "laws") for form in ("json", "tex")),
    *("datasheet.csv", "datasheet.tex"),
    *(*_ON_REQUEST, *DRAWS, "report.html", "datasheet.html", POPULATION, CAMPAIGN, PRIORS, MODEL),
)
"""Files that a run and its report write, but for the manifest and what lies in folders."""


def folder_of(test_id: str) -> str:
    """Folder of all that is stored of a test."""
    return f"tests/{test_id}"


def posterior_of(test_id: str) -> str:
    """File of a test's posterior."""
    return f"{folder_of(test_id)}/posterior.nc"


def pooled_of(test_id: str) -> str:
    """File of a test's posterior after pooling."""
    return f"{folder_of(test_id)}/pooled.nc"


def record_of(test_id: str) -> str:
    """File of the record of a held-out test (predicted, never fitted)."""
    return f"{folder_of(test_id)}/record.nc"


def is_written_by_run(name: Path) -> bool:
    """Whether a run writes a file of this name in its folder."""
    first = name.parts[0] if name.parts else ""
    return first in FOLDERS or name.as_posix() in (*OUTPUTS, MANIFEST, DISCARDED)


def is_file_of_a_run(path: Path) -> bool:
    """Whether a path, links followed, lies in a run folder and is one that the run writes."""
    place = path.resolve()
    for folder in place.parents:
        if (folder / MANIFEST).is_file() or (folder / DISCARDED).is_file():
            return is_written_by_run(place.relative_to(folder))
    return False


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


# --- the lock


@contextmanager
def alone_in(out: Path) -> Iterator[None]:
    """Make the folder and keep other processes from working in it until the end.

    The lock is the operating system's, on a file in the folder, and ends with its owner. The file
    names the owner to a process that is refused.
    """
    path = out / OWNER
    try:
        out.mkdir(parents=True, exist_ok=True)
        file = path.open("ab+", buffering=0)
    except OSError as error:
        raise StoreError(f"cannot write in the run folder {out}: {error.strerror}") from error

    def leave() -> None:
        with suppress(OSError):  # a name that is left behind is no lock
            path.unlink(missing_ok=True)

    with file:
        if not _has_lock(file, path):
            file.seek(0)
            owner = file.read(1000).decode(errors="replace").strip()
            name = f": {owner}" if owner else ""
            raise StoreError(f"another process is working in {out}{name}: let it end")
        command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
        where = f"process {os.getpid()} on {socket.gethostname()}"
        owner = f"{command!r}, {where} since {datetime.now(UTC):%Y-%m-%d %H:%M:%S UTC}"
        with before_end(leave):
            try:
                with suppress(OSError):  # a full disk: the first result reports it
                    file.truncate(0)
                    file.write(owner.encode(errors="backslashreplace"))
                yield
            finally:
                leave()


def _has_lock(file: FileIO, path: Path) -> bool:
    """Whether this process has the lock of a file now, which no other has removed meanwhile."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat())


# --- what lies in a folder


def is_free(out: Path, home: Path) -> bool:
    """Whether a folder holds nothing but the campaign, a lock's owner or an unfinished manifest."""
    return not out.is_dir() or all(
        entry.resolve() == home or entry.name == OWNER or is_part(entry, MANIFEST)
        for entry in out.iterdir()
    )


def check_links(out: Path, names: Iterable[str] = FOLDERS) -> None:
    """Refuse named folders that are, or hold, links to outside of a run folder."""
    try:
        home = out.resolve()
        for name in names:
            for path in chain([out / name], (out / name).rglob("*")):
                if path.is_symlink() and not path.resolve().is_relative_to(home):
                    raise StoreError(f"{path} is a link to outside of the run folder")
    except (OSError, RuntimeError) as error:  # links in a circle
        raise StoreError(f"cannot read {out}: {error}") from error


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
                f"{path} is not what this run wrote: its SHA-256 is not that in {MANIFEST}; or "
                "another process has changed the run meanwhile"
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
        copied = name.as_posix() in (CAMPAIGN, PRIORS, MODEL)  # written as they were read
        in_folder = name.parts[0] in FOLDERS and not (resume and name.parts[0] == "tests")
        if is_written_by_run(name) and (force or not (copied or in_folder)):
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
            remove_folder(out, name)
        for name in (*OUTPUTS, *ADVICE):
            (out / name).unlink(missing_ok=True)
        begun.unlink()
    except OSError as error:
        raise cannot_remove(out, error) from error


def remove_folder(out: Path, name: str) -> None:
    """Remove what a run wrote in one of its folders, and the folder where nothing else is in it.

    Of a link, the link alone. StoreError where something cannot be removed.
    """
    path = out / name
    try:
        if path.is_symlink():
            path.unlink()
        elif path.is_dir():
            for entry in path.iterdir():
                if WRITTEN.fullmatch(f"{name}/{entry.name}"):
                    entry.unlink()
                elif name == "tests" and entry.is_dir():
                    remove_folder(out, f"{name}/{entry.name}")
            if not any(path.iterdir()):
                path.rmdir()
    except OSError as error:
        raise cannot_remove(path, error) from error


def remove_stale(out: Path, *, draws: bool) -> None:
    """Remove what no report writes again unasked, before the population is inferred anew.

    With `draws`, tests are sampled too, and the table of their draws is removed.
    """
    on_request = (*_ON_REQUEST, *ADVICE, "figures/next.png", "figures/next.csv")
    for name in (*on_request, *(DRAWS if draws else ())):
        remove_file(out / name)


OLD_PAGE = (
    '<p role="alert"><strong>This page is of an earlier calibration.</strong> The run in this '
    "folder is being calibrated again, since {since}, and the page is written again at the end.</p>"
)


def mark_pages(out: Path) -> None:
    """Let the pages of an earlier report say so, while a run is calibrated again."""
    since, begin = f"{datetime.now(UTC):%Y-%m-%d %H:%M UTC}", OLD_PAGE.partition("{")[0]
    for path in (
        *out.glob("report.html"),
        *out.glob("datasheet.html"),
        *out.glob("tests/*/page.html"),
    ):
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, ValueError):  # not what a report wrote
            continue
        if begin not in text:
            write_text(path, text.replace("<header>", f"<header>{OLD_PAGE.format(since=since)}", 1))


def remove_partial_files(out: Path) -> None:
    """Remove the partly written files that a killed process left in a run folder, if possible."""
    for parts in (out.glob, *((out / name).rglob for name in FOLDERS)):
        for part in parts(f".*{PART}"):
            if re.fullmatch(rf"\..+\.[0-9a-f]{{8}}\{PART}", part.name):
                with suppress(OSError):  # if the folder is read-only, the next write reports it
                    part.unlink(missing_ok=True)


def check_outputs(outputs: Iterable[Path], inputs: Iterable[Path], *, force: bool) -> None:
    """Refuse outputs that exist, but for `force`, and what must never be replaced."""
    inputs = list(inputs)
    for path in outputs:
        if path.name in ("", ".."):
            raise StoreError(f"cannot write {path}: give the name of a file")
        check_place(path)
        try:
            if path.is_dir():
                raise StoreError(f"cannot write {path}: it is a folder; give the name of a file")
            for source in inputs:
                linked = path.exists() and source.exists() and path.samefile(source)
                if linked or path.resolve() == source.resolve():
                    raise StoreError(
                        f"cannot write {path}: it is an input of this command, {source}"
                    )
            if is_file_of_a_run(path):
                raise StoreError(f"cannot write {path}: it is a file of the run in that folder")
            if path.exists() and not force:
                raise StoreError(f"{path} exists: give another name, or --force to replace it")
        except (OSError, RuntimeError, ValueError) as error:
            raise StoreError(f"cannot write {path}: {error}") from error


def check_folder(folder: Path, *, force: bool) -> None:
    """Refuse a folder of outputs that holds something, but for `force`, and run folders."""
    if folder.exists() and not folder.is_dir():
        raise StoreError(f"cannot write {folder}: it is a file, and a folder is expected")
    if (folder / MANIFEST).exists():
        raise StoreError(f"{folder} is a run folder: give a folder of its own")
    if folder.is_dir() and any(folder.iterdir()) and not force:
        raise StoreError(f"{folder} is not empty: give another name, or --force to write into it")


# --- verdicts and warnings


class Verdict(StrEnum):
    """Verdict of a check, as its files hold it."""

    PASS = "pass"
    NOTE = "note"
    """The reader must know of it, but it is no fault of the run."""
    WARNING = "warning"
    """The model misses this by more than its tolerance."""
    FAIL = "fail"
    """The value is beyond its limit: figures that depend on it must not be used."""

    @classmethod
    def of(cls, good: bool) -> Verdict:
        """PASS or FAIL."""
        return cls.PASS if good else cls.FAIL

    @classmethod
    def pass_or_note(cls, good: bool) -> Verdict:
        """PASS or NOTE, of a check that cannot fail."""
        return cls.PASS if good else cls.NOTE


class Use(StrEnum):
    """What a test or a run may be used for, in the words of its verdict; the best first."""

    USABLE = "usable"
    WITH_CARE = "usable with care"
    NOT_USABLE = "not usable"

    @property
    def mark(self) -> Verdict:
        """The verdict of a check that looks like it."""
        marks = {self.USABLE: Verdict.PASS, self.WITH_CARE: Verdict.WARNING}
        return marks.get(self, Verdict.FAIL)


SPOILING = re.compile(
    "no force|two clocks|peaks and valleys|displacement clipping|force sign|both signs|channels"
    "|time unit|duplicate|actuation|unit of displacement|unit of force|displacement"
    "|force|another device|beyond the priors"
)
"""Names of findings that say that something is wrong with a test: its results cannot be used."""


@dataclass(frozen=True)
class Finding:
    """A warning of a stage, which a reader of the results must know."""

    subject: str
    name: str
    message: Message
    stage: str = "records"

    @property
    def spoils(self) -> bool:
        """Whether something is wrong with the test, rather than to be kept in mind."""
        return SPOILING.fullmatch(self.name) is not None


# --- a test

FORMAT: Literal[2] = 2
"""Format of a run folder, raised when another version cannot read what this one writes."""


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


# --- what evaluation makes of a run, as the manifest holds it

PartKind = Literal["test", "level", "session"]
"""What is left out of a campaign at a time."""


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
    whole: bool | None = None
    """Whether the whole force is inside the 95 % band of whole histories."""


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
class Comparison:
    """Models of one campaign, compared: rows of every test, then of all; best model first.

    The sentence says which model the records favour, and whether its check figures speak
    against it.
    """

    rows: tuple[ComparisonRow, ...]
    sentence: str


# --- the manifest


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


# --- a run is begun, resumed or replaced

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


@dataclass(frozen=True)
class Resumed:
    """What a run begins with: `before` is an earlier session whose population is the same."""

    manifest: Manifest
    before: Manifest | None = None
    same_tests: bool = False
    notes: tuple[str, ...] = ()


def check_free(home: Path, out: Path) -> None:
    """Refuse a folder that exists, where it is neither to be resumed nor to be replaced."""
    if not is_free(out, home):
        raise StoreError(f"{out} exists: give --resume to finish it or --force to replace it")


def prepare_folder(
    manifest: Manifest, home: Path, out: Path, *, resume: bool = False, force: bool = False
) -> Resumed:
    """Check that a run may be started, resumed or replaced in a folder; remove a replaced one.

    Of a run that is resumed, everything is kept whose key is the same as before; what is stored
    under another key is removed.
    """
    check_links(out)
    check_places(out)
    if is_free(out, home):
        return Resumed(manifest)
    if not (resume or force):
        check_free(home, out)
    if force or (out / DISCARDED).exists():
        discard(out)
        return Resumed(manifest)
    try:
        before = read_begun(out)
    except StoreError as error:
        again = "--force to start again" if (out / MANIFEST).exists() else "another folder by -o"
        raise StoreError(f"{out} cannot be resumed: {error}; give {again}") from error
    _check_resumable(manifest, before, out)
    same = {place for place, key in manifest.keys.items() if before.keys.get(place) == key}
    damaged = {name: reason for name in manifest.tests if (reason := _damage(out, name, before))}
    kept = [n for n in manifest.tests if folder_of(n) in same and n not in damaged]
    notes = [f"{reason}; {name} is sampled again" for name, reason in damaged.items()]
    if POPULATION in same and not damaged and (reason := _damage_of_population(out, before)):
        notes.append(f"{reason}; the population is inferred again")
        same.remove(POPULATION)
    resumed = _with_results(manifest, before, kept, out)
    if COMPARISON in same and all((out / posterior_of(n)).is_file() for n in manifest.fitted):
        resumed = resumed.changed(comparison=before.comparison)
    notes += _notes([*kept, *damaged], manifest, before, out)
    if CROSSVALIDATION not in same:
        remove_folder(out, CROSSVALIDATION)
        before = before.changed(crossvalidation=None)
    if POPULATION not in same or damaged:
        before.changed(status=Status.RUNNING).write(out)  # what is left is no finished run
    for name in {*before.tests, *manifest.tests}.difference(kept):
        remove_folder(out, folder_of(name))
    population = before if POPULATION in same else None
    return Resumed(resumed, population, COMPARISON in same, tuple(notes))


def _check_resumable(manifest: Manifest, before: Manifest, out: Path) -> None:
    """Refuse to resume a run of other tests, or with another seed, effort or version."""
    for key in ("seed", "effort", "versions"):
        old, new = getattr(before, key), getattr(manifest, key)
        if old != new:
            names = _differing(old, new) if isinstance(old, Mapping) else []
            raise StoreError(
                f"{out} cannot be resumed: {key}{f' ({_listed(names)})' if names else ''} changed "
                "since it was started; give --force to start again"
            )
    if not set(before.tests) & set(manifest.tests):
        raise StoreError(
            f"{out} cannot be resumed: it is a run of other tests ({_listed(before.tests)}); "
            "give another folder, or --force to replace it"
        )


def _damage(out: Path, name: str, before: Manifest) -> str:
    """Why the stored posterior of a test cannot be kept; "" where it can, or there is none.

    The hash of one that was stored just before the run was killed is not known: it is read.
    """
    file = posterior_of(name)
    if not (out / file).is_file():
        return ""
    try:
        path = check_stored(out, file, before.files)
        if file not in before.files and load_test(path).facts.get("test") != name:
            return f"{path} is of another test"
    except StoreError as error:
        return str(error)
    return ""


def _damage_of_population(out: Path, before: Manifest) -> str:
    """Why the stored population of a finished run cannot be kept; "" where it can."""
    if before.status == Status.FINISHED:
        try:
            for name in (POPULATION, *map(pooled_of, before.tests)):
                if name in before.files:
                    check_stored(out, name, before.files)
        except StoreError as error:
            return str(error)
    return ""


def _with_results(
    manifest: Manifest, before: Manifest, kept: Collection[str], out: Path
) -> Manifest:
    """The manifest with what is kept of an earlier session.

    Hashes of other files are dropped: such a file is written again before its hash is, and a kill
    in between would leave a new file with an old hash.
    """
    files = [name for name in map(posterior_of, kept) if (out / name).is_file()]
    truth = before.truth
    if truth is not None:
        tests = {name: values for name, values in truth.tests.items() if name in kept}
        truth = truth.model_copy(update={"tests": tests})
    machines = dict.fromkeys(tuple(m.items()) for m in (*before.machines, *manifest.machines))
    resumed = manifest.changed(
        files={n: before.files[n] for n in files if n in before.files},
        truth=truth or manifest.truth,
        started=before.started,
        seconds=before.seconds,
        machines=tuple(map(dict, machines)),
    )
    for name in kept:
        if before.tests[name].status == State.DONE:
            seconds = before.tests[name].seconds
            resumed = resumed.with_test(name, status=State.DONE, seconds=seconds)
    return resumed


def _notes(kept: Collection[str], manifest: Manifest, before: Manifest, out: Path) -> Iterable[str]:
    """Sentences on finished tests that are not kept, and on another machine that computed some."""
    lost = [n for n in before.tests if n not in kept and (out / posterior_of(n)).is_file()]
    again = [name for name in lost if name in manifest.fitted]
    gone = [name for name in lost if name not in again]
    if again:
        yield f"what they rest on has changed, so they are sampled again: {_listed(again)}"
    if gone:
        yield f"no longer calibrated by this campaign, so removed: {_listed(gone)}"
    (here,) = manifest.machines
    for there in before.machines:
        if names := _differing(there, here):
            differ = "; ".join(
                f"{name} was {there.get(name, 'none')}, is {here.get(name, 'none')}"
                for name in names
            )
            yield (
                "another machine has computed a part of this run, and draws that are kept can "
                f"differ in their last digits from those of this one: {differ}"
            )
            return


def _differing(old: Mapping[str, str], new: Mapping[str, str]) -> list[str]:
    """Keys whose values differ."""
    return [name for name in {**old, **new} if old.get(name) != new.get(name)]


def _listed(names: Iterable[str]) -> str:
    """Names with commas; the first ten of many."""
    first, rest = [*names][:10], [*names][10:]
    return ", ".join(first) + (f", and {len(rest)} more" if rest else "")
