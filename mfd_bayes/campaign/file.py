"""A campaign, read from its file and checked: settings, laws and tests."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from mfd_bayes.campaign.content import read_content
from mfd_bayes.campaign.goal import wanted_of
from mfd_bayes.campaign.order import Part, check_order, check_parts
from mfd_bayes.campaign.schema import (
    Column,
    Columns,
    DisplacementColumn,
    Entry,
    NoiseName,
    Role,
    TimeColumn,
)
from mfd_bayes.errors import CampaignError, UnitError
from mfd_bayes.planning.goal import check_session
from mfd_bayes.population.laws import complete_laws
from mfd_bayes.records.channels import Source, Subtracted
from mfd_bayes.records.columns import header_unit
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.readers.table import own_name
from mfd_bayes.records.record import Record, Window, read_record
from mfd_bayes.records.regular import file_inside
from mfd_bayes.records.time_axis import parse_window
from mfd_bayes.units import (
    ActuationUnit,
    actuation_factor,
    actuation_kind,
    measure,
    parse_actuation,
)

_PARTS = ("minus_mass", "tare", "arm", "measured_at", "rate", "dates")  # keys of a source


@dataclass(frozen=True, eq=False)
class Test:
    """One test of a campaign."""

    __test__: ClassVar[bool] = False  # pytest must not take it for a test class

    id: str
    """The name of its folder; no two ids differ only in the case of their letters."""
    path: Path
    """Its file, inside the campaign's folder, links resolved."""
    actuation: str | None
    """Constant actuation with its unit; None where `columns` has the role "actuation"."""
    actuation_unit: ActuationUnit
    """"ksi" where the actuation is a pressure, "kip" where it is a force, or as "A"."""
    window: Window | None
    """The part of the record that is fitted, s."""
    role: Role
    columns: dict[str, Source]
    """Role to its source, where the campaign file gives one."""
    session: str = ""
    """Tests of one session were made together, with nothing changed in between."""
    after: str = ""
    """Id of the test that was made directly before it, the device not reset in between."""

    def read(self) -> Record:
        """Record of this test; raises as `read_record` does."""
        return read_record(self.path, self.columns, None, self.actuation, fit=self.window)


@dataclass(frozen=True, eq=False)
class Campaign:
    """A campaign file, checked."""

    path: Path
    folder: Path
    """The campaign file's folder, links resolved; all test files are inside it."""
    title: str
    """The campaign file's name where no title is given."""
    priors: str
    """A name, or a path relative to `folder`."""
    model: str
    noise: NoiseName
    noise_check: bool | None
    """Whether each test is fitted under other noises too; None where the file does not say."""
    rate: float | None
    """Hz."""
    start: Literal["sample", "mask"]
    area: float | None
    """Area of the actuator, in², where the actuation is a pressure."""
    laws: dict[str, str]
    """Law of every name that may have one, given or by default."""
    dependence: dict[str, tuple[str, ...]]
    """Parameter to the covariates, "velocity" or "amplitude", that it depends on."""
    tolerances: dict[str, float]
    """By how much the model may miss each figure, where the file says so."""
    tests: tuple[Test, ...]
    actuation_unit: ActuationUnit
    """The same for all tests."""

    def since(self, test: Test) -> float:
        """Time in a test's file at which the test before it ended, s, if it is in the same file."""
        same = (t for t in self.tests if t.id == test.after and t.path == test.path)
        return max((t.window[1] for t in same if t.window), default=-math.inf)


def load_campaign(
    path: str | Path, model: str | None = None, noise: NoiseName | None = None
) -> Campaign:
    """Campaign of a TOML file; test files must exist but are not read yet.

    A test file is read where only its row of units tells whether its actuation is a pressure or
    a force.

    Parameters
    ----------
    path : str or Path
    model : str, optional
        Replaces the file's own: "three_stage", "lugre", "bouc_wen" or "backlash".
    noise : {"ou", "iid", "student_t", "staged"}, optional
        Replaces the file's own.

    Raises
    ------
    CampaignError
        When the file is not TOML, a key is unknown, missing or of the wrong kind, two tests
        share an id, a test's file is missing or outside the campaign's folder, actuations mix
        pressures and forces or a force has an area, no test has the role "calibrate", or tests
        follow each other as they cannot.
    RecordError
        When a test file that must be read for its row of units cannot be read.
    """
    path = Path(path)
    content = read_content(path)
    try:
        folder = path.resolve().parent
    except (OSError, RuntimeError) as error:
        raise CampaignError(f"cannot read {path}: {error}") from error
    tests = tuple(_test(path, folder, content.columns, entry) for entry in content.test)
    _check_together(path, tests, content.campaign.area)
    after = {test.id: test.after for test in tests}
    check_order(path, after)
    check_parts(path, after, {test.id: Part(test.path, test.window) for test in tests})
    wanted = wanted_of(path, content.goal, tests[0].actuation_unit)
    learned = [test.session for test in tests if test.role == "calibrate"]
    check_session(wanted.goal.session, learned, of=f"goal.session in {path}")
    return Campaign(
        path=path,
        folder=folder,
        title=content.campaign.title or path.stem,
        priors=content.campaign.priors,
        model=model or content.campaign.model,
        noise=noise or content.campaign.noise,
        noise_check=content.campaign.noise_check,
        rate=content.campaign.rate,
        start=content.campaign.start,
        area=content.campaign.area,
        laws=complete_laws(content.laws),
        dependence=content.dependence.covariates,
        tolerances=dict(content.tolerances),
        tests=tests,
        actuation_unit=tests[0].actuation_unit,
    )


def _test(path: Path, folder: Path, defaults: Columns, entry: Entry) -> Test:
    """Test of an entry, with the campaign's columns where the entry gives none."""
    chosen = defaults.given | entry.columns.given
    if entry.rate is not None:
        if "time" in entry.columns.given:
            raise CampaignError(
                f"test {entry.id!r} in {path}: a time is given either by its column or by a rate"
            )
        chosen["time"] = TimeColumn(rate=entry.rate)
    file = _inside(path, folder, entry)
    level: str | None = None
    if isinstance(entry.actuation, str):
        level, unit = entry.actuation, parse_actuation(entry.actuation)[1]
    else:
        chosen["actuation"] = entry.actuation
        unit = _history_unit(path, entry.id, entry.actuation, file)
    return Test(
        id=entry.id,
        path=file,
        actuation=level,
        actuation_unit=unit,
        window=None if entry.fit is None else parse_window(entry.fit),
        role=entry.role,
        columns={role: _source(c) for role, c in chosen.items()},
        session=entry.session,
        after=entry.after,
    )


def _source(column: Column) -> Source:
    """Source of a column of the campaign file."""
    parts = {name: getattr(column, name, None) or "" for name in _PARTS}
    other = column.minus if isinstance(column, DisplacementColumn) else None
    minus = None if other is None else Subtracted(other.key, other.unit, other.times)
    key = None if parts["rate"] else column.key
    return Source(key, column.unit, minus, sign=getattr(column, "sign", 1), **parts)


def _history_unit(path: Path, test: str, column: Column, file: Path) -> ActuationUnit:
    """Whether a measured actuation is a pressure or a force: by its unit, name or row of units."""
    unit = column.unit or header_unit(column.name or "")
    if column.unit is None and (unit is None or not _actuates(unit)):
        table = read_table(file)
        name = table.name_of(column.key)
        unit = table.units.get(name, unit or header_unit(own_name(name)))
    where = f"actuation of test {test!r} in {path}"
    if unit is None:
        given = f"name = {column.name!r}" if column.name else f"column = {column.column}"
        raise CampaignError(f"{where} needs a unit: {{ {given}, unit = … }}")
    try:
        return actuation_factor(unit, of=f"the {where}")[1]
    except UnitError as error:
        raise CampaignError(str(error)) from error


def _actuates(unit: str) -> bool:
    """Whether a unit is one of an actuation; "force" of "axial_force" is none, nor 1 of "p_1"."""
    try:
        actuation_factor(unit)
    except UnitError:
        return False
    return measure(unit) != "ratio"


def _inside(path: Path, folder: Path, entry: Entry) -> Path:
    """Path of a test's file, which must be in the campaign's folder once links are followed."""
    named = f"file {entry.file!r} of test {entry.id!r} in {path}"
    try:
        found = file_inside(folder, entry.file)
        if found is None:
            raise CampaignError(f"{named} lies outside the campaign's folder")
        if not found.is_file():
            raise CampaignError(f"{named} does not exist")
    except (OSError, RuntimeError, ValueError) as error:
        raise CampaignError(f"{named} cannot be found: {error}") from error
    return found


def _check_together(path: Path, tests: tuple[Test, ...], area: float | None) -> None:
    """Refuse equal ids, pressures mixed with forces, and a campaign with nothing to calibrate."""
    seen: dict[str, str] = {}
    for test in tests:
        other = seen.get(test.id.lower())
        seen[test.id.lower()] = test.id
        if other is not None:
            also = "" if other == test.id else f" (as {other!r}; case does not tell folders apart)"
            raise CampaignError(f"two tests of {path} have the id {test.id!r}{also}")
    units = {test.actuation_unit: test.id for test in reversed(tests)}
    if len(units) > 1:
        raise CampaignError(
            f"actuations of {path} must be all of one kind, as all pressures or all forces; "
            + ", ".join(
                f"that of test {name!r} is {actuation_kind(u)}" for u, name in units.items()
            )
        )
    if all(test.role == "validate" for test in tests):
        raise CampaignError(f"{path} has no test with role 'calibrate'")
    if area is not None and "ksi" not in units:
        unit, name = next(iter(units.items()))
        raise CampaignError(
            f"area in [campaign] of {path} is for actuations that are pressures; the actuation of "
            f"test {name!r} is {actuation_kind(unit)}: leave area out"
        )
