"""The keys of a building file, and which values each may have."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Annotated, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    model_validator,
)

from mfd_bayes.errors import BuildingError, UnitError
from mfd_bayes.response.ground import parse_acceleration
from mfd_bayes.store.files import TomlError, faults_text, read_toml
from mfd_bayes.units import GRAVITY, parse_actuation, parse_quantity


def _quantity(what: str) -> Callable[[str], float]:
    return lambda text: parse_quantity(text, what)


def _mass(text: str) -> float:
    try:
        return parse_quantity(text, "mass")
    except UnitError as error:
        raise UnitError(
            f"expected a mass such as '45 Mg' or '0.26 kip*s^2/in', got {text!r}"
        ) from error


def _share(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return parse_quantity(text, "dimensionless")


def _read(parse: Callable[[str], object], *, only_text: bool = True) -> BeforeValidator:
    """Validator of a text with a number and a unit; other values are refused, or left alone."""

    def validate(value: object) -> object:
        if not isinstance(value, str):
            if only_text:
                raise ValueError(f"give a number and a unit in quotes, got {value!r}")
            return value
        try:
            return parse(value)
        except UnitError as error:
            raise ValueError(str(error)) from error

    return BeforeValidator(validate)


def _checked_actuation(text: str) -> str:
    parse_actuation(text)
    return text


_ABOVE = Field(gt=0.0, le=1e12)
Mass = Annotated[float, _ABOVE, _read(_mass)]
Length = Annotated[float, _ABOVE, _read(_quantity("displacement"))]
Stiffness = Annotated[float, _ABOVE, _read(_quantity("stiffness"))]
Force = Annotated[float, _ABOVE, _read(_quantity("force"))]
Dashpot = Annotated[float, Field(ge=0.0, le=1e12), _read(_quantity("damping"))]
Acceleration = Annotated[float, _ABOVE, _read(parse_acceleration)]
Share = Annotated[float, _ABOVE, _read(_share, only_text=False)]
Ratio = Annotated[float, Field(ge=0.0, lt=1.0), _read(_share, only_text=False)]
Actuation = Annotated[str, _read(_checked_actuation, only_text=False)]
Positive = Annotated[int, Field(ge=1)]
Floor = Annotated[int, Field(ge=0)]


class Part(BaseModel):
    """A table of a building file; unknown keys, NaN and infinity are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Damping(Part):
    """Damping of the structure itself."""

    kind: Literal["rayleigh", "modal", "none"] = "rayleigh"
    ratio: Ratio = 0.02
    modes: tuple[Positive, Positive] = (1, 2)


class Storey(Part):
    """A storey and the floor above it; the first is the lowest."""

    mass: Mass | None = None
    weight: Force | None = None
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


def _kind(value: object) -> str:
    return ":table" if isinstance(value, dict) else ":list" if isinstance(value, list) else ":text"


class Damper(Part):
    """One damper, or several at one place."""

    storey: Positive | None = None
    between: tuple[Floor, Floor] | None = None
    count: Annotated[int, Field(ge=1, le=100)] = 1
    actuation: Annotated[
        Annotated[Actuation, Tag(":text")]
        | Annotated[tuple[Actuation, ...], Tag(":list")]
        | Annotated[History, Tag(":table")],
        Discriminator(_kind),
    ]
    geometry: Annotated[float, Field(gt=0.0, le=1e6)] = 1.0
    brace: Annotated[Stiffness | None, BeforeValidator(lambda v: None if v == "rigid" else v)] = (
        None
    )

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
    """Limits whose probability of being passed is computed."""

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


KEYS: dict[str, Collection[str]] = {
    "": Content.model_fields,
    "building": About.model_fields,
    "damping": Damping.model_fields,
    "storey": Storey.model_fields,
    "matrices": Matrices.model_fields,
    "units": ("mass", "stiffness", "damping"),
    "damper": Damper.model_fields,
    "actuation": History.model_fields,
    "limits": Limits.model_fields,
}
"""Keys that each table may have; "" is the file itself."""


def read_content(path: Path) -> Content:
    """Content of a building file.

    Raises
    ------
    BuildingError
        When the file cannot be read or is not TOML, or a key is unknown, missing or has a value
        that it may not have.
    """
    try:
        raw = read_toml(path)
        return Content.model_validate(raw)
    except OSError as error:
        raise BuildingError(f"cannot read {path}: {error.strerror or error}") from error
    except TomlError as error:
        raise BuildingError(f"{path} {error}") from error
    except ValidationError as error:
        raise BuildingError(
            faults_text(path, raw, error, lambda tables: KEYS[("", *tables)[-1]])
        ) from None
