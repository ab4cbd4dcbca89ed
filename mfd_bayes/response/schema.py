"""The keys of a building file, and which values each may have."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from mfd_bayes.errors import UnitError
from mfd_bayes.response.measures import parse_acceleration, parse_mass, parse_share
from mfd_bayes.units import GRAVITY, parse_actuation, parse_quantity


def _text(parse: Callable[[str], float]) -> BeforeValidator:
    """Validator of a text with a number and a unit."""

    def validate(value: object) -> float:
        if not isinstance(value, str):
            raise ValueError(f"give a number and a unit in quotes, got {value!r}")
        try:
            return parse(value)
        except UnitError as error:
            raise ValueError(str(error)) from error

    return BeforeValidator(validate)


def _of(dimension: str) -> BeforeValidator:
    return _text(lambda text: parse_quantity(text, dimension))


def _share(value: object) -> object:
    if not isinstance(value, str):
        return value
    try:
        return parse_share(value)
    except UnitError as error:
        raise ValueError(str(error)) from error


def _rigid(value: object) -> object:
    return None if value == "rigid" else value


_SMALL, _LARGE = 1e-12, 1e12

Mass = Annotated[float, Field(gt=0.0, le=_LARGE), _text(parse_mass)]
Weight = Annotated[float, Field(gt=0.0, le=_LARGE), _of("force")]
Length = Annotated[float, Field(gt=0.0, le=_LARGE), _of("displacement")]
Stiffness = Annotated[float, Field(gt=0.0, le=_LARGE), _of("stiffness")]
Force = Annotated[float, Field(gt=0.0, le=_LARGE), _of("force")]
Dashpot = Annotated[float, Field(ge=0.0, le=_LARGE), _of("damping")]
Acceleration = Annotated[float, Field(gt=0.0, le=_LARGE), _text(parse_acceleration)]
Share = Annotated[float, Field(gt=0.0, le=_LARGE), BeforeValidator(_share)]
Ratio = Annotated[float, Field(ge=0.0, lt=1.0), BeforeValidator(_share)]


def _checked_actuation(text: str) -> str:
    try:
        parse_actuation(text)
    except UnitError as error:
        raise ValueError(str(error)) from error
    return text


Actuation = Annotated[
    str, BeforeValidator(lambda v: _checked_actuation(v) if isinstance(v, str) else v)
]


class Part(BaseModel):
    """A table of a building file; unknown keys, NaN and infinity are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Damping(Part):
    """Damping of the structure itself."""

    kind: Literal["rayleigh", "modal", "none"] = "rayleigh"
    ratio: Ratio = 0.02
    modes: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]] = (1, 2)


class Storey(Part):
    """A storey and the floor above it; the first is the lowest."""

    mass: Mass | None = None
    weight: Weight | None = None
    height: Length | None = None
    stiffness: Stiffness
    yield_force: Force | None = None
    dashpot: Dashpot = 0.0

    @model_validator(mode="after")
    def _one_mass(self) -> Storey:
        if (self.mass is None) == (self.weight is None):
            raise ValueError("give either mass or weight of the floor")
        return self

    @property
    def inertia(self) -> float:
        """Mass of the floor, kip s²/in."""
        return self.mass if self.mass is not None else (self.weight or 0.0) / GRAVITY


class Matrices(Part):
    """A structure by its matrices, from CSV or .npy files beside the building file."""

    mass: str
    stiffness: str
    damping: str | None = None
    units: dict[Literal["mass", "stiffness", "damping"], str] = {}
    influence: tuple[float, ...] | None = None
    heights: tuple[Length, ...] | None = None


class History(Part):
    """An actuation that changes in time, from a file with a column of the time."""

    file: str
    column: str
    unit: str


class Damper(Part):
    """One damper, or several at one place."""

    storey: Annotated[int, Field(ge=1)] | None = None
    between: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]] | None = None
    count: Annotated[int, Field(ge=1, le=100)] = 1
    actuation: Actuation | tuple[Actuation, ...] | History
    geometry: Annotated[float, Field(gt=0.0, le=1e6)] = 1.0
    brace: Annotated[Stiffness | None, BeforeValidator(_rigid)] = None

    @model_validator(mode="after")
    def _one_place(self) -> Damper:
        if (self.storey is None) == (self.between is None):
            raise ValueError("give either storey, or between = [upper, lower] of two floors")
        if isinstance(self.actuation, tuple) and len(self.actuation) != self.count:
            raise ValueError(
                f"actuation must have one value, or one for each of the {self.count} dampers"
            )
        return self


class Limits(Part):
    """Limits whose probability of being passed is wanted."""

    drift: Share | None = None
    acceleration: Acceleration | None = None
    base_shear: Force | None = None
    travel: Length | None = None
    residual: Share | None = None


class About(Part):
    """What the building is."""

    title: Annotated[str, Field(max_length=200)] = "Building"
    damping: Damping = Damping()


class Content(Part):
    """A whole building file."""

    building: About = About()
    storey: tuple[Storey, ...] = ()
    matrices: Matrices | None = None
    damper: tuple[Damper, ...] = ()
    limits: Limits = Limits()

    @model_validator(mode="after")
    def _one_structure(self) -> Content:
        if bool(self.storey) == (self.matrices is not None):
            raise ValueError("give either [[storey]] tables or [matrices]")
        return self


TABLES: dict[str, type[Part]] = {
    "": Content,
    "building": About,
    "damping": Damping,
    "storey": Storey,
    "matrices": Matrices,
    "damper": Damper,
    "actuation": History,
    "limits": Limits,
}


def known_keys(table: str) -> list[str]:
    """Keys of a table of a building file; "" is the file itself."""
    kind: Any = TABLES.get(table, Content)
    return list(kind.model_fields)
