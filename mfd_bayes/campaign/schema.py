"""What a campaign file may hold: each key with its type, unit, default and meaning, once.

The reader, the manifest of a run and the reference page of the documentation are made of it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import date
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from mfd_bayes.calibration.noises import NOISES
from mfd_bayes.calibration.priors import MOST_UNCERTAIN
from mfd_bayes.errors import UnitError
from mfd_bayes.friction import models
from mfd_bayes.population.design import complete_laws, default_laws
from mfd_bayes.records import cycles
from mfd_bayes.records.record import NO_ACTUATION, Source, Subtracted, step_of
from mfd_bayes.records.table import COLUMNS, NAME
from mfd_bayes.store.files import nearest
from mfd_bayes.units import (
    ActuationUnit,
    actuation_factor,
    dimension_of,
    parse_actuation,
    parse_quantity,
    split_quantity,
)

if TYPE_CHECKING:
    from mfd_bayes.population.inference import InferenceSettings

LawName = Literal["proportional", "affine", "power", "constant", "residual_power", "compare"]
Role = Literal["calibrate", "validate"]

TOLERANCES: Mapping[str, tuple[float, str]] = MappingProxyType(
    {
        **cycles.TOLERANCES,
        "residual": (0.3, "rms residual"),
        "correlation": (0.2, "correlation of neighbouring residuals, as a difference (at most 1)"),
        "mid_gap": (0.1, "force at mid-gap, of half the range of the force"),
        "coverage": (0.1, "by how much fewer samples lie inside a band than its probability"),
    }
)
"""By how much a model may miss a figure of a test, as a share, and what the figure is."""

LAWS: Mapping[str, str] = MappingProxyType(
    {
        "Fc_fwd": "kinetic friction forward",
        "Fc_bwd": "kinetic friction backward",
        "Fs_fwd": "static friction forward; no other law is possible: F_s = F_c (1 + excess)",
        "Fs_bwd": "static friction backward, likewise",
        "sigma0": "stiffness of the bristles",
        "Fy_fwd": "yield force forward, of `bouc_wen`",
        "Fy_bwd": "yield force backward, of `bouc_wen`",
    }
)

DEPENDENCE: Mapping[str, str] = MappingProxyType(
    {
        "Fc": "kinetic friction in both directions",
        "Fc_fwd": "kinetic friction forward",
        "Fc_bwd": "kinetic friction backward",
        "sigma0": "stiffness of the bristles",
        "d2": "width of the gap, d2 + d3, of the three stages",
        "gap": "width of the gap, of `backlash` and of the three stages",
    }
)

ACCEPTANCE: Mapping[str, str] = MappingProxyType(
    {"all": "every quantity that has no limit of its own", **cycles.LIMITS}
)
"""What a device may deviate in from the nominal value of `accept`, as a share."""

CALIBRATION_KEYS = {"uncertainty", "arm_uncertainty", "instrument"}
"""What a column says of its instrument: records and posteriors do not depend on it."""

RESERVED = frozenset({"campaign", "sentence", "population"})
"""Names beside those of the tests in the verdicts and steps of a run, in small letters."""

_ID = re.compile(r"[A-Za-z0-9+_-][A-Za-z0-9+_.-]{0,99}")
_PERCENT = re.compile(r"(\d+(?:\.\d+)?)\s*%")
_TEMPERATURE = re.compile(r"([+-]?\d+(?:\.\d+)?)\s*°?\s*([CFK])")


def _one_of(
    names: Callable[[], Iterable[str]],
    is_own: Callable[[str, ValidationInfo], object] = lambda name, info: False,
) -> BeforeValidator:
    """Validator of a name in a registry, which is read when a campaign is, or of a user's own."""

    def check(value: object, info: ValidationInfo) -> object:
        *choices, final = map(repr, names())
        if repr(value) in (*choices, final) or (isinstance(value, str) and is_own(value, info)):
            return value
        expected = f"Input should be {', '.join(choices)} or {final}"
        raise PydanticCustomError("literal_error", expected)

    return BeforeValidator(check)


def _key_of(names: Iterable[str]) -> BeforeValidator:
    """Validator of a key; those of a user's own model are checked by `load_campaign`."""
    return _one_of(lambda: names, lambda _, info: _model_of(info) is None)


def _model_of(info: ValidationInfo) -> str | None:
    """The campaign's model, if it is one of the package."""
    general = (info.data or {}).get("campaign")
    name = general.model if isinstance(general, General) else General().model
    return name if name in models.MODELS else None


def _understood(parse: Callable[[str], object]) -> AfterValidator:
    """Validator of a text that `parse` must understand; it stays text."""

    def check(text: str) -> str:
        try:
            parse(text)
        except UnitError as error:
            raise ValueError(str(error)) from error
        return text

    return AfterValidator(check)


def _quantity(dimension: str) -> BeforeValidator:
    """Validator of a number in the internal unit, or a text with a unit of the dimension."""

    def read(value: object) -> object:
        try:
            return parse_quantity(value, dimension) if isinstance(value, str) else value
        except UnitError as error:
            raise ValueError(str(error)) from error

    return BeforeValidator(read)


def _kind_of_actuation(value: object) -> str:
    if value is None:
        return ":none"
    return ":quantity" if isinstance(value, str) else ":column"


def _share(value: object) -> object:
    percent = _PERCENT.fullmatch(value.strip()) if isinstance(value, str) else None
    return float(percent[1]) / 100.0 if percent else value


def _uncertainty(value: object) -> float:
    """A standard uncertainty as a share, of a number or of a text such as "0.5 %"."""
    share = _share(value)
    if isinstance(share, float) and 0.0 < share < MOST_UNCERTAIN:
        return share
    raise ValueError(
        'a standard uncertainty is a share such as "0.5 %" or 0.005, above 0 and below '
        f"{MOST_UNCERTAIN:.0%}"
    )


def _day(value: object) -> object:
    """A date of TOML, or a text such as "2024-03-05", as text."""
    if isinstance(value, date):
        return value.isoformat()[:10]
    try:
        return date.fromisoformat(str(value)).isoformat()
    except ValueError:
        raise ValueError("a date reads 2024-03-05 (year, month, day)") from None


def _celsius(value: object) -> object:
    """A number in °C, or a text such as "20 °C", "68 °F" or "293 K"."""
    if not isinstance(value, str):
        return value
    read = _TEMPERATURE.fullmatch(value.strip())
    if read is None:
        raise ValueError('a temperature reads "20 °C", "68 °F" or "293 K"')
    number = float(read[1])
    return {"C": number, "F": (number - 32.0) / 1.8, "K": number - 273.15}[read[2]]


def _all_dependences(dependences: Mapping[str, Any], info: ValidationInfo) -> dict[str, Any]:
    """Covariates of each quantity of the model; "Fc" stands for both directions."""
    gap = "d2" if _model_of(info) == "three_stage" else "gap"
    expanded: dict[str, Any] = {}
    for name, covariates in dependences.items():
        for quantity in {"Fc": ("Fc_fwd", "Fc_bwd"), "gap": (gap,)}.get(name, (name,)):
            expanded[quantity] = tuple(dict.fromkeys((*expanded.get(quantity, ()), *covariates)))
    return {name: covariates for name, covariates in expanded.items() if covariates}


def check_id(name: str) -> str:
    """A test's id, unchanged; raises ValueError where it cannot be the name of a folder."""
    if not _ID.fullmatch(name):
        raise ValueError(
            "a test's id names a folder: letters, digits and . _ - + only, at most 100 of them, "
            "and no dot first"
        )
    if name.lower() in RESERVED:
        raise ValueError(f"a test's id cannot be {name!r}: a run uses that name for itself")
    return name


def _once(names: tuple[str, ...]) -> tuple[str, ...]:
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ValueError(f"each of them may be there once, and {twice[0]!r} is there twice")
    return names


def _all_laws(law_names: dict[str, LawName], info: ValidationInfo) -> dict[str, Any]:
    """Law of every sampled quantity; a law that is tied to another may not differ from it."""
    if _model_of(info) is None:
        return dict(law_names)
    laws = complete_laws(law_names)
    for model in models.MODELS.values():
        for name, source in model.shared_laws.items():
            if laws[name] != laws[source]:
                raise ValueError(
                    f"{name} must have the law of {source} ({laws[source]!r}), since it follows "
                    f"{source}; got {laws[name]!r}"
                )
    return {name: laws[name] for name in default_laws()}


Id = Annotated[str, AfterValidator(check_id)]
ModelName = Annotated[
    str,
    Field(max_length=1000),
    _one_of(
        lambda: ("my_file.py:MyClass", *models.model_names()), lambda name, _: models.file_of(name)
    ),
]
NoiseName = Annotated[str, _one_of(lambda: NOISES)]
SampleRate = Annotated[str, _understood(lambda text: step_of(text, "rate"))]
Text = Annotated[str, Field(max_length=100)]
QuantityText = Annotated[str, Field(max_length=200)]
Path1000 = Annotated[str, Field(min_length=1, max_length=1000)]
Tolerance = Annotated[float, Field(gt=0, strict=True), BeforeValidator(_share)]
Limit = Annotated[float, Field(gt=0, lt=1, strict=True), BeforeValidator(_share)]
Uncertainty = Annotated[float, BeforeValidator(_uncertainty)]
Covariates = Annotated[
    tuple[Literal["velocity", "amplitude", "date", "cycles", "temperature"], ...],
    AfterValidator(_once),
]


class TomlTable(BaseModel):
    """A table of a campaign file; unknown keys, NaN and infinity are errors."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


class Column(TomlTable):
    """A column of a test file."""

    name: Annotated[str, Field(min_length=1, max_length=NAME)] | None = None
    """its name"""
    column: Annotated[int, Field(ge=1, le=COLUMNS, strict=True)] | None = None
    """in place of `name`: its number, from 1"""
    unit: Annotated[str, Field(max_length=60)] | None = None
    """its unit; may be left out where the name ends in it, as `force_kip`"""

    @model_validator(mode="after")
    def _named_once(self) -> Self:
        ways = [getattr(self, way, None) for way in ("name", "column", "rate")]
        if len(ways) - ways.count(None) != 1:
            raise ValueError(
                "a column is given either by its name or, as column = 1, by its number, or a time "
                "by its rate"
            )
        return self

    @property
    def key(self) -> str | int:
        """Its name or its number."""
        return self.name if self.name is not None else int(self.column or 0)

    @property
    def source(self) -> Source:
        """The column as records are read."""
        exclude = {"name", "column", "unit", "minus", *CALIBRATION_KEYS}
        options = self.model_dump(exclude=exclude, exclude_none=True)
        subtrahend = getattr(self, "minus", None)
        minus = (
            None
            if subtrahend is None
            else Subtracted(subtrahend.key, subtrahend.unit, subtrahend.times)
        )
        return Source(None if options.get("rate") else self.key, self.unit, minus, **options)


class TimeColumn(Column):
    """A column of times, or in its place the rate at which samples were taken."""

    rate: SampleRate | None = None
    """in place of a column: `"100 Hz"`, or the step, `"10 ms"`"""
    dates: Literal["day first", "month first"] | None = None
    """order in time stamps such as `05/03/2024 23:59:59`, where both orders are possible and
    the date changes"""


class SignedColumn(Column):
    """A column whose sign may be turned."""

    sign: Literal[1, -1] = 1
    """`-1` turns the sign; `mfd-bayes init` writes it for the force where loops run backward"""


class Minus(Column):
    """A column that is subtracted from another, times a quantity."""

    times: QuantityText = ""
    """the quantity, `"518.7 mm^2"`"""


class DisplacementColumn(SignedColumn):
    """A displacement, and what is corrected in it."""

    minus: Minus | None = None
    """a column that is subtracted, times a quantity: `{ name = "pressure", times = "518.7 mm^2"
    }`"""
    tare: QuantityText = ""
    """the reading at zero, `"12 N"`, which is subtracted; or a window in which the true value
    is zero on average, `"0 s to 2 s"`"""
    arm: QuantityText = ""
    """`"4 in"`: of an angle, the travel is the angle times the arm; of a torque, the force is
    the torque over it"""
    measured_at: QuantityText = ""
    """with `arm`: a travel or a force was measured at this radius, and is converted to that at
    the arm"""
    uncertainty: Uncertainty | None = None
    """standard uncertainty of the gain of the instrument, by its calibration, as a share (`0.005`)
    or `"0.5 %"`; by default that of the prior file, else none"""
    arm_uncertainty: Uncertainty | None = None
    """that of the `arm`, likewise; force and displacement that have the same arm share it"""
    instrument: Text = ""
    """name of the instrument, `"load cell 2"`; tests with the same one share its deviation"""

    @model_validator(mode="after")
    def _of_an_arm(self) -> Self:
        if self.arm_uncertainty is not None and not self.arm:
            raise ValueError('arm_uncertainty needs an arm such as "4 in", of which it is')
        return self


class ForceColumn(DisplacementColumn):
    """A force, and what is corrected in it."""

    minus_mass: QuantityText = ""
    """`"3 kg"`: mass times acceleration is subtracted; the acceleration comes from a cubic
    fitted to a tenth of a half-cycle (Savitzky–Golay)"""


class Columns(TomlTable):
    """The column of each role in a test file."""

    time: TimeColumn | None = None
    """must increase; where time has a gap, the longest unbroken piece is used. Time stamps are
    read too: `2024-03-05 10:00:00.050`, `03/05/2024 10:00:00 AM`, `10:00:00.050`; the first
    row is 0 s"""
    rate: SampleRate | None = None
    """in place of `time`, where a file has no column of times: `"100 Hz"`, or the step, `"10
    ms"`; also as `time = { rate = "100 Hz" }`"""
    displacement: DisplacementColumn | None = None
    """displacement of the damper's rod"""
    force: ForceColumn | None = None
    """may be absent only if the test is neither fitted nor scored"""
    velocity: SignedColumn | None = None
    """computed from the displacement if it is absent"""

    @model_validator(mode="after")
    def _time_or_rate(self) -> Self:
        if self.rate is not None and self.time is not None:
            raise ValueError("a time is given either by its column or by a rate")
        return self

    @property
    def given(self) -> dict[str, Column]:
        """Role to column, of those that are given."""
        time = self.time if self.rate is None else TimeColumn(rate=self.rate)
        columns = {"time": time, **{r: getattr(self, r) for r in _MEASURED}}
        return {role: column for role, column in columns.items() if column is not None}


_MEASURED = ("displacement", "force", "velocity")


class General(TomlTable):
    """The table `[campaign]`."""

    title: Annotated[str, Field(max_length=1000)] = ""
    """title of the report; the file's name if it is empty"""
    priors: Path1000 = "mfd"
    """a family of the package (`"mfd"`, `"brfd"`), or the path of a prior file, relative to the
    campaign file and inside its folder"""
    model: ModelName = "three_stage"
    """or `"lugre"`, `"bouc_wen"`, `"backlash"`; or a model of your own, which is run:
    `"my_damper.py:Viscous"`, a class in a file in the campaign's folder, or the entry point of an
    installed package"""
    noise: NoiseName = "ou"
    """or `"iid"`, `"student_t"`, `"staged"`"""
    rate: Annotated[float, Field(gt=0, strict=True), _quantity("rate")] | None = None
    """sampling rate to which records are thinned, a number in Hz or `"64 Hz"`; by default a
    rate that resolves the gap"""
    initial: Literal["sample", "discard"] = "sample"
    """the position in the gap at the first sample is inferred; `"discard"` leaves out the samples
    before the first slip instead"""
    area: Annotated[float, Field(ge=1e-10, le=1e10, strict=True), _quantity("area")] | None = None
    """area of the actuator, a number in in² or `"1.5 in^2"` (1e-10 to 1e10 in²), for the
    self-energizing factors; with pressures only"""


class TestTable(TomlTable):
    """One `[[test]]`."""

    __test__ = False

    id: Id
    """name of its folder in the run: letters, digits and `. _ - +`, at most 100, unique
    whatever the case"""
    file: Path1000
    """relative to the campaign file, and inside its folder"""
    actuation: Annotated[
        Annotated[str, _understood(parse_actuation), Tag(":quantity")]
        | Annotated[Column, Tag(":column")]
        | Annotated[None, Tag(":none")],
        Discriminator(_kind_of_actuation),
    ] = None
    """`"500 psi"`, `"30 lbf"`, `"0 psi"` (not for all tests), or `{ name = "pressure", unit =
    "MPa" }` for a measured history; also in A, V, W, N*m, T, K, %, turns, degrees, clicks,
    notches or steps: laws, tables and figures are in that unit. Left out, in all tests, where
    nothing in a model of your own follows it"""
    rate: SampleRate | None = None
    """in place of a column of times: `"100 Hz"`, or the step, `"10 ms"`"""
    window: QuantityText | None = None
    """the part of the record that is used, `"0 s to 60 s"`, in its own time; `"0 to 300"`, in
    samples, where the model is rate-independent"""
    role: Role = "calibrate"
    """or `"validate"`: predicted from the others and scored, never fitted"""
    columns: Columns = Columns()
    """as `[columns]`, for this test only"""
    session: Text = ""
    """tests that were made together, with nothing changed on damper or rig in between; they
    have one deviation from the laws in common"""
    device: Text = ""
    """the device that was tested, `"no. 3"`, where there are several of one make; tests of a device
    have one deviation from the others in common"""
    date: Annotated[str, BeforeValidator(_day)] | None = None
    """day of the test, `2024-03-05`"""
    cycles: Annotated[float, Field(ge=0, strict=True)] | None = None
    """number of cycles that the device had made before"""
    temperature: Annotated[float, Field(ge=-273.15), BeforeValidator(_celsius)] | None = None
    """temperature of the device, a number in °C or `"68 °F"`"""
    after: Text = ""
    """id of the test that was made directly before this one, without a reset of the device in
    between: this one begins where in the gap that one ended"""

    @property
    def conditions(self) -> dict[str, float]:
        """What is known of date (decimal years), cycles and temperature (°C)."""
        day = None if self.date is None else date.fromisoformat(self.date)
        years = None if day is None else day.year + (day.timetuple().tm_yday - 1) / 365.25
        values = {"date": years, "cycles": self.cycles, "temperature": self.temperature}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def actuation_unit(self) -> str:
        """Unit of the actuation as it is given, such as "psi"; "" where the file has it."""
        if isinstance(self.actuation, Column):
            return self.actuation.unit or ""
        return split_quantity(self.actuation or NO_ACTUATION)[1]


class GoalTable(TomlTable):
    """The table `[goal]`."""

    quantity: Annotated[str, Field(min_length=1, max_length=100)] = "band"
    """or `"energy"`, `"peak"`, `"peak_fwd"`, `"peak_bwd"`, `"slip"`, `"gap"`, `"slope"`,
    `"exponent"`"""
    of: Text = ""
    """quantity whose law is meant, for slope and exponent: `"Fc_fwd"`"""
    kind: Literal["mean", "new_test"] = "mean"
    """of the band: `"mean"` for the mean property, `"new_test"` with test-to-test scatter"""
    at: Annotated[tuple[str, ...], Field(max_length=100)] = ()
    """motions and actuations, `["1000 psi, 0.5 Hz, 1 in"]`; none for the campaign's range"""
    probability: Annotated[float, Field(gt=0, lt=1, strict=True)] = 0.95
    """of the band or interval"""
    session: Text = ""
    """session that it is about, where there are several"""
    candidates: Annotated[tuple[str, ...], Field(max_length=2000)] = ()
    """tests to choose from, `["500|1350 psi, 0.5 Hz, 1 in"]`; none for a grid of the campaign's
    range"""
    limits: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """of the actuator: velocity, stroke and force, `"10 in/s, 6 in, 20 kip"`"""


def _quantity_name(name: object) -> object:
    """Name of a quantity that cycles have, unchanged."""
    if name not in cycles.quantities():
        raise ValueError(
            f"there is no quantity {name!r}; {nearest(str(name), cycles.quantities())}"
        )
    return name


def _target_name(name: object) -> object:
    """Name of a quantity, or of a property in one direction, unchanged."""
    return name if cycles.properties_called(str(name)) else _quantity_name(name)


def _target(target: object) -> object:
    """A value with its unit, or a table of it and its tolerance."""
    return {"value": target} if isinstance(target, str | int | float) else target


def _in_unit_of(dimension: str) -> BeforeValidator:
    """Validator of a text that is a positive quantity of a dimension; it stays text."""

    def check(value: object) -> object:
        try:
            size = parse_quantity(value, dimension) if isinstance(value, str) else 0.0
        except UnitError as error:
            raise ValueError(str(error)) from error
        if not size > 0.0:
            example = dimension_of(dimension).quantity
            raise ValueError(f"expected a positive number with its unit such as {example!r}")
        return value

    return BeforeValidator(check)


QuantityName = Annotated[str, BeforeValidator(_quantity_name)]


class FactorRange(TomlTable):
    """Smallest and largest factor on a nominal property."""

    min: Annotated[float, Field(gt=0, le=1, strict=True)] = 1.0
    """at most 1"""
    max: Annotated[float, Field(ge=1, le=10, strict=True)] = 1.0
    """at least 1"""


class Target(TomlTable):
    """What a quantity should be, as the specification has it."""

    value: QuantityText | float
    """with its unit: `"2.4 kip"`"""
    tolerance: Limit | None = None
    """as a share, `"10 %"`; that of the standard, where it is left out"""

    def internal(self, unit: str) -> float:
        """The value in an internal unit."""
        return self.value if isinstance(self.value, float) else parse_quantity(self.value, unit)


class DesignTable(TomlTable):
    """The table `[design]`: a standard, and what the building asks of the device."""

    standard: Path1000
    """`"asce7-22"`, `"asce7-16"`, `"en15129"`, `"ntc2018"`, or a file of your own of the same form,
    inside the campaign's folder"""
    T1: Annotated[QuantityText, _in_unit_of("time")] | None = None
    """period of the building in its first mode, `"0.8 s"`"""
    mce: Annotated[QuantityText, _in_unit_of("displacement")] | None = None
    """largest displacement of the device from its middle, `"2 in"`: in the maximum considered
    earthquake of ASCE 7, d_bd of EN 15129"""
    actuation: Annotated[QuantityText, _understood(parse_actuation)] | None = None
    """actuation at which the targets hold, `"1000 psi"`; needed where several were tested"""
    target: dict[
        Annotated[str, BeforeValidator(_target_name)], Annotated[Target, BeforeValidator(_target)]
    ] = {}
    """value of each quantity, `{ slip_force = "2.4 kip", energy = { value = "8 kip*in", tolerance
    = "10 %" } }`; of one direction as `slip_fwd`"""
    lambda_ae: FactorRange = FactorRange()
    """of ageing and environment, `{ min = 0.9, max = 1.1 }`"""
    lambda_spec: FactorRange = FactorRange()
    """of the specification's tolerance on a device, likewise"""

    @field_validator("target")
    @classmethod
    def _check_target(cls, targets: dict[str, Target]) -> dict[str, Target]:
        for name, target in targets.items():
            unit = cycles.properties_called(name)[0].unit
            if isinstance(target.value, float) != (unit == "1"):
                needed = "is a plain number" if unit == "1" else f"needs a unit such as {unit!r}"
                raise ValueError(f"{name} {needed}")
            try:
                value = target.internal(unit)
            except UnitError as error:
                raise ValueError(f"{name}: {error}") from error
            if not 0.0 < value < 1e6:
                raise ValueError(f"{name} must be positive")
        return targets

    def target_of(self, item: cycles.DeviceProperty) -> Target | None:
        """Target of a property: its own, else that of its quantity."""
        return self.target.get(item.name) or self.target.get(item.quantity)


class Instrument(NamedTuple):
    """What measures "force" or "displacement", by its name; or an "arm", by its length."""

    role: str
    name: str = ""


class CampaignFile(TomlTable):
    """A whole campaign file; the manifest of a run holds it as `settings`."""

    campaign: General = General()
    columns: Columns = Columns()
    laws: Annotated[
        dict[Annotated[str, _key_of(complete_laws({}))], LawName],
        Field(validate_default=True),
        AfterValidator(_all_laws),
    ] = {}
    dependence: Annotated[
        dict[Annotated[str, _key_of(DEPENDENCE)], Covariates],
        AfterValidator(_all_dependences),
    ] = {}
    goal: GoalTable | None = None
    design: DesignTable | None = None
    tolerances: dict[Annotated[str, _one_of(lambda: TOLERANCES)], Tolerance] = {}
    limits: dict[Annotated[str, _one_of(lambda: ACCEPTANCE)], Limit] = {}
    test: Annotated[tuple[TestTable, ...], Field(min_length=1)]

    @property
    def tests(self) -> dict[str, TestTable]:
        """Tests by id."""
        return {test.id: test for test in self.test}

    @property
    def model(self) -> str:
        """Name of the friction model."""
        return self.campaign.model

    @property
    def noise(self) -> str:
        """Name of the noise."""
        return self.campaign.noise

    @property
    def area(self) -> float | None:
        """Area of the actuator, in²."""
        return self.campaign.area

    @property
    def actuation_unit(self) -> ActuationUnit:
        """Internal unit of all actuations, such as "ksi" or "kip"."""
        return actuation_factor(self.test[0].actuation_unit)[1]

    @property
    def sessions(self) -> dict[str, str]:
        """Session of each test, "" where it has none."""
        return {test.id: test.session for test in self.test}

    @property
    def devices(self) -> dict[str, str]:
        """Device of each test, "" where it has none."""
        return {test.id: test.device for test in self.test}

    @property
    def conditions(self) -> dict[str, dict[str, float]]:
        """What is known of the date, the cycles and the temperature of each test."""
        return {test.id: test.conditions for test in self.test}

    @property
    def order(self) -> dict[str, str]:
        """The test that each follows without a reset, of those that follow one."""
        return {test.id: test.after for test in self.test if test.after}

    def columns_of(self, test: TestTable) -> dict[str, Column]:
        """Role to column of a test: its own, else that of the campaign; an actuation's too."""
        columns = self.columns.given | test.columns.given
        if test.rate is not None:
            columns["time"] = TimeColumn(rate=test.rate)
        if isinstance(test.actuation, Column):
            columns["actuation"] = test.actuation
        return columns

    def stated_uncertainties(self) -> Iterator[tuple[str, Instrument, float]]:
        """Test, instrument and standard uncertainty of each column that states one."""
        for test in self.test:
            for role, column in self.columns_of(test).items():
                if isinstance(column, DisplacementColumn):
                    if column.uncertainty is not None:
                        yield test.id, Instrument(role, column.instrument), column.uncertainty
                    if column.arm_uncertainty is not None:
                        yield test.id, Instrument("arm", column.arm), column.arm_uncertainty

    def with_test(self, name: str, **changes: Any) -> Self:
        """The file with changed keys of a test."""
        tests = [t.model_copy(update=changes) if t.id == name else t for t in self.test]
        return self.model_copy(update={"test": tuple(tests)})

    def inference(self, effort: str, seed: Sequence[int], jobs: int = 1) -> InferenceSettings:
        """Settings of the inference of the population."""
        from mfd_bayes.population.inference import InferenceSettings

        return InferenceSettings(
            *(self.laws, self.actuation_unit, effort, seed, self.dependence, self.sessions, jobs),
            devices=self.devices,
            conditions=self.conditions,
        )


def complete_tolerances(tolerances: Mapping[str, float] | None) -> dict[str, float]:
    """Every tolerance, as given or by default."""
    return {name: default for name, (default, _) in TOLERANCES.items()} | dict(tolerances or {})


TABLES: Mapping[str, type[TomlTable]] = MappingProxyType(
    {
        "": CampaignFile,
        "campaign": General,
        "columns": Columns,
        "goal": GoalTable,
        "design": DesignTable,
        "lambda_ae": FactorRange,
        "lambda_spec": FactorRange,
        "test": TestTable,
        "actuation": Column,
        "time": TimeColumn,
        "displacement": DisplacementColumn,
        "force": ForceColumn,
        "velocity": SignedColumn,
        "minus": Minus,
    }
)
"""Tables of a campaign file by their own name, but for laws, dependence, tolerances, limits."""


def keys_of(table: str) -> dict[str, tuple[str, str]]:
    """Default, as TOML, and meaning of each key of a table; "" is the file itself."""
    if table == "laws":
        defaults = {name: f'`"{law}"`' for name, law in complete_laws({}).items()}
        for model in models.MODELS.values():
            tied = {**model.laws_from, **model.shared_laws}
            defaults |= {name: f"that of `{source}`" for name, source in tied.items()}
        return {name: (default, LAWS.get(name, "")) for name, default in defaults.items()}
    if table == "dependence":
        return {name: ("`[]`", meaning) for name, meaning in DEPENDENCE.items()}
    if table == "limits":
        default = dict.fromkeys(ACCEPTANCE, "none") | {"all": '`"15 %"`'}
        return {name: (default[name], meaning) for name, meaning in ACCEPTANCE.items()}
    if table == "tolerances":
        return {name: (f"`{share:g}`", meaning) for name, (share, meaning) in TOLERANCES.items()}

    def shown(default: object) -> str:
        if default is None:
            return "none"
        if isinstance(default, str):
            return f'`"{default}"`'
        if isinstance(default, tuple):
            return "`[]`"
        return "`{}`" if isinstance(default, TomlTable) else f"`{default}`"

    fields = TABLES[table].model_fields
    return {
        name: (
            "required" if f.is_required() else shown(f.default),
            " ".join(str(f.description).split()),
        )
        for name, f in fields.items()
    }
