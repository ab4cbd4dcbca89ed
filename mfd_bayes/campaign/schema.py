"""The keys of a campaign file, and which values each may have."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Annotated, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from mfd_bayes.calibration import noise as noises
from mfd_bayes.campaign.tolerances import DEFAULTS
from mfd_bayes.errors import UnitError
from mfd_bayes.friction import models
from mfd_bayes.population.laws import complete_laws
from mfd_bayes.records.channels import step_of
from mfd_bayes.records.readers.table import COLUMNS, NAME
from mfd_bayes.records.time_axis import parse_window
from mfd_bayes.units import parse_actuation, parse_quantity

LawName = Literal["proportional", "affine", "power", "constant", "residual_power", "compare"]
Role = Literal["calibrate", "validate"]
Covariate = Literal["velocity", "amplitude"]


def _one_of(known: Callable[[], Iterable[str]]) -> BeforeValidator:
    """Validator of a name in a registry, which is read when a campaign is."""

    def validate(value: object) -> object:
        *others, last = map(repr, known())
        if repr(value) not in (*others, last):
            raise PydanticCustomError(
                "literal_error", f"Input should be {', '.join(others)} or {last}"
            )
        return value

    return BeforeValidator(validate)


def _known_tolerance(name: str) -> str:
    if name not in DEFAULTS:
        raise PydanticCustomError("extra_forbidden", "Extra inputs are not permitted")
    return name


def _known_key(name: str) -> str:
    if name not in complete_laws({}):
        raise PydanticCustomError("extra_forbidden", "Extra inputs are not permitted")
    return name


ModelName = Annotated[str, _one_of(lambda: models.MODELS)]
NoiseName = Annotated[str, _one_of(lambda: noises.NOISES)]

_ID = re.compile(r"[A-Za-z0-9+_-][A-Za-z0-9+_.-]{0,99}")

RESERVED = frozenset({"campaign", "sentence", "population"})
"""Names beside those of the tests in the verdicts and steps of a run, in small letters."""


def check_id(name: str) -> str:
    """A test's id, unchanged; raises ValueError where it cannot be the name of a folder."""
    if not _ID.fullmatch(name):
        raise ValueError(
            "a test's id names a folder: letters, digits and . _ - + only, at most 100 of them, "
            "and no dot first"
        )
    return name


def _check_new_id(name: str) -> str:
    """Id of a test in a campaign file: as `check_id`, and none that a run uses for itself."""
    if name.lower() in RESERVED:
        raise ValueError(f"a test's id cannot be {name!r}: a run uses that name for itself")
    return check_id(name)


def _parsed(parse: Callable[[str], object]) -> Callable[[object], object]:
    """Validator that parses a text, and returns any other value unchanged."""

    def validate(value: object) -> object:
        try:
            return parse(value) if isinstance(value, str) else value
        except UnitError as error:
            raise ValueError(str(error)) from error

    return validate


def _checked(parse: Callable[[str], object]) -> Callable[[str], str]:
    """Validator that checks that a text can be parsed, and returns the text."""

    def validate(text: str) -> str:
        _parsed(parse)(text)
        return text

    return validate


_rate = BeforeValidator(_parsed(lambda text: parse_quantity(text, "rate")))
_area = BeforeValidator(_parsed(lambda text: parse_quantity(text, "area")))

SampleRate = Annotated[str, AfterValidator(_checked(lambda text: step_of(text, "rate")))]
"""Rate of samples, "100 Hz", or their step, "10 ms"."""

Area = Annotated[float, Field(ge=1e-10, le=1e10)]
"""Area of an actuator, in²: of a campaign file, and of the manifest that is written of it."""


class Part(BaseModel):
    """A table of a campaign file; unknown keys, NaN and infinity are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Column(Part):
    """A column of a test file, by its name or its number from 1.

    Without `unit`, the ending of its name gives the unit.
    """

    name: Annotated[str, Field(min_length=1, max_length=NAME)] | None = None
    column: Annotated[int, Field(ge=1, le=COLUMNS, strict=True)] | None = None
    unit: Annotated[str, Field(max_length=60)] | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.name is None) == (self.column is None):
            raise ValueError(
                "a column is given either by its name or, as column = 1, by its number"
            )
        return self

    @property
    def key(self) -> str | int:
        """Its name or its number."""
        return self.name if self.name is not None else int(self.column or 0)


class TimeColumn(Column):
    """A column of times, or in its place the rate at which samples were taken."""

    rate: SampleRate | None = None
    dates: Literal["day first", "month first"] | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if self.rate is None:
            _ = Column(name=self.name, column=self.column, unit=self.unit)
        elif self.name is not None or self.column is not None or self.dates is not None:
            raise ValueError("a time is given either by its column or by a rate")
        return self


class SignedColumn(Column):
    """A column whose sign may be turned."""

    sign: Annotated[int, Field(strict=True)] = 1

    @field_validator("sign")
    @classmethod
    def _one(cls, sign: int) -> int:
        if sign not in (1, -1):
            raise ValueError("a sign is 1 or -1")
        return sign


class Minus(Column):
    """A column that is taken off another, times a quantity."""

    times: Annotated[str, Field(max_length=200)] = ""


class DisplacementColumn(SignedColumn):
    """A displacement, and what is taken off it."""

    minus: Minus | None = None
    tare: Annotated[str, Field(max_length=200)] = ""
    arm: Annotated[str, Field(max_length=200)] = ""
    measured_at: Annotated[str, Field(max_length=200)] = ""


class ForceColumn(DisplacementColumn):
    """A force, and what is taken off it."""

    minus_mass: Annotated[str, Field(max_length=200)] = ""


class Columns(Part):
    """The column of each role in a test file; a `rate` is that of the time without a column."""

    time: TimeColumn | None = None
    displacement: DisplacementColumn | None = None
    force: ForceColumn | None = None
    velocity: SignedColumn | None = None
    rate: SampleRate | None = None

    @model_validator(mode="after")
    def _time_or_rate(self) -> Self:
        if self.rate is not None and self.time is not None:
            raise ValueError("a time is given either by its column or by a rate")
        return self

    @property
    def given(self) -> dict[str, Column]:
        """Role to column, of those that are given."""
        time = TimeColumn(rate=self.rate) if self.rate is not None else self.time
        named = {
            "time": time,
            "displacement": self.displacement,
            "force": self.force,
            "velocity": self.velocity,
        }
        return {role: column for role, column in named.items() if column is not None}


def _once(names: tuple[str, ...]) -> tuple[str, ...]:
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ValueError(f"each of them may be there once, and {twice[0]!r} is there twice")
    return names


Covariates = Annotated[tuple[Covariate, ...], AfterValidator(_once)]


class Dependence(Part):
    """What each parameter depends on besides the actuation; default none."""

    Fc_fwd: Covariates = ()
    Fc_bwd: Covariates = ()
    sigma0: Covariates = ()
    d2: Covariates = ()
    gap: Covariates = ()

    @property
    def covariates(self) -> dict[str, tuple[str, ...]]:
        """Parameters to the covariates of a test that they depend on."""
        return {name: chosen for name, chosen in self if chosen}


def _percent(value: object) -> object:
    """Share of a text such as "5 %"; any other value unchanged."""
    found = _PERCENT.fullmatch(value.strip()) if isinstance(value, str) else None
    return float(found[1]) / 100.0 if found else value


_PERCENT = re.compile(r"(\d+(?:\.\d+)?)\s*%")
Tolerance = Annotated[float, Field(gt=0, strict=True), BeforeValidator(_percent)]


class Settings(Part):
    """The table `[campaign]`; `rate` in Hz, `area` in in²."""

    title: Annotated[str, Field(max_length=1000)] = ""
    priors: Annotated[str, Field(min_length=1, max_length=1000)] = "mfd"
    model: ModelName = "three_stage"
    noise: NoiseName = "ou"
    noise_check: Annotated[bool, Field(strict=True)] | None = None
    rate: Annotated[float, Field(gt=0, strict=True), _rate] | None = None
    start: Literal["sample", "mask"] = "sample"
    area: Annotated[Area, Field(strict=True), _area] | None = None


class Entry(Part):
    """One `[[test]]`."""

    id: Annotated[str, AfterValidator(_check_new_id)]
    file: Annotated[str, Field(min_length=1, max_length=1000)]
    actuation: Annotated[
        Annotated[str, AfterValidator(_checked(parse_actuation)), Tag(":quantity")]
        | Annotated[Column, Tag(":column")],
        Discriminator(lambda value: ":column" if isinstance(value, dict) else ":quantity"),
    ]
    fit: Annotated[str, AfterValidator(_checked(parse_window))] | None = None
    role: Role = "calibrate"
    columns: Columns = Columns()
    rate: SampleRate | None = None
    session: Annotated[str, Field(max_length=100)] = ""
    after: Annotated[str, Field(max_length=100)] = ""


class Wish(Part):
    """The table `[goal]`: what is to be known better, and by which tests."""

    quantity: Annotated[str, Field(min_length=1, max_length=100)] = "band"
    of: Annotated[str, Field(max_length=100)] = ""
    kind: Literal["device", "new_test"] = "device"
    at: Annotated[tuple[str, ...], Field(max_length=100)] = ()
    probability: Annotated[float, Field(gt=0, lt=1, strict=True)] = 0.95
    session: Annotated[str, Field(max_length=100)] = ""
    candidates: Annotated[tuple[str, ...], Field(max_length=2000)] = ()
    limits: Annotated[str, Field(min_length=1, max_length=200)] | None = None


class Content(Part):
    """A whole campaign file."""

    campaign: Settings = Settings()
    columns: Columns = Columns()
    laws: dict[Annotated[str, AfterValidator(_known_key)], LawName] = {}
    dependence: Dependence = Dependence()
    goal: Wish | None = None
    tolerances: dict[Annotated[str, AfterValidator(_known_tolerance)], Tolerance] = {}
    test: Annotated[tuple[Entry, ...], Field(min_length=1)]


def known_keys(table: str) -> list[str]:
    """Keys of a table of a campaign file; "" is the file itself."""
    if table == "laws":
        return list(complete_laws({}))
    if table == "tolerances":
        return list(DEFAULTS)
    tables: dict[str, type[Part]] = {
        "": Content,
        "campaign": Settings,
        "columns": Columns,
        "dependence": Dependence,
        "goal": Wish,
        "test": Entry,
        "minus": Minus,
        "time": TimeColumn,
        "displacement": DisplacementColumn,
        "force": ForceColumn,
        "velocity": SignedColumn,
    }
    return list(tables.get(table, Column).model_fields)
