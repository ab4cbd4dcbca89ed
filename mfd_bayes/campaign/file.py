"""What a campaign file says: settings, laws, and the tests with their files and actuations."""

from __future__ import annotations

import difflib
import re
import reprlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
)

from mfd_bayes.errors import CampaignError, UnitError
from mfd_bayes.records.readers import read_table
from mfd_bayes.records.readers.bounds import NAME
from mfd_bayes.records.record import Record, Window, read_record
from mfd_bayes.records.roles import header_unit
from mfd_bayes.store.toml import TomlError, read_toml
from mfd_bayes.units import (
    ActuationUnit,
    actuation_factor,
    measure,
    parse_actuation,
    parse_quantity,
    parse_window,
)

LawName = Literal["proportional", "affine", "power", "constant", "compare"]
ModelName = Literal["three_stage", "lugre", "bouc_wen"]
Role = Literal["calibrate", "validate"]
Covariate = Literal["velocity", "amplitude"]

_TOLD = 10
"""Most faults of a file that are told at once."""

_LONGEST = 400
"""Most characters of what is said of a fault."""

_NAME = "campaign.toml"
_ID = re.compile(r"[A-Za-z0-9+_-][A-Za-z0-9+_.-]{0,99}")


def _parsed(parse: Callable[[str], object]) -> Callable[[object], object]:
    """Parse a text as a validator does, and pass anything else on."""

    def validate(value: object) -> object:
        try:
            return parse(value) if isinstance(value, str) else value
        except UnitError as error:
            raise ValueError(str(error)) from error

    return validate


def _checked(parse: Callable[[str], object]) -> Callable[[str], str]:
    """Check that a text parses, and keep the text."""

    def validate(text: str) -> str:
        _parsed(parse)(text)
        return text

    return validate


_rate = BeforeValidator(_parsed(lambda text: parse_quantity(text, "rate")))
_area = BeforeValidator(_parsed(lambda text: parse_quantity(text, "area")))


def check_id(name: str) -> str:
    """A test's id, which names a folder; raises ValueError where it cannot."""
    if not _ID.fullmatch(name):
        raise ValueError(
            "a test's id names a folder: letters, digits and . _ - + only, at most 100 of them, "
            "and no dot first"
        )
    return name


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Column(_Part):
    """A column of a test file; without a unit, the name's ending is taken."""

    name: Annotated[str, Field(min_length=1, max_length=NAME)]
    unit: str | None = None


class Columns(_Part):
    """Columns of a test file by role."""

    time: Column | None = None
    displacement: Column | None = None
    force: Column | None = None
    velocity: Column | None = None


class Laws(_Part):
    """How parameters follow the actuation; "compare" weighs the laws against each other.

    Bouc-Wen's F_y follows F_c's law where it has none of its own.
    """

    Fc_fwd: LawName = "proportional"
    Fc_bwd: LawName = "proportional"
    Fs_fwd: LawName = "proportional"
    Fs_bwd: LawName = "proportional"
    sigma0: LawName = "affine"
    Fy_fwd: LawName | None = None
    Fy_bwd: LawName | None = None


class Dependence(_Part):
    """What parameters follow besides the actuation; nothing where it is not given."""

    Fc_fwd: tuple[Covariate, ...] = ()
    Fc_bwd: tuple[Covariate, ...] = ()
    sigma0: tuple[Covariate, ...] = ()
    d2: tuple[Covariate, ...] = ()


class Settings(_Part):
    """The `[campaign]` table; `rate` in Hz, `area` in in²."""

    title: Annotated[str, Field(max_length=1000)] = ""
    priors: Annotated[str, Field(min_length=1, max_length=1000)] = "mfd"
    model: ModelName = "three_stage"
    noise: Literal["ou", "iid", "student_t", "staged"] = "ou"
    rate: Annotated[float, Field(gt=0, strict=True), _rate] | None = None
    start: Literal["sample", "mask"] = "sample"
    area: Annotated[float, Field(gt=0, strict=True), _area] | None = None


class _Entry(_Part):
    """One `[[test]]`."""

    id: Annotated[str, AfterValidator(check_id)]
    file: Annotated[str, Field(min_length=1, max_length=1000)]
    actuation: Annotated[
        Annotated[str, AfterValidator(_checked(parse_actuation)), Tag(":quantity")]
        | Annotated[Column, Tag(":column")],
        Discriminator(lambda value: ":column" if isinstance(value, dict) else ":quantity"),
    ]
    fit: Annotated[str, AfterValidator(_checked(parse_window))] | None = None
    role: Role = "calibrate"
    columns: Columns = Columns()
    session: Annotated[str, Field(max_length=100)] = ""


class _File(_Part):
    campaign: Settings = Settings()
    columns: Columns = Columns()
    laws: Laws = Laws()
    dependence: Dependence = Dependence()
    test: Annotated[tuple[_Entry, ...], Field(min_length=1)]


@dataclass(frozen=True, eq=False)
class Test:
    """One test of a campaign.

    Attributes
    ----------
    id : str
        Safe as a folder's name, unique whatever the case of its letters.
    path : Path
        Inside the campaign's folder, links resolved.
    actuation_value : float, ksi or kip, or None
        None when it was measured: `columns` then has the role "actuation".
    actuation_unit : "ksi" or "kip"
    window : (float, float), s, or None
    role : "calibrate" or "validate"
    columns : dict
        Role to the column's name and unit, where given.
    session : str
        Tests of one session share what changes between sessions.
    """

    __test__: ClassVar[bool] = False  # no test class, whatever pytest makes of its name

    id: str
    path: Path
    actuation: str | None
    actuation_value: float | None
    actuation_unit: ActuationUnit
    window: Window | None
    role: Role
    columns: dict[str, tuple[str, str | None]]
    session: str = ""

    def read(self) -> Record:
        """Record of this test; raises as `read_record` does."""
        names = {role: name for role, (name, _) in self.columns.items()}
        units = {role: unit for role, (_, unit) in self.columns.items() if unit is not None}
        return read_record(self.path, names, units, self.actuation, fit=self.window)


@dataclass(frozen=True, eq=False)
class Campaign:
    """A campaign file, checked.

    Attributes
    ----------
    path : Path
    folder : Path
        Where test files are, links resolved.
    title : str
        The file's name when none is given.
    priors : str
        A name, or a path relative to `folder`.
    model, noise, start : str
    rate : float, Hz, or None
    area : float, in², or None
        Of the actuator, where actuation is a pressure.
    laws : Laws
    dependence : dict of str to tuple of str
        Covariates, "velocity" or "amplitude", that parameters follow.
    tests : tuple of Test
    actuation_unit : "ksi" or "kip"
        The same for all tests.
    """

    path: Path
    folder: Path
    title: str
    priors: str
    model: ModelName
    noise: Literal["ou", "iid", "student_t", "staged"]
    rate: float | None
    start: Literal["sample", "mask"]
    area: float | None
    laws: Laws
    dependence: dict[str, tuple[str, ...]]
    tests: tuple[Test, ...]
    actuation_unit: ActuationUnit


def load_campaign(path: str | Path, model: ModelName | None = None) -> Campaign:
    """Campaign of a TOML file; test files must exist but are not read yet.

    One is where only its row of units can tell whether its actuation is a pressure or a force.

    Parameters
    ----------
    path : str or Path
    model : {"three_stage", "lugre", "bouc_wen"}, optional
        Instead of the file's own.

    Raises
    ------
    CampaignError
        When the file is not TOML, a key is unknown, missing or of the wrong kind, two tests
        share an id, a test's file is missing or outside the campaign's folder, actuations mix
        pressures and forces or a force has an area, or no test calibrates.
    RecordError
        When a file whose row of units is asked for cannot be read.
    """
    path = Path(path)
    raw = _toml(path)
    try:
        content = _File.model_validate(raw)
    except ValidationError as error:
        told = [_cut(text) for text in islice(_sentences(path, raw, error), _TOLD + 1)]
        more = "; and more" if len(told) > _TOLD else ""
        raise CampaignError("; ".join(told[:_TOLD]) + more) from None
    try:
        folder = path.resolve().parent
    except (OSError, RuntimeError) as error:
        raise CampaignError(f"cannot read {path}: {error}") from error
    tests = tuple(_test(path, folder, content.columns, entry) for entry in content.test)
    _check_together(path, tests)
    if content.campaign.area is not None and tests[0].actuation_unit != "ksi":
        raise CampaignError(
            f"area in [campaign] of {path} is that of a pressure's actuator; test "
            f"{tests[0].id!r} is actuated by a force: leave it out"
        )
    return Campaign(
        path=path,
        folder=folder,
        title=content.campaign.title or path.stem,
        priors=content.campaign.priors,
        model=model or content.campaign.model,
        noise=content.campaign.noise,
        rate=content.campaign.rate,
        start=content.campaign.start,
        area=content.campaign.area,
        laws=content.laws,
        dependence={name: those for name, those in content.dependence if those},
        tests=tests,
        actuation_unit=tests[0].actuation_unit,
    )


def _toml(path: Path) -> dict[str, Any]:
    if path.is_dir():
        raise CampaignError(f"{path} is a folder: give the campaign file in it, {path / _NAME}")
    try:
        return read_toml(path)
    except FileNotFoundError as error:
        beside = [file.name for file in path.parent.glob("*.toml")]
        near = difflib.get_close_matches(path.name, beside, n=1)
        hint = f"; did you mean {path.parent / near[0]}?" if near else ""
        raise CampaignError(f"cannot read {path}: {error.strerror}{hint}") from error
    except OSError as error:
        raise CampaignError(f"cannot read {path}: {error.strerror or error}") from error
    except TomlError as error:
        raise CampaignError(f"{path} {error}") from error


def _test(path: Path, folder: Path, defaults: Columns, entry: _Entry) -> Test:
    """Test of an entry, with the campaign's columns where it gives none."""
    chosen = {**dict(defaults), **{k: v for k, v in entry.columns if v is not None}}
    file = _inside(path, folder, entry)
    level: float | None = None
    if isinstance(entry.actuation, str):
        level, unit = parse_actuation(entry.actuation)
    else:
        chosen["actuation"] = entry.actuation
        unit = _history_unit(path, entry.id, entry.actuation, file)
    return Test(
        id=entry.id,
        path=file,
        actuation=None if level is None else str(entry.actuation),
        actuation_value=level,
        actuation_unit=unit,
        window=None if entry.fit is None else parse_window(entry.fit),
        role=entry.role,
        columns={role: (c.name, c.unit) for role, c in chosen.items() if c is not None},
        session=entry.session,
    )


def _history_unit(path: Path, test: str, column: Column, file: Path) -> ActuationUnit:
    unit = column.unit or header_unit(column.name)
    if column.unit is None and (unit is None or measure(unit) not in ("pressure", "force")):
        unit = read_table(file).units.get(column.name, unit)
    where = f"actuation of test {test!r} in {path}"
    if unit is None:
        raise CampaignError(f"{where} needs a unit: {{ name = {column.name!r}, unit = … }}")
    try:
        return actuation_factor(unit, of=f"the {where}")[1]
    except UnitError as error:
        raise CampaignError(str(error)) from error


def _inside(path: Path, folder: Path, entry: _Entry) -> Path:
    """Path of a test's file, which must be in the campaign's folder once links are followed."""
    named = f"file {entry.file!r} of test {entry.id!r} in {path}"
    try:
        found = (folder / entry.file).resolve()
        if Path(entry.file).is_absolute() or not found.is_relative_to(folder):
            raise CampaignError(f"{named} lies outside the campaign's folder")
        if not found.is_file():
            raise CampaignError(f"{named} does not exist")
    except (OSError, RuntimeError, ValueError) as error:
        raise CampaignError(f"{named} cannot be found: {error}") from error
    return found


def _check_together(path: Path, tests: tuple[Test, ...]) -> None:
    """Refuse shared ids, mixed actuations, and a campaign without a test to calibrate."""
    seen: dict[str, str] = {}
    for test in tests:
        other = seen.setdefault(test.id.lower(), test.id)
        if other is not test.id:
            also = "" if other == test.id else f" (as {other!r}; case does not tell folders apart)"
            raise CampaignError(f"two tests of {path} have the id {test.id!r}{also}")
    units = {test.actuation_unit: test.id for test in reversed(tests)}
    if len(units) > 1:
        raise CampaignError(
            f"actuations of {path} must be all pressures or all forces; test {units['ksi']!r} "
            f"has a pressure, test {units['kip']!r} a force"
        )
    if all(test.role == "validate" for test in tests):
        raise CampaignError(f"{path} has no test with role 'calibrate'")


_SECTIONS: dict[str, type[_Part]] = {
    "": _File,
    "campaign": Settings,
    "columns": Columns,
    "laws": Laws,
    "dependence": Dependence,
    "test": _Entry,
}


def _sentences(path: Path, raw: dict[str, Any], error: ValidationError) -> Iterator[str]:
    """One sentence per fault: where, what was expected, what came."""
    for fault in error.errors(include_url=False):
        loc = [part for part in fault["loc"] if not str(part).startswith(":")]
        where, came = _dotted(raw, loc), reprlib.repr(fault["input"])
        if fault["type"] == "too_short" and raw.get("test"):
            continue  # every test has a fault, which is told by itself
        if fault["type"] == "extra_forbidden":
            yield _unknown_key(path, raw, loc)
        elif fault["type"] == "missing":
            yield f"{where} is missing in {path}"
        elif fault["msg"].startswith("Input should be"):
            expected = fault["msg"].removeprefix("Input ")
            yield f"{where} in {path} {expected}, got {came}"
        else:
            yield f"{where} in {path}: {fault['msg'].removeprefix('Value error, ')}, got {came}"


def _cut(text: str) -> str:
    """Sentence that a strange key or value makes no longer than can be read."""
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"


def _unknown_key(path: Path, raw: dict[str, Any], loc: list[int | str]) -> str:
    names = [part for part in loc[:-1] if isinstance(part, str)]
    known = list(_SECTIONS.get(names[-1] if names else "", Column).model_fields)
    near = difflib.get_close_matches(str(loc[-1]), known, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}?" if near else f"expected {', '.join(known)}"
    section = f" in [{_dotted(raw, loc[:-1])}]" if names else ""
    return f"unknown key {str(loc[-1])!r}{section} of {path}; {hint}"


def _dotted(raw: dict[str, Any], loc: list[int | str]) -> str:
    """Path of a key, with a test named by its id, or by its number from 1."""
    text = ""
    for part in loc:
        if isinstance(part, int):
            entry = raw["test"][part] if text == "test" else None
            name = entry.get("id") if isinstance(entry, dict) else None
            text += f" {name!r}" if isinstance(name, str) else f" {part + 1}"
        else:
            text += f".{part}" if text else part
    return text
